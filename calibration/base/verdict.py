"""Verdicts, and checks: comparisons of a value with its expectation."""

import math
from collections.abc import Iterable
from typing import Literal, TypeAlias

from calibration.base.records import field, result

Verdict: TypeAlias = Literal["pass", "undecided", "fail"]
"""Undecided: nothing is wrong, but the error bar with its guard band reaches over a limit. Neither conformity nor
nonconformity is proven (ISO 14253-1, "uncertainty zone"; JCGM 106, 8.3.2).
"""
VERDICTS: tuple[Verdict, ...] = ("pass", "undecided", "fail")
"""From the best to the worst."""


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
