"""XML of robots with the line of every element; documents that declare entities are refused."""

from collections.abc import Sequence
from typing import Any
from xml.etree.ElementTree import Element

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import ParseError, XMLParser

LINE_KEY = "{calibration}line"
"""Key of an element's line, which cannot be an attribute of a document."""

MAX_ELEMENT_DEPTH = 100
"""Limit of elements inside one another; readers of elements are recursive."""


class _Parser(XMLParser):
    """XML parser that stores the line of every element, and refuses what is nested too deeply."""

    _depth = 0

    def _end(self, tag: str) -> Element:
        self._depth -= 1
        element: Element = super()._end(tag)  # type: ignore[misc]
        return element

    def _start(self, tag: str, attributes: Sequence[str]) -> Element:
        self._depth += 1
        if self._depth > MAX_ELEMENT_DEPTH:
            raise ValueError(f"more than {MAX_ELEMENT_DEPTH} elements are inside one another")
        element: Element = super()._start(tag, attributes)  # type: ignore[misc]
        element.set(LINE_KEY, str(self.parser.CurrentLineNumber))
        return element


def parse_xml(data: bytes) -> Element | None:
    """Return the root of a document; None if it is not valid XML, declares entities, or is nested too deeply."""
    try:
        parser: Any = _Parser()
        parser.feed(data)
        root: Element = parser.close()
    except (DefusedXmlException, ParseError, ValueError, LookupError):  # LookupError: an unknown encoding
        return None
    return root


def line_of(element: Element) -> int:
    """Return the line of an element, from 1."""
    return int(element.get(LINE_KEY, "1"))


def attributes_of(element: Element) -> dict[str, str]:
    """Return the attributes that the document gives an element."""
    return {name: value for name, value in element.items() if name != LINE_KEY}
