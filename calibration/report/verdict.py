"""Verdict of a check, a unit of work or a whole command."""

from typing import Literal, TypeAlias

Verdict: TypeAlias = Literal["pass", "undecided", "fail"]
"""Undecided: nothing is wrong, but the error bar with its guard band reaches over a limit. Neither conformity nor
nonconformity is proven (ISO 14253-1, "uncertainty zone"; JCGM 106, 8.3.2).
"""


def verdict_of(passed: bool) -> Verdict:
    """Convert a truth value to a verdict."""
    return "pass" if passed else "fail"
