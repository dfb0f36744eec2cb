"""Two small systems that calibrate in milliseconds, in files."""

from pathlib import Path

import pytest

from calibration.engine.diagnosis.limits import Limits
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.system import NoiseGrid, System

DATASETS = Path(__file__).parents[2] / "datasets"
T2RGB = System("t2rgb", DATASETS / "t2rgb", "rgb-to-rgb:right_camera:left_camera")
RIWBOT = System("riwbot", DATASETS / "riwbot", "inter-collection-rgb-to-rgb:rgb_world:rgb_world")


@pytest.fixture
def matrix() -> Matrix:
    """Two systems, two noises, two seeds: 8 cells."""
    return Matrix((T2RGB, RIWBOT), NoiseGrid((0.0, 0.5), (0.3,), (1, 2)))


@pytest.fixture
def limits() -> Limits:
    return Limits(rms_px=1.0, translation_mm=1.0, rotation_deg=0.1)
