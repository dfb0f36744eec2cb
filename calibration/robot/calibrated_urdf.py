"""Write calibrated origins into an existing URDF; all other bytes are unchanged.

A calibrated transform is a joint of the URDF, or a chain of fixed joints, of which the last one is changed.
The file is searched for the byte positions of its tags, and only the ``xyz`` and ``rpy`` of these joints are rewritten.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from xml.parsers.expat import ParserCreate, XMLParserType

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse
from calibration.robot.urdf import Joint, Robot, parse_robot

_ATTRIBUTE = r"""(\s{name}\s*=\s*)("[^"]*"|'[^']*')"""
_Span = tuple[int, int]
"""First byte of a tag, and the byte after its last."""


@dataclass
class CalibratedUrdf:
    """The new URDF, and notes for the user."""

    content: bytes
    notes: list[str] = field(default_factory=list)


def calibrated_urdf(content: bytes, transforms: Mapping[Edge, Array], where: str) -> CalibratedUrdf:
    """Write calibrated transforms into a URDF.

    Args:
        content: the URDF, in UTF-8.
        transforms: ``T_parent_child`` (4, 4); of movable joints at position 0.
        where: the file, for messages.

    Raises:
        InputError: it is no URDF that `parse_robot` reads, is not in UTF-8, or lacks the frames of a transform or a
            joint to change.
    """
    try:
        content.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: a URDF in UTF-8 was expected: {error}") from None
    robot = parse_robot(content, Path(where))
    origins: dict[str, Array] = {}
    notes = []
    for (parent, child), T in transforms.items():
        chain = _joints_down(robot, parent, child)
        if len(chain) == 1:
            origins[chain[0].name] = T
            continue
        if not all(each.kind == "fixed" for each in chain):
            raise InputError(
                f"{where}: the joints from '{parent}' to '{child}' are not all fixed, so none of them can take the "
                f"calibrated transform"
            )
        before = reduce(np.matmul, (origins.get(each.name, each.T_parent_joint) for each in chain[:-1]))
        origins[chain[-1].name] = inverse(before) @ T
        notes.append(f"'{parent}' to '{child}' spans {len(chain)} joints; '{chain[-1].name}' takes the change")
    tags = _joint_tags(content)
    for start, end, text in sorted((_edit(content, *tags[name], T) for name, T in origins.items()), reverse=True):
        content = content[:start] + text + content[end:]
    return CalibratedUrdf(content, notes)


def _joints_down(robot: Robot, parent: str, child: str) -> list[Joint]:
    """Return the joints from a link to one of its descendants."""
    steps = robot.tree.path(parent, child) if parent in robot.tree and child in robot.tree else ()
    if not steps or any(step.inverted for step in steps):
        raise InputError(f"{robot.path}: no chain of joints from '{parent}' to '{child}'; are these the robot's links?")
    return [robot.by_edge[step.parent, step.child] for step in steps]


def _joint_tags(content: bytes) -> dict[str, tuple[_Span, _Span | None]]:
    """Return where the tags of each joint and of its origin are, by name; not those of transmissions and plugins.

    `parse_robot` has checked the content: it has no document type, and no two joints of one name.
    """
    found: dict[str, tuple[_Span, _Span | None]] = {}
    path: list[str] = []
    parser = ParserCreate("UTF-8")

    def start(tag: str, attributes: dict[str, str]) -> None:
        path.append(tag)
        if path == ["robot", "joint"]:
            found[attributes["name"]] = (_span(content, parser), None)
        elif path == ["robot", "joint", "origin"]:
            name, (joint, origin) = list(found.items())[-1]
            found[name] = (joint, origin or _span(content, parser))

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: path.pop()
    parser.Parse(content, True)
    return found


def _span(content: bytes, parser: XMLParserType) -> _Span:
    """Return where the current tag is: up to the first ``>`` outside of quotes."""
    start = parser.CurrentByteIndex
    tag = re.compile(rb"""(?:[^>"']|"[^"]*"|'[^']*')*>""").match(content, start)
    assert tag is not None  # noqa: S101 (the parser has read it)
    return start, tag.end()


def _edit(content: bytes, joint: _Span, origin: _Span | None, T: Array) -> tuple[int, int, bytes]:
    """Return the byte range to replace, and its new content, to give a joint another origin."""
    new = {"xyz": number_texts(T[:3, 3]), "rpy": number_texts(rotations.to_rpy(T[:3, :3]))}
    if origin is None:
        start, end = joint
        line = re.search(rb"\n[ \t]*$", content[:start])
        indent = (line.group() if line else b"") + b"  "
        return end, end, indent + f'<origin xyz="{new["xyz"]}" rpy="{new["rpy"]}"/>'.encode()
    start, end = origin
    text = content[start:end].decode()
    for name, value in new.items():
        text, count = re.subn(_ATTRIBUTE.format(name=name), rf'\g<1>"{value}"', text)
        if not count:
            text = re.sub(r"^<origin", f'<origin {name}="{value}"', text)
    return start, end, text.encode()


def number_texts(values: Array) -> str:
    """Format numbers with all their digits, separated by blanks, without -0."""
    return " ".join(repr(float(value) + 0.0) for value in values)
