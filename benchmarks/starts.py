"""Calibrations of one dataset from many noisy starts."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.shared_data import load
from calibration.base import CalibrationError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.truth import truth_error, truth_of
from calibration.engine.evaluation.two_sensors import rgb_to_rgb
from calibration.engine.geometry.transforms import distance


@dataclass(frozen=True)
class Start:
    """A dataset, the noise on its guess, and how to calibrate."""

    dataset: str
    translation: float
    rotation: float
    seed: int
    start: Literal["linear", "given"] = "linear"
    loss: Literal["huber", "linear"] = "linear"
    evaluate: tuple[str, str] | None = None
    """The two cameras of the evaluation ``rgb_to_rgb``."""


@dataclass(frozen=True, eq=False)
class End:
    """Result from one start; NaN where there is none."""

    converged: bool = False
    pose: Array | None = None
    """(4, 4): what the dataset determines, see `_determined`."""
    translation_mm: float = np.nan
    """Its distance from the truth."""
    rotation_deg: float = np.nan
    sigma_mm: float = np.nan
    """Its own standard deviations."""
    sigma_deg: float = np.nan
    rms: float = np.nan
    """``Averages``, ``RMS (pix)`` of the evaluation."""


def solve(start: Start) -> End:
    """Calibrate from one start; the transforms in the file are the truth."""
    dataset = load(start.dataset)
    noise = StartingNoise(start.translation, start.rotation, start.seed)
    try:
        result = calibrate(dataset, Options(start=start.start, loss=start.loss), noise)
    except CalibrationError:
        return End()
    error = truth_error(result.dataset, truth_of(dataset))
    rms = rgb_to_rgb(result.dataset, *start.evaluate).average("RMS (pix)") if start.evaluate else np.nan
    pose = _determined(result.dataset)
    return End(result.converged, pose, error.translation_mm, error.rotation_deg, *_sigmas(result), rms)


def spread_mm(ends: list[End]) -> float:
    """The greatest distance of a result from the first, mm; NaN when there is none from some start."""
    poses = [end.pose for end in ends if end.pose is not None]
    if len(poses) < len(ends):
        return np.nan
    return 1e3 * float(distance(poses[0], np.stack(poses))[0].max())


def _determined(dataset: Dataset) -> Array:
    """The pose (4, 4) that the labels determine: a sensor's transform, or between two of which none is anchored."""
    free = [sensor for sensor in dataset.sensors.values() if sensor.name != dataset.anchored]
    frames = free[0].edge if len(free) == 1 else (free[0].frame, free[1].frame)
    T: Array = dataset.transform(*frames)[0]
    return T


def _sigmas(result: Calibration) -> tuple[float, float]:
    """Standard deviations (mm, deg) of the sensor that was free; NaN when it has not converged."""
    for sensor in result.dataset.sensors.values():
        if sensor.edge in result.covariances:
            return result.label_sigma_mm(sensor.edge), float(np.degrees(result.label_sigma_mrad(sensor.edge) / 1e3))
    return np.nan, np.nan
