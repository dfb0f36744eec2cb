"""Results of ``static-analysis``, and their document."""

from collections import Counter
from collections.abc import Mapping

from calibration.analysis.finding import CATEGORIES, Finding
from calibration.records import computed, field, result
from calibration.report import Check


@result
class Tool:
    """An analyser that ran."""

    name: str
    version: str = field("Empty where it has none of its own.")
    files: int = field("How many files it looked at.")


@result
class Suppressed:
    """A finding that the team has accepted."""

    finding: Finding
    reason: str = field("Why.")


@result
class Results:
    """Results of static-analysis."""

    tools: tuple[Tool, ...] = field("The analysers that had files to look at.")
    files: int = field("How many files at least one of them looked at.")
    code_lines: int = field("How many lines those files have that are not empty.")
    left_out: Mapping[str, str] = field("Why a file was not analysed, by its path.")
    base: str | None = field("The commit that the change set out from; null where there is nothing to compare with.")
    new: tuple[Finding, ...] = field("What the change has brought in.")
    unchanged: tuple[Finding, ...] = field("What was there before; everything where there is no base.")
    fixed: tuple[Finding, ...] = field("What is gone, at its line in the base.")
    suppressed: tuple[Suppressed, ...] = field("What the team has accepted.")
    remarks: tuple[str, ...] = field("Suppressions that have ended or cover nothing; why there is no base.")
    checks: tuple[Check, ...] = field("The limits.")

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings that are not accepted, the new ones first."""
        return self.new + self.unchanged

    @property
    @computed()
    def by_category(self) -> dict[str, int]:
        """Number of findings of each category."""
        counts = Counter(finding.category for finding in self.findings)
        return {category: counts[category] for category in CATEGORIES}

    @property
    @computed()
    def per_thousand_lines(self) -> float | None:
        """Number of findings per thousand lines; null if there are no lines."""
        return round(1000 * len(self.findings) / self.code_lines, 2) if self.code_lines else None

    @property
    @computed()
    def problems(self) -> list[str]:
        """Reasons of a fail verdict, one line each; empty if it is pass."""
        return [str(check) for check in self.checks if not check.passed]
