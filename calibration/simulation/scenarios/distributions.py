"""Distributions: what a number drawn evenly from 0 to 1 becomes, by the inverse of the cumulative distribution.

In a scenario set a number alone is itself; else one of

- ``{uniform: [low, high]}``;
- ``{log_uniform: [low, high]}``: evenly by order of magnitude, both above 0;
- ``{normal: [mean, sigma]}``, cut at the parameter's own limits, or at ``within: [low, high]`` beside it;
- ``{choice: [a, b, ...]}``: each as likely as the others; one that is listed twice is twice as likely;
- ``{integer: [low, high]}``: whole numbers, both ends included.

Values have six significant digits, so that the last bits of a machine's arithmetic do not show.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Protocol

from calibration.dataset.document import Node
from calibration.simulation.description import numbers, only

SIGNIFICANT_DIGITS = 6
LEAST_KEPT = 1e-3
"""A normal distribution that keeps less of itself between its limits is a mistake."""
MAX_CHOICES = 1000
_HALF_STEP = 2.0**-54  # half the distance between the numbers of a generator: the least that is not 0


class Distribution(Protocol):
    """How a value is drawn."""

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the largest value, both possible."""
        ...

    @property
    def is_whole(self) -> bool:
        """Whether every value is a whole number."""
        ...

    def value(self, u: float) -> float:
        """The value at u, the share of the distribution below it: 0 <= u < 1. It never falls as u grows."""
        ...


@dataclass(frozen=True)
class Choice:
    """Listed values, each as likely as the others. A constant is a choice of one."""

    values: tuple[float, ...]
    """In rising order."""

    @property
    def bounds(self) -> tuple[float, float]:
        """The first and the last."""
        return self.values[0], self.values[-1]

    @property
    def is_whole(self) -> bool:
        """Whether all are."""
        return all(value.is_integer() for value in self.values)

    def value(self, u: float) -> float:
        """See `Distribution`."""
        return self.values[int(u * len(self.values))] + 0.0  # no negative zero


@dataclass(frozen=True)
class Integers:
    """Whole numbers, both ends included."""

    low: int
    high: int

    @property
    def bounds(self) -> tuple[float, float]:
        """Both ends."""
        return float(self.low), float(self.high)

    @property
    def is_whole(self) -> bool:
        """Always."""
        return True

    def value(self, u: float) -> float:
        """See `Distribution`."""
        return float(self.low + int(u * (self.high - self.low + 1)))


@dataclass(frozen=True)
class _Interval:
    """Any number between two ends."""

    low: float
    high: float

    @property
    def bounds(self) -> tuple[float, float]:
        """Both ends."""
        return self.low, self.high

    @property
    def is_whole(self) -> bool:
        """Never."""
        return False


@dataclass(frozen=True)
class Uniform(_Interval):
    """Evenly from low to high."""

    def value(self, u: float) -> float:
        """See `Distribution`."""
        return _rounded(self.low + u * (self.high - self.low), self.low, self.high)


@dataclass(frozen=True)
class LogUniform(_Interval):
    """The logarithm evenly from that of low to that of high; both are above 0."""

    def value(self, u: float) -> float:
        """See `Distribution`."""
        return _rounded(self.low * math.exp(u * math.log(self.high / self.low)), self.low, self.high)


@dataclass(frozen=True)
class Normal:
    """A normal distribution of which only what lies between two limits is kept."""

    mean: float
    sigma: float
    low: float = -math.inf
    high: float = math.inf

    @property
    def bounds(self) -> tuple[float, float]:
        """The limits."""
        return self.low, self.high

    @property
    def is_whole(self) -> bool:
        """Never."""
        return False

    @property
    def _kept(self) -> tuple[float, float]:
        """The shares of the whole normal distribution below the two limits."""
        whole = NormalDist(self.mean, self.sigma)
        return whole.cdf(self.low), whole.cdf(self.high)

    @property
    def kept(self) -> float:
        """The share of the whole normal distribution between the limits."""
        below_low, below_high = self._kept
        return below_high - below_low

    def value(self, u: float) -> float:
        """See `Distribution`."""
        below_low, below_high = self._kept
        share = below_low + u * (below_high - below_low)
        share = min(max(share, _HALF_STEP), 1 - 2 * _HALF_STEP)  # at 0 and 1 it is infinite
        return _rounded(NormalDist(self.mean, self.sigma).inv_cdf(share), self.low, self.high)


def constant(value: float) -> Choice:
    """The distribution that is always the same."""
    return Choice((value,))


def read_distribution(node: Node, low: float, high: float, *, whole: bool = False) -> Distribution:
    """Read the distribution of a parameter.

    Args:
        node: where it stands.
        low: the least value that makes sense.
        high: the largest value that makes sense.
        whole: whether only whole numbers make sense.

    Raises:
        InputError: it is none of those known, or may give a value that makes no sense.
    """
    if type(node.value) in (int, float):
        distribution: Distribution = constant(node.number())
    else:
        distribution = _read(node, low, high)
    least, most = distribution.bounds
    if not low <= least <= most <= high:
        raise node.fault(f"found values from {least:g} to {most:g}, expected them from {low:g} to {high:g}")
    if whole and not distribution.is_whole:
        raise node.fault("found values between whole numbers, expected a whole number, an integer or a choice of some")
    return distribution


def _read(node: Node, low: float, high: float) -> Distribution:
    kinds: dict[str, Callable[[Node], Distribution]] = {
        "uniform": lambda node: Uniform(*_rising(node, "uniform")),
        "log_uniform": _read_log_uniform,
        "normal": lambda node: _read_normal(node, low, high),
        "choice": _read_choice,
        "integer": _read_integers,
    }
    if type(node.value) is not dict:
        raise node.unexpected(f"a number, or one of {', '.join(kinds)} with its numbers")
    found = [kind for kind in kinds if kind in node.mapping()]
    only(node, *(["normal", "within"] if found == ["normal"] else kinds))
    if len(found) != 1:
        raise node.fault(f"found {' and '.join(found) or 'nothing'}, expected one of {', '.join(kinds)}")
    return kinds[found[0]](node)


def _rising(node: Node, key: str) -> tuple[float, float]:
    low, high = numbers(node, key, 2)
    if not low < high:
        raise node[key].fault(f"found [{low:g}, {high:g}], expected two numbers, the second above the first")
    if not math.isfinite(high - low):
        raise node[key].fault(f"found [{low:g}, {high:g}], which are too far apart")
    return low, high


def _read_log_uniform(node: Node) -> LogUniform:
    low, high = _rising(node, "log_uniform")
    if low <= 0 or not math.isfinite(high / low):
        raise node["log_uniform"].fault(f"found [{low:g}, {high:g}], expected numbers above 0")
    return LogUniform(low, high)


def _read_normal(node: Node, low: float, high: float) -> Normal:
    mean, sigma = numbers(node, "normal", 2)
    if sigma <= 0:
        raise node["normal"].fault(f"found a standard deviation of {sigma:g}, expected one above 0")
    if node.get("within"):
        low, high = _rising(node, "within")
    distribution = Normal(mean, sigma, low, high)
    if not distribution.kept >= LEAST_KEPT:
        raise node.fault(f"nearly nothing of a normal distribution [{mean:g}, {sigma:g}] is from {low:g} to {high:g}")
    return distribution


def _read_choice(node: Node) -> Choice:
    values = [element.number() for element in node["choice"].elements()]
    if not 1 <= len(values) <= MAX_CHOICES:
        raise node["choice"].unexpected(f"a list of 1 to {MAX_CHOICES} numbers")
    return Choice(tuple(sorted(values)))


def _read_integers(node: Node) -> Integers:
    low, high = _rising(node, "integer")
    if not (low.is_integer() and high.is_integer() and abs(low) < 2**53 and abs(high) < 2**53):
        raise node["integer"].fault(f"found [{low:g}, {high:g}], expected whole numbers")
    return Integers(int(low), int(high))


def _rounded(value: float, low: float, high: float) -> float:
    """The value to `SIGNIFICANT_DIGITS`, and not beyond the limits."""
    return min(max(float(f"{value:.{SIGNIFICANT_DIGITS - 1}e}"), low), high) + 0.0  # no negative zero
