"""Hypothesis: a convention that a recording may have been made by, other than the one it was read by."""

from collections.abc import Callable
from dataclasses import dataclass

from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.conventions.misfit import Misfit


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Other convention, with the dataset as it would be, and what to change in the recording."""

    name: str
    """After "with": "the robot's poses inverted"."""
    remedy: str
    """What to change, in the user's files."""
    dataset: Callable[[], Dataset]
    sensors: tuple[str, ...] = ()
    """Those concerned."""
    told_apart: Callable[[Misfit], tuple[str, str]] | None = None
    """Name and remedy by the result, where conventions have the same equations and only its size tells them apart."""
