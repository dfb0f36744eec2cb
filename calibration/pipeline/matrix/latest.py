"""What follows from the latest calibration of a system, for the next cell, which often has the same calibration.

The linear start is computed from the labels, so that most calibrations do not depend on the noise of their cell at all:
they are equal to the last bit, and so is everything that is computed from them.
"""

from collections.abc import Callable
from typing import Generic, TypeVar

from calibration.estimation.options import Options
from calibration.estimation.result import Calibration

_T = TypeVar("_T")
_STATED = (
    "reason",
    "cost",
    "iterations",
    "degrees_of_freedom",
    "noise_levels",
    "rejected",
    "weak_directions",
    "warnings",
    "notes",
    "gauge",
    "dropped_views",
    "not_determined",
)


class Latest(Generic[_T]):
    """What was made of the latest calibration."""

    def __init__(self) -> None:
        self._kept: tuple[Calibration, Options, _T] | None = None

    def of(self, calibration: Calibration, options: Options, make: Callable[[], _T]) -> _T:
        """Return what was made of the latest calibration if this one is the same, else make it.

        Args:
            calibration: of the same dataset as the latest one.
            options: its options.
            make: makes it; its errors are not kept.
        """
        if self._kept is not None and self._kept[1] == options and same(self._kept[0], calibration):
            return self._kept[2]
        made = make()
        self._kept = calibration, options, made
        return made


def same(a: Calibration, b: Calibration) -> bool:
    """Whether two calibrations of a dataset with the same options are equal to the last bit."""
    if a is b:
        return True
    if any(getattr(a, name) != getattr(b, name) for name in _STATED):
        return False
    values, others = ((*each.solution.values, *each.covariances.values()) for each in (a, b))
    return len(values) == len(others) and all(x.tobytes() == y.tobytes() for x, y in zip(values, others, strict=True))
