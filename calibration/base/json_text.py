"""Fast JSON formatting of large documents: the result of `json.dumps` with an indent, in less than half the time.

Python's encoder is fast only without an indent. So flat objects and lists, which are nearly all of a
dataset's text, are left to it, with separators that already contain the line ends and the indent.
"""

import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import chain
from json.encoder import encode_basestring_ascii
from typing import Any

CONTAINERS = frozenset({dict, list, tuple})
MOST_KEPT = 64 * 1024**2
"""Characters of the texts that `Shared` keeps."""


class Shared:
    """Objects that several documents contain; the text of each is made once."""

    def __init__(self, objects: Iterable[Any]) -> None:
        self._objects = {id(each): each for each in objects if type(each) in CONTAINERS}
        self._texts: dict[tuple[int, str], str] = {}
        self._room = MOST_KEPT

    def has(self, value: Any) -> bool:
        """Return whether a value is one of the objects."""
        return id(value) in self._objects

    def find(self, value: Any, indent: str) -> str | None:
        """Return the kept text of an object, whose lines begin with ``indent``; None if there is none."""
        return self._texts.get((id(value), indent))

    def keep(self, value: Any, indent: str, text: str) -> None:
        """Keep the text of an object, as long as there is room."""
        if len(text) <= self._room:
            self._room -= len(text)
            self._texts[id(value), indent] = text


def json_text(
    document: Mapping[str, Any],
    *,
    width: int = 2,
    sort_keys: bool = True,
    allow_nan: bool = True,
    shared: Shared | None = None,
) -> str:
    """Format a document like ``json.dumps(document, indent=width, sort_keys=..., allow_nan=...)``; keys must be text.

    Args:
        document: the document.
        width: blanks per level.
        sort_keys: whether the keys are sorted.
        allow_nan: whether NaN and Infinity, which are no JSON, are written.
        shared: objects in the document whose text is kept for other documents; they must not change.

    Raises:
        RecursionError: it is nested too deeply.
        ValueError: a number is not finite, without ``allow_nan``.
    """
    return _Style(width, sort_keys, allow_nan, shared or Shared(())).text(document, "\n")


class _Style:
    """Options of the format."""

    def __init__(self, width: int, sort_keys: bool, allow_nan: bool, shared: Shared) -> None:
        self.step = " " * width
        self.sort_keys = sort_keys
        self.allow_nan = allow_nan
        self.shared = shared
        self.plain = _encoder(", ", sort_keys, allow_nan).encode

    def text(self, value: Any, indent: str) -> str:
        """Format a value; its lines begin with ``indent``, which includes the line end."""
        if not value or type(value) not in CONTAINERS:
            return self.plain(value)
        if not self.shared.has(value):
            return self.container(value, indent)
        text = self.shared.find(value, indent)
        if text is None:
            text = self.container(value, indent)
            self.shared.keep(value, indent, text)
        return text

    def container(self, value: Any, indent: str) -> str:
        """Format a container that is not empty."""
        inner = indent + self.step
        children = value.values() if isinstance(value, dict) else value
        if _are_flat(children):
            text = self.flat(value, inner)
            return f"{text[0]}{inner}{text[1:-1]}{indent}{text[-1]}"
        if isinstance(value, dict):
            keys = sorted(value) if self.sort_keys else value
            lines = [f"{encode_basestring_ascii(key)}: {self.text(value[key], inner)}" for key in keys]
            return f"{{{inner}{f',{inner}'.join(lines)}{indent}}}"
        if all(value) and set(map(type, value)) == {dict} and _are_flat(chain.from_iterable(map(dict.values, value))):
            # JSON strings contain no line ends, so only the end of an object can match.
            deep = inner + self.step
            text = self.flat(value, deep)[2:-2].replace(f"}},{deep}{{", f"{inner}}},{inner}{{{deep}")
            return f"[{inner}{{{deep}{text}{inner}}}{indent}]"
        return f"[{inner}{f',{inner}'.join([self.text(each, inner) for each in value])}{indent}]"

    def flat(self, value: Any, separator: str) -> str:
        """Format a container, with a separator between the values."""
        return _encoder(f",{separator}", self.sort_keys, self.allow_nan).encode(value)


def _are_flat(values: Any) -> bool:
    return CONTAINERS.isdisjoint(map(type, values))


@lru_cache(maxsize=64)
def _encoder(separator: str, sort_keys: bool, allow_nan: bool) -> json.JSONEncoder:
    return json.JSONEncoder(
        sort_keys=sort_keys, allow_nan=allow_nan, check_circular=False, separators=(separator, ": ")
    )
