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
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Annotated, Protocol

from calibration.records import Converted, Misfit, Place, above, exactly_one, field, length, needs, record

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


Pair = Annotated[tuple[float, ...], length(2, 2)]
WholePair = Annotated[tuple[int, ...], length(2, 2)]


@record(case="snake", rules=(exactly_one("choice", "integer"),))
class WholeEntry:
    """The distribution of a whole number."""

    choice: Annotated[tuple[int, ...], length(1, MAX_CHOICES)] | None = field(
        "Each as likely as the others.", default=None
    )
    integer: WholePair | None = field("Whole numbers, both ends included.", default=None)

    def distribution(self, low: float, high: float) -> "Distribution":
        """The distribution itself; ``low`` and ``high`` are the parameter's own limits."""
        del low, high
        if self.choice is not None:
            return Choice(tuple(sorted(map(float, self.choice))))
        first, last = _rising(self.integer or (), "integer")
        return Integers(int(first), int(last))


@record(
    case="snake",
    rules=(exactly_one("uniform", "log_uniform", "normal", "choice", "integer"), needs("within", "normal")),
)
class NumberEntry:
    """The distribution of a number."""

    uniform: Pair | None = field("Evenly from low to high.", default=None)
    log_uniform: Annotated[tuple[Annotated[float, above(0)], ...], length(2, 2)] | None = field(
        "Evenly by order of magnitude.", default=None
    )
    normal: Pair | None = field("Mean and standard deviation; cut at the parameter's own limits.", default=None)
    within: Pair | None = field("Where a normal distribution is cut.", default=None)
    choice: Annotated[tuple[float, ...], length(1, MAX_CHOICES)] | None = field(
        "Each as likely as the others.", default=None
    )
    integer: WholePair | None = field("Whole numbers, both ends included.", default=None)

    def distribution(self, low: float, high: float) -> "Distribution":
        """The distribution itself; ``low`` and ``high`` are the parameter's own limits."""
        if self.uniform is not None:
            return Uniform(*_rising(self.uniform, "uniform"))
        if self.log_uniform is not None:
            lower, upper = _rising(self.log_uniform, "log_uniform")
            if not math.isfinite(upper / lower):
                raise Misfit(f"found [{lower:g}, {upper:g}], which are too far apart", "log_uniform")
            return LogUniform(lower, upper)
        if self.normal is not None:
            mean, sigma = self.normal
            return _cut_normal(mean, sigma, *(_rising(self.within, "within") if self.within else (low, high)))
        if self.choice is not None:
            return Choice(tuple(sorted(self.choice)))
        return WholeEntry(integer=self.integer).distribution(low, high)


@dataclass(frozen=True, eq=False)
class Drawn(Converted):
    """A field of a record whose value is drawn from the distribution that the document says."""

    axes: str = ""
    """Such as "xyz", where there is a value for each."""


def drawn(low: float, high: float, *, axes: str = "", whole: bool = False) -> Drawn:
    """A parameter whose values lie between two limits.

    Args:
        low: the least value that makes sense.
        high: the largest value that makes sense.
        axes: such as "xyz", where it has a value for each.
        whole: whether only whole numbers make sense.
    """

    def make(entry: float | WholeEntry | NumberEntry, place: Place) -> Distribution:
        try:
            distribution = constant(float(entry)) if isinstance(entry, int | float) else entry.distribution(low, high)
        except Misfit as misfit:
            raise place.misfit(misfit) from None
        least, most = distribution.bounds
        if not low <= least <= most <= high:
            raise place.fault(f"found values from {least:g} to {most:g}, expected them from {low:g} to {high:g}")
        return distribution

    return Drawn(int | WholeEntry if whole else float | NumberEntry, make, axes)


def _cut_normal(mean: float, sigma: float, low: float, high: float) -> Normal:
    if sigma <= 0:
        raise Misfit(f"found a standard deviation of {sigma:g}, expected one above 0", "normal")
    distribution = Normal(mean, sigma, low, high)
    if not distribution.kept >= LEAST_KEPT:
        raise Misfit(f"nearly nothing of a normal distribution [{mean:g}, {sigma:g}] is from {low:g} to {high:g}")
    return distribution


def _rising(pair: Sequence[float], key: str) -> tuple[float, float]:
    low, high = pair
    if not low < high:
        raise Misfit(f"found [{low:g}, {high:g}], expected two numbers, the second above the first", key)
    if not math.isfinite(float(high) - float(low)):
        raise Misfit(f"found [{low:g}, {high:g}], which are too far apart", key)
    return low, high


def _rounded(value: float, low: float, high: float) -> float:
    """The value to `SIGNIFICANT_DIGITS`, and not beyond the limits."""
    return min(max(float(f"{value:.{SIGNIFICANT_DIGITS - 1}e}"), low), high) + 0.0  # no negative zero
