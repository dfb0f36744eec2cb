"""Outcomes of units of work as JUnit XML, which CI systems read; and reports of tests that others have written.

Read are JUnit XML of any tool, and CTest's own; failures are counted over repeated runs.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Self
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from calibration.base import ExitCode, InputError, one_line, shorten, visible
from calibration.base.documents import xml_elements
from calibration.base.records import Converted, field, result
from calibration.base.verdict import Check, FlakeRate, Verdict, verdict_of
from calibration.ci.report.blocks import MOST_LINES, RESULTS_FILE, cut

ErrorCode = Annotated[ExitCode, Converted(Literal[2, 3], lambda code, _place: ExitCode(code))]
"""Exit code of work that failed because of bad input (2) or infrastructure (3), in results.json."""
CaseState = Literal["passed", "failed", "skipped"]
MAX_CASE_NAME, MAX_CASE_MESSAGE = 200, 500
"""Limits of the characters of a name and of a message that are kept."""
MAX_CASE_SECONDS = 1e9
_PLACE_IN_TEXT = re.compile(r"(?m)^[ \t]*(?:E\s+)?(?:File \")?([\w./+-]+\.\w{1,5})(?:\", line |:)([0-9]{1,7})\b")
"""A file and line as gtest, pytest and Python's traceback name them at the start of a line."""


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


@dataclass(frozen=True)
class CaseOutcome:
    """Outcome of one test."""

    name: str
    message: str = ""
    """Why it failed."""
    file: str | None = None
    """Path as the tool named it: where it ran, or relative to the working directory of the tests."""
    line: int | None = None
    state: CaseState = "failed"
    """Failed includes tests that could not run; an expected failure has passed."""
    seconds: float = 0.0


@dataclass(frozen=True)
class Tally:
    """Numbers of tests by outcome."""

    passed: int = 0
    failed: int = 0
    """Including tests that could not run."""
    skipped: int = 0
    failures: tuple[CaseOutcome, ...] = ()

    @property
    def ran(self) -> int:
        """Number of tests that were not skipped."""
        return self.passed + self.failed

    @classmethod
    def of(cls, cases: Iterable[CaseOutcome]) -> Self:
        """Count outcomes; a test that fails and whose teardown fails too, two cases of one name, counts once."""
        listed = list(cases)
        failures = {(case.name, case.file): case for case in reversed(listed) if case.state == "failed"}
        counts = [sum(case.state == state for case in listed) for state in ("passed", "skipped")]
        return cls(counts[0], len(failures), counts[1], tuple(reversed(failures.values())))


def read_test_report(data: bytes, name: str) -> tuple[CaseOutcome, ...]:
    """Return the tests in a report, JUnit or CTest.

    Raises:
        InputError: it is neither, or not valid XML.
    """
    return tuple(_read_cases(data, name))


def _read_cases(data: bytes, name: str) -> Iterator[CaseOutcome]:
    root: Element | None = None
    first_line = 0
    for event, element in xml_elements(data, name):
        if root is None:
            root = element
            if root.tag not in ("testsuites", "testsuite", "Site"):
                raise InputError(
                    f"{name}: found XML with the root <{shorten(one_line(str(root.tag)))}>, expected JUnit or CTest"
                )
        if event == "start" and element.tag == "testsuite":
            first_line = 1 if element.get("name") == "pytest" else 0  # pytest's line numbers start at 0
        elif event == "end" and element.tag == "testcase":
            yield _read_junit_case(element, first_line)
            element.clear()
        elif event == "end" and element.tag == "Test" and element.get("Status"):
            yield _read_ctest_case(element)
            element.clear()


def _read_junit_case(case: Element, first_line: int) -> CaseOutcome:
    kinds = {child.tag: child for child in case}
    problem = kinds.get("failure", kinds.get("error"))
    name = ".".join(part for part in (case.get("classname"), case.get("name")) if part)
    if problem is not None:
        text = problem.text or ""
        line = case.get("line", "")
        number = int(line) + first_line if re.fullmatch("[0-9]{1,9}", line) else None
        message = problem.get("message") or text.strip()
        return _case_outcome(name, "failed", case.get("time"), message, case.get("file"), number, text)
    skipped = kinds.get("skipped")
    ran = skipped is None or skipped.get("type") == "pytest.xfail"  # an expected failure did run
    # gtest has no element for a test that is disabled
    return _case_outcome(name, "skipped" if not ran or case.get("status") == "notrun" else "passed", case.get("time"))


def _read_ctest_case(test: Element) -> CaseOutcome:
    measured = {each.get("name", ""): (each.findtext("Value") or "").strip() for each in test.iter("NamedMeasurement")}
    name, status, seconds = test.findtext("Name") or "", test.get("Status"), measured.get("Execution Time")
    if status == "passed":
        return _case_outcome(name, "passed", seconds)
    completion = measured.get("Completion Status", "")
    if status == "notrun" and completion in ("Disabled", "SKIP_RETURN_CODE=77", "Skipped"):
        return _case_outcome(name, "skipped", seconds)
    output = test.findtext("Results/Measurement/Value") or ""
    code = measured.get("Exit Code", "")  # Failed, or what ended it: SEGFAULT, Timeout
    reason = f"exit code {measured.get('Exit Value', '?')}" if code in ("", "Failed") else code
    if status == "notrun":
        reason = f"not run ({completion or 'no reason given'})"
    last = next((line for line in reversed(output.splitlines()) if line.strip()), "")
    return _case_outcome(name, "failed", seconds, f"{reason}: {last}" if last else reason, text=output)


def _case_outcome(
    name: str,
    state: CaseState,
    seconds: str | None,
    message: str = "",
    file: str | None = None,
    line: int | None = None,
    text: str = "",
) -> CaseOutcome:
    """Return an outcome with bounded texts; a failure that names no line takes the first place in its text."""
    if state == "failed":
        message = shorten(one_line(message or "failed"), MAX_CASE_MESSAGE)
        if line is None and (place := _PLACE_IN_TEXT.search(text or message)):
            file, line = place[1], int(place[2])
    return CaseOutcome(
        shorten(one_line(name), MAX_CASE_NAME) or "(no name)", message, file, line, state, _read_seconds(seconds)
    )


def _read_seconds(text: str | None) -> float:
    try:
        seconds = float(text or 0)
    except ValueError:
        return 0.0
    return seconds if 0 <= seconds <= MAX_CASE_SECONDS else 0.0


@result
class RepeatedFailure:
    """What failed in at least one run: a test, a cell."""

    name: str
    rate: FlakeRate = field("How often it failed, of the runs in which it ran.")
    message: str = field("Why it failed, in the first of these runs.", default="")
    file: str | None = field("File in the repository, if it is known.", default=None)
    line: int | None = field("Line in this file.", default=None)
    runs: tuple[int, ...] = field("Numbers of the runs in which it failed, from 1.", default=())

    @property
    def flaky(self) -> bool:
        """Whether it passed in other runs."""
        return self.rate.failed < self.rate.runs

    def is_within(self, max_flake_rate: float | None) -> bool:
        """Return whether it is flaky, and fails in no larger share of the runs than is allowed."""
        return self.flaky and max_flake_rate is not None and self.rate.share <= max_flake_rate

    def __str__(self) -> str:
        message = f": {self.message}" if self.message else ""
        if self.flaky:
            return f"is flaky, {self.rate}{message}"
        every = f" in each of {self.rate.runs} runs" if self.rate.runs > 1 else ""
        return f"failed{every}{message}"


def repeated_failures(runs: Iterable[Iterable[Iterable[CaseOutcome]]]) -> tuple[RepeatedFailure, ...]:
    """Return what failed at least once: first what always fails, then the most frequent.

    Args:
        runs: of each run its attempts, of each attempt its outcomes, of which each name counts once.
    """
    failures: dict[str, list[tuple[int, CaseOutcome]]] = defaultdict(list)
    ran: dict[str, int] = defaultdict(int)
    for number, attempts in enumerate(runs, start=1):
        for cases in attempts:
            for name, case in _case_by_name(cases).items():
                ran[name] += case.state != "skipped"
                if case.state == "failed":
                    failures[name].append((number, case))
    found = [
        RepeatedFailure(
            name,
            FlakeRate(len(failed), ran[name]),
            failed[0][1].message,
            failed[0][1].file,
            failed[0][1].line,
            tuple(dict.fromkeys(number for number, _ in failed)),
        )
        for name, failed in failures.items()
    ]
    return tuple(sorted(found, key=lambda each: (each.flaky, -each.rate.share, each.name)))


def _case_by_name(cases: Iterable[CaseOutcome]) -> dict[str, CaseOutcome]:
    """Return the outcome of each name; of several the first that failed, else the last."""
    found: dict[str, CaseOutcome] = {}
    for case in cases:
        if case.name not in found or found[case.name].state != "failed":
            found[case.name] = case
    return found
