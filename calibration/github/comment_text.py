"""The text of a comment on a pull request: Markdown in which nothing that others wrote is active."""

import re
from collections.abc import Mapping
from urllib.parse import quote

from calibration.github.comments import LONGEST
from calibration.report.brief import Brief
from calibration.workflow.summary import escape_markdown, markdown_table

REASONS_SHOWN = 10
ROWS_SHOWN = 40
LONGEST_TEXT = LONGEST - 4096
"""Characters; the rest is for the marker and what counts differently on GitHub's side."""
_CUT = "\n\n*Cut here: the whole is on the page of the run.*\n"
_SAFE = "/:?&=#%~"
"""In an address, beside letters and digits."""
_APART = "\u200b"
"""A space without width."""
_ACTIVE = re.compile(r"(?<=@)|(?<=\\#)|(?<=:)(?=//)|(?<=[wW]{3})(?=\.)|(?<=[Gg][Hh])(?=-[0-9])")
"""Where GitHub makes a mention, a reference or a link, which is taken apart."""


def comment_text(brief: Brief, name: str, links: Mapping[str, str], commit: str | None = None) -> str:
    """Return a comment: verdict, reasons, tables, links.

    Args:
        brief: what the run found; its texts may be a stranger's.
        name: what tells the comment from others, for its heading; may be empty.
        links: addresses, which are ours, by what they are called.
        commit: that was tested.
    """
    mark = "✅" if brief.verdict == "pass" else "❌"
    title = f"Calibration{f' ({name})' if name else ''}: {brief.verdict}"
    parts = [f"### {mark} {_inactive(title)}\n\n{_inactive(brief.sentence)}\n"]
    if brief.reasons:
        lines = [_inactive(reason) for reason in brief.reasons[:REASONS_SHOWN]]
        if (more := len(brief.reasons) - REASONS_SHOWN) > 0:
            lines.append(f"and {more} more")
        parts.append("".join(f"- {line}\n" for line in lines))
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
    """Return a text as Markdown that shows it as it is, on one line."""
    return _apart(escape_markdown(text))


def _apart(markdown: str) -> str:
    """Return Markdown in which nobody is mentioned, nothing referred to, and no address becomes a link."""
    return _ACTIVE.sub(_APART, markdown)
