"""Our own analysers: XML, URDF of robots, and packages of ROS, whose checks run in a process of their own."""

import json
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar
from xml.etree.ElementTree import Element

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import ParseError, iterparse

import calibration
from calibration.addons.analysis.analysers import analyser
from calibration.addons.analysis.analysers.analyser import Analyser, run_program
from calibration.addons.analysis.copies import MAX_FILES, Copy
from calibration.addons.analysis.results import CodeFinding, GraphSummary, Severity
from calibration.addons.analysis.ros.tree import line_of, parse_xml
from calibration.base import did_you_mean, one_line, parse_number, shorten, temporary_folder

_CHECKED_FILES = re.compile(
    r"(.*/)?(package\.xml|CMakeLists\.txt|setup\.(py|cfg)|calibration\.yml|config\.yml|dataset\.json)"
    r"|.*\.(launch|launch\.xml|test|urdf|xacro|msg|srv|action|py|cpp|cc|cxx|c|h|hpp|hh|hxx|yaml|yml)"
)
_PROGRAM_OF_CHECKS = (
    "import runpy, sys; sys.path.insert(0, sys.argv.pop(1)); "
    "runpy.run_module('calibration.addons.analysis.ros', run_name='__main__', alter_sys=True)"
)
"""Runs the checks from where this package is, whether it is installed or not."""


class XmlFiles(analyser.Analyser):
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


_JOINTS_WITH_LIMITS = ("revolute", "prismatic")
_MOMENTS_OF_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_Found = tuple[Element, str, Severity, str]
"""Element, rule, severity, message."""


class Urdf(analyser.Analyser):
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
    lower, upper = parse_number(limit.get("lower", "0").strip()), parse_number(limit.get("upper", "0").strip())
    if lower is None or upper is None or lower > upper:
        fault = f"found {shorten(limit.get('lower', '0'))} to {shorten(limit.get('upper', '0'))}"
        yield limit, "limits", "error", f"limits of joint {name!r}: {fault}, expected two numbers in their order"
    elif lower == upper:
        yield limit, "limits", "warning", f"limits of joint {name!r}: found {lower:g} twice, so that it cannot move"


def _inertia_faults(inertial: Element, link: str) -> Iterator[_Found]:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is not None and not (parse_number(mass.get("value", "").strip()) or 0) > 0:
        found = shorten(mass.get("value", "nothing"))
        yield mass, "mass", "error", f"mass of link {link!r}: found {found}, expected a number above 0"
    if inertia is None:
        return
    values = [parse_number(inertia.get(name, "0").strip()) for name in _MOMENTS_OF_INERTIA]
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


class RosChecks(Analyser):
    """Packages, build files, interfaces, launch files and code of ROS, one against the other."""

    name = "ros"
    at_once = MAX_FILES
    whole: ClassVar[bool] = True

    def wants(self, path: str, copy: Copy) -> bool:
        """Select the files that checks report on, if there is a package."""
        return bool(_CHECKED_FILES.fullmatch(path)) and any(
            each.rpartition("/")[2] == "package.xml" for each in copy.present
        )

    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Check all files together, and keep what is found in ``files``."""
        asked = set(files)
        entries = run_in_process("findings", copy, seconds)
        return [finding for entry in entries if (finding := CodeFinding(**entry)).path in asked]


def run_in_process(what: str, copy: Copy, seconds: float) -> Any:
    """Run the checks of ROS packages in a process of their own, and return the document that it prints.

    Args:
        what: ``findings`` or ``graph``.
        copy: the files.
        seconds: time limit.

    Raises:
        InfrastructureError: it fails, or takes too long.
    """
    with temporary_folder(prefix="calibration-analysis-") as folder:
        task = folder / "task.json"
        task.write_text(json.dumps([what, str(copy.root), copy.present, copy.opaque]), encoding="ascii")
        home = str(Path(calibration.__file__).parents[1])
        result = run_program(
            RosChecks.name, [sys.executable, "-I", "-c", _PROGRAM_OF_CHECKS, home, str(task)], copy.root, seconds, (0,)
        )
    return json.loads(result.output)


JSON_FILE, PICTURE_FILE = "ros-graph.json", "ros-graph.svg"


@dataclass(frozen=True)
class RosGraph:
    """Graph of one state of a repository."""

    nodes: int
    connections: frozenset[str]
    """Connections of nodes, one line each: ``/scan: scanner -> follower``."""
    unresolved: tuple[str, ...]
    document: str
    """The whole graph as JSON."""
    picture: str
    """Picture of the graph as SVG."""

    def since(self, earlier: "RosGraph | None") -> GraphSummary:
        """Return what the graph has, and what has changed since an earlier state."""
        before = self.connections if earlier is None else earlier.connections
        return GraphSummary(
            nodes=self.nodes,
            connections=len(self.connections),
            connected=tuple(sorted(self.connections - before)),
            cut=tuple(sorted(before - self.connections)),
            unresolved=self.unresolved,
        )


def read_graph(copy: Copy, seconds: float) -> RosGraph:
    """Read the graph of a copy in a process of its own.

    Raises:
        InfrastructureError: it fails, or takes too long.
    """
    found = run_in_process("graph", copy, seconds)
    connections = frozenset(found["connections"])
    return RosGraph(found["nodes"], connections, tuple(found["unresolved"]), found["document"], found["picture"])
