"""Verdicts over tables as a report."""

from collections.abc import Sequence
from typing import Any

from calibration.introspection.result import RuleResult, TableResult, Violation
from calibration.report import Outcome, Report, Table, count_of, verdict_of
from calibration.workflow.annotations import Annotation
from calibration.workflow.text import shorten

TITLE = "introspect-csv"


def report(verdicts: Sequence[TableResult]) -> Report:
    """Return the report of ``introspect-csv``."""
    passed = all(verdict.passed for verdict in verdicts)
    violations = [violation for verdict in verdicts for violation in verdict.violations]
    checks = [(verdict, check) for verdict in verdicts for check in verdict.checks]
    found = f"{count_of(len(checks), 'check')} of {count_of(len(verdicts), 'table')}"
    sentence = f"{count_of(len(violations), 'violation')} in {found}" if violations else found
    return Report(
        title=TITLE,
        verdict=verdict_of(passed),
        sentence=sentence,
        results={
            "reasons": [] if passed else [sentence],
            "violations": len(violations),
            "tables": [_table_object(verdict) for verdict in verdicts],
        },
        outputs={
            "violations": len(violations),
            "values": [{"file": verdict.file, **_check_object(check)} for verdict, check in checks],
        },
        annotations=tuple(
            Annotation(violation.message, file=violation.file, line=violation.line) for violation in violations
        ),
        blocks=(
            Table(_VIOLATION_HEADER, tuple(map(_violation_row, violations))),
            Table(_CHECK_HEADER, tuple(_check_row(*each) for each in checks), title="What was checked", folded=True),
        ),
        suites={verdict.file: [_outcome(verdict, check) for check in verdict.checks] for verdict in verdicts},
    )


_CHECK_HEADER = ("verdict", "file", "column", "rows", "value", "expected")
_VIOLATION_HEADER = ("file", "line", "column", "row", "found", "expected")


def _check_row(verdict: TableResult, check: RuleResult) -> tuple[str, ...]:
    if check.value is not None:
        value = str(check.value)
    elif check.smallest is not None:
        value = f"{check.smallest} to {check.largest}"
    else:
        value = count_of(check.judged, "value")
    return verdict_of(check.passed), verdict.file, check.column or "", check.rows, shorten(value), check.expected


def _violation_row(violation: Violation) -> tuple[str, ...]:
    line = "" if violation.line is None else str(violation.line)
    return violation.file, line, violation.column or "", violation.row, violation.found, violation.expected


def _outcome(verdict: TableResult, check: RuleResult) -> Outcome:
    lines = [
        f"{violation.file}:{violation.line or ''}{':' if violation.line else ''} {violation.message}"
        for violation in check.violations
    ]
    return Outcome(
        name=f"{check.rows if check.column is None else f'{check.column}, {check.rows}'}: {check.expected}",
        group=verdict.file,
        reasons=() if check.passed else (count_of(len(check.violations), "violation"), *lines),
        file=verdict.file,
        line=next((violation.line for violation in check.violations), None),
    )


def _table_object(verdict: TableResult) -> dict[str, Any]:
    return {
        "file": verdict.file,
        "rows": verdict.rows,
        "key_column": verdict.key_column,
        "verdict": verdict_of(verdict.passed),
        "checks": [_check_object(check) for check in verdict.checks],
        "violations": [_violation_object(violation) for violation in verdict.violations],
    }


def _check_object(check: RuleResult) -> dict[str, Any]:
    names = ("column", "rows", "expected", "judged", "value", "smallest", "largest")
    return {
        **{name: getattr(check, name) for name in names},
        "violations": len(check.violations),
        "verdict": verdict_of(check.passed),
    }


def _violation_object(violation: Violation) -> dict[str, Any]:
    return {name: getattr(violation, name) for name in ("line", "column", "row", "found", "expected")}
