"""Report of ``introspect-csv``."""

from collections.abc import Sequence

from calibration.base.records import document_of
from calibration.base.tables.table_verdict import Results, RuleResult, TableResult, Violation
from calibration.base.text import shorten
from calibration.ci.report import Lines, Outcome, Report, Table, count_of, verdict_of
from calibration.ci.workflow.annotation import Annotation

TITLE = "introspect-csv"


def report(tables: Sequence[TableResult]) -> Report:
    """Return the report of ``introspect-csv``."""
    results = Results(tuple(tables))
    violations = [violation for table in tables for violation in table.violations]
    checks = [(table, check) for table in tables for check in table.checks]
    notes = tuple(
        f"{table.file}: {check.column}, {check.rows}: {count_of(check.unlisted, 'more violation')} not listed"
        for table, check in checks
        if check.unlisted
    )
    return Report(
        title=TITLE,
        verdict=verdict_of(not violations),
        notes=notes,
        sentence=results.sentence,
        results=results,
        outputs={
            "violations": results.count,
            "values": [{"file": table.file, **document_of(check)} for table, check in checks],
        },
        annotations=tuple(
            Annotation(violation.message, file=violation.file, line=violation.line) for violation in violations
        ),
        blocks=(
            Table(_VIOLATION_HEADER, tuple(map(_violation_row, violations))),
            Lines(notes),
            Table(_CHECK_HEADER, tuple(_check_row(*each) for each in checks), title="What was checked", folded=True),
        ),
        suites={table.file: [_outcome_of_rule(table, check) for check in table.checks] for table in tables},
    )


_CHECK_HEADER = ("verdict", "file", "column", "rows", "value", "expected")
_VIOLATION_HEADER = ("file", "line", "column", "row", "found", "expected")


def _check_row(table: TableResult, check: RuleResult) -> tuple[str, ...]:
    if check.value is not None:
        value = str(check.value)
    elif check.smallest is not None:
        value = f"{check.smallest} to {check.largest}"
    else:
        value = count_of(check.judged, "value")
    return check.verdict, table.file, check.column or "", check.rows, shorten(value), check.expected


def _violation_row(violation: Violation) -> tuple[str, ...]:
    line = "" if violation.line is None else str(violation.line)
    return violation.file, line, violation.column or "", violation.row, violation.found, violation.expected


def _outcome_of_rule(table: TableResult, check: RuleResult) -> Outcome:
    lines = [
        f"{violation.file}:{violation.line or ''}{':' if violation.line else ''} {violation.message}"
        for violation in check.violations
    ]
    return Outcome(
        name=f"{check.rows if check.column is None else f'{check.column}, {check.rows}'}: {check.expected}",
        group=table.file,
        reasons=() if not check.violations else (count_of(check.count, "violation"), *lines),
        file=table.file,
        line=next((violation.line for violation in check.violations), None),
    )
