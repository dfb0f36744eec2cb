"""Outcomes of units of work, and JUnit XML, the format of test reports that CI systems read."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from calibration.base import ExitCode, visible
from calibration.base.records import Converted
from calibration.base.verdict import Check, Verdict, verdict_of
from calibration.ci.report.blocks import MOST_LINES, cut
from calibration.ci.report.results_json import RESULTS_FILE

ErrorCode = Annotated[ExitCode, Converted(Literal[2, 3], lambda code, _place: ExitCode(code))]
"""Exit code of work that failed because of bad input (2) or infrastructure (3), in results.json."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of one unit of work, as JUnit shows it."""

    name: str
    group: str = ""
    """Group in reports, such as a system."""
    reasons: tuple[str, ...] = ()
    """Reasons of a failure, one line each."""
    is_undecided: bool = False
    """Whether the reasons are undecided limits: to JUnit a failure of its own type."""
    error: ErrorCode | None = None
    """Exit code if the work failed because of bad input (2) or infrastructure (3)."""
    skipped: str | None = None
    """Reason why the work was skipped, if that is not a failure."""
    seconds: float | None = None
    """Duration; None if it was not measured."""
    file: str | None = None
    """The user's file to which the outcome refers."""
    line: int | None = None
    """Line in this file, from 1."""

    @property
    def verdict(self) -> Verdict:
        """Fail if there is a reason or an error."""
        return verdict_of(not self.reasons and self.error is None)


def outcome_of_check(check: Check, group: str) -> Outcome:
    """Convert a check to an outcome, for JUnit."""
    return Outcome(name=check.subject, group=group, reasons=() if check.passed else (str(check),))


_INVALID_IN_XML = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def junit_xml(suites: Mapping[str, Sequence[Outcome]]) -> str:
    """Return outcomes, in suites by name, as JUnit XML; characters that are invalid in XML are removed.

    An outcome with an error has no verdict, so it is an ``error`` and not a ``failure``. Its first
    reason is the message.
    """
    root = Element("testsuites", _count_results(outcome for outcomes in suites.values() for outcome in outcomes))
    for name, outcomes in suites.items():
        suite = SubElement(root, "testsuite", {"name": _valid_text(name), **_count_results(outcomes)})
        for outcome in outcomes:
            _add_case(suite, outcome)
    indent(root)
    # ElementTree writes the declaration with single quotes.
    return f'<?xml version="1.0" encoding="utf-8"?>\n{tostring(root, "unicode")}\n'


def _add_case(suite: Element, outcome: Outcome) -> None:
    attributes = {"name": outcome.name, "classname": outcome.group}
    if outcome.file is not None:
        attributes["file"] = outcome.file
    if outcome.line is not None:
        attributes["line"] = str(outcome.line)
    if outcome.seconds is not None:
        attributes["time"] = f"{outcome.seconds:.3f}"
    case = SubElement(suite, "testcase", {key: _valid_text(text) for key, text in attributes.items()})
    tag = _result_tag(outcome)
    if tag is not None:
        lines = "\n".join(cut(outcome.reasons, MOST_LINES, RESULTS_FILE))
        text = _valid_text(lines or outcome.skipped or "failed for no known reason")
        kind = {"type": "undecided"} if outcome.is_undecided and tag == "failure" else {}
        SubElement(case, tag, {"message": text.partition("\n")[0], **kind}).text = text


def _result_tag(outcome: Outcome) -> str | None:
    """Return the tag of the element for a case that did not pass; None if it passed."""
    if outcome.verdict == "fail":
        return "failure" if outcome.error is None else "error"
    return None if outcome.skipped is None else "skipped"


def _count_results(outcomes: Iterable[Outcome]) -> dict[str, str]:
    tags = [_result_tag(outcome) for outcome in outcomes]
    return {
        "tests": str(len(tags)),
        "failures": str(tags.count("failure")),
        "errors": str(tags.count("error")),
        "skipped": str(tags.count("skipped")),
    }


def _valid_text(text: str) -> str:
    return visible(_INVALID_IN_XML.sub("", text))
