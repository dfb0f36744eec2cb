"""Markdown: tables, code, and text that is shown literally."""

import re
from collections.abc import Iterable, Sequence

from calibration.base.text import LONGEST_CELL, shorten, visible

_ENTITY_OF_CHARACTER = {"&": "&amp;", "<": "&lt;", ">": "&gt;", "|": "&#124;"}
# The last begins a list: in it, text that is indented further is code, where entities are shown as they are.
_SPECIAL_CHARACTERS = re.compile(r"\r\n|\r|\n|[&<>|]|[\\`*_\[\]#~$]|\A\s*(?:\d{1,9}[.)](?=\s|\Z)|[-+](?=\s))")


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table; every cell is escaped."""
    cells = [[escape_markdown(shorten(cell, LONGEST_CELL)) for cell in row] for row in (header, *rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in (cells[0], ["---"] * len(header), *cells[1:]))


def escape_markdown(text: str) -> str:
    """Escape a text so that Markdown shows it literally, also in table cells: no markup, no HTML."""
    return _SPECIAL_CHARACTERS.sub(_escaped_match, visible(text))


def code_block(text: str) -> str:
    """Format a text as a code block, whose fence is longer than any run of backticks in it."""
    longest = max((len(run) for run in re.findall(r"`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    return f"{fence}\n{text.rstrip()}\n{fence}\n"


def _escaped_match(match: re.Match[str]) -> str:
    found = match[0]
    if found in ("\r\n", "\r", "\n"):
        return "<br>"
    return _ENTITY_OF_CHARACTER.get(found, f"{found[:-1]}\\{found[-1]}")
