"""Text: escaping of untrusted text, Markdown, suggestions for misspelt words, and numbers."""

import math
import re
from collections.abc import Iterable, Sequence

LONGEST_CELL = 200
"""Limit of characters of a table cell."""
_LINE_BREAKS = re.compile(r"[ \t]*[\n\v\f\r\x1c-\x1e\x85\u2028\u2029]+[ \t]*")
_UNPRINTABLE = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff"
    r"\U000e0000-\U000e007f]"
)
"""Control characters and line breaks (but tab, CR and LF), changes of the writing direction, invisible characters,
halves of surrogate pairs."""


_TERMINAL_ESCAPES = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)|[ -/]+[0-~]|[0-Z\\^-~])")
"""Sequences for terminals: colours and cursor, titles of windows (roslaunch), character sets, others."""


def without_escapes(text: str) -> str:
    """Remove the sequences by which programs command a terminal."""
    return _TERMINAL_ESCAPES.sub("", text)


def one_line(text: str) -> str:
    """Put a text on one line, without control of the terminal or the runner.

    Line breaks become spaces; the rest is done by `visible`.
    """
    return visible(_LINE_BREAKS.sub(" ", text.strip()))


def visible(text: str) -> str:
    """Replace control characters, changes of the writing direction and invisible characters by escapes.

    ``##[``, which the runner takes for a command anywhere in a line, is broken up.
    """
    text = _UNPRINTABLE.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)
    return text.replace("##[", "## [")


def shorten(text: str, length: int = 80) -> str:
    """Truncate a text to ``length`` characters, with an ellipsis as the last one."""
    return text if len(text) <= length else text[: length - 1] + "…"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``": did you mean 'x'?"`` for the known word nearest to a misspelt one, or an empty string."""
    from difflib import get_close_matches  # imported only in case of an error, to keep start-up fast

    nearest = get_close_matches(word, known, n=1)
    return f": did you mean {nearest[0]!r}?" if nearest else ""


def aligned(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table of texts for a log, with minimal column widths."""
    table = [[shorten(one_line(cell), LONGEST_CELL) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table)
    return "\n".join(line.rstrip() for line in lines)


def count_of(number: int, noun: str) -> str:
    """Return a number with its noun: ``1 table``, ``2 tables``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


_DECIMAL_TEXT = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


def parse_number(text: str) -> float | None:
    """Parse a finite decimal number (``-1.5e3``); None for anything else.

    NaN, infinity, overflow, an empty text, ``1,5``, ``0x1f`` and ``1_000`` are rejected.
    """
    if not _DECIMAL_TEXT.fullmatch(text):
        return None
    number = float(text)
    return number if math.isfinite(number) else None


def not_a_number(text: str) -> str:
    """Describe a text that `parse_number` rejects; a decimal comma is named."""
    comma = parse_number(text.replace(",", ".", 1)) is not None
    return f"{shorten(text)!r}, which is no finite number" + (": its decimal comma must be a point" if comma else "")


def rounded(number: float, digits: int) -> str:
    """Format a number with some significant digits: 270 for 268.4 and 2 digits, where ``:.2g`` has 2.7e+02."""
    return f"{float(f'{number:.{digits}g}'):g}"


def with_error_bar(value: float, sigma: float) -> str:
    """Format a value with its standard deviation: ``3.05 ± 0.07``."""
    return f"{rounded(value, 3)} ± {rounded(sigma, 1)}"


def number_text(number: float) -> str:
    """Format a number with all its digits, whole numbers without a point."""
    text = repr(float(number))
    return text.removesuffix(".0")


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
