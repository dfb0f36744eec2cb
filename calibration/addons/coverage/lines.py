"""Line, branch and function coverage of files, and the combination of reports of the same files."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field

from calibration.base.records import computed, field, result


@result
class Rate:
    """A ratio of counts: covered and total."""

    covered: int = field("Number of lines, branches or functions that tests run.", default=0)
    total: int = field("Number of executable lines, of branches or of functions.", default=0)

    def __add__(self, other: "Rate") -> "Rate":
        return Rate(self.covered + other.covered, self.total + other.total)

    @property
    @computed()
    def percent(self) -> float | None:
        """Percentage with two decimals, rounded down, so that only full coverage is 100; null if total is 0."""
        return None if self.total == 0 else self.covered * 10_000 // self.total / 100

    def reaches(self, minimum: float) -> bool:
        """Return whether the percentage is at least ``minimum``; always False if total is 0."""
        return self.total > 0 and self.covered * 100 >= minimum * self.total

    def __str__(self) -> str:
        if self.percent is None:
            return "-"
        return f"{math.floor(self.percent * 10) / 10:.1f} % ({self.covered} of {self.total})"


@dataclass(frozen=True)
class FileCoverage:
    """Line, branch and function coverage of a file."""

    hits: Mapping[int, int] = dataclass_field(default_factory=dict)
    """Hits of each executable line; the first line is 1."""
    branches: Mapping[int, Rate] = dataclass_field(default_factory=dict)
    """Branches taken, by the line that branches."""
    functions: Mapping[tuple[int, int], int] = dataclass_field(default_factory=dict)
    """Hits of each function, by its first and last line: those of the line of its that is run most."""

    @property
    def line_rate(self) -> Rate:
        """Rate of executable lines."""
        return Rate(sum(count > 0 for count in self.hits.values()), len(self.hits))

    @property
    def branch_rate(self) -> Rate:
        """Rate of all branches."""
        return sum(self.branches.values(), Rate())

    @property
    def function_rate(self) -> Rate:
        """Rate of functions of which a line was run."""
        return Rate(sum(count > 0 for count in self.functions.values()), len(self.functions))

    @property
    def missing(self) -> list[int]:
        """Lines that no test runs, in order."""
        return sorted(line for line, count in self.hits.items() if count == 0)

    def ranges(self, lines: Iterable[int]) -> list[tuple[int, int]]:
        """Join executable lines to ranges (first, last) without another executable line between."""
        return ranges(lines, self.hits.keys() - set(lines))


def combined(parts: Iterable[FileCoverage]) -> FileCoverage:
    """Combine the coverage of one file from several reports: the union of the lines, with the sum of their hits.

    A report gives the number of branches taken, not which ones, so the maximum over the reports is used.
    """
    hits: dict[int, int] = {}
    branches: dict[int, Rate] = {}
    functions: dict[tuple[int, int], int] = {}
    for part in parts:
        for line, count in part.hits.items():
            hits[line] = hits.get(line, 0) + count
        for line, rate in part.branches.items():
            known = branches.get(line, Rate())
            branches[line] = Rate(max(known.covered, rate.covered), max(known.total, rate.total))
        for span, count in part.functions.items():
            functions[span] = functions.get(span, 0) + count
    return FileCoverage(hits, branches, functions)


def ranges(lines: Iterable[int], others: Iterable[int]) -> list[tuple[int, int]]:
    """Join lines to ranges (first, last) that contain none of the ``others``.

    Lines in neither set (comments, empty lines) do not split a range.
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
