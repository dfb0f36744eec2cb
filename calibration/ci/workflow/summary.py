"""Summary of the step: Markdown that GitHub shows on the page of the run."""

import re
from collections.abc import Iterable, Sequence

from calibration.base.errors import InfrastructureError
from calibration.base.text import LONGEST_CELL, shorten, visible
from calibration.ci.workflow.runner import Runner

SUMMARY_LIMIT = 1024 * 1024
"""GitHub's limit of the summary of a step, in bytes; a longer one is dropped completely."""

_CUT = "\n\n*The summary was cut here: GitHub takes 1 MiB. Everything is in the log.*\n"
_ENTITIES = {"&": "&amp;", "<": "&lt;", ">": "&gt;", "|": "&#124;"}
# The last begins a list: in it, text that is indented further is code, where entities are shown as they are.
_SPECIAL = re.compile(r"\r\n|\r|\n|[&<>|]|[\\`*_\[\]#~$]|\A\s*(?:\d{1,9}[.)]|[-+])(?=\s)")


def add_summary(runner: Runner, markdown: str) -> None:
    """Append Markdown to the step's summary; does nothing if the runner provides no file for it.

    Text beyond :data:`SUMMARY_LIMIT` is cut at the end of a line, with a remark in the summary.
    Raises :class:`InfrastructureError` if the runner's file cannot be written.
    """
    if runner.summary_file is None:
        return
    try:
        with runner.summary_file.open("ab") as file:
            file.write(_cut((markdown.rstrip("\n") + "\n").encode("utf-8", "replace"), SUMMARY_LIMIT - file.tell()))
    except OSError as error:
        raise InfrastructureError(
            f"{runner.summary_file}: the step's summary cannot be written: {error.strerror}"
        ) from error


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table; every cell is escaped."""
    cells = [[escape_markdown(shorten(cell, LONGEST_CELL)) for cell in row] for row in (header, *rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in (cells[0], ["---"] * len(header), *cells[1:]))


def escape_markdown(text: str) -> str:
    """Escape a text so that Markdown shows it literally, also in table cells: no markup, no HTML."""
    return _SPECIAL.sub(_escape, visible(text))


def code_block(text: str) -> str:
    """Format a text as a code block, whose fence is longer than any run of backticks in it."""
    longest = max((len(run) for run in re.findall(r"`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}\n{text.rstrip()}\n{fence}\n"


def _escape(match: re.Match[str]) -> str:
    found = match[0]
    if found in ("\r\n", "\r", "\n"):
        return "<br>"
    return _ENTITIES.get(found, f"{found[:-1]}\\{found[-1]}")


def _cut(text: bytes, room: int) -> bytes:
    if len(text) <= room:
        return text
    note = _CUT.encode()
    if room < len(note):
        return b""
    kept = text[: room - len(note)]
    kept = kept[: kept.rfind(b"\n")] if b"\n" in kept else kept.decode("utf-8", "ignore").encode()
    return kept + note
