"""How much of something is covered: whole numbers, so that nothing is rounded into a pass."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Rate:
    """So many of so many."""

    covered: int = 0
    total: int = 0

    def __add__(self, other: "Rate") -> "Rate":
        return Rate(self.covered + other.covered, self.total + other.total)

    @property
    def percent(self) -> float | None:
        """With two decimals, rounded down, so that only all is 100; None of nothing."""
        return None if self.total == 0 else self.covered * 10_000 // self.total / 100

    def reaches(self, minimum: float) -> bool:
        """Whether it is at least so many percent; nothing reaches no limit."""
        return self.total > 0 and self.covered * 100 >= minimum * self.total

    def __str__(self) -> str:
        if self.percent is None:
            return "-"
        return f"{math.floor(self.percent * 10) / 10:.1f} % ({self.covered} of {self.total})"
