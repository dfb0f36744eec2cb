"""Tests, coverage, limits and upload of one run of ``coverage-upload``."""

import enum
from collections.abc import Mapping
from dataclasses import dataclass

from calibration.coverage.lines import FileCoverage, Rate
from calibration.coverage.reading import Found
from calibration.coverage.tests import Tests
from calibration.report import Check


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
    """A smallest percentage of lines that tests must run."""

    name: str
    """Name of the option: minimum, minimum-change."""
    minimum: float
    """Percent."""
    rate: Rate
    of_change: bool = False
    """Whether it is of the lines of a change, which passes where the change has no line that can be run."""

    @property
    def check(self) -> Check:
        """The comparison of the lines that are run with the limit."""
        return Check(
            subject="lines of the change that are run" if self.of_change else "lines that are run",
            found=str(self.rate) if self.rate.total else "no line",
            expected=f"at least {self.minimum:g} % ({self.name})",
            passed=self.rate.reaches(self.minimum) or (self.of_change and self.rate.total == 0),
            value=self.rate.percent,
            limit=self.minimum,
            minimum=True,
            unit="%",
        )


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
        """Why the verdict is fail, one line each; none if it is pass."""
        tests = [self.tests.problem] if self.tests is not None and self.tests.problem else []
        return tests + [str(limit.check) for limit in self.limits if not limit.check.passed]
