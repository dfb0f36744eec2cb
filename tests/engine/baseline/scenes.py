"""Snapshots of small systems: other data of the same robot, a sensor that moved."""

from dataclasses import replace

import numpy as np

from calibration.engine.baseline.calibration_document import CalibrationDocument, document_of_calibration
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry.transforms import retract
from tests.engine.estimation import systems

RIGHT = ("world", "right")
STILL = (0.0,) * 6


def stereo(seed: int = 1, twist: tuple[float, ...] = STILL, edge: Edge = RIGHT) -> Dataset:
    """Two cameras, recorded with a seed of its own, with one of them moved by a twist in its frame (m, rad)."""
    scene = systems.stereo(24, seed=seed, pixel_noise=0.1)
    moved = {**scene.transforms, edge: retract(scene.transforms[edge], np.array(twist))}
    return replace(scene, transforms=moved).dataset(seed)


def taken(dataset: Dataset, noise: StartingNoise | None = None) -> CalibrationDocument:
    """The snapshot of a dataset's calibration."""
    calibration = calibrate(dataset, noise=noise)
    return document_of_calibration(calibration, dataset, calibration.rms_px)
