"""HTML elements; texts are escaped unless they are markup already."""

from collections.abc import Sequence
from html import escape

VOID = frozenset(("br", "img", "meta", "line", "rect", "circle", "path", "polyline", "polygon", "ellipse"))
"""Elements without content."""


class Html(str):
    """Markup, as opposed to a text, which may hold anything."""

    __slots__ = ()


def element(tag: str, *children: str, **attributes: str | float | None) -> Html:
    """Return an element.

    Args:
        tag: its name.
        children: markup as it is, and texts, which are escaped.
        attributes: by name, with ``_`` for ``-`` and one at the end dropped (``class_``); None leaves one out.
    """
    given = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(number(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    if tag in VOID and not children:
        return Html(f"<{tag}{given}/>")
    return Html(f"<{tag}{given}>{join(children)}</{tag}>")


def join(parts: Sequence[str]) -> Html:
    """Return texts and markup one after the other."""
    return Html("".join(part if isinstance(part, Html) else escape(part) for part in parts))


def number(value: str | float) -> str:
    """Return an attribute's value; numbers with the digits that a picture can show."""
    return value if isinstance(value, str) else f"{value:.6g}" if isinstance(value, int) else f"{round(value, 2):g}"
