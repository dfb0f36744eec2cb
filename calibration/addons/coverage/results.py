"""Results of ``coverage-upload`` and their document: tests, coverage, limits and upload."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

from calibration.addons.coverage.formats import FileCoverage, Rate
from calibration.addons.coverage.pseudo_tested import OVER_BUDGET, PseudoTestedResults
from calibration.addons.coverage.reading import Found, UncountedFile
from calibration.addons.coverage.tests import Tests
from calibration.base.records import computed, field, result
from calibration.base.verdict import at_most
from calibration.ci.report import Check, Verdict, verdict_of

State = Literal["uploaded", "skipped", "failed", "dry-run", "none"]
"""Outcome of the upload; none without a service."""


@result
class Uploaded:
    """The upload of the coverage to a service."""

    service: str = field("The name of the service, or none.", default="none")
    state: State = field("What came of it.", default="none")
    reason: str = field("Why it was skipped or failed; else empty.", default="")


@result
class CoverageLimit:
    """Lower limit of the percentage of covered lines or functions."""

    name: str = field("The option: minimum, minimum-change, minimum-functions, minimum-functions-change.")
    minimum: float = field("The limit.", unit="percent")
    rate: Rate = field("The lines, or the functions, that it is of.", key="lines")
    what: str = "lines"
    of_change: bool = False
    """Whether it applies to a change; then it passes if the change has no executable line, or no function."""

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Verdict of the limit."""
        return verdict_of(self.check.passed)

    @property
    def check(self) -> Check:
        """Comparison of the covered lines with the limit."""
        return Check(
            subject=f"{self.what}{' of the change' if self.of_change else ''} that are run",
            found=str(self.rate) if self.rate.total else f"no {self.what.removesuffix('s')}",
            expected=f"at least {self.minimum:g} % ({self.name})",
            passed=self.rate.reaches(self.minimum) or (self.of_change and self.rate.total == 0),
            value=self.rate.percent,
            limit=self.minimum,
            minimum=True,
            unit="%",
        )


@result
class PseudoTestedLimit:
    """Upper limit of the number of functions that tests run and do not test."""

    name: str = field("The option: max-pseudo-tested, max-pseudo-tested-change.")
    maximum: int = field("The limit.")
    found: int = field("How many there are.")
    unjudged: int = field("Functions that the budget of time did not suffice for.")

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Verdict of the limit."""
        return verdict_of(self.check.passed)

    @property
    def undecided(self) -> str | None:
        """Why the limit is neither kept nor broken; None if it is one of these."""
        if not self.check.passed or self.found + self.unjudged <= self.maximum:
            return None
        return f"{self.name} is undecided: {self.unjudged} functions are not judged, as {OVER_BUDGET}"

    @property
    def check(self) -> Check:
        """Comparison of the number with the limit."""
        of_change = " of the change" if self.name.endswith("-change") else ""
        subject = f"functions{of_change} that tests run and do not test"
        return replace(at_most(subject, self.found, self.maximum), expected=f"at most {self.maximum} ({self.name})")


@result
class Span:
    """Consecutive lines of a file that no test runs."""

    path: str = field("The file, in the repository.")
    first: int = field("The first line; the first of the file is 1.")
    last: int = field("The last line.")


@result
class CoverageOfChange:
    """Coverage of the lines that a change touched."""

    base: str = field("The commit that it is compared with.")
    rate: Rate = field("The lines of the change.", key="lines")
    missing: tuple[Span, ...] = field("What no test runs of the change.")
    functions: Rate = field("The functions that the change touches.", default_factory=Rate)


@result
class FileResult:
    """Coverage of a file that counts."""

    path: str = field("In the repository.")
    lines: Rate = field("The lines that can be run.")
    branches: Rate = field("The branches.")
    functions: Rate = field("The functions.")
    missing: tuple[tuple[int, int], ...] = field("Lines that no test runs, as first and last.")


@result
class CoverageResults:
    """Results of coverage-upload."""

    found: Found
    goal: float = field("Percent of its lines that every file is to have run.")
    commit: str = field("The commit that the coverage is of.")
    tests: Tests | None = field("What came of the tests; null where only reports were read.", default=None)
    change: CoverageOfChange | None = field(
        "Of the lines that the change touched; null where there is nothing to compare with.", default=None
    )
    no_change: str = ""
    """Reason why there is no base to compare with."""
    limits: tuple[CoverageLimit, ...] = field("The limits of coverage that were asked for.", default=())
    pseudo_tested: PseudoTestedResults | None = field(
        "Functions that tests run and do not test; null where none were looked for.", default=None
    )
    no_pseudo_tested: str = ""
    """Reason why none were looked for, though it was asked for."""
    pseudo_tested_limits: tuple[PseudoTestedLimit, ...] = field("The limits of these.", default=())
    upload: Uploaded = field("What came of the upload.", default_factory=Uploaded)

    @property
    def files(self) -> Mapping[str, FileCoverage]:
        """Coverage by path."""
        return self.found.files

    @property
    @computed("files")
    def file_results(self) -> tuple[FileResult, ...]:
        """Results of the files that count."""
        return tuple(
            FileResult(
                path,
                each.line_rate,
                each.branch_rate,
                each.function_rate,
                tuple(each.ranges(each.missing)),
            )
            for path, each in sorted(self.files.items())
        )

    @property
    @computed()
    def left_out(self) -> UncountedFile:
        """Files and names that are not counted."""
        return self.found.left_out

    @property
    @computed()
    def lines(self) -> Rate:
        """Rate of the lines of all files."""
        return sum((coverage.line_rate for coverage in self.files.values()), Rate())

    @property
    @computed()
    def branches(self) -> Rate:
        """Rate of the branches of all files."""
        return sum((coverage.branch_rate for coverage in self.files.values()), Rate())

    @property
    @computed()
    def functions(self) -> Rate:
        """Rate of the functions of all files of which a line was run."""
        return sum((coverage.function_rate for coverage in self.files.values()), Rate())

    @property
    @computed()
    def files_below_goal(self) -> int:
        """Number of files below the goal."""
        return len(self.below_goal)

    @property
    def below_goal(self) -> list[str]:
        """The files below the goal, the least covered first."""
        below = {path: rate for path, rate in self.line_rates().items() if rate.total and not rate.reaches(self.goal)}
        return sorted(below, key=lambda path: (below[path].covered / below[path].total, path))

    def line_rates(self) -> dict[str, Rate]:
        """Return the line rate of each file."""
        return {path: coverage.line_rate for path, coverage in self.files.items()}

    @property
    @computed()
    def problems(self) -> list[str]:
        """Reasons for the verdict fail, one line each; empty if it is pass."""
        tests = [self.tests.problem] if self.tests is not None and self.tests.problem else []
        checks = [limit.check for limit in self.limits] + [limit.check for limit in self.pseudo_tested_limits]
        return tests + [str(check) for check in checks if not check.passed]

    @property
    def undecided(self) -> list[str]:
        """Limits that are neither kept nor broken, one line each."""
        return list(filter(None, (limit.undecided for limit in self.pseudo_tested_limits)))


def coverage_of_change(
    base: str, changed: Mapping[str, set[int]], files: Mapping[str, FileCoverage]
) -> CoverageOfChange:
    """Return the coverage of the changed executable lines and of the functions that have any, and what no test runs."""
    total = functions = Rate()
    missing: list[Span] = []
    for path in sorted(changed.keys() & files.keys()):
        part = {line: hits for line, hits in files[path].hits.items() if line in changed[path]}
        coverage = FileCoverage(part)
        total += coverage.line_rate
        missing += [Span(path, *each) for each in files[path].ranges(coverage.missing)]
        spans = {
            span: hits
            for span, hits in files[path].functions.items()
            if any(span[0] <= line <= span[1] for line in changed[path])
        }
        functions += FileCoverage(functions=spans).function_rate
    return CoverageOfChange(base, total, tuple(missing), functions)
