"""Analyser of URDF: whether a robot description is a tree of links that a reader and a simulator can use."""

import math
from collections.abc import Iterator, Sequence
from xml.etree.ElementTree import Element

from calibration.addons.analysis.analysers.analyser import Analyser
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import CodeFinding, Severity
from calibration.addons.analysis.ros.tree import line_of, parse_xml
from calibration.base.text import did_you_mean, shorten

_JOINTS_WITH_LIMITS = ("revolute", "prismatic")
_MOMENTS_OF_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_Found = tuple[Element, str, Severity, str]
"""Element, rule, severity, message."""


class Urdf(Analyser):
    """Links, joints, limits and inertias of URDF; xacro is not expanded, so it is not checked."""

    name = "urdf"

    def wants(self, path: str, copy: Copy) -> bool:
        """Select URDF files by suffix."""
        return path.endswith(".urdf")

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
