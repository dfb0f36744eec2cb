"""Calibration CI: does the robot still calibrate?

>>> import calibration
>>> result = calibration.calibrate(calibration.read_dataset("datasets/t2rgb"))
>>> result.converged
True

A house of floors, from the bottom up: ``base`` (what all use), ``ci`` (runner, images, jobs, reports), ``engine``
(dataset to calibration to verdict), ``robot`` (recordings, simulation, exports), ``pipeline`` (a ``calibration.yml``)
and ``commands``; ``addons`` stand beside them. The page of each (its ``__init__``) says what it knows and may import.
"""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from calibration.base import errors as errors

__version__ = "0.1.0"

sys.modules["calibration.errors"] = errors  # a public name: ``from calibration.errors import InputError``

MAX_IMAGE_PIXELS = 75_000_000
"""Limit of an image: OpenCV, which reads it from the environment at its import, refuses a larger one by its header."""
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_IMAGE_PIXELS))

if TYPE_CHECKING:
    from calibration.base.errors import CalibrationError as CalibrationError
    from calibration.base.errors import InputError as InputError
    from calibration.base.errors import UndeterminedError as UndeterminedError
    from calibration.engine.dataset.model import Dataset as Dataset
    from calibration.engine.dataset.reading import read_dataset as read_dataset
    from calibration.engine.dataset.writing import write_dataset as write_dataset
    from calibration.engine.estimation.calibrate import calibrate as calibrate
    from calibration.engine.estimation.covariance.result import Calibration as Calibration
    from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels as NoiseLevels
    from calibration.engine.estimation.options import Options as Options
    from calibration.engine.estimation.start.guesses import StartingNoise as StartingNoise

# Imported at first use, so that a command loads only the modules that it needs.
_HOMES = {
    "Calibration": "calibration.engine.estimation.covariance.result",
    "CalibrationError": "calibration.base.errors",
    "Dataset": "calibration.engine.dataset.model",
    "InputError": "calibration.base.errors",
    "NoiseLevels": "calibration.engine.estimation.least_squares.noise_levels",
    "Options": "calibration.engine.estimation.options",
    "StartingNoise": "calibration.engine.estimation.start.guesses",
    "UndeterminedError": "calibration.base.errors",
    "calibrate": "calibration.engine.estimation.calibrate",
    "read_dataset": "calibration.engine.dataset.reading",
    "write_dataset": "calibration.engine.dataset.writing",
}
__all__ = ["__version__", "errors", *_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'calibration' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
