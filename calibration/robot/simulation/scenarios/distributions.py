"""Distributions of parameters, sampled by their inverse cumulative distribution from uniform numbers in [0, 1).

In a scenario set a number is a constant; else it is one of

- ``{uniform: [low, high]}``;
- ``{log_uniform: [low, high]}``: uniform by order of magnitude, both above 0;
- ``{normal: [mean, sigma]}``, truncated to the parameter's own limits, or to ``within: [low, high]`` beside it;
- ``{choice: [a, b, ...]}``: equally likely values; one that is listed twice is twice as likely;
- ``{integer: [low, high]}``: integers, both ends included.

Values have six significant digits, so that rounding errors of the arithmetic have no effect.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Annotated

from calibration.base.records import Converted, Misfit, Place, above, exactly_one, field, length, needs, record

SIGNIFICANT_DIGITS = 6
LEAST_KEPT = 1e-3
"""Limit of the probability between a normal distribution's limits; less is a mistake."""
MAX_CHOICES = 1000
_HALF_STEP = 2.0**-54  # half the resolution of the generator: its smallest number above 0


@dataclass(frozen=True)
class Choice:
    """Discrete distribution of equally likely values. A constant is a choice of one."""

    values: tuple[float, ...]
    """Values in ascending order."""

    @property
    def bounds(self) -> tuple[float, float]:
        """First and last value."""
        return self.values[0], self.values[-1]

    def value(self, u: float) -> float:
        """Quantile at u, 0 <= u < 1, not decreasing; so are those of the others."""
        return self.values[int(u * len(self.values))] + 0.0  # no negative zero


@dataclass(frozen=True)
class _Interval:
    """Distribution on an interval."""

    low: float
    high: float

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper end."""
        return self.low, self.high


@dataclass(frozen=True)
class Integers(_Interval):
    """Uniform distribution of integers, both ends included."""

    def value(self, u: float) -> float:
        """See `Choice`."""
        return float(self.low + int(u * (self.high - self.low + 1)))


@dataclass(frozen=True)
class Uniform(_Interval):
    """Uniform distribution."""

    def value(self, u: float) -> float:
        """See `Choice`."""
        return _round_within(self.low + u * (self.high - self.low), self.low, self.high)


@dataclass(frozen=True)
class LogUniform(_Interval):
    """Log-uniform distribution; both ends are above 0."""

    def value(self, u: float) -> float:
        """See `Choice`."""
        return _round_within(self.low * math.exp(u * math.log(self.high / self.low)), self.low, self.high)


@dataclass(frozen=True)
class Normal:
    """Normal distribution, truncated to two limits."""

    mean: float
    sigma: float
    low: float = -math.inf
    high: float = math.inf

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper limit."""
        return self.low, self.high

    @property
    def kept(self) -> float:
        """Probability of the normal distribution between the limits."""
        whole = NormalDist(self.mean, self.sigma)
        return whole.cdf(self.high) - whole.cdf(self.low)

    def value(self, u: float) -> float:
        """See `Choice`."""
        whole = NormalDist(self.mean, self.sigma)
        share = whole.cdf(self.low) + u * self.kept
        share = min(max(share, _HALF_STEP), 1 - 2 * _HALF_STEP)  # the quantiles of 0 and 1 are infinite
        return _round_within(whole.inv_cdf(share), self.low, self.high)


Distribution = Choice | Integers | Uniform | LogUniform | Normal
"""Distribution of a parameter, with its smallest and largest possible value (`bounds`) and its quantiles (`value`)."""
Pair = Annotated[tuple[float, ...], length(2, 2)]
WholePair = Annotated[tuple[int, ...], length(2, 2)]


@record(case="snake", rules=(exactly_one("choice", "integer"),))
class WholeEntry:
    """Distribution of an integer."""

    choice: Annotated[tuple[int, ...], length(1, MAX_CHOICES)] | None = field(
        "Each as likely as the others.", default=None
    )
    integer: WholePair | None = field("Whole numbers, both ends included.", default=None)

    def distribution(self, low: float, high: float) -> Distribution:
        """Create the distribution; ``low`` and ``high`` are the parameter's own limits."""
        if self.choice is not None:
            return Choice(tuple(sorted(map(float, self.choice))))
        first, last = _checked_rising(self.integer or (), "integer")
        return Integers(first, last)


@record(
    case="snake",
    rules=(exactly_one("uniform", "log_uniform", "normal", "choice", "integer"), needs("within", "normal")),
)
class NumberEntry:
    """Distribution of a number."""

    uniform: Pair | None = field("Evenly from low to high.", default=None)
    log_uniform: Annotated[tuple[Annotated[float, above(0)], ...], length(2, 2)] | None = field(
        "Evenly by order of magnitude.", default=None
    )
    normal: Pair | None = field("Mean and standard deviation; truncated to the parameter's own limits.", default=None)
    within: Pair | None = field("Limits of a truncated normal distribution.", default=None)
    choice: Annotated[tuple[float, ...], length(1, MAX_CHOICES)] | None = field(
        "Each as likely as the others.", default=None
    )
    integer: WholePair | None = field("Whole numbers, both ends included.", default=None)

    def distribution(self, low: float, high: float) -> Distribution:
        """Create the distribution; ``low`` and ``high`` are the parameter's own limits."""
        if self.uniform is not None:
            return Uniform(*_checked_rising(self.uniform, "uniform"))
        if self.log_uniform is not None:
            lower, upper = _checked_rising(self.log_uniform, "log_uniform")
            if not math.isfinite(upper / lower):
                raise Misfit(f"found [{lower:g}, {upper:g}], which are too far apart", "log_uniform")
            return LogUniform(lower, upper)
        if self.normal is not None:
            mean, sigma = self.normal
            return _cut_normal(mean, sigma, *(_checked_rising(self.within, "within") if self.within else (low, high)))
        if self.choice is not None:
            return Choice(tuple(sorted(self.choice)))
        return WholeEntry(integer=self.integer).distribution(low, high)


@dataclass(frozen=True, eq=False)
class Drawn(Converted):
    """Field of a record whose value is drawn from the distribution in the document."""

    axes: str = ""
    """Names of the axes, such as "xyz", if there is a value for each."""


def drawn(low: float, high: float, *, axes: str = "", whole: bool = False) -> Drawn:
    """Declare a parameter with values between two limits.

    Args:
        low: the smallest valid value.
        high: the largest valid value.
        axes: such as "xyz", if it has a value for each axis.
        whole: whether only integers are valid.
    """

    def make(entry: float | WholeEntry | NumberEntry, place: Place) -> Distribution:
        try:
            distribution = Choice((float(entry),)) if isinstance(entry, int | float) else entry.distribution(low, high)
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


def _checked_rising(pair: Sequence[float], key: str) -> tuple[float, float]:
    low, high = pair
    if not low < high:
        raise Misfit(f"found [{low:g}, {high:g}], expected two numbers, the second above the first", key)
    if not math.isfinite(float(high) - float(low)):
        raise Misfit(f"found [{low:g}, {high:g}], which are too far apart", key)
    return low, high


def _round_within(value: float, low: float, high: float) -> float:
    """Round a value to `SIGNIFICANT_DIGITS`, clipped to the limits."""
    return min(max(float(f"{value:.{SIGNIFICANT_DIGITS - 1}e}"), low), high) + 0.0  # no negative zero
