"""The HTML page: head, style, sections, and a script for interaction."""

from collections.abc import Sequence
from pathlib import Path

from calibration.ci.pages.html import Html, element, join

_SECURITY_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
"""Content security policy: no external resources."""


def page(title: str, sections: list[Html]) -> str:
    """Return a self-contained page: the same bytes for the same sections."""
    style, script = (Path(__file__).with_name(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    head = join(
        [
            element("meta", charset="utf-8"),
            element("meta", name="viewport", content="width=device-width, initial-scale=1"),
            element("meta", http_equiv="Content-Security-Policy", content=_SECURITY_POLICY),
            element("title", title),
            Html(f"<style>\n{style}</style>"),
        ]
    )
    body = join([element("main", *sections), Html(f"<script>\n{script}</script>")])
    return f'<!doctype html>\n<html lang="en">\n<head>{head}</head>\n<body>{body}</body>\n</html>\n'


def section(title: str, *content: str, level: int = 2, anchor: str | None = None) -> Html:
    """Return a section with its heading."""
    return element("section", element(f"h{level}", title), *content, id_=anchor)


def figure(drawing: Html, caption: str) -> Html:
    """Return a figure with its caption."""
    return element("figure", drawing, element("figcaption", caption))


def folded(title: str, *content: str, opened: bool = False) -> Html:
    """Return a section that a reader can open."""
    return element("details", element("summary", title), *content, open_="open" if opened else None)


def verdict_line(verdict: str, sentence: str) -> Html:
    """Return a paragraph with the highlighted verdict and its numbers."""
    return element("p", element("span", verdict, class_=f"verdict {verdict}"), f" {sentence}")


def bullets(lines: Sequence[str]) -> Html:
    """Return a list; empty if there are no lines."""
    items = (element("li", line.replace(" +- ", " ± ")) for line in lines)
    return element("ul", *items, class_="reasons") if lines else Html("")
