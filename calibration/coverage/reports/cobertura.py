"""Cobertura XML, which coverage.py, gcovr and many others write."""

import re
from typing import NoReturn
from xml.etree.ElementTree import Element

from calibration.coverage.lines import FileCoverage
from calibration.coverage.rate import Rate
from calibration.coverage.reports.report import MAX_HITS, MAX_LINE, Report
from calibration.coverage.reports.xml import elements
from calibration.errors import InputError
from calibration.workflow.text import one_line, shorten

_WHOLE = re.compile(r"[0-9]{1,19}")
_BRANCHES = re.compile(r"\s*[0-9.]+\s*%\s*\(([0-9]{1,9})/([0-9]{1,9})\)\s*")


def parse_cobertura(data: bytes, name: str) -> Report:
    """Read a report; several classes in one file, and several entries of one line, are added up.

    Raises:
        InputError: it is no Cobertura XML, or a number in it is none; names the file and line that it speaks of.
    """
    hits: dict[str, dict[int, int]] = {}
    branches: dict[str, dict[int, Rate]] = {}
    folders: list[str] = []
    file: str | None = None
    in_methods = 0
    root: Element | None = None
    for event, element in elements(data, name):
        tag = element.tag
        if root is None:
            root = element
            _check_root(element, name)
        elif tag == "class" and event == "start":
            file = element.get("filename")
            if not file:
                raise InputError(f"{name}: a class has no filename")
            hits.setdefault(file, {})
            branches.setdefault(file, {})
        elif tag == "methods":  # their lines stand in the class once more
            in_methods += 1 if event == "start" else -1
        elif tag == "line" and event == "end" and file is not None and not in_methods:
            _add_line(element, f"{name}: {file}", hits[file], branches[file])
        elif tag == "source" and event == "end" and element.text and element.text.strip():
            folders.append(element.text.strip())
        if event == "end":
            element.clear()
    found = {file: FileCoverage(lines, branches[file]) for file, lines in hits.items()}
    return Report(name, found, tuple(folders))


def _check_root(root: Element, name: str) -> None:
    if root.tag == "coverage" and "line-rate" in root.attrib:
        return
    tag = shorten(one_line(str(root.tag)))
    raise InputError(f"{name}: found XML with the root <{tag}>, expected Cobertura: <coverage line-rate=...>")


def _add_line(element: Element, where: str, hits: dict[int, int], branches: dict[int, Rate]) -> None:
    number = _whole(element.get("number"), where, "number", 1, MAX_LINE)
    count = _whole(element.get("hits"), f"{where}:{number}", "hits", 0, MAX_HITS)
    hits[number] = hits.get(number, 0) + count
    condition = element.get("condition-coverage")
    if element.get("branch", "").lower() == "true" and condition is not None:
        found = _BRANCHES.fullmatch(condition)
        if found is None or int(found[1]) > int(found[2]):
            _refuse(f"{where}:{number}", "condition-coverage", condition, "such as 50% (1/2)")
        known = branches.get(number, Rate())
        branches[number] = Rate(max(known.covered, int(found[1])), max(known.total, int(found[2])))


def _whole(text: str | None, where: str, key: str, least: int, most: int) -> int:
    if text is None or not _WHOLE.fullmatch(text) or not least <= int(text) <= most:
        _refuse(where, key, text, f"a whole number from {least} to {most}")
    return int(text)


def _refuse(where: str, key: str, found: str | None, expected: str) -> NoReturn:
    shown = "nothing" if found is None else repr(shorten(found))
    raise InputError(f"{shorten(one_line(where), 300)}: {key} is {shown}, {expected} was expected")
