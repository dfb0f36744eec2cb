"""JUnit XML, the format of test reports that CI systems read; made as text, since XML libraries are slow to import."""

import re
from collections.abc import Iterable, Mapping, Sequence

from calibration.base.text import visible
from calibration.ci.report.blocks import MOST_LINES, cut
from calibration.ci.report.outcome import Outcome
from calibration.ci.report.results_json import RESULTS_FILE

_IN_TEXT = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})
_IN_ATTRIBUTES = _IN_TEXT | str.maketrans({'"': "&quot;", "\r": "&#13;", "\n": "&#10;", "\t": "&#09;"})
_INVALID = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def junit_xml(suites: Mapping[str, Sequence[Outcome]]) -> str:
    """Return outcomes, in suites by name, as JUnit XML; characters that are invalid in XML are removed.

    An outcome with an error has no verdict, so it is an ``error`` and not a ``failure``. Its first
    reason is the message.
    """
    parts = [_suite(name, outcomes) for name, outcomes in suites.items()]
    counts = _counts(outcome for outcomes in suites.values() for outcome in outcomes)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{_element("testsuites", counts, parts)}\n'


def _suite(name: str, outcomes: Sequence[Outcome]) -> str:
    cases = [_case(outcome) for outcome in outcomes]
    return _element("testsuite", {"name": _valid(name), **_counts(outcomes)}, cases, "  ")


def _case(outcome: Outcome) -> str:
    attributes = {"name": outcome.name, "classname": outcome.group}
    if outcome.file is not None:
        attributes["file"] = outcome.file
    if outcome.line is not None:
        attributes["line"] = str(outcome.line)
    if outcome.seconds is not None:
        attributes["time"] = f"{outcome.seconds:.3f}"
    children = []
    result = _result(outcome)
    if result is not None:
        text = _valid(
            "\n".join(cut(outcome.reasons, MOST_LINES, RESULTS_FILE)) or outcome.skipped or "failed for no known reason"
        )
        type_ = {"type": "undecided"} if outcome.is_undecided and result == "failure" else {}
        begin = _begin(result, {"message": text.partition("\n")[0], **type_})
        children.append(f"{begin}>{text.translate(_IN_TEXT)}</{result}>" if text else f"{begin} />")
    return _element("testcase", {key: _valid(text) for key, text in attributes.items()}, children, "    ")


def _element(tag: str, attributes: Mapping[str, str], children: Sequence[str], indent: str = "") -> str:
    """Return an element with each child on a line of its own, ``indent`` and two blanks deep."""
    begin = _begin(tag, attributes)
    if not children:
        return f"{begin} />"
    lines = "".join(f"\n{indent}  {child}" for child in children)
    return f"{begin}>{lines}\n{indent}</{tag}>"


def _begin(tag: str, attributes: Mapping[str, str]) -> str:
    return "".join([f"<{tag}", *(f' {name}="{value.translate(_IN_ATTRIBUTES)}"' for name, value in attributes.items())])


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
