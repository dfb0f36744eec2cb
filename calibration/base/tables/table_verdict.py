"""Evaluation of rules on a table, and the document of its results."""

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import TypeAlias

from calibration.base.errors import InputError
from calibration.base.records import computed, field, result
from calibration.base.tables.rules import ChangeRule, LimitRule, Limits, Rule, RuleSet, TextRule
from calibration.base.tables.table import Aggregate, EveryRow, KeyedTable, Table
from calibration.base.text import count_of, not_a_number, number_text, parse_number, shorten
from calibration.base.verdict import Verdict, expectation, verdict_of


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


MAX_MATCHED = 1000
"""Length limit of cells for regular expressions, in characters; a longer cell is a violation."""


def judge(table: Table, rules: RuleSet, baseline: Table | None = None) -> TableResult:
    """Apply rules to a table and return every violation.

    A cell that is not a finite decimal number violates every numeric rule, and a table without rows
    violates every rule. ``baseline`` is the reference table of ``max-increase`` and ``max-decrease``;
    there "every row" is matched by label, and a row that only one of the two tables has is a
    violation.

    Raises :class:`InputError` if there is nothing to judge, a column or a labelled row is missing,
    a requested label occurs twice, or the baseline is missing or not numeric.
    """
    if not rules.judges:
        raise InputError(f"{table.name}: there is no rule, so nothing would be judged")
    keyed = KeyedTable.of(table, rules.key_column, rules.excluded_rows)
    keyed_baseline = None if baseline is None else KeyedTable.of(baseline, rules.key_column, rules.excluded_rows)
    checks = [_check_row_count(keyed, rules.min_rows or 1)]
    if rules.required_rows:
        checks.append(_check_required_rows(keyed, rules.required_rows))
    checks += [_check_rule(keyed, rule, keyed_baseline) for rule in rules.rules]
    return TableResult(table.name, len(table.rows), keyed.key_column, tuple(checks))


@dataclass(frozen=True, slots=True)
class _Cell:
    """A value to judge and its position."""

    line: int | None
    row: str
    """Label of the row, or the aggregate."""
    text: str


_Finding: TypeAlias = tuple[_Cell, str, str]
"""A cell that violates a rule, with the found and the expected value."""


def _check_row_count(keyed: KeyedTable, minimum: int) -> RuleResult:
    count = len(keyed.every_row)
    expected = f"at least {minimum}"
    violation = Violation(keyed.table.name, None, None, "number of rows", str(count), expected)
    return RuleResult(
        None, "number of rows", expected, 1, count, count, count, () if count >= minimum else (violation,)
    )


def _check_required_rows(keyed: KeyedTable, required: Sequence[str]) -> RuleResult:
    file, column = keyed.table.name, keyed.key_column
    missing = [label for label in required if label not in keyed.labels]
    violations = tuple(
        Violation(file, None, column, label, "no such row", "a row with this label") for label in missing
    )
    return RuleResult(column, "required rows", ", ".join(required), len(required), None, None, None, violations)


def _check_rule(keyed: KeyedTable, rule: Rule, baseline: KeyedTable | None) -> RuleResult:
    cells = _judged_cells(keyed, rule)
    if not cells:
        findings = [(_Cell(None, str(rule.target), ""), "no row", str(rule))]
    elif isinstance(rule, TextRule):
        findings = _judge_text(rule, cells)
    elif isinstance(rule, LimitRule):
        findings = [finding for cell in cells for finding in _judge_number(cell, rule.limits, str(rule))]
    else:
        findings = _judge_change(rule, cells, keyed, baseline)
    numbers = (
        []
        if isinstance(rule, TextRule)
        else [number for cell in cells if (number := _number_of_cell(cell)) is not None]
    )
    only = cells[0] if len(cells) == 1 else None
    return RuleResult(
        column=rule.column,
        rows=str(rule.target),
        expected=str(rule),
        judged=len(cells),
        value=None if only is None else numbers[0] if numbers else only.text,
        smallest=min(numbers, default=None),
        largest=max(numbers, default=None),
        violations=tuple(
            Violation(keyed.table.name, cell.line, rule.column, cell.row or f"line {cell.line}", found, expected)
            for cell, found, expected in findings[:MOST_LISTED]
        ),
        unlisted=max(0, len(findings) - MOST_LISTED),
    )


def _judged_cells(keyed: KeyedTable, rule: Rule) -> list[_Cell]:
    """Return the values that a rule judges: the cells of its rows, or their aggregate.

    If a cell is not a number there is no aggregate; then the non-numeric cells are returned.
    """
    column = keyed.table.column(rule.column)
    if isinstance(rule.target, EveryRow | Aggregate):
        rows = keyed.every_row
    else:
        row = keyed.row(rule.target)
        rows = () if row is None else (row,)
    cells = [_Cell(row.line, keyed.label(row), row.cells[column]) for row in rows]
    if not isinstance(rule.target, Aggregate) or not cells:
        return cells
    no_numbers = [cell for cell in cells if _number_of_cell(cell) is None]
    if no_numbers:
        return no_numbers
    aggregate = rule.target([Decimal(cell.text) for cell in cells])
    return [_Cell(None, str(rule.target), number_text(float(aggregate)))]


def _judge_text(rule: TextRule, cells: Sequence[_Cell]) -> list[_Finding]:
    findings = []
    for cell in cells:
        if rule.matches is not None and len(cell.text) > MAX_MATCHED:
            findings.append((cell, f"a text of {len(cell.text)} characters", f"at most {MAX_MATCHED}, {rule}"))
        elif not rule.admit(cell.text):
            findings.append((cell, repr(shorten(cell.text)), str(rule)))
    return findings


def _judge_number(cell: _Cell, limits: Limits, expected: str) -> list[_Finding]:
    number = _number_of_cell(cell)
    if number is None:
        found = not_a_number(cell.text) if cell.text else "an empty cell"
        return [(cell, found, f"a number {expected}")]
    return [] if limits.admit(number) else [(cell, shorten(cell.text), expected)]


def _judge_change(
    rule: ChangeRule, cells: Sequence[_Cell], keyed: KeyedTable, baseline: KeyedTable | None
) -> list[_Finding]:
    if baseline is None:
        raise InputError(f"{keyed.table.name}: {rule.column}: {rule} was expected, but there is no baseline")
    before = _baseline_numbers(baseline, rule)
    findings: list[_Finding] = []
    if isinstance(rule.target, EveryRow):
        _refuse_repeated_labels(keyed, cells)
        gone = before.keys() - {cell.row for cell in cells}
        findings += [(_Cell(None, row, ""), "no such row", "the row that the baseline has") for row in sorted(gone)]
    else:  # an aggregate is one number per table, independent of row labels
        before = {cell.row: number for cell in cells for number in before.values()}
    for cell in cells:
        if cell.row not in before:
            findings.append((cell, "a new row", "a row that the baseline has"))
            continue
        limits = rule.limits(before[cell.row])
        findings += _judge_number(cell, limits, f"{limits} (baseline {number_text(before[cell.row])})")
    return findings


def _baseline_numbers(baseline: KeyedTable, rule: ChangeRule) -> dict[str, float]:
    """Return the baseline's numbers by row label."""
    cells = _judged_cells(baseline, rule)
    name = baseline.table.name
    if not cells:
        raise InputError(f"{name}: the baseline has no row to compare with ({rule.column}, {rule.target})")
    if isinstance(rule.target, EveryRow):
        _refuse_repeated_labels(baseline, cells)
    numbers = {}
    for cell in cells:
        number = _number_of_cell(cell)
        if number is None:
            line = "" if cell.line is None else f":{cell.line}"
            raise InputError(f"{name}{line}: {rule.column}: the baseline has {not_a_number(cell.text)}")
        numbers[cell.row] = number
    return numbers


def _refuse_repeated_labels(keyed: KeyedTable, cells: Sequence[_Cell]) -> None:
    seen = set()
    for cell in cells:
        if cell.row in seen:
            raise InputError(
                f"{keyed.table.name}:{cell.line}: a second row is labelled {cell.row!r}, "
                f"so rows cannot be matched with the baseline; is {keyed.key_column!r} the key column?"
            )
        seen.add(cell.row)


def _number_of_cell(cell: _Cell) -> float | None:
    return parse_number(cell.text)
