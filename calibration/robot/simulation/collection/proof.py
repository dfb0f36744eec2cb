"""Proof of a dataset: it is calibrated and the result is compared with the ground truth."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from calibration.base.errors import CalibrationError
from calibration.base.records import field, result
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.truth import choose_truth
from calibration.engine.diagnosis.check_data import check_data
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.evaluation.truth import TruthError, truth_error


@result
class SensorSigma:
    """Standard deviation of one transform, by the calibration's own covariance."""

    translation_mm: float = field("Norm of three axes.", unit="mm")
    rotation_deg: float = field("Norm of three axes.", unit="deg")


@result
class JointProof:
    """Calibrated parameter of a joint, m or rad."""

    joint: str = field("Its name.")
    parameter: str = field("Which of its parameters.")
    unit: Literal["m", "rad"] = field("Of all numbers.")
    value: float = field("The calibrated value.")
    sigma: float = field("Standard deviation.")
    error: float | None = field("Its size against the truth, where that is known.")


@result
class Proof:
    """Calibration of a dataset, compared with the truth. Numbers are null if there is no result."""

    converged: bool = field("Whether an optimum was found.")
    reason: str = field("Reason why it did not converge; empty if it did.")
    rms_px: float | None = field("RMS of the reprojection errors.", unit="px", default=None)
    translation_mm: float | None = field("Worst error of a calibrated sensor against the truth.", default=None)
    rotation_deg: float | None = field("Likewise.", default=None)
    sigmas: Mapping[str, SensorSigma] | None = field("By sensor, of the transforms that were free.", default=None)
    weak_directions: tuple[str, ...] = field("Directions that the data hardly determine.", default=())
    joints: tuple[JointProof, ...] | None = field(
        "Free parameters of joints; absent if there are none.", default=None, omitted=True
    )

    @property
    def joint_mm(self) -> float | None:
        """Largest error of the joints' parameters that are lengths."""
        worst = self._largest_joint_error("m")
        return None if worst is None else round(1e3 * worst, 4)

    @property
    def joint_deg(self) -> float | None:
        """Largest error of the joints' parameters that are angles."""
        worst = self._largest_joint_error("rad")
        return None if worst is None else round(math.degrees(worst), 6)

    def _largest_joint_error(self, unit: str) -> float | None:
        errors = (each.error for each in self.joints or () if each.unit == unit and each.error is not None)
        return max(errors, default=None)


def prove(folder: Path, truth: str | None = None) -> Proof:
    """Calibrate the dataset in a folder from the linear initial guess, and compare with a truth (see `choose_truth`).

    A dataset that cannot be calibrated is a result, not an error.
    """
    try:
        return prove_dataset(read_dataset(folder), truth)
    except CalibrationError as error:
        return Proof(False, str(error).replace(f"{folder}/", ""))  # the folder is temporary


def prove_dataset(dataset: Dataset, choice: str | None = None) -> Proof:
    """Calibrate a dataset like `prove`.

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
        rms_px=_round_finite(found.rms_px, 4),
        translation_mm=_round_finite(error.translation_mm, 4) if error else None,
        rotation_deg=_round_finite(error.rotation_deg, 6) if error else None,
        sigmas={
            name: SensorSigma(
                round(found.label_sigma_mm(edge), 4), round(float(np.degrees(found.label_sigma_mrad(edge) / 1e3)), 6)
            )
            for name, edge in sensors.items()
        }
        if found.converged
        else None,
        weak_directions=found.weak_directions,
        joints=(tuple(_joint_proofs(found, error)) or None) if found.converged else None,
    )


def _joint_proofs(found: Calibration, error: TruthError | None) -> Iterator[JointProof]:
    errors = {(each.joint, each.parameter): each.error for each in error.joints} if error else {}
    for name, joint in found.joints.items():
        numbers = zip(joint.parameters, joint.units, joint.values.tolist(), joint.label_sigmas.tolist(), strict=True)
        for parameter, unit, value, sigma in numbers:
            off = errors.get((name, parameter))
            yield JointProof(
                name, parameter, unit, round(value, 6), round(sigma, 8), None if off is None else round(off, 8)
            )


def _round_finite(value: float, decimals: int) -> float | None:
    return round(float(value), decimals) if np.isfinite(value) else None
