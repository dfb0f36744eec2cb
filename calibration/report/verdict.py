"""Verdict of a check, a unit of work or a whole command."""

from typing import Literal, TypeAlias

Verdict: TypeAlias = Literal["pass", "fail"]


def verdict_of(passed: bool) -> Verdict:
    """Convert a truth value to a verdict."""
    return "pass" if passed else "fail"
