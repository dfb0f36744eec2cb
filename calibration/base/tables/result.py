"""Results of rules applied to tables, and their document."""

from calibration.base.check import expectation
from calibration.base.records import computed, field, result
from calibration.base.text import count_of
from calibration.base.verdict import Verdict, verdict_of


@result
class Violation:
    """A value that violates a rule."""

    file: str
    line: int | None = field("Line of the file; null where the violation is in no one line.")
    column: str | None = field("Null where the violation is the table's.")
    row: str = field("Label of the row, or of the aggregate (``p95 of every row``).")
    found: str = field("The value.")
    expected: str = field("What the rule asks for.")

    @property
    def message(self) -> str:
        """The violation in one sentence."""
        place = self.row if self.column is None else f"{self.column}, {self.row}"
        return expectation(place, self.found, self.expected)


MOST_LISTED = 10_000
"""Limit of the listed violations of one rule in one table; the others are counted."""


@result
class RuleResult:
    """Result of one rule on one table."""

    column: str | None = field("Null where the check is of the table.")
    rows: str = field("Which rows were judged: ``every row``, ``row Averages``, ``p95 of every row``.")
    expected: str = field("What the rule asks for.")
    judged: int = field("How many values were judged.")
    value: float | str | None = field("The value, where there was only one.")
    smallest: float | None = field("The smallest of the numbers among the judged values; null where there was none.")
    largest: float | None = field("The largest of them.")
    violations: tuple[Violation, ...]
    unlisted: int = 0
    """Number of violations beyond `violations`."""

    @property
    @computed("violations")
    def count(self) -> int:
        """Number of values that violate the rule."""
        return len(self.violations) + self.unlisted

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Pass if no value violates the rule."""
        return verdict_of(not self.violations)


@result
class TableResult:
    """Results of all rules on one table."""

    file: str = field("The path as it was given.")
    rows: int = field("How many rows the table has, those that sum up others included.")
    key_column: str = field("The column of the rows' labels.")
    checks: tuple[RuleResult, ...] = field("The rules.")

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return not self.violations

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Pass if every check passed."""
        return verdict_of(self.passed)

    @property
    @computed()
    def violations(self) -> tuple[Violation, ...]:
        """Violations, in the order of the checks and the lines, at most 10 000 of each check."""
        return tuple(violation for check in self.checks for violation in check.violations)


@result
class Results:
    """Results of introspect-csv."""

    tables: tuple[TableResult, ...] = field("The tables that were judged.")

    @property
    @computed("violations")
    def count(self) -> int:
        """Violations in all tables together."""
        return sum(check.count for table in self.tables for check in table.checks)

    @property
    @computed()
    def reasons(self) -> tuple[str, ...]:
        """Reasons for the verdict fail."""
        return (self.sentence,) if self.count else ()

    @property
    def sentence(self) -> str:
        """Summary in one line."""
        checks = sum(len(table.checks) for table in self.tables)
        found = f"{count_of(checks, 'check')} of {count_of(len(self.tables), 'table')}"
        return f"{count_of(self.count, 'violation')} in {found}" if self.count else found
