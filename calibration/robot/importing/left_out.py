"""What an import leaves out, counted by rule and place: nothing goes in silence."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from calibration.robot.importing.results import LeftOut

NS_PER_S = 1e9


@dataclass
class LeftOutCounts:
    """Counts of what was left out, and the stamp of the first of each."""

    _counts: dict[tuple[str, str], int] = field(default_factory=dict)
    _first: dict[tuple[str, str], float | None] = field(default_factory=dict)

    def add(self, rule: str, place: str, stamp: float | None = None, count: int = 1) -> None:
        """Count something.

        Args:
            rule: why it is left out.
            place: its sensor, topic, frame or joint.
            stamp: its time, ns.
            count: how many there are.
        """
        if not count:
            return
        key = (rule, place)
        self._counts[key] = self._counts.get(key, 0) + count
        self._first.setdefault(key, stamp)

    def of(self, place: str) -> Iterator[str]:
        """Yield in words what was left out of one place."""
        for (rule, where), count in self._counts.items():
            if where == place:
                yield f"{count} left out: {rule}"

    def results(self) -> tuple[LeftOut, ...]:
        """Return them as results, in the order in which they were found."""
        return tuple(
            LeftOut(rule, place, count, None if first is None else round(first / NS_PER_S, 6))
            for ((rule, place), count), first in zip(self._counts.items(), self._first.values(), strict=True)
        )
