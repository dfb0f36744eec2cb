"""Rows of the table: a measured number and its bar."""

import math
from dataclasses import dataclass
from typing import Any, Self


@dataclass(frozen=True)
class Bar:
    """Limits of a number, inclusive."""

    low: float = -math.inf
    high: float = math.inf

    @classmethod
    def around(cls, value: float, tolerance: float) -> Self:
        """Bar from ``value - tolerance`` to ``value + tolerance``."""
        return cls(value - tolerance, value + tolerance)

    def holds(self, value: float) -> bool:
        """Whether a number keeps to it; NaN never does."""
        return self.low <= value <= self.high

    def __str__(self) -> str:
        if math.isinf(self.low):
            return f"<= {self.high:.5g}"
        if math.isinf(self.high):
            return f">= {self.low:.5g}"
        return f"{self.low:.5g} to {self.high:.5g}"


@dataclass(frozen=True)
class Row:
    """A measured number, or why there is none."""

    name: str
    """``module/what``, in words that stay the same."""
    value: float = math.nan
    unit: str = ""
    bar: Bar | None = None
    """None for a number that is only reported."""
    note: str = ""
    """What the number includes, or others that go with it."""
    skipped: str = ""
    """Why there is no number, and what to install or fetch."""

    @property
    def verdict(self) -> str:
        """Verdict: met, missed, reported or skipped."""
        if self.skipped:
            return "skipped"
        if self.bar is None:
            return "reported"
        return "met" if self.bar.holds(self.value) else "missed"

    def line(self) -> str:
        """The row of the printed table."""
        measured = "" if self.skipped else f"{self.value:.4g} {self.unit}"
        bar = "" if self.bar is None else str(self.bar)
        return f"{self.name:34} {measured:>18}   {bar:20} {self.verdict:9} {self.skipped or self.note}".rstrip()

    def record(self) -> dict[str, Any]:
        """The row for JSON; a number that is not finite is null."""
        limits = {} if self.bar is None else {"low": self.bar.low, "high": self.bar.high}
        return {
            "name": self.name,
            "value": self.value if math.isfinite(self.value) else None,
            "unit": self.unit,
            "bar": {key: limit for key, limit in limits.items() if math.isfinite(limit)} or None,
            "verdict": self.verdict,
            "note": self.skipped or self.note,
        }


HEADER = f"{'row':34} {'measured':>18}   {'bar':20} verdict"
