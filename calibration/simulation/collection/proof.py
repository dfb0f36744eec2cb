"""The proof of a dataset: does it calibrate, and to the truth?"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.dataset.model import Dataset
from calibration.dataset.reading import read_dataset
from calibration.dataset.truth import choose_truth
from calibration.diagnosis.check_data import check_data
from calibration.errors import CalibrationError
from calibration.estimation.calibrate import calibrate
from calibration.estimation.result import Calibration
from calibration.evaluation.truth import TruthError, truth_error


@dataclass(frozen=True)
class SensorSigma:
    """How sure a calibration is of one transform, by its own covariance."""

    translation_mm: float
    rotation_deg: float


@dataclass(frozen=True)
class JointProof:
    """What a calibration found of one parameter of a joint, m or rad."""

    joint: str
    parameter: str
    unit: str
    value: float
    sigma: float
    error: float | None
    """Its size against the truth, where that is known."""


@dataclass(frozen=True)
class Proof:
    """What a calibration of a dataset found. Numbers are None where there is none."""

    converged: bool
    reason: str
    """Why it did not converge; empty where it did."""
    rms_px: float | None = None
    """Of the reprojected corners."""
    translation_mm: float | None = None
    """The worst error of a calibrated sensor against the truth."""
    rotation_deg: float | None = None
    sigmas: dict[str, SensorSigma] | None = None
    """By sensor, of the transforms that were free."""
    weak_directions: tuple[str, ...] = ()
    joints: tuple[JointProof, ...] = ()
    """The parameters of joints that were free."""

    @property
    def joint_mm(self) -> float | None:
        """The worst error of the joints' parameters that are lengths."""
        worst = self._worst("m")
        return None if worst is None else round(1e3 * worst, 4)

    @property
    def joint_deg(self) -> float | None:
        """The worst error of those that are angles."""
        worst = self._worst("rad")
        return None if worst is None else round(math.degrees(worst), 6)

    def _worst(self, unit: str) -> float | None:
        return max((each.error for each in self.joints if each.unit == unit and each.error is not None), default=None)


def prove(folder: Path, truth: str | None = None) -> Proof:
    """Calibrate the dataset in a folder from its linear start, and compare with a truth (see `choose_truth`).

    A dataset that cannot be calibrated is an answer, not an error.
    """
    try:
        return prove_dataset(read_dataset(folder), truth)
    except CalibrationError as error:
        return Proof(False, str(error).replace(f"{folder}/", ""))  # it will be elsewhere when this is read


def prove_dataset(dataset: Dataset, choice: str | None = None) -> Proof:
    """`prove` for a dataset that was read.

    Raises:
        CalibrationError: it cannot be calibrated.
    """
    check_data(dataset)
    found = calibrate(dataset)
    truth = choose_truth(dataset, choice)
    error = truth_error(found.dataset, truth) if truth is not None and found.converged else None
    sensors = {s.name: s.edge for s in dataset.sensors.values() if s.edge in found.covariances}
    return Proof(
        converged=found.converged,
        reason=found.reason,
        rms_px=_rounded(found.rms_px, 4),
        translation_mm=_rounded(error.translation_mm, 4) if error else None,
        rotation_deg=_rounded(error.rotation_deg, 6) if error else None,
        sigmas={
            name: SensorSigma(
                round(found.label_sigma_mm(edge), 4), round(float(np.degrees(found.label_sigma_mrad(edge) / 1e3)), 6)
            )
            for name, edge in sensors.items()
        }
        if found.converged
        else None,
        weak_directions=found.weak_directions,
        joints=tuple(_joints(found, error)) if found.converged else (),
    )


def _joints(found: Calibration, error: TruthError | None) -> Iterator[JointProof]:
    errors = {(each.joint, each.parameter): each.error for each in error.joints} if error else {}
    for name, joint in found.joints.items():
        numbers = zip(joint.parameters, joint.units, joint.values.tolist(), joint.sigmas.tolist(), strict=True)
        for parameter, unit, value, sigma in numbers:
            off = errors.get((name, parameter))
            yield JointProof(
                name, parameter, unit, round(value, 6), round(sigma, 8), None if off is None else round(off, 8)
            )


def _rounded(value: float, decimals: int) -> float | None:
    return round(float(value), decimals) if np.isfinite(value) else None
