"""XML that others wrote, read safely and without holding it all."""

import io
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from calibration.errors import InputError
from calibration.workflow.text import one_line, shorten

DEEPEST = 100
"""Elements inside each other; the formats in use need ten."""


def elements(data: bytes, name: str) -> Iterator[tuple[str, Element]]:
    """Yield ``("start" | "end", element)`` in the order of the document; an element that ended may be cleared.

    Raises:
        InputError: it is no XML, declares entities, or is nested too deeply.
    """
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, iterparse

    depth = 0
    try:
        for event, element in iterparse(io.BytesIO(data), ("start", "end")):
            depth += 1 if event == "start" else -1
            if depth > DEEPEST:
                raise InputError(f"{name}: its elements are nested more than {DEEPEST} deep, which no report is")
            yield event, element
    except DefusedXmlException:
        raise InputError(f"{name}: the XML declares entities, which no report needs and which is not safe") from None
    except (ParseError, ValueError, LookupError) as error:  # the last two: an encoding that there is not
        raise InputError(f"{name}: this is not valid XML: {shorten(one_line(str(error)), 200)}") from None
