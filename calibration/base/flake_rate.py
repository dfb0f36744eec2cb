"""Rate of failures over repeated runs: with its confidence interval, and the runs that a rare failure takes to show."""

import math

from calibration.base.records import computed, field, result
from calibration.base.text import rounded

CONFIDENCE = 0.95
MAX_REPETITIONS = 1000
"""Limit of the runs of one piece of work."""
_BISECTIONS = 60
"""Halvings of [0, 1] until the interval's ends are exact in double precision."""


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
