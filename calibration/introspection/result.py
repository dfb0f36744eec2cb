"""Results of rules applied to tables."""

from dataclasses import dataclass

from calibration.report.check import expectation


@dataclass(frozen=True)
class Violation:
    """One value that is not as a rule asks."""

    file: str
    line: int | None
    """Line of the file, None where the violation is in no one line."""
    column: str | None
    """None where the violation is the table's."""
    row: str
    """Label of the row, or what stands for it (``p95 of every row``)."""
    found: str
    expected: str

    @property
    def message(self) -> str:
        """The violation in one sentence."""
        place = self.row if self.column is None else f"{self.column}, {self.row}"
        return expectation(place, self.found, self.expected)


@dataclass(frozen=True)
class RuleResult:
    """One rule applied to one table."""

    column: str | None
    """None where the check is of the table."""
    rows: str
    """Which rows were judged: ``every row``, ``row Averages``, ``p95 of every row``."""
    expected: str
    judged: int
    """How many values were judged."""
    value: float | str | None
    """The value, where there was only one."""
    smallest: float | None
    """The smallest of the numbers among the judged values; None where there was none."""
    largest: float | None
    violations: tuple[Violation, ...]

    @property
    def passed(self) -> bool:
        """Whether every value is as asked."""
        return not self.violations


@dataclass(frozen=True)
class TableResult:
    """All rules applied to one table."""

    file: str
    rows: int
    """How many rows the table has, those that sum up others included."""
    key_column: str
    checks: tuple[RuleResult, ...]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    @property
    def violations(self) -> tuple[Violation, ...]:
        """All violations, in the order of the checks and the lines."""
        return tuple(violation for check in self.checks for violation in check.violations)
