"""Markdown of a comment on a pull request, without active mentions, references or links from untrusted text."""

import re
from collections.abc import Mapping
from urllib.parse import quote

from calibration.ci.github.comments import LONGEST
from calibration.ci.report.brief import Brief
from calibration.ci.workflow.markdown import escape_markdown, markdown_table

ROWS_SHOWN = 40
LONGEST_TEXT = LONGEST - 4096
"""Characters; leaves room for the marker, and for characters that GitHub counts differently."""
_CUT = "\n\n*Truncated: the full report is on the page of the run.*\n"
_SAFE = "/:?&=#%~"
"""Characters that are not escaped in an address, beside letters and digits."""
_APART = "\u200b"
"""Zero-width space."""
_ACTIVE = re.compile(r"(?<=@)|(?<=\\#)|(?<=:)(?=//)|(?<=[wW]{3})(?=\.)|(?<=[Gg][Hh])(?=-[0-9])")
"""Positions in mentions, references and links where `_APART` deactivates them."""


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
    parts = [f"### {mark} {_inactive(title)}\n\n{_inactive(brief.sentence)}\n"]
    if brief.about:
        parts.append(f"{_inactive(brief.about)}\n")
    if brief.reasons:
        parts.append("".join(f"- {_inactive(reason)}\n" for reason in brief.reasons))
    for table in brief.tables:
        text = _apart(markdown_table(table.columns, table.rows[:ROWS_SHOWN]))
        if (more := len(table.rows) - ROWS_SHOWN) > 0:
            text += f"\nand {more} more\n"
        parts.append(text)
    ends = [f"[{name}]({quote(address, safe=_SAFE)})" for name, address in links.items()]
    end = " · ".join([*ends, _inactive(commit[:7])] if commit else ends)
    text = "\n".join(parts)
    if len(text) > LONGEST_TEXT:
        text = text[: text.rfind("\n", 0, LONGEST_TEXT)] + _CUT
    return f"{text}\n{end}\n"


def _inactive(text: str) -> str:
    """Escape a text to one line of Markdown that shows it literally; indented, it would be a block of code."""
    return _apart(escape_markdown(text).strip())


def _apart(markdown: str) -> str:
    """Deactivate mentions, references and automatic links in Markdown."""
    return _ACTIVE.sub(_APART, markdown)
