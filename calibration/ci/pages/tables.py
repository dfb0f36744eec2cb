"""Tables of a report as HTML, sorted by a click on a header."""

import re
from collections.abc import Sequence

from calibration.ci.pages.html import Html, element, join

MOST_ROWS = 500
NO_BREAK = "\u00a0"
BETWEEN_VALUES = re.compile(r"(?<=[^\W\d]|\)), ")
"""Between two values: after a unit or a bracket, as the numbers of a vector belong together."""
VERDICT_WORD = re.compile(r"\b(FAIL|UNDECIDED)\b")
LONGEST_VALUE = 40
"""Characters: what is longer is no value, and breaks over lines."""


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Html:
    """Return a table whose first column names the rows; empty if there are no rows."""
    if not rows:
        return Html("")
    head = element("tr", *(element("th", name, scope="col") for name in columns))
    body = [
        element(
            "tr",
            element("th", _keep_values_unbroken(row[0]), scope="row"),
            *(element("td", _keep_values_unbroken(text), class_=_class_of_verdict(text)) for text in row[1:]),
        )
        for row in rows[:MOST_ROWS]
    ]
    more = f"The first {MOST_ROWS} of {len(rows)} rows." if len(rows) > MOST_ROWS else ""
    whole = element("table", element("thead", head), element("tbody", *body), class_="sortable")
    return join([element("div", whole, class_="scroll", tabindex="0", role="group", aria_label=columns[0]), more])


def _class_of_verdict(text: str) -> str | None:
    """Return the class of a cell whose text has a verdict that is not pass."""
    found = VERDICT_WORD.search(text)
    return found[0].lower() if found else None


def _keep_values_unbroken(text: str) -> str:
    """Return a cell's text with no-break spaces inside its values, and the sign ±, after which no line breaks."""
    parts = BETWEEN_VALUES.split(text.replace(" +- ", " ± "))
    whole = (len(part) <= LONGEST_VALUE and any(map(str.isdigit, part)) for part in parts)
    return ", ".join(part.replace(" ", NO_BREAK) if keep else part for part, keep in zip(parts, whole, strict=True))
