"""Accepted findings: a file with a reason for each, and an optional end date."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

from calibration.addons.analysis.finding import Finding
from calibration.base.errors import InputError
from calibration.base.records import Converted, field, length, read, record
from calibration.base.yaml_file import read_yaml


def parse_date(value: str, place: object) -> date:
    """Parse a date, YYYY-MM-DD.

    Raises:
        InputError: it is not a date.
    """
    try:
        if re.fullmatch(r"[0-9]{4}-[0-9]{2}-[0-9]{2}", value):
            return date.fromisoformat(value)
    except ValueError:
        pass
    raise InputError(f"{place}: found {value!r}, expected a date such as 2030-01-31")


@record
class Suppression:
    """Findings of a rule that are accepted."""

    rule: str = field("The rule, or a pattern of rules: ruff/S603, cppcheck/*.")
    reason: Annotated[str, length(1)] = field("Why they are accepted.")
    path: str = field("The file, or a pattern of files: src/**.", default="*")
    until: Annotated[date, Converted(str, parse_date)] | None = field(
        "The last day that it holds, YYYY-MM-DD.", default=None
    )

    def covers(self, finding: Finding) -> bool:
        """Whether it applies to a finding."""
        return fnmatchcase(finding.rule, self.rule) and fnmatchcase(finding.path, self.path)


@record
class SuppressionFile:
    """File of the findings that a team has accepted."""

    suppressions: tuple[Suppression, ...] = field("What is accepted.", default=())


@dataclass(frozen=True)
class Sifted:
    """Findings separated into accepted and others."""

    kept: tuple[Finding, ...]
    suppressed: tuple[tuple[Finding, Suppression], ...]
    remarks: tuple[str, ...]
    """Remarks on suppressions that have ended, or match nothing."""


def read_suppressions(path: Path) -> tuple[Suppression, ...]:
    """Read a file of suppressions.

    Raises:
        InputError: it cannot be read, or something in it is wrong.
    """
    document = read_yaml(path, "a file of suppressions")
    entries = document.get("suppressions") if isinstance(document, dict) else None
    for entry in entries if isinstance(entries, list) else ():
        if isinstance(entry, dict) and isinstance(entry.get("until"), date):  # YAML parses dates
            entry["until"] = entry["until"].isoformat()[:10]
    return read(SuppressionFile, document, str(path)).suppressions


def sift(findings: Sequence[Finding], suppressions: Sequence[Suppression], today: date) -> Sifted:
    """Separate the findings that are accepted today."""
    kept, suppressed, used, ended = [], [], set(), []
    for finding in findings:
        covering = [each for each in suppressions if each.covers(finding)]
        valid = next((each for each in covering if each.until is None or each.until >= today), None)
        used.update(covering)
        if valid is None:
            kept.append(finding)
            ended += covering
        else:
            suppressed.append((finding, valid))
    remarks = [f"the suppression of {each.rule} in {each.path} ended on {each.until}" for each in dict.fromkeys(ended)]
    remarks += [
        f"the suppression of {each.rule} in {each.path} covers nothing" for each in suppressions if each not in used
    ]
    return Sifted(tuple(kept), tuple(suppressed), tuple(remarks))
