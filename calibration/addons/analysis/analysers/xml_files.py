"""Analyser of XML files of robots (launch files, URDF, xacro, package.xml): valid and safe to read."""

from collections.abc import Sequence

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import ParseError, iterparse

from calibration.addons.analysis.analysers.analyser import Analyser
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.finding import CodeFinding
from calibration.base.text import one_line, shorten

_XML_SUFFIXES = (".xml", ".launch", ".urdf", ".xacro", ".sdf", ".srdf")


class XmlFiles(Analyser):
    """Validity of XML, by a parser that refuses entities; runs no program."""

    name = "xml"

    def wants(self, path: str, copy: Copy) -> bool:
        """Select XML files by suffix."""
        return path.endswith(_XML_SUFFIXES)

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Parse each file."""
        return [finding for path in files if (finding := _check_file(copy, path)) is not None]


def _check_file(copy: Copy, path: str) -> CodeFinding | None:
    try:
        for _, element in iterparse(copy.root / path, ("end",)):
            element.clear()
    except DefusedXmlException:
        message = "the XML declares entities, which a reader may expand without end"
        return CodeFinding(path, 1, "xml/entities", "security", "warning", message)
    except ParseError as error:
        message = f"this is not valid XML: {shorten(one_line(str(error)), 200)}"
        return CodeFinding(path, max(error.position[0], 1), "xml/syntax", "error-prone", "error", message)
    except (ValueError, LookupError) as error:  # an unknown encoding
        message = f"this is not valid XML: {shorten(one_line(str(error)), 200)}"
        return CodeFinding(path, 1, "xml/syntax", "error-prone", "error", message)
    return None
