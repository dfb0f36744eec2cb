"""Verdicts as people and programs read them: log, Markdown, JSON, JUnit, annotations."""

import json
from collections.abc import Sequence
from typing import Any

from calibration.introspection.verdict import Check, Verdict, Violation
from calibration.workflow.annotations import Annotation
from calibration.workflow.summary import markdown_table
from calibration.workflow.text import aligned, shorten

SCHEMA = 1
"""Number of the form of results.json; ``results.schema.json`` beside this module describes it."""


def sentence(verdicts: Sequence[Verdict]) -> str:
    """Say what came of it in one line: ``fail: 3 violations of 4 rules in 1 table``."""
    violations = sum(len(verdict.violations) for verdict in verdicts)
    checks = sum(len(verdict.checks) for verdict in verdicts)
    where = f"{_count(checks, 'check')} of {_count(len(verdicts), 'table')}"
    return f"fail: {_count(violations, 'violation')} in {where}" if violations else f"pass: {where}"


def log(verdicts: Sequence[Verdict]) -> str:
    """Write all checks and all violations as plain tables."""
    text = aligned(_CHECK_HEADER, (_check_row(verdict, check) for verdict in verdicts for check in verdict.checks))
    violations = [_violation_row(violation) for verdict in verdicts for violation in verdict.violations]
    return text + ("\n\n" + aligned(_VIOLATION_HEADER, violations) if violations else "")


def markdown(verdicts: Sequence[Verdict]) -> str:
    """Write the summary: the verdict, then the violations, then what was checked."""
    text = f"## introspect-csv: {sentence(verdicts)}\n\n"
    violations = [_violation_row(violation) for verdict in verdicts for violation in verdict.violations]
    if violations:
        text += markdown_table(_VIOLATION_HEADER, violations) + "\n"
    checks = markdown_table(
        _CHECK_HEADER, (_check_row(verdict, check) for verdict in verdicts for check in verdict.checks)
    )
    return f"{text}<details><summary>What was checked</summary>\n\n{checks}\n</details>\n"


def results_json(verdicts: Sequence[Verdict]) -> str:
    """Write everything as JSON in the form of ``results.schema.json``."""
    document = {
        "schema": SCHEMA,
        "verdict": _word(all(verdict.passed for verdict in verdicts)),
        "violations": sum(len(verdict.violations) for verdict in verdicts),
        "tables": [
            {
                "file": verdict.file,
                "rows": verdict.rows,
                "key_column": verdict.key_column,
                "verdict": _word(verdict.passed),
                "checks": [_check_object(check) for check in verdict.checks],
                "violations": [_violation_object(violation) for violation in verdict.violations],
            }
            for verdict in verdicts
        ],
    }
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def values(verdicts: Sequence[Verdict]) -> list[dict[str, Any]]:
    """List the checks of all tables with what they judged, for an output of the step."""
    return [{"file": verdict.file, **_check_object(check)} for verdict in verdicts for check in verdict.checks]


def annotations(verdicts: Sequence[Verdict]) -> list[Annotation]:
    """Make an annotation of every violation, at its file and line."""
    return [
        Annotation(violation.message, file=violation.file, line=violation.line, title="introspect-csv")
        for verdict in verdicts
        for violation in verdict.violations
    ]


def junit(verdicts: Sequence[Verdict]) -> str:
    """Write JUnit XML: a suite per table, a case per check, and all its violations in the failure."""
    from calibration.workflow.junit import Case, Suite, junit_xml  # XML is slow to import, and rarely asked for

    def case(verdict: Verdict, check: Check) -> Case:
        lines = [
            f"{violation.file}:{violation.line or ''}{':' if violation.line else ''} {violation.message}"
            for violation in check.violations
        ]
        return Case(
            name=f"{_subject(check)}: {check.expected}",
            group=verdict.file,
            failure=None if check.passed else "\n".join([_count(len(lines), "violation"), *lines]),
            file=verdict.file,
            line=next((violation.line for violation in check.violations), None),
        )

    return junit_xml(
        Suite(verdict.file, tuple(case(verdict, check) for check in verdict.checks)) for verdict in verdicts
    )


_CHECK_HEADER = ("verdict", "file", "column", "rows", "value", "expected")
_VIOLATION_HEADER = ("file", "line", "column", "row", "found", "expected")


def _check_row(verdict: Verdict, check: Check) -> tuple[str, ...]:
    if check.value is not None:
        value = str(check.value)
    elif check.smallest is not None:
        value = f"{check.smallest} to {check.largest}"
    else:
        value = _count(check.judged, "value")
    return _word(check.passed), verdict.file, check.column or "", check.rows, shorten(value), check.expected


def _violation_row(violation: Violation) -> tuple[str, ...]:
    line = "" if violation.line is None else str(violation.line)
    return violation.file, line, violation.column or "", violation.row, violation.found, violation.expected


def _check_object(check: Check) -> dict[str, Any]:
    return {
        "column": check.column,
        "rows": check.rows,
        "expected": check.expected,
        "judged": check.judged,
        "value": check.value,
        "smallest": check.smallest,
        "largest": check.largest,
        "violations": len(check.violations),
        "verdict": _word(check.passed),
    }


def _violation_object(violation: Violation) -> dict[str, Any]:
    return {
        "line": violation.line,
        "column": violation.column,
        "row": violation.row,
        "found": violation.found,
        "expected": violation.expected,
    }


def _subject(check: Check) -> str:
    return check.rows if check.column is None else f"{check.column}, {check.rows}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _word(passed: bool) -> str:
    return "pass" if passed else "fail"
