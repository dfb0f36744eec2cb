"""Analysers of documents: yamllint, zizmor (workflows and actions of GitHub), XML and URDF of robots."""

import json
import math
import re
from collections.abc import Iterator, Sequence
from xml.etree.ElementTree import Element

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
from calibration.addons.analysis.ros.tree import line_of, parse_xml
from calibration.base import did_you_mean, one_line, shorten

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


class XmlFiles(Analyser):
    """Validity of XML, by a parser that refuses entities; runs no program."""

    name = "xml"
    suffixes = (".xml", ".launch", ".urdf", ".xacro", ".sdf", ".srdf")

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


_JOINTS_WITH_LIMITS = ("revolute", "prismatic")
_MOMENTS_OF_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_Found = tuple[Element, str, Severity, str]
"""Element, rule, severity, message."""


class Urdf(Analyser):
    """Links, joints, limits and inertias of URDF; xacro is not expanded, so it is not checked."""

    name = "urdf"
    suffixes = (".urdf",)

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Check each file; invalid XML is reported by the analyser xml."""
        found = []
        for path in files:
            root = parse_xml((copy.root / path).read_bytes())
            if root is None:
                continue
            for element, rule, severity, message in _find_faults(root):
                found.append(CodeFinding(path, line_of(element), f"urdf/{rule}", "error-prone", severity, message))
        return found


def _find_faults(root: Element) -> Iterator[_Found]:
    if root.tag != "robot":
        return
    links, joints = root.findall("link"), root.findall("joint")
    for elements in (links, joints):
        seen = set()
        for each in elements:
            name = each.get("name", "")
            if name in seen:
                yield each, "name-twice", "error", f"a second {each.tag} is called {shorten(name)!r}"
            seen.add(name)
    yield from _tree_faults(root, [each.get("name", "") for each in links], joints)
    for joint in joints:
        yield from _limit_faults(joint)
    for link in links:
        if (inertial := link.find("inertial")) is not None:
            yield from _inertia_faults(inertial, shorten(link.get("name", "")))


def _tree_faults(root: Element, links: Sequence[str], joints: Sequence[Element]) -> Iterator[_Found]:
    parents: dict[str, str] = {}
    for joint in joints:
        ends = []
        for end in ("parent", "child"):
            place = joint.find(end)
            name = "" if place is None else place.get("link", "")
            ends.append(name)
            if name not in links:
                where = joint if place is None else place
                fault = f"there is no link {shorten(name)!r}{did_you_mean(name, links)}"
                yield where, "no-such-link", "error", f"the {end} of joint {shorten(joint.get('name', ''))!r}: {fault}"
        parent, child = ends
        if child in parents:
            fault = f"{shorten(child)!r} is the child of two joints: found a second parent {shorten(parent)!r}"
            yield joint, "two-parents", "error", fault
        elif child:
            parents[child] = parent
    roots = [name for name in dict.fromkeys(links) if name not in parents]
    if links and len(roots) != 1:
        named = shorten(", ".join(roots), 200) or "none, because its joints go round in a circle"
        yield root, "no-tree", "error", f"expected one link that is no joint's child, found {named}"


def _limit_faults(joint: Element) -> Iterator[_Found]:
    kind, name = joint.get("type", ""), shorten(joint.get("name", ""))
    limit = joint.find("limit")
    if kind not in _JOINTS_WITH_LIMITS:
        return
    if limit is None:
        yield joint, "no-limits", "error", f"joint {name!r} is {kind} and has no <limit>"
        return
    lower, upper = _parse_number(limit.get("lower", "0")), _parse_number(limit.get("upper", "0"))
    if lower is None or upper is None or lower > upper:
        fault = f"found {shorten(limit.get('lower', '0'))} to {shorten(limit.get('upper', '0'))}"
        yield limit, "limits", "error", f"limits of joint {name!r}: {fault}, expected two numbers in their order"
    elif lower == upper:
        yield limit, "limits", "warning", f"limits of joint {name!r}: found {lower:g} twice, so that it cannot move"


def _inertia_faults(inertial: Element, link: str) -> Iterator[_Found]:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is not None and not (_parse_number(mass.get("value", "")) or 0) > 0:
        found = shorten(mass.get("value", "nothing"))
        yield mass, "mass", "error", f"mass of link {link!r}: found {found}, expected a number above 0"
    if inertia is None:
        return
    values = [_parse_number(inertia.get(name, "0")) for name in _MOMENTS_OF_INERTIA]
    if not _is_positive_definite(values):
        fault = "is not positive definite, which that of a body is"
        yield inertia, "inertia", "error", f"the inertia of link {link!r} {fault}"


def _is_positive_definite(values: Sequence[float | None]) -> bool:
    """Whether a symmetric matrix is positive definite by its leading minors; from its six numbers, row by row."""
    numbers = [value for value in values if value is not None]
    if len(numbers) < len(_MOMENTS_OF_INERTIA):
        return False
    xx, xy, xz, yy, yz, zz = numbers
    second = xx * yy - xy * xy
    third = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    return xx > 0 and second > 0 and third > 0


def _parse_number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
