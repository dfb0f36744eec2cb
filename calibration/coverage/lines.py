"""Which lines of files tests run, how many of how many, and how reports of the same files are combined."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field

from calibration.records import computed, field, result


@result
class Rate:
    """So many of so many."""

    covered: int = field("How many tests run.", default=0)
    total: int = field("Of how many that can be run.", default=0)

    def __add__(self, other: "Rate") -> "Rate":
        return Rate(self.covered + other.covered, self.total + other.total)

    @property
    @computed()
    def percent(self) -> float | None:
        """With two decimals, rounded down, so that only all is 100; null of nothing."""
        return None if self.total == 0 else self.covered * 10_000 // self.total / 100

    def reaches(self, minimum: float) -> bool:
        """Whether it is at least so many percent; nothing reaches no limit."""
        return self.total > 0 and self.covered * 100 >= minimum * self.total

    def __str__(self) -> str:
        if self.percent is None:
            return "-"
        return f"{math.floor(self.percent * 10) / 10:.1f} % ({self.covered} of {self.total})"


@dataclass(frozen=True)
class FileCoverage:
    """What tests run of a file."""

    hits: Mapping[int, int] = dataclass_field(default_factory=dict)
    """How often each line that can be run was run; the first line is 1."""
    branches: Mapping[int, Rate] = dataclass_field(default_factory=dict)
    """Of each line that branches, how many of its branches were taken."""

    @property
    def line_rate(self) -> Rate:
        """Of the lines that can be run."""
        return Rate(sum(count > 0 for count in self.hits.values()), len(self.hits))

    @property
    def branch_rate(self) -> Rate:
        """Of all branches."""
        return sum(self.branches.values(), Rate())

    @property
    def missing(self) -> list[int]:
        """The lines that no test runs, in order."""
        return sorted(line for line, count in self.hits.items() if count == 0)

    def ranges(self, lines: Iterable[int]) -> list[tuple[int, int]]:
        """Some of the lines that can be run, joined to ranges of first and last between which there is no other."""
        return ranges(lines, self.hits.keys() - set(lines))


def combined(parts: Iterable[FileCoverage]) -> FileCoverage:
    """What several reports say of one file together: all their lines, the hits of each summed.

    Of branches a report says only how many were taken, not which, so the most that one report has seen counts.
    """
    hits: dict[int, int] = {}
    branches: dict[int, Rate] = {}
    for part in parts:
        for line, count in part.hits.items():
            hits[line] = hits.get(line, 0) + count
        for line, rate in part.branches.items():
            known = branches.get(line, Rate())
            branches[line] = Rate(max(known.covered, rate.covered), max(known.total, rate.total))
    return FileCoverage(hits, branches)


def ranges(lines: Iterable[int], others: Iterable[int]) -> list[tuple[int, int]]:
    """Join lines to ranges of first and last, as long as none of the ``others`` lies between.

    What is neither (comments, empty lines) does not keep them apart.
    """
    chosen = set(lines)
    found: list[tuple[int, int]] = []
    joined = False
    for line in sorted(chosen.union(others)):
        if line not in chosen:
            joined = False
        elif joined:
            found[-1] = (found[-1][0], line)
        else:
            found.append((line, line))
            joined = True
    return found
