"""Verdict of a check, a unit of work or a whole command."""

from collections.abc import Iterable
from typing import Literal, TypeAlias

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
