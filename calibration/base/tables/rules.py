"""Rules for the cells of a column."""

import re
from dataclasses import dataclass
from typing import TypeAlias

from calibration.base.tables.allowance import Allowance
from calibration.base.tables.numbers import number_text
from calibration.base.tables.selection import Target


@dataclass(frozen=True)
class Limits:
    """Interval of numbers; None means unbounded."""

    minimum: float | None = None
    maximum: float | None = None
    exclusive: bool = False
    """Whether the limits themselves are excluded."""

    def admit(self, value: float) -> bool:
        """Return whether a value is within the limits; False for NaN."""
        if self.exclusive:
            return (self.minimum is None or value > self.minimum) and (self.maximum is None or value < self.maximum)
        return (self.minimum is None or value >= self.minimum) and (self.maximum is None or value <= self.maximum)

    def contradict(self, other: "Limits") -> bool:
        """Return whether the intersection with another interval is empty."""
        lows = [limits.minimum for limits in (self, other) if limits.minimum is not None]
        highs = [limits.maximum for limits in (self, other) if limits.maximum is not None]
        if not lows or not highs or max(lows) < min(highs):
            return False
        return not (self.admit(max(lows)) and other.admit(max(lows)))

    def __str__(self) -> str:
        low, high = ("more than", "less than") if self.exclusive else ("at least", "at most")
        parts = [] if self.minimum is None else [f"{low} {number_text(self.minimum)}"]
        parts += [] if self.maximum is None else [f"{high} {number_text(self.maximum)}"]
        return " and ".join(parts)


@dataclass(frozen=True)
class LimitRule:
    """Numbers of a column must be within limits."""

    column: str
    target: Target
    limits: Limits

    def __str__(self) -> str:
        return str(self.limits)


@dataclass(frozen=True)
class TextRule:
    """Texts of a column must contain, not contain, or fully match a text; None means no condition."""

    column: str
    target: Target
    contains: str | None = None
    does_not_contain: str | None = None
    matches: re.Pattern[str] | None = None

    def admit(self, text: str) -> bool:
        """Return whether a text meets the conditions."""
        return (
            (self.contains is None or self.contains in text)
            and (self.does_not_contain is None or self.does_not_contain not in text)
            and (self.matches is None or self.matches.fullmatch(text) is not None)
        )

    def contradicts_itself(self) -> bool:
        """Return whether a required text is also forbidden."""
        return (
            self.contains is not None and self.does_not_contain is not None and self.does_not_contain in self.contains
        )

    def __str__(self) -> str:
        parts = [] if self.contains is None else [f"text that contains {self.contains!r}"]
        parts += [] if self.does_not_contain is None else [f"text that does not contain {self.does_not_contain!r}"]
        parts += [] if self.matches is None else [f"text that matches {self.matches.pattern!r}"]
        return " and ".join(parts)


@dataclass(frozen=True)
class ChangeRule:
    """Numbers of a column must not deviate from the baseline by more than allowed; None means any deviation."""

    column: str
    target: Target
    increase: Allowance | None = None
    decrease: Allowance | None = None

    def limits(self, baseline: float) -> Limits:
        """Return the limits for a number, given its baseline."""
        return Limits(
            None if self.decrease is None else self.decrease.below(baseline),
            None if self.increase is None else self.increase.above(baseline),
        )

    def __str__(self) -> str:
        parts = [] if self.decrease is None else [f"at least the baseline - {self.decrease}"]
        parts += [] if self.increase is None else [f"at most the baseline + {self.increase}"]
        return " and ".join(parts)


Rule: TypeAlias = LimitRule | TextRule | ChangeRule
