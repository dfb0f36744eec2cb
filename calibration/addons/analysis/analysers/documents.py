"""Analysers of documents: yamllint, zizmor (workflows and actions of GitHub), and XML of robots."""

import json
import re
from collections.abc import Iterator, Sequence

import yaml
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import ParseError, iterparse

from calibration.addons.analysis.analysers.analyser import (
    Analyser,
    ProgramAnalyser,
    ProgramFinding,
    ProgramResult,
    failure_of,
    module,
    program,
)
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import Category, CodeFinding, Severity
from calibration.base.text import one_line, shorten

_WORKFLOWS_AND_ACTIONS = re.compile(r"\.github/workflows/[^/]+\.ya?ml|(.*/)?action\.ya?ml")
_SEVERITY_OF_ZIZMOR_LEVEL: dict[str, Severity] = {"High": "error", "Medium": "warning"}


class Zizmor(ProgramAnalyser):
    """Security of workflows and composite actions, offline."""

    name = "zizmor"
    settings = ("zizmor.yml", "zizmor.yaml")

    def wants(self, path: str, copy: Copy) -> bool:
        """Select workflows and actions; invalid YAML is reported by yamllint."""
        return bool(_WORKFLOWS_AND_ACTIONS.fullmatch(path)) and _is_mapping(copy.text(path))

    def runs(self, copy: Copy, files: Sequence[str]) -> Iterator[tuple[list[str], Sequence[str]]]:
        """Yield the command."""
        command = [program("zizmor"), "--offline", "--no-exit-codes", "--no-progress", "--quiet"]
        yield [*command, "--format", "json-v1", "--"], files

    def parsed(self, result: ProgramResult) -> Iterator[ProgramFinding]:
        """Parse the list of findings."""
        for entry in json.loads(result.output or "[]"):
            if entry.get("ignored"):
                continue
            places = entry["locations"]
            primary = next((each for each in places if each["symbolic"].get("kind") == "Primary"), places[0])
            path = primary["symbolic"]["key"]["Local"]["verbatim_path"]
            line = primary["concrete"]["location"]["start_point"]["row"] + 1
            severity = _SEVERITY_OF_ZIZMOR_LEVEL.get(entry["determinations"]["severity"], "note")
            message = f"{entry['desc']}: {primary['symbolic'].get('annotation', '')}"
            yield path, line, entry["ident"], "security", severity, message


def _is_mapping(text: str) -> bool:
    try:
        events = yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # the other one takes minutes
        return any(isinstance(event, yaml.MappingStartEvent) for event in list(events)[:3])
    except (yaml.YAMLError, RecursionError):
        return False


_XML_SUFFIXES = (".xml", ".launch", ".urdf", ".xacro", ".sdf", ".srdf")


class XmlFiles(Analyser):
    """Validity of XML, by a parser that refuses entities; runs no program."""

    name = "xml"

    def wants(self, path: str, copy: Copy) -> bool:
        """Select XML files by suffix."""
        return path.endswith(_XML_SUFFIXES)

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Parse each file."""
        return [finding for path in files if (finding := _check_xml(copy, path)) is not None]


def _check_xml(copy: Copy, path: str) -> CodeFinding | None:
    try:
        for _, element in iterparse(copy.root / path, ("end",)):
            element.clear()
    except DefusedXmlException:
        message = "the XML declares entities, which a reader may expand without end"
        return CodeFinding(path, 1, "xml/entities", "security", "warning", message)
    except (ParseError, ValueError, LookupError) as error:  # the latter two: an unknown encoding
        line = max(error.position[0], 1) if isinstance(error, ParseError) else 1
        message = f"this is not valid XML: {shorten(one_line(str(error)), 200)}"
        return CodeFinding(path, line, "xml/syntax", "error-prone", "error", message)
    return None


_LINE_OF_YAMLLINT = re.compile(r"(.+?):(\d+):(\d+): \[(error|warning)\] (.*?)(?: \(([a-z-]+)\))?")
_DEFAULT_CONFIGURATION = "{extends: relaxed, rules: {line-length: disable, new-line-at-end-of-file: disable}}"
_YAML_RULES_OF_ERRORS = ("syntax", "key-duplicates", "anchors")
"""Rules of errors that change the meaning; the others are style."""


class Yamllint(ProgramAnalyser):
    """Syntax, duplicate keys, and style of YAML; the team's settings select the rules, if there are any."""

    name = "yamllint"
    settings = (".yamllint", ".yamllint.yml", ".yamllint.yaml")
    codes = (0, 1)

    def wants(self, path: str, copy: Copy) -> bool:
        """Select YAML files by suffix, if they are UTF-8."""
        return path.endswith((".yml", ".yaml")) and copy.is_utf8(path)

    def runs(self, copy: Copy, files: Sequence[str]) -> Iterator[tuple[list[str], Sequence[str]]]:
        """Yield the command."""
        own = any((copy.root / name).is_file() for name in self.settings)
        rules = [] if own else ["--config-data", _DEFAULT_CONFIGURATION]
        yield [*module("yamllint"), "--format", "parsable", *rules, "--"], files

    def parsed(self, result: ProgramResult) -> Iterator[ProgramFinding]:
        """Parse the output, one finding per line."""
        if "Traceback" in result.errors:  # 1 is also the exit code of a Python program that crashes
            raise failure_of(self.name, result)
        for match in filter(None, map(_LINE_OF_YAMLLINT.fullmatch, result.output.splitlines())):
            rule = match[6] or "syntax"
            is_error = rule in _YAML_RULES_OF_ERRORS
            category: Category = "error-prone" if is_error else "style"
            yield match[1], int(match[2]), rule, category, "error" if is_error else "note", match[5]
