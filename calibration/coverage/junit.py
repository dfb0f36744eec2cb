"""The JUnit XML that pytest writes: how many tests ran, and which failed."""

import re
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from calibration.coverage.formats import elements
from calibration.errors import InputError
from calibration.workflow.text import one_line, shorten


@dataclass(frozen=True)
class Failure:
    """A test that failed, or that could not run."""

    name: str
    message: str
    file: str | None = None
    """As the report has it: relative to the folder that the tests ran in."""
    line: int | None = None


@dataclass(frozen=True)
class Tally:
    """How many tests there were."""

    passed: int = 0
    failed: int = 0
    """With those that could not run."""
    skipped: int = 0
    failures: tuple[Failure, ...] = ()

    @property
    def ran(self) -> int:
        """Those that were not skipped."""
        return self.passed + self.failed


def parse_junit(data: bytes, name: str) -> Tally:
    """Count the test cases of a report.

    Raises:
        InputError: it is no JUnit XML.
    """
    passed = skipped = 0
    failures: list[Failure] = []
    root: Element | None = None
    for event, element in elements(data, name):
        if root is None:
            root = element
            if root.tag not in ("testsuites", "testsuite"):
                raise InputError(
                    f"{name}: found XML with the root <{shorten(one_line(str(root.tag)))}>, expected JUnit"
                )
        if event == "end" and element.tag == "testcase":
            kinds = {child.tag: child for child in element}
            problem = kinds.get("failure", kinds.get("error"))
            if problem is not None:
                failures.append(_failure(element, problem))
            elif "skipped" in kinds and kinds["skipped"].get("type") != "pytest.xfail":  # that one ran
                skipped += 1
            else:
                passed += 1
            element.clear()
    # A test that fails and whose clean-up fails too is two cases of one name.
    unique = {(failure.name, failure.file): failure for failure in reversed(failures)}
    return Tally(passed, len(unique), skipped, tuple(reversed(unique.values())))


def _failure(case: Element, problem: Element) -> Failure:
    line = case.get("line", "")
    number = int(line) + 1 if re.fullmatch("[0-9]{1,9}", line) else None  # pytest counts from 0
    names = [part for part in (case.get("classname"), case.get("name")) if part]
    return Failure(
        shorten(one_line(".".join(names)), 200) or "(no name)",
        shorten(one_line(problem.get("message") or (problem.text or "").strip() or "failed"), 500),
        case.get("file"),
        number,
    )
