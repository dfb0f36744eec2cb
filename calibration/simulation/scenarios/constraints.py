"""Constraints: what the values of a world have to keep to; where they do not, they are drawn again.

In a scenario set, under ``constraints``, a list of

- ``{parameter: NAME, min: A, max: B}``, with one of the two or both;
- ``{less: [NAME, NAME, ...]}``: each below the next.

A name is that of a parameter, ``left_camera.exposure``, or of all of a kind, ``cameras.exposure``, or
`CLEARANCE`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

from calibration.dataset.document import Node
from calibration.simulation.description import number, only
from calibration.simulation.scenarios.parameters import Parameters

CLEARANCE = "scene.clearance_m"
"""The least distance from a sensor to a box, m, where the robot rests."""
MAX_CONSTRAINTS = 100

Value = Callable[[str], float]
"""The value of a parameter or of `CLEARANCE`, by its name."""


@dataclass(frozen=True)
class Range:
    """Each of the named values lies between two limits, which are included."""

    names: tuple[str, ...]
    low: float
    high: float
    text: str
    """What messages call it."""

    def holds(self, value: Value) -> bool:
        """Whether a world keeps to it."""
        return all(self.low <= value(name) <= self.high for name in self.names)


@dataclass(frozen=True)
class Order:
    """Every value of one step is below every value of the next."""

    steps: tuple[tuple[str, ...], ...]
    text: str
    """What messages call it."""

    def holds(self, value: Value) -> bool:
        """Whether a world keeps to it."""
        return all(max(map(value, lower)) < min(map(value, upper)) for lower, upper in pairwise(self.steps))


Constraint = Range | Order


def read_constraints(node: Node, parameters: Parameters) -> tuple[Constraint, ...]:
    """Read a list of constraints.

    Raises:
        InputError: an entry is of no known form, or names what does not vary.
    """
    if len(node.sequence()) > MAX_CONSTRAINTS:
        raise node.unexpected(f"at most {MAX_CONSTRAINTS} constraints")
    return tuple(_read(entry, parameters) for entry in node.elements())


def _read(node: Node, parameters: Parameters) -> Constraint:
    only(node, "parameter", "min", "max", "less")
    if node.get("less"):
        only(node, "less")
        if len(node["less"].sequence()) < 2:
            raise node["less"].unexpected("a list of two names or more")
        steps = tuple(_named(name, parameters) for name in node["less"].elements())
        return Order(steps, " < ".join(node["less"].sequence()))
    names = _named(node["parameter"], parameters)
    if not node.get("min") and not node.get("max"):
        raise node.fault("found neither 'min' nor 'max', expected one of them or both")
    low, high = number(node, "min", -math.inf), number(node, "max", math.inf)
    if low > high:
        raise node.fault(f"found min {low:g} above max {high:g}")
    limits = [f"at least {low:g}"] * math.isfinite(low) + [f"at most {high:g}"] * math.isfinite(high)
    return Range(names, low, high, f"{node['parameter'].text()} {' and '.join(limits)}")


def _named(node: Node, parameters: Parameters) -> tuple[str, ...]:
    name = node.name()
    names = (name,) if name == CLEARANCE else parameters.named(name)
    if not names:
        known = ", ".join((*parameters.groups, CLEARANCE))
        raise node.fault(f"found '{name}', which this scenario set does not draw (it draws {known})")
    return names


def broken(constraints: tuple[Constraint, ...], values: Mapping[str, float], clearance: Callable[[], float]) -> int:
    """The index of the first constraint that a world does not keep to; -1 where it keeps to all.

    Args:
        constraints: in the order of the file.
        values: the world's parameters.
        clearance: the value of `CLEARANCE`, asked for only where a constraint names it.
    """

    def value(name: str) -> float:
        return clearance() if name == CLEARANCE else values[name]

    return next((i for i, constraint in enumerate(constraints) if not constraint.holds(value)), -1)
