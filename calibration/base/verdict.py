"""Verdicts, and checks: comparisons of a value with its expectation; rates of failures over repeated runs."""

import math
from collections.abc import Iterable
from typing import Literal, TypeAlias

from calibration.base.records import computed, field, result
from calibration.base.text import rounded

Verdict: TypeAlias = Literal["pass", "undecided", "fail"]
"""Undecided: nothing is wrong, but the error bar with its guard band reaches over a limit. Neither conformity nor
nonconformity is proven (ISO 14253-1, "uncertainty zone"; JCGM 106, 8.3.2).
"""
VERDICTS: tuple[Verdict, ...] = ("pass", "undecided", "fail")
"""From the best to the worst."""
CONFIDENCE = 0.95
MAX_REPETITIONS = 1000
"""Limit of the runs of one piece of work."""
_BISECTIONS = 60
"""Halvings of [0, 1] until the interval's ends are exact in double precision."""


def verdict_of(passed: bool) -> Verdict:
    """Convert a truth value to a verdict."""
    return "pass" if passed else "fail"


def worst_verdict(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict on several things together; pass without any."""
    return max(verdicts, key=VERDICTS.index, default="pass")


@result(kw_only=True)
class Check:
    """Result of one comparison; :func:`at_most` and :func:`at_least` compare numbers, as stored in results.json."""

    subject: str = field("Compared quantity: ``RMS``, ``detection rate of left``.", key="name")
    value: float | None = field("Value found, if it is a number.", default=None)
    limit: float | None = field("Smallest or largest value that passes.", default=None)
    minimum: bool = field("Whether the limit is the smallest value that passes.", key="at_least", default=False)
    unit: str = field("Unit of value and limit.", default="")
    passed: bool = field("Whether the value passes.")
    found: str
    expected: str

    def __str__(self) -> str:
        return expectation(self.subject, self.found, self.expected)


def at_most(subject: str, value: float | None, limit: float, unit: str = "") -> Check:
    """Compare a number with the largest that passes; None and NaN or infinity fail."""
    return _limit_check(subject, value, limit, minimum=False, unit=unit)


def at_least(subject: str, value: float | None, limit: float, unit: str = "") -> Check:
    """Compare a number with the smallest that passes; None and NaN or infinity fail."""
    return _limit_check(subject, value, limit, minimum=True, unit=unit)


def expectation(subject: str, found: str, expected: str) -> str:
    """Return the common wording of a comparison: ``RMS: found 0.9 px, expected at most 0.8 px``."""
    return f"{subject}: found {found}, expected {expected}"


def _limit_check(subject: str, value: float | None, limit: float, *, minimum: bool, unit: str) -> Check:
    def passes(number: float) -> bool:
        return math.isfinite(number) and (number >= limit if minimum else number <= limit)

    suffix = f" {unit}" if unit else ""
    found = "no value"
    if value is not None:
        short = f"{value:.4g}"
        # a number just beyond the limit must not be rounded onto it
        found = (short if passes(value) == passes(float(short)) else repr(float(value))) + suffix
    return Check(
        subject=subject,
        found=found,
        expected=f"at {'least' if minimum else 'most'} {limit:g}{suffix}",
        passed=value is not None and passes(value),
        value=value,
        limit=limit,
        minimum=minimum,
        unit=unit,
    )


@result
class FlakeRate:
    """Number of failures among repeated runs."""

    failed: int = field("Number of runs that failed.")
    runs: int = field("Number of all runs.")

    @property
    def share(self) -> float:
        """Share of the runs that failed."""
        return self.failed / self.runs

    @property
    @computed()
    def interval(self) -> tuple[float, float]:
        """Bounds of the rate, at 95 % confidence, by the method of Clopper and Pearson (1934)."""
        tail = (1 - CONFIDENCE) / 2
        low = 0.0 if self.failed == 0 else _rate_where(self, self.failed - 1, 1 - tail)
        high = 1.0 if self.failed == self.runs else _rate_where(self, self.failed, tail)
        return round(low, 6), round(high, 6)

    def __str__(self) -> str:
        low, high = (rounded(100 * end, 2) for end in self.interval)
        return f"failed {self.failed} of {self.runs}: between {low} and {high} % of runs at 95 %"


def _rate_where(found: FlakeRate, most: int, probability: float) -> float:
    """Return the rate at which at most ``most`` of the runs fail with the given probability."""
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        if _probability_of_at_most(most, found.runs, middle) > probability:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _probability_of_at_most(most: int, runs: int, rate: float) -> float:
    return math.fsum(math.comb(runs, k) * rate**k * (1 - rate) ** (runs - k) for k in range(most + 1))


def runs_to_see(rate: float) -> int:
    """Return the number of runs of which at least one fails with a probability of 95 %, at this rate of failures."""
    return 1 if rate == 1 else math.ceil(math.log(1 - CONFIDENCE) / math.log1p(-rate))


def rate_seen_by(runs: int) -> float:
    """Return the smallest rate of failures that shows at least once in these runs with a probability of 95 %."""
    return -math.expm1(math.log(1 - CONFIDENCE) / runs)


def runs_show(runs: int, what: str, rate: float = 0.01) -> str:
    """Return what so many runs show: ``60 runs show a test that fails in 4.9 % of them, at 95 %``.

    Args:
        runs: their number.
        what: what may fail in them.
        rate: rate of failures for which the number of runs is named, if these are too few.
    """
    needed = runs_to_see(rate)
    more = f"; {needed} show one of {rounded(100 * rate, 2)} %" if needed > runs else ""
    return f"{runs} runs show a {what} that fails in {rounded(100 * rate_seen_by(runs), 2)} % of them, at 95 %{more}"
