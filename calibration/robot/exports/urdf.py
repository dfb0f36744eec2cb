"""Write calibrated origins into an existing URDF; all other bytes are unchanged.

A calibrated transform is a joint of the URDF, or a chain of fixed joints, of which the last one is changed.
The file is parsed for the byte positions of its tags, and only the ``xyz`` and ``rpy`` of these joints are rewritten.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.parsers.expat import ExpatError, ParserCreate, XMLParserType
from xml.sax.saxutils import escape

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse

_ATTRIBUTE = r"""(\s{name}\s*=\s*)("[^"]*"|'[^']*')"""


@dataclass
class _Joint:
    """Joint of a URDF, with its byte positions in the file."""

    name: str
    fixed: bool
    start: tuple[int, int]
    """First and last byte of the joint's tag."""
    parent: str = ""
    child: str = ""
    origin: tuple[int, int] | None = None
    """First and last byte of the tag of its origin."""
    xyz: str = "0 0 0"
    rpy: str = "0 0 0"

    @property
    def pose(self) -> Array:
        """``T_parent_child`` (4, 4) at position 0."""
        T = np.eye(4)
        T[:3, :3] = rotations.from_rpy(_numbers(self.rpy, self.name))
        T[:3, 3] = _numbers(self.xyz, self.name)
        return T


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
        InputError: it is not a URDF, or is a xacro, two joints have the same child, or it lacks the frames of a
            transform or a joint to change.
    """
    joints = {joint.child: joint for joint in _joints(content, where)}
    origins: dict[str, Array] = {}
    notes = []
    for (parent, child), T in transforms.items():
        path = _path(joints, parent, child, where)
        if len(path) == 1:
            origins[child] = T
            continue
        taking = next((each for each in reversed(path) if each.fixed), None)
        if taking is None or not all(each.fixed for each in path):
            raise InputError(
                f"{where}: the joints from '{parent}' to '{child}' are not all fixed, so none of them can take the "
                f"calibrated transform"
            )
        at = path.index(taking)
        poses = [origins.get(each.child, each.pose) for each in path]
        before, after = (_product(poses[:at]), _product(poses[at + 1 :]))
        origins[taking.child] = inverse(before) @ T @ inverse(after)
        notes.append(f"'{parent}' to '{child}' spans {len(path)} joints; '{taking.name}' takes the change")
    edits = sorted((_edit(content, joints[child], T) for child, T in origins.items()), reverse=True)
    for start, end, text in edits:
        content = content[:start] + text + content[end:]
    return CalibratedUrdf(content, notes)


def _joints(content: bytes, where: str) -> list[_Joint]:
    """Return the robot's joints with the positions of their tags; those of transmissions and plugins are skipped."""
    found: list[_Joint] = []
    path: list[str] = []
    parser = ParserCreate("UTF-8")

    def start(tag: str, attributes: dict[str, str]) -> None:
        path.append(tag)
        # The namespace alone is no sign of a xacro: xacro leaves it in what it has expanded.
        if tag.startswith("xacro:"):
            raise InputError(
                f"{where}: found <{tag[:80]}>, a URDF was expected: name the file robot.urdf.xacro and it is expanded"
            )
        if path[0] != "robot":
            raise InputError(f"{where}: found <{path[0]}>, <robot> was expected")
        if path == ["robot", "joint"]:
            span = _span(content, parser)
            found.append(_Joint(attributes.get("name", ""), attributes.get("type") == "fixed", span))
        elif path[:2] == ["robot", "joint"] and len(path) == 3:
            joint = found[-1]
            if tag in ("parent", "child"):
                setattr(joint, tag, attributes.get("link", ""))
            elif tag == "origin":
                joint.origin = _span(content, parser)
                joint.xyz, joint.rpy = attributes.get("xyz", joint.xyz), attributes.get("rpy", joint.rpy)

    def doctype(*_: object) -> None:
        raise InputError(f"{where}: found a document type declaration; it is not allowed in a URDF")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: path.pop()
    parser.StartDoctypeDeclHandler = doctype
    try:
        content.decode()
        parser.Parse(content, True)
    except (ExpatError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"{where}: a URDF in UTF-8 was expected: {error}") from None
    twice = next((a for i, a in enumerate(found) if any(a.child == b.child for b in found[:i])), None)
    if twice:
        raise InputError(f"{where}: found two joints with the child '{twice.child}', expected one")
    return found


def _span(content: bytes, parser: XMLParserType) -> tuple[int, int]:
    """Return the first byte of the current tag, and the byte after its last."""
    start = at = parser.CurrentByteIndex
    quote = b""
    while True:
        byte = content[at : at + 1]
        if not quote and byte == b">":
            return start, at + 1
        if quote:
            quote = b"" if byte == quote else quote
        elif byte in (b'"', b"'"):
            quote = byte
        at += 1


def _path(joints: Mapping[str, _Joint], parent: str, child: str, where: str) -> list[_Joint]:
    """Return the joints from a link to one of its descendants."""
    path: list[_Joint] = []
    at = child
    while at != parent:
        joint = joints.get(at)
        if joint is None or joint in path:
            raise InputError(f"{where}: no chain of joints from '{parent}' to '{child}'; are these the robot's links?")
        path.append(joint)
        at = joint.parent
    return path[::-1]


def _product(poses: list[Array]) -> Array:
    T = np.eye(4)
    for pose in poses:
        T = T @ pose
    return T


def _edit(content: bytes, joint: _Joint, T: Array) -> tuple[int, int, bytes]:
    """Return the byte range to replace, and its new content, to give a joint another origin."""
    new = {"xyz": number_texts(T[:3, 3]), "rpy": number_texts(rotations.to_rpy(T[:3, :3]))}
    if joint.origin is None:
        start, end = joint.start
        tag = content[start:end]
        line = re.search(rb"\n[ \t]*$", content[:start])
        indent = (line.group() if line else b"") + b"  "
        return start, end, tag + indent + f'<origin xyz="{new["xyz"]}" rpy="{new["rpy"]}"/>'.encode()
    start, end = joint.origin
    text = content[start:end].decode()
    for name, value in new.items():
        text, count = re.subn(_ATTRIBUTE.format(name=name), rf'\g<1>"{value}"', text)
        if not count:
            text = re.sub(r"^<origin", f'<origin {name}="{value}"', text)
    return start, end, text.encode()


def number_texts(values: Array) -> str:
    """Format numbers with all their digits, separated by blanks, without -0."""
    return " ".join(escape(repr(float(value) + 0.0)) for value in values)


def _numbers(text: str, joint: str) -> Array:
    try:
        values = np.array([float(each) for each in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputError(f"joint '{joint}': found an origin {text!r}, three numbers were expected")
    return values
