"""HTML page: its elements, tables sorted by a click on a header, sections, head, style and script.

Strings are escaped unless they are markup.
"""

import gzip
import re
from base64 import b64encode
from collections.abc import Sequence
from functools import cache
from html import escape
from pathlib import Path

VOID_ELEMENTS = frozenset(("br", "img", "meta", "line", "rect", "circle", "path", "polyline", "polygon", "ellipse"))
"""Elements without content."""


class Html(str):
    """Markup, as opposed to plain text, which is escaped."""

    __slots__ = ()


def element(tag: str, *children: str, **attributes: str | float | None) -> Html:
    """Return an element.

    Args:
        tag: name of the element.
        children: markup, inserted unchanged, and texts, which are escaped.
        attributes: by name, with ``_`` for ``-`` and a trailing ``_`` removed (``class_``); None omits an attribute.
    """
    given = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(number(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    if tag in VOID_ELEMENTS and not children:
        return Html(f"<{tag}{given}/>")
    return Html(f"<{tag}{given}>{join(children)}</{tag}>")


def join(parts: Sequence[str]) -> Html:
    """Concatenate markup and texts, which are escaped."""
    return Html("".join(part if isinstance(part, Html) else escape(part) for part in parts))


def number(value: str | float) -> str:
    """Format an attribute's value; numbers with the precision of a picture."""
    return value if isinstance(value, str) else f"{value:.6g}" if isinstance(value, int) else f"{round(value, 2):g}"


MOST_ROWS = 500
NO_BREAK = "\u00a0"
BETWEEN_VALUES = re.compile(r"(?<=[^\W\d]|\)), ")
"""Between two values: after a unit or a bracket, as the numbers of a vector belong together."""
VERDICT_WORD = re.compile(r"\b(FAIL|UNDECIDED)\b")
LONGEST_VALUE = 40
"""Characters: what is longer is no value, and breaks over lines."""


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Html:
    """Return a table whose first column names the rows; empty if there are no rows.

    Texts are escaped, markup is kept.
    """
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
    """Return a cell's text with no-break spaces inside its values, so that none is broken after its sign ±."""
    if isinstance(text, Html):
        return text
    parts = BETWEEN_VALUES.split(text)
    whole = (len(part) <= LONGEST_VALUE and any(map(str.isdigit, part)) for part in parts)
    return ", ".join(part.replace(" ", NO_BREAK) if keep else part for part, keep in zip(parts, whole, strict=True))


_SECURITY_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
"""Content security policy: no external resources."""


def page(title: str, sections: list[Html], refresh: int | None = None) -> str:
    """Return a self-contained page: the same bytes for the same sections.

    Args:
        title: of the page.
        sections: its content.
        refresh: seconds after which a browser reads it again; never by default.
    """
    style, script = (_file_of_page(name) for name in ("page.css", "page.js"))
    head = join(
        [
            element("meta", charset="utf-8"),
            element("meta", name="viewport", content="width=device-width, initial-scale=1"),
            element("meta", http_equiv="Content-Security-Policy", content=_SECURITY_POLICY),
            *([] if refresh is None else [element("meta", http_equiv="refresh", content=str(refresh))]),
            element("title", title),
            Html(f"<style>\n{style}</style>"),
        ]
    )
    main = element("main", *sections)
    body = join([main, Html(f"<script>\n{script}</script>"), *(_scripts_of_scenes() if _SCENE in main else ())])
    return f'<!doctype html>\n<html lang="en">\n<head>{head}</head>\n<body>{body}</body>\n</html>\n'


_SCENE = 'class="turning"'
"""What the scripts of scenes look for; texts have no quotes, as they are escaped."""


def _file_of_page(name: str) -> str:
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


@cache
def _scripts_of_scenes() -> tuple[Html, ...]:
    """Return three.js, packed, as a third is enough for it, and the script that unpacks and uses it."""
    packed = b64encode(gzip.compress(_file_of_page("three/three.min.js").encode(), mtime=0)).decode("ascii")
    return (
        Html(f"<!-- three.js: {_file_of_page('three/LICENSE')}-->"),
        element("script", packed, type="application/gzip", id_="three"),
        Html(f"<script>\n{_file_of_page('scene.js')}</script>"),
    )


def section(title: str, *content: str, anchor: str | None = None) -> Html:
    """Return a section with its heading."""
    return element("section", element("h2", title), *content, id_=anchor)


def figure(drawing: Html, caption: str) -> Html:
    """Return a figure with its caption."""
    return element("figure", drawing, element("figcaption", caption))


def folded(title: str, *content: str) -> Html:
    """Return a section that a reader can open."""
    return element("details", element("summary", title), *content)


def verdict_line(verdict: str, sentence: str) -> Html:
    """Return a paragraph with the highlighted verdict and its numbers."""
    return element("p", element("span", verdict, class_=f"verdict {verdict}"), " ", sentence)


def bullets(lines: Sequence[str]) -> Html:
    """Return a list; empty if there are no lines."""
    items = (element("li", line) for line in lines)
    return element("ul", *items, class_="reasons") if lines else Html("")
