"""Markdown of a comment on a pull request, without active mentions, references or links from untrusted text."""

import re
from collections.abc import Mapping
from urllib.parse import quote

from calibration.ci.github.comments import MAX_COMMENT_CHARACTERS
from calibration.ci.report.brief import Brief
from calibration.ci.workflow.markdown import escape_markdown, markdown_table

MAX_ROWS_OF_TABLE = 40
MAX_TEXT_CHARACTERS = MAX_COMMENT_CHARACTERS - 4096
"""Characters; leaves room for the marker, and for characters that GitHub counts differently."""
_CUT_NOTE = "\n\n*Truncated: the full report is on the page of the run.*\n"
_SAFE_IN_ADDRESS = "/:?&=#%~"
"""Characters that are not escaped in an address, beside letters and digits."""
_ZERO_WIDTH_SPACE = "\u200b"
"""Zero-width space."""
_ACTIVE_POSITION = re.compile(r"(?<=@)|(?<=\\#)|(?<=:)(?=//)|(?<=[wW]{3})(?=\.)|(?<=[Gg][Hh])(?=-[0-9])")
"""Positions in mentions, references and links where `_ZERO_WIDTH_SPACE` deactivates them."""


def comment_text(brief: Brief, name: str, links: Mapping[str, str], commit: str | None = None) -> str:
    """Return the Markdown of a comment: verdict, reasons, tables, links.

    Args:
        brief: results of the run, which may contain untrusted text.
        name: name of the comment for its heading, which distinguishes it from others; may be empty.
        links: trusted addresses by their title.
        commit: hash of the tested commit.
    """
    mark = {"pass": "✅", "undecided": "🟡", "fail": "❌"}[brief.verdict]
    title = f"Calibration{f' ({name})' if name else ''}: {brief.verdict}"
    parts = [f"### {mark} {_literal_text(title)}\n\n{_literal_text(brief.sentence)}\n"]
    if brief.about:
        parts.append(f"{_literal_text(brief.about)}\n")
    if brief.reasons:
        parts.append("".join(f"- {_literal_text(reason)}\n" for reason in brief.reasons))
    for table in brief.tables:
        text = _deactivate_links(markdown_table(table.columns, table.rows[:MAX_ROWS_OF_TABLE]))
        if (more := len(table.rows) - MAX_ROWS_OF_TABLE) > 0:
            text += f"\nand {more} more\n"
        parts.append(text)
    ends = [f"[{name}]({quote(address, safe=_SAFE_IN_ADDRESS)})" for name, address in links.items()]
    end = " · ".join([*ends, _literal_text(commit[:7])] if commit else ends)
    text = "\n".join(parts)
    if len(text) > MAX_TEXT_CHARACTERS:
        text = text[: text.rfind("\n", 0, MAX_TEXT_CHARACTERS)] + _CUT_NOTE
    return f"{text}\n{end}\n"


def _literal_text(text: str) -> str:
    """Escape a text to one line of Markdown that shows it literally; indented, it would be a block of code."""
    return _deactivate_links(escape_markdown(text).strip())


def _deactivate_links(markdown: str) -> str:
    """Deactivate mentions, references and automatic links in Markdown."""
    return _ACTIVE_POSITION.sub(_ZERO_WIDTH_SPACE, markdown)
