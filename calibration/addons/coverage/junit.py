"""Parser of pytest's JUnit XML: number of tests, and failures."""

import re
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from calibration.addons.coverage.formats import elements
from calibration.base.errors import InputError
from calibration.base.text import one_line, shorten


@dataclass(frozen=True)
class FailedTest:
    """A test that failed, or that could not run."""

    name: str
    message: str
    file: str | None = None
    """Path in the report, relative to the working directory of the tests."""
    line: int | None = None


@dataclass(frozen=True)
class Tally:
    """Numbers of tests by outcome."""

    passed: int = 0
    failed: int = 0
    """Including tests that could not run."""
    skipped: int = 0
    failures: tuple[FailedTest, ...] = ()

    @property
    def ran(self) -> int:
        """Number of tests that were not skipped."""
        return self.passed + self.failed


def parse_junit(data: bytes, name: str) -> Tally:
    """Count the test cases of a report.

    Raises:
        InputError: it is not JUnit XML.
    """
    passed = skipped = 0
    failures: list[FailedTest] = []
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
                failures.append(_read_failure(element, problem))
            elif "skipped" in kinds and kinds["skipped"].get("type") != "pytest.xfail":  # an expected failure did run
                skipped += 1
            else:
                passed += 1
            element.clear()
    # A test that fails and whose teardown fails too is reported as two cases of one name.
    unique = {(failure.name, failure.file): failure for failure in reversed(failures)}
    return Tally(passed, len(unique), skipped, tuple(reversed(unique.values())))


def _read_failure(case: Element, problem: Element) -> FailedTest:
    line = case.get("line", "")
    number = int(line) + 1 if re.fullmatch("[0-9]{1,9}", line) else None  # pytest's line numbers start at 0
    names = [part for part in (case.get("classname"), case.get("name")) if part]
    return FailedTest(
        shorten(one_line(".".join(names)), 200) or "(no name)",
        shorten(one_line(problem.get("message") or (problem.text or "").strip() or "failed"), 500),
        case.get("file"),
        number,
    )
