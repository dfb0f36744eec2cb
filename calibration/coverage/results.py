"""What came of it all: tests, coverage, limits, upload; and the verdict."""

import enum
from collections.abc import Mapping
from dataclasses import dataclass

from calibration.coverage.lines import FileCoverage
from calibration.coverage.measuring.tests import Tests
from calibration.coverage.rate import Rate
from calibration.coverage.reading import Found
from calibration.errors import ExitCode


class Uploaded(enum.StrEnum):
    """What came of the upload."""

    YES = "uploaded"
    SKIPPED = "skipped"
    FAILED = "failed"
    DRY_RUN = "dry-run"
    NONE = "none"
    """No service was asked for."""


@dataclass(frozen=True)
class Limit:
    """A limit that makes it red."""

    name: str
    """As the user writes it: minimum, minimum-change."""
    minimum: float
    """Percent."""
    rate: Rate
    of_nothing: bool = False
    """Whether it passes where there is nothing to judge: a change need not have a line that can be run."""

    @property
    def passed(self) -> bool:
        """Whether it is kept."""
        return self.rate.reaches(self.minimum) or (self.of_nothing and self.rate.total == 0)


@dataclass(frozen=True)
class Change:
    """What is covered of the lines that a change touched."""

    base: str
    """The commit that it is compared with."""
    rate: Rate
    missing: Mapping[str, list[int]]
    """The lines that no test runs, by file."""


@dataclass(frozen=True)
class Results:
    """Everything."""

    found: Found
    goal: float
    """Percent that every file is to have."""
    commit: str
    tests: Tests | None = None
    """None where only reports were read."""
    change: Change | None = None
    """None where there is nothing to compare with."""
    no_change: str = ""
    """Why not."""
    limits: tuple[Limit, ...] = ()
    service: str = "none"
    uploaded: Uploaded = Uploaded.NONE
    upload_reason: str = ""
    """Why it was skipped or failed."""

    @property
    def files(self) -> Mapping[str, FileCoverage]:
        """What is covered, by path."""
        return self.found.files

    @property
    def lines(self) -> Rate:
        """Of all files."""
        return sum((coverage.line_rate for coverage in self.files.values()), Rate())

    @property
    def branches(self) -> Rate:
        """Of all files."""
        return sum((coverage.branch_rate for coverage in self.files.values()), Rate())

    @property
    def below_goal(self) -> list[str]:
        """The files below the goal, the least covered first."""
        below = {path: rate for path, rate in self.line_rates().items() if rate.total and not rate.reaches(self.goal)}
        return sorted(below, key=lambda path: (below[path].covered / below[path].total, path))

    def line_rates(self) -> dict[str, Rate]:
        """Of every file."""
        return {path: coverage.line_rate for path, coverage in self.files.items()}

    @property
    def problems(self) -> list[str]:
        """Why the verdict is fail, a line for each; none when it is pass."""
        problems = [self.tests.problem] if self.tests is not None and self.tests.problem else []
        for limit in self.limits:
            if not limit.passed:
                of = "of the change" if limit.of_nothing else "of all lines"
                problems.append(f"{limit.rate} {of} are run, {limit.name} is {limit.minimum:g} %")
        return problems

    @property
    def passed(self) -> bool:
        """The verdict."""
        return not self.problems

    @property
    def exit_code(self) -> ExitCode:
        """The verdict goes before what became of the upload."""
        if not self.passed:
            return ExitCode.FAIL
        return ExitCode.WORLD if self.uploaded is Uploaded.FAILED else ExitCode.PASS
