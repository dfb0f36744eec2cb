"""JUnit XML, the format of test reports that CI systems read."""

import re
from collections.abc import Iterable, Mapping, Sequence
from xml.etree import ElementTree as ET

from calibration.report.blocks import MOST_LINES, cut
from calibration.report.outcome import Outcome
from calibration.report.results_json import RESULTS_FILE
from calibration.workflow.text import visible

_INVALID = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(suites: Mapping[str, Sequence[Outcome]]) -> str:
    """Return outcomes, in suites by name, as JUnit XML; characters that are invalid in XML are removed.

    An outcome with an error has no verdict, so it is an ``error`` and not a ``failure``. Its first
    reason is the message.
    """
    root = ET.Element("testsuites", _counts(outcome for outcomes in suites.values() for outcome in outcomes))
    for name, outcomes in suites.items():
        parent = ET.SubElement(root, "testsuite", {"name": _valid(name), **_counts(outcomes)})
        for outcome in outcomes:
            _add_case(parent, outcome)
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _add_case(parent: ET.Element, outcome: Outcome) -> None:
    attributes = {"name": outcome.name, "classname": outcome.group}
    if outcome.file is not None:
        attributes["file"] = outcome.file
    if outcome.line is not None:
        attributes["line"] = str(outcome.line)
    if outcome.seconds is not None:
        attributes["time"] = f"{outcome.seconds:.3f}"
    case = ET.SubElement(parent, "testcase", {key: _valid(text) for key, text in attributes.items()})
    result = _result(outcome)
    if result is not None:
        text = _valid(
            "\n".join(cut(outcome.reasons, MOST_LINES, RESULTS_FILE)) or outcome.skipped or "failed for no known reason"
        )
        ET.SubElement(case, result, {"message": text.partition("\n")[0]}).text = text


def _result(outcome: Outcome) -> str | None:
    """Return the tag of the element for a case that did not pass; None if it passed."""
    if outcome.verdict == "fail":
        return "failure" if outcome.error is None else "error"
    return None if outcome.skipped is None else "skipped"


def _counts(outcomes: Iterable[Outcome]) -> dict[str, str]:
    results = [_result(outcome) for outcome in outcomes]
    return {
        "tests": str(len(results)),
        "failures": str(results.count("failure")),
        "errors": str(results.count("error")),
        "skipped": str(results.count("skipped")),
    }


def _valid(text: str) -> str:
    return visible(_INVALID.sub("", text))
