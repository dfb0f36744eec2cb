"""Text: escaping of untrusted text, redaction of secrets, Markdown, suggestions for misspelt words, and numbers.

Secrets are redacted in every form in which they may be printed: in texts, and in streams of bytes.
"""

import base64
import json
import math
import re
from collections.abc import Iterable, Sequence
from urllib.parse import quote

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
MIN_PART_LENGTH = 4
"""Minimum length in characters; shorter lines of a secret (a brace, a bracket) would mask half the log."""


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


def redact(text: str, secrets: Iterable[str]) -> str:
    """Replace secrets, in every form of :func:`derived_forms`, by ``***``."""
    forms = {form for secret in secrets for form in derived_forms(secret)}
    for form in sorted(forms, key=len, reverse=True):
        text = text.replace(form, "***")
    return text


def derived_forms(secret: str) -> list[str]:
    """Return the forms in which a secret may be printed.

    Unchanged, stripped of white space, each of its lines, as a JSON string, in a URL, and
    in base64; parts shorter than :data:`MIN_PART_LENGTH` are omitted unless they are the whole secret.
    """
    whole = secret.strip()
    if not whole:
        return []
    encoded = whole.encode("utf-8", "surrogateescape")
    standard = base64.b64encode(encoded).decode("ascii")
    forms = [secret, whole, json.dumps(whole)[1:-1], quote(encoded, safe=""), quote(encoded)]
    forms += [standard, standard.rstrip("="), base64.urlsafe_b64encode(encoded).decode("ascii")]
    forms += [line.strip() for line in whole.splitlines() if len(line.strip()) >= MIN_PART_LENGTH]
    return list(dict.fromkeys(forms))


REDACTED_BYTES = b"***"


class Redactor:
    """Replaces secrets in a stream, in every form of :func:`calibration.base.text.derived_forms`.

    Bytes that may be the beginning of a secret are delayed until this is known.
    """

    def __init__(self, secrets: Iterable[str]) -> None:
        forms = {form.encode("utf-8", "surrogateescape") for secret in secrets for form in derived_forms(secret)}
        self._forms = sorted(forms, key=len, reverse=True)
        self._pattern = re.compile(b"|".join(map(re.escape, self._forms))) if self._forms else None
        self._held = b""

    def feed(self, data: bytes) -> bytes:
        """Add bytes of the stream; return those that can be shown."""
        if self._pattern is None:
            return data
        data, shown = self._held + data, bytearray()
        position = 0
        while True:
            open_end = self._possible_beginning(data, position)
            match = self._pattern.search(data, position)
            if match is None or match.start() >= open_end:
                shown += data[position:open_end]
                self._held = data[open_end:]
                return bytes(shown)
            shown += data[position : match.start()] + REDACTED_BYTES
            position = match.end()

    def close(self) -> bytes:
        """Return the delayed bytes at the end of the stream."""
        held, self._held = self._held, b""
        return held if self._pattern is None else self._pattern.sub(REDACTED_BYTES, held)

    def _possible_beginning(self, data: bytes, start: int) -> int:
        """Return the position where an incomplete secret may begin; the length of the data if there is none."""
        earliest = len(data)
        for form in self._forms:
            position = data.find(form[:1], max(start, len(data) - len(form) + 1))
            while 0 <= position < earliest:
                if form.startswith(data[position:]):
                    earliest = position
                    break
                position = data.find(form[:1], position + 1)
        return earliest
