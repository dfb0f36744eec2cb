"""Settings of an analysis: options of the command and the section ``analysis``, limits of findings, accepted findings.

Limits are of the number of findings of a kind (``error=0``, ``security=3``); what a team accepts is a file of
suppressions.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

from calibration.addons.analysis.results import CATEGORIES, SEVERITIES, CodeFinding, Suppressed
from calibration.base import InputError, did_you_mean, read_yaml, shorten
from calibration.base.records import Converted, field, length, read, record
from calibration.ci.report import Check, at_most

SUPPRESSIONS_FILE = ".static-analysis.yml"
"""Default path of the accepted findings, in the root of the repository."""


@record
class AnalysisSettings:
    """Settings of the static analysis: the files, the tools, and the limits of findings."""

    paths: tuple[str, ...] = field("Folders and files of the repository to analyse (all in git).", default=())
    exclude: tuple[str, ...] = field("Patterns of git for files that are not analysed.", default=())
    tools: tuple[str, ...] = field(
        "Only these of ruff, cppcheck, shellcheck, yamllint, zizmor, lizard, xml, urdf, ros (all).", default=()
    )
    base: str | None = field("Branch or commit that the change goes to (what the event says).", default=None)
    base_sarif: Path | None = field(
        "findings.sarif of an earlier analysis to compare with, in place of a commit.", default=None
    )
    max_new: tuple[str, ...] = field(
        "Most new findings of a severity, a category or all (error=0 security=0).", default=("error=0", "security=0")
    )
    max_total: tuple[str, ...] = field("Most findings, new or not, in the same form (no limit).", default=())
    max_file: tuple[str, ...] = field("Most findings of any one file, in the same form (no limit).", default=())
    suppressions: Path | None = field(f"File of what is accepted ({SUPPRESSIONS_FILE}, if there is one).", default=None)
    metrics: bool = field(
        "Measure complexity and duplication, and grade the code; 10 s for 100 000 lines.", default=False
    )
    timeout: str = field("Time limit of one program, such as 5m (5m).", default="5m")


EVERY_FINDING = "all"
MAX_FILES_NAMED = 20
"""Limit of the files that are named for a limit of each file."""
_LIMIT_TEXT = re.compile(r"([a-z -]+)=([0-9]{1,9})")
_KINDS_OF_FINDINGS = (EVERY_FINDING, *SEVERITIES, *CATEGORIES)


@dataclass(frozen=True)
class FindingLimit:
    """Limit of the number of findings of a kind."""

    kind: str
    """A severity, a category, or all."""
    most: int

    def check(self, findings: Sequence[CodeFinding], what: str) -> Check:
        """Check the number of findings; ``what`` describes them in the message: new, all."""
        return at_most(
            f"{what} findings{self._kind_in_parentheses}", sum(map(self._concerns_finding, findings)), self.most
        )

    def check_files(self, findings: Sequence[CodeFinding]) -> list[Check]:
        """Check the number of findings of each file: those with too many, the worst first, or else the worst one."""
        counts = Counter(finding.path for finding in findings if self._concerns_finding(finding)).most_common(
            MAX_FILES_NAMED
        )
        broken = [each for each in counts if each[1] > self.most]
        return [
            at_most(f"findings{self._kind_in_parentheses} of {shorten(path)}", count, self.most)
            for path, count in broken or counts[:1]
        ]

    def _concerns_finding(self, finding: CodeFinding) -> bool:
        return self.kind in (EVERY_FINDING, finding.severity, finding.category)

    @property
    def _kind_in_parentheses(self) -> str:
        return "" if self.kind == EVERY_FINDING else f" ({self.kind})"


def parse_limits(texts: Sequence[str], option: str) -> list[FindingLimit]:
    """Parse limits from options.

    Raises:
        InputError: a limit is invalid, or of an unknown kind.
    """
    limits = []
    for text in texts:
        match = _LIMIT_TEXT.fullmatch(text.strip())
        if match is None:
            raise InputError(f"{option}: found {shorten(text)!r}, expected a limit such as error=0 or all=100")
        kind = match[1].strip()
        if kind not in _KINDS_OF_FINDINGS:
            known = ", ".join(_KINDS_OF_FINDINGS)
            raise InputError(
                f"{option}: found {kind!r}, expected one of {known}{did_you_mean(kind, _KINDS_OF_FINDINGS)}"
            )
        limits.append(FindingLimit(kind, int(match[2])))
    return limits


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

    def covers(self, finding: CodeFinding) -> bool:
        """Return whether this acceptance applies to a finding."""
        return fnmatchcase(finding.rule, self.rule) and fnmatchcase(finding.path, self.path)


@record
class SuppressionFile:
    """File of the findings that a team has accepted."""

    suppressions: tuple[Suppression, ...] = field("What is accepted.", default=())


@dataclass(frozen=True)
class Sifted:
    """Findings separated into accepted and others."""

    kept: tuple[CodeFinding, ...]
    suppressed: tuple[Suppressed, ...]
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


def sift(findings: Sequence[CodeFinding], suppressions: Sequence[Suppression], today: date) -> Sifted:
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
            suppressed.append(Suppressed(finding, valid.reason))
    remarks = [f"the suppression of {each.rule} in {each.path} ended on {each.until}" for each in dict.fromkeys(ended)]
    remarks += [
        f"the suppression of {each.rule} in {each.path} covers nothing" for each in suppressions if each not in used
    ]
    return Sifted(tuple(kept), tuple(suppressed), tuple(remarks))
