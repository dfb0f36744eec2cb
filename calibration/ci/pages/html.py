"""HTML elements; strings are escaped unless they are markup."""

from collections.abc import Sequence

from calibration.base.text import escape_markup

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
        f' {name.rstrip("_").replace("_", "-")}="{escape_markup(number(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    if tag in VOID_ELEMENTS and not children:
        return Html(f"<{tag}{given}/>")
    return Html(f"<{tag}{given}>{join(children)}</{tag}>")


def join(parts: Sequence[str]) -> Html:
    """Concatenate markup and texts, which are escaped."""
    return Html("".join(part if isinstance(part, Html) else escape_markup(part) for part in parts))


def number(value: str | float) -> str:
    """Format an attribute's value; numbers with the precision of a picture."""
    return value if isinstance(value, str) else f"{value:.6g}" if isinstance(value, int) else f"{round(value, 2):g}"
