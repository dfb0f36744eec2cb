"""JUnit XML, which test reports of every CI system read."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

from calibration.files import write_atomically

_INVALID = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Case:
    """One thing that was checked. It passed when it has no failure, no error and was not skipped."""

    name: str
    group: str = ""
    """What reports group cases by (``classname``)."""
    failure: str | None = None
    """Why the verdict is fail; the first line is the message, the whole is the detail."""
    error: str | None = None
    """Why there is no verdict."""
    skipped: str | None = None
    """Why it was not checked."""
    seconds: float | None = None
    """How long it took; None where that was not measured."""
    file: str | None = None
    line: int | None = None


@dataclass(frozen=True)
class Suite:
    """Cases under one name."""

    name: str
    cases: tuple[Case, ...]


def write_junit(path: str | Path, suites: Iterable[Suite]) -> None:
    """Write the suites as a file of JUnit XML; raises :class:`calibration.errors.WorldError`."""
    write_atomically(path, junit_xml(suites))


def junit_xml(suites: Iterable[Suite]) -> str:
    """Return the suites as JUnit XML; characters that XML cannot hold are left out."""
    suites = list(suites)
    root = ET.Element("testsuites", _counts(case for suite in suites for case in suite.cases))
    for suite in suites:
        parent = ET.SubElement(root, "testsuite", {"name": _valid(suite.name), **_counts(suite.cases)})
        for case in suite.cases:
            _add_case(parent, case)
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _add_case(parent: ET.Element, case: Case) -> None:
    attributes = {"name": case.name, "classname": case.group}
    if case.file is not None:
        attributes["file"] = case.file
    if case.line is not None:
        attributes["line"] = str(case.line)
    if case.seconds is not None:
        attributes["time"] = f"{case.seconds:.3f}"
    element = ET.SubElement(parent, "testcase", {key: _valid(text) for key, text in attributes.items()})
    for tag, text in (("failure", case.failure), ("error", case.error), ("skipped", case.skipped)):
        if text is not None:
            valid = _valid(text)
            ET.SubElement(element, tag, {"message": valid.partition("\n")[0]}).text = valid


def _counts(cases: Iterable[Case]) -> dict[str, str]:
    cases = list(cases)
    return {
        "tests": str(len(cases)),
        "failures": str(sum(case.failure is not None for case in cases)),
        "errors": str(sum(case.error is not None for case in cases)),
        "skipped": str(sum(case.skipped is not None for case in cases)),
    }


def _valid(text: str) -> str:
    return _INVALID.sub("", text)
