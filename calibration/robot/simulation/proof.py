"""Proof of a dataset: it is calibrated and the result is compared with the ground truth."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from calibration.base import CalibrationError
from calibration.base.records import field, result
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.check_data import check_data
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import ALL_EXACT, Assumptions, Options
from calibration.engine.evaluation.truth import Truth, TruthError, choose_truth, truth_error, with_true_values
from calibration.engine.geometry.transforms import local
from calibration.engine.statistics import MOST_FREEDOM, score_of_f, squared_mahalanobis


@result
class SensorSigma:
    """Standard deviation of one transform: the noise of its labels, and how far its collections disagree."""

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
    error_sigmas: float | None = field(
        "Worst error of a calibrated sensor in its stated standard deviations: the root mean square over the six "
        "directions of its covariance, 1 on average.",
        default=None,
    )
    chance: float | None = field("Probability that chance makes it as large.", default=None)
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


def prove(folder: Path, truth: str | None = None, assume: Assumptions = ALL_EXACT) -> Proof:
    """Calibrate the dataset in a folder from the linear initial guess, and compare with a truth (see `choose_truth`).

    A dataset that cannot be calibrated is a result, not an error.

    Args:
        folder: folder of the dataset.
        truth: see `choose_truth`.
        assume: how well is known what the simulated world has otherwise than the dataset says.
    """
    try:
        return prove_dataset(read_dataset(folder), truth, assume)
    except CalibrationError as error:
        return Proof(False, str(error).replace(f"{folder}/", ""))  # the folder is temporary


def prove_dataset(dataset: Dataset, choice: str | None = None, assume: Assumptions = ALL_EXACT) -> Proof:
    """Calibrate a dataset like `prove`.

    Raises:
        CalibrationError: it cannot be calibrated.
    """
    check_data(dataset)
    found = calibrate(dataset, Options(assume=assume))
    truth = choose_truth(dataset, choice)
    error = truth_error(found.dataset, truth) if truth is not None and found.converged else None
    sigmas, chance = _error_in_sigmas(found, truth) if truth is not None and found.converged else (None, None)
    sensors = {s.name: s.edge for s in dataset.sensors.values() if s.edge in found.covariances}
    return Proof(
        converged=found.converged,
        reason=found.reason,
        rms_px=_round_finite(found.rms_px, 4),
        translation_mm=_round_finite(error.translation_mm, 4) if error else None,
        rotation_deg=_round_finite(error.rotation_deg, 6) if error else None,
        sigmas={
            name: SensorSigma(round(found.sigma_mm(edge), 4), round(float(np.degrees(found.sigma_mrad(edge) / 1e3)), 6))
            for name, edge in sensors.items()
        }
        if found.converged
        else None,
        error_sigmas=sigmas,
        chance=chance,
        weak_directions=found.weak_directions,
        joints=(tuple(_joint_proofs(found, error)) or None) if found.converged else None,
    )


def _error_in_sigmas(found: Calibration, truth: Truth) -> tuple[float | None, float | None]:
    """Return `Proof.error_sigmas` and `Proof.chance`; None if no transform is free.

    Collections that disagree tell one factor of the covariance. It is known as well as if each of them told one number,
    since what moves between the sensors' measurements moves all labels of a collection alike: the squared error over 6
    is F-distributed with 6 and as many degrees of freedom as there are effective collections, less one.
    """
    true, bars = with_true_values(found.dataset, truth), found.error_bars
    agree = bars is None or all(np.array_equal(bars.total[block], each) for block, each in bars.expected.items())
    freedom = MOST_FREEDOM if agree or bars is None else max(bars.effective_collections - 1, 1.0)
    gauge = found.dataset.sensors[found.gauge].frame if found.gauge else None
    squares = []
    for edge in (sensor.edge for sensor in found.dataset.sensors.values() if sensor.edge in found.covariances):
        parent, child = gauge or edge[0], edge[1]
        d = local(true.transform(parent, child)[0], found.dataset.transform(parent, child)[0])
        squares.append(squared_mahalanobis(d, found.covariances[edge]) / 6)
    if not squares:
        return None, None
    tail = 0.5 * math.erfc(float(score_of_f(max(squares), 6, freedom)) / math.sqrt(2))
    return round(math.sqrt(max(squares)), 4), float(f"{min(1.0, len(squares) * tail):.2g}")


def _joint_proofs(found: Calibration, error: TruthError | None) -> Iterator[JointProof]:
    errors = {(each.joint, each.parameter): each.error for each in error.joints} if error else {}
    for name, joint in found.joints.items():
        numbers = zip(joint.parameters, joint.units, joint.values.tolist(), joint.sigmas.tolist(), strict=True)
        for parameter, unit, value, sigma in numbers:
            off = errors.get((name, parameter))
            yield JointProof(
                name, parameter, unit, round(value, 6), round(sigma, 8), None if off is None else round(off, 8)
            )


def _round_finite(value: float, decimals: int) -> float | None:
    return round(float(value), decimals) if np.isfinite(value) else None
