"""Calibration CI: does the robot still calibrate?

>>> import calibration
>>> result = calibration.calibrate(calibration.read_dataset("datasets/t2rgb"))
>>> result.converged
True

The engine is ``dataset``, ``estimation`` and ``evaluation``; ``simulation`` makes datasets; ``pipeline`` runs a
``calibration.yml``, ``commands`` has one module for each command. CONTRIBUTING.md lists all packages, each below those
that it imports.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

MAX_IMAGE_PIXELS = 75_000_000
"""Limit of an image: OpenCV, which reads it from the environment at its import, refuses a larger one by its header."""
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_IMAGE_PIXELS))

if TYPE_CHECKING:
    from calibration.dataset.model import Dataset as Dataset
    from calibration.dataset.reading import read_dataset as read_dataset
    from calibration.dataset.writing import write_dataset as write_dataset
    from calibration.errors import CalibrationError as CalibrationError
    from calibration.errors import InputError as InputError
    from calibration.errors import UndeterminedError as UndeterminedError
    from calibration.estimation.calibrate import calibrate as calibrate
    from calibration.estimation.noise_levels import NoiseLevels as NoiseLevels
    from calibration.estimation.options import Options as Options
    from calibration.estimation.result import Calibration as Calibration
    from calibration.estimation.starting_noise import StartingNoise as StartingNoise

# Imported at first use, so that a command loads only the modules that it needs.
_HOMES = {
    "Calibration": "calibration.estimation.result",
    "CalibrationError": "calibration.errors",
    "Dataset": "calibration.dataset.model",
    "InputError": "calibration.errors",
    "NoiseLevels": "calibration.estimation.noise_levels",
    "Options": "calibration.estimation.options",
    "StartingNoise": "calibration.estimation.starting_noise",
    "UndeterminedError": "calibration.errors",
    "calibrate": "calibration.estimation.calibrate",
    "read_dataset": "calibration.dataset.reading",
    "write_dataset": "calibration.dataset.writing",
}
__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'calibration' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
