"""Constraints on the values of a scenario; values that break one are drawn again.

In a scenario set, ``constraints`` is a list of

- ``{parameter: NAME, min: A, max: B}``, with one of the two or both;
- ``{less: [NAME, NAME, ...]}``: each below the next.

A name is that of a parameter, ``left_camera.exposure``, or of all of a kind, ``cameras.exposure``, or
`CLEARANCE_KEY`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

from calibration.base.records import Misfit, exactly_one, excludes, field, length, record

CLEARANCE_KEY = "scene.clearance_m"
"""Smallest distance from a sensor to a box, m, with the robot at rest."""

Value = Callable[[str], float]
"""Function that returns the value of a parameter or of `CLEARANCE_KEY`, by its name."""


@dataclass(frozen=True)
class Range:
    """Constraint to an interval: each of the named values is within two inclusive limits."""

    names: tuple[str, ...]
    low: float
    high: float
    text: str
    """Name in messages."""

    def holds(self, value: Value) -> bool:
        """Whether a scenario satisfies it."""
        return all(self.low <= value(name) <= self.high for name in self.names)


@dataclass(frozen=True)
class Order:
    """Constraint to an order: every value of one group is below every value of the next."""

    steps: tuple[tuple[str, ...], ...]
    text: str
    """Name in messages."""

    def holds(self, value: Value) -> bool:
        """Whether a scenario satisfies it."""
        return all(max(map(value, lower)) < min(map(value, upper)) for lower, upper in pairwise(self.steps))


Constraint = Range | Order


@record(case="snake", rules=(exactly_one("parameter", "less"), excludes("less", "min"), excludes("less", "max")))
class ConstraintEntry:
    """Constraint as it is in the document."""

    parameter: Annotated[str, length(1)] | None = field("The name of what lies between min and max.", default=None)
    min: float | None = field("The least value.", default=None)
    max: float | None = field("The largest value.", default=None)
    less: Annotated[tuple[Annotated[str, length(1)], ...], length(2)] | None = field(
        "Names: each of them below the next.", default=None
    )

    def __post_init__(self) -> None:
        """Refuse a parameter without limits, and empty intervals."""
        if self.parameter is not None and self.min is None and self.max is None:
            raise Misfit("found neither 'min' nor 'max', expected one of them or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise Misfit(f"found min {self.min:g} above max {self.max:g}")

    def constraint(self, named: Callable[[str], tuple[str, ...]]) -> "Constraint":
        """Create the constraint; ``named`` returns the parameters of a name."""
        if self.less is not None:
            return Order(tuple(map(named, self.less)), " < ".join(self.less))
        name = self.parameter or ""
        limits = [f"at least {self.min:g}"] if self.min is not None else []
        limits += [f"at most {self.max:g}"] if self.max is not None else []
        low, high = -math.inf if self.min is None else self.min, math.inf if self.max is None else self.max
        return Range(named(name), low, high, f"{name} {' and '.join(limits)}")


def broken(constraints: tuple[Constraint, ...], values: Mapping[str, float], clearance: Callable[[], float]) -> int:
    """Return the index of the first constraint that a scenario breaks; -1 if it satisfies all.

    Args:
        constraints: in the order of the file.
        values: the scenario's parameters.
        clearance: function for the value of `CLEARANCE_KEY`, called only if a constraint names it.
    """

    def value(name: str) -> float:
        return clearance() if name == CLEARANCE_KEY else values[name]

    return next((i for i, constraint in enumerate(constraints) if not constraint.holds(value)), -1)
