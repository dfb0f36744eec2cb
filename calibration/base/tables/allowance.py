"""Allowed deviations of a number from a baseline."""

from dataclasses import dataclass
from decimal import Decimal

from calibration.base.errors import InputError
from calibration.base.tables.numbers import number_text, parse_number


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
