"""Introspection of tables: rule files, and the report of ``introspect-csv``.

Rule files are YAML, or a Rigelfile, so that existing ones keep working. Rigelfiles have rules in the form of Rigel's
file introspection plugin. The keys are the plugin's, with these differences: limits are inclusive, every column is
judged, and a violated limit fails the verdict. ``validation_min`` and ``validation_max`` apply to every row,
``acceptable_min`` and ``acceptable_max`` to the selected one.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.base import InputError, did_you_mean, read_yaml, shorten
from calibration.base.records import document_of
from calibration.base.tables.rules import RuleSet, parse_rules
from calibration.base.tables.table_verdict import Results, RuleResult, TableResult, Violation
from calibration.ci.report import Lines, Outcome, Report, Table, count_of, verdict_of
from calibration.ci.workflow.runner import Annotation

COLUMNS_KEY = "introspection_target_columns"
"""Key that distinguishes a Rigelfile from a rule set."""

_KEY_OF_LIMIT = {
    "validation_min": "every-min",
    "validation_max": "every-max",
    "acceptable_min": "min",
    "acceptable_max": "max",
    "contains_str": "contains",
    "does_not_contain_str": "does-not-contain",
}
_ROW_KEYS = ("use_latest_row", "value_row")


def read_rules(path: str | Path) -> RuleSet:
    """Read rules from a YAML file (see :mod:`calibration.base.tables.rules`) or from a Rigelfile.

    Raises :class:`InputError` that names the file and the error.
    """
    document = read_yaml(path, "a file of rules")
    settings = find_columns(document, str(path))
    return parse_rules(document if settings is None else translate(settings, str(path)), str(path))


def find_columns(document: object, where: str) -> Mapping[str, Any] | None:
    """Find the plugin's settings anywhere in a Rigelfile, whose format has changed over the years.

    Returns None if there are none, so that the document is not a Rigelfile. Raises :class:`InputError`
    if there is more than one.
    """
    found = dict(_find_settings(document, (), set()))
    if len(found) > 1:
        names = ", ".join(found)
        raise InputError(f"{where}: {names} all have {COLUMNS_KEY}: put the one to use in a file of its own")
    return next(iter(found.values()), None)


def _find_settings(node: object, path: tuple[str, ...], seen: set[int]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Return every mapping below a node that has the plugin's key, by its path.

    Nodes that YAML aliases repeat, or nest in themselves, are visited once.
    """
    if not isinstance(node, Mapping | list) or id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, Mapping) and COLUMNS_KEY in node:
        yield ".".join(path), node
    for key, value in node.items() if isinstance(node, Mapping) else enumerate(node):
        yield from _find_settings(value, (*path, str(key)), seen)


def translate(settings: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Convert the plugin's settings to a rule set, for :func:`calibration.base.tables.parse_rules`.

    Raises :class:`InputError` for what the plugin rejects too: an unknown key, two selections of
    a row, or none for limits that need one.
    """
    for key in settings:
        if key not in ("file", COLUMNS_KEY):
            raise InputError(f"{where}: there is no key {key!r}{did_you_mean(str(key), ('file', COLUMNS_KEY))}")
    columns = settings[COLUMNS_KEY]
    if not isinstance(columns, list):
        raise InputError(f"{where}: {COLUMNS_KEY}: a list of columns was expected, found {columns!r}")
    rules = []
    for number, entry in enumerate(columns, start=1):
        if not isinstance(entry, Mapping) or len(entry) != 1 or not isinstance(next(iter(entry.values())), Mapping):
            raise InputError(f"{where}: {COLUMNS_KEY}: entry {number}: one column and its limits were expected")
        ((column, limits),) = entry.items()
        rules.append(_rule_of_column(str(column), limits, f"{where}: {COLUMNS_KEY}: {column}"))
    document: dict[str, Any] = {"rules": rules}
    if settings.get("file") is not None:
        document["file"] = settings["file"]
    return document


def _rule_of_column(column: str, limits: Mapping[str, Any], where: str) -> dict[str, Any]:
    given = {key: value for key, value in limits.items() if value is not None}
    for key, value in given.items():
        if key not in (*_KEY_OF_LIMIT, *_ROW_KEYS):
            raise InputError(f"{where}: there is no key {key!r}{did_you_mean(str(key), (*_KEY_OF_LIMIT, *_ROW_KEYS))}")
        if "{{" in str(value):
            raise InputError(f"{where}: {key}: only Rigel fills in {value!r}: write the value itself")
    latest, label = given.get("use_latest_row", False), given.get("value_row")
    if not isinstance(latest, bool):
        raise InputError(f"{where}: use_latest_row: true or false was expected, found {latest!r}")
    if latest and label is not None:
        raise InputError(f"{where}: use_latest_row and value_row both choose a row: leave one out")
    rule = {"column": column, **{_KEY_OF_LIMIT[key]: value for key, value in given.items() if key in _KEY_OF_LIMIT}}
    if rule.keys() & {"min", "max", "contains", "does-not-contain"}:
        if not latest and label is None:
            raise InputError(f"{where}: the limits are for one row: choose it with value_row or use_latest_row")
        rule["row"] = "last" if latest else f"label:{label}"
    return rule


REPORT_TITLE = "introspect-csv"


def introspection_report(tables: Sequence[TableResult]) -> Report:
    """Return the introspection_report of ``introspect-csv``."""
    results = Results(tuple(tables))
    violations = [violation for table in tables for violation in table.violations]
    checks = [(table, check) for table in tables for check in table.checks]
    notes = tuple(
        f"{table.file}: {check.column}, {check.rows}: {count_of(check.unlisted, 'more violation')} not listed"
        for table, check in checks
        if check.unlisted
    )
    return Report(
        title="Tables",
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
