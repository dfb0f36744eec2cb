"""Rules for the cells of a column, and the deviations from a baseline that they allow."""

import re
from dataclasses import dataclass
from decimal import Decimal
from typing import TypeAlias

from calibration.base.errors import InputError
from calibration.base.tables.selection import Target
from calibration.base.text import number_text, parse_number


@dataclass(frozen=True)
class Allowance:
    """Allowed deviation from the baseline, in one direction."""

    amount: float
    """Allowed change, in the column's unit or in percent of the baseline's absolute value; not negative."""
    relative: bool

    def __str__(self) -> str:
        return number_text(self.amount) + ("%" if self.relative else "")

    def above(self, baseline: float) -> float:
        """Return the largest allowed number, in exact decimal arithmetic."""
        return float(Decimal(repr(baseline)) + self._allowed_change(baseline))

    def below(self, baseline: float) -> float:
        """Return the smallest allowed number, in exact decimal arithmetic."""
        return float(Decimal(repr(baseline)) - self._allowed_change(baseline))

    def _allowed_change(self, baseline: float) -> Decimal:
        amount = Decimal(repr(self.amount))
        return amount * abs(Decimal(repr(baseline))) / 100 if self.relative else amount


def parse_allowance(text: str) -> Allowance:
    """Parse an allowance: ``0.1`` in the column's unit, ``10%`` of the baseline.

    Raises :class:`InputError` for anything else, and for negative values.
    """
    number = text.strip()
    amount = parse_number(number.removesuffix("%").rstrip())
    if amount is None or amount < 0:
        raise InputError(f"{text!r} is no allowance: give 0.1 (in the column's unit) or 10% (of the baseline)")
    return Allowance(amount, relative=number.endswith("%"))


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
