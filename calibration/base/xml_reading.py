"""Safe reading of XML of others: an element at a time, without entities, within limits."""

import io
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import ParseError, iterparse

from calibration.base.errors import InputError
from calibration.base.text import one_line, shorten

MAX_ELEMENT_DEPTH = 100
"""Limit of nested elements; the supported formats need ten."""


def elements(data: bytes, name: str) -> Iterator[tuple[str, Element]]:
    """Yield ``("start" | "end", element)`` in the order of the document; an element that ended may be cleared.

    Raises:
        InputError: it is not XML, declares entities, or is nested too deeply.
    """
    depth = 0
    try:
        for event, element in iterparse(io.BytesIO(data), ("start", "end")):
            depth += 1 if event == "start" else -1
            if depth > MAX_ELEMENT_DEPTH:
                raise InputError(
                    f"{name}: its elements are nested more than {MAX_ELEMENT_DEPTH} deep, the limit of a report"
                )
            yield event, element
    except DefusedXmlException:
        raise InputError(f"{name}: the XML declares entities, which are not allowed, for safety") from None
    except (ParseError, ValueError, LookupError) as error:  # the last two: unknown encoding
        raise InputError(f"{name}: this is not valid XML: {shorten(one_line(str(error)), 200)}") from None
