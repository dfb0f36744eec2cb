"""Robots from URDF descriptions: joints and links, forward kinematics, and joints in ATOM's parameters.

URDF: a tree of links, each connected to its parent by a joint. Floating and planar joints, and those that follow a
joint that is not there, have no position here, and stay at their origin. A description is untrusted input: entities are
refused, the size is bounded.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, get_args
from xml.etree.ElementTree import Element, ParseError

import defusedxml.ElementTree
import numpy as np
from defusedxml.common import DefusedXmlException

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.base.records import between
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry import rotations
from calibration.engine.geometry.frames import JOINT_PARAMETERS, FrameTree, JointModel, JointParameter
from calibration.engine.geometry.transforms import from_xyz_rpy, inverse, transform, translation
from calibration.robot.robot_description import NO_INPUTS, XacroInputs, read_robot_description

ROBOT_FILE = "robot.urdf"
"""Name of the description beside a dataset."""

JointKind = Literal["fixed", "revolute", "continuous", "prismatic", "floating", "planar"]
JOINT_KINDS: tuple[JointKind, ...] = get_args(JointKind)
AXIS_KINDS: frozenset[JointKind] = frozenset(("revolute", "continuous", "prismatic"))
"""Kinds that move along or about one axis."""


@dataclass(frozen=True)
class Mimic:
    """Position of a joint that follows another one: ``multiplier * position + offset``."""

    joint: str
    """The followed joint, which follows none itself."""
    multiplier: float = 1.0
    offset: float = 0.0

    def positions(self, followed: Array) -> Array:
        """Return the positions (N,) from those of the followed joint (N,)."""
        return self.multiplier * np.asarray(followed, float) + self.offset


@dataclass(frozen=True, eq=False)
class Joint:
    """Joint between a link and its parent. Its frame is the child link's at position 0."""

    name: str
    kind: JointKind
    parent: str
    child: str
    T_parent_joint: Array
    """(4, 4): the origin."""
    axis: Array
    """(3,): unit vector in the joint's frame; unused for a fixed joint."""
    lower: float = -math.inf
    """Lower limit of the position, rad or m."""
    upper: float = math.inf
    mimic: Mimic | None = None
    """What it follows; None for a joint with a position of its own."""
    without_position: str = ""
    """Why its transform is not known from one position, as a predicate; empty if it is, or is fixed."""

    @property
    def edge(self) -> Edge:
        """(parent link, child link)."""
        return (self.parent, self.child)

    @property
    def is_movable(self) -> bool:
        """Whether the joint has a position, its own or that of a joint that it follows."""
        return self.kind in AXIS_KINDS and not self.without_position

    @property
    def driver(self) -> str:
        """Name of the joint whose position moves it: its own, or that of the joint that it follows."""
        return self.name if self.mimic is None else self.mimic.joint

    @property
    def twist(self) -> Array:
        """Twist (6,) of the child in its own frame per unit of the position."""
        zero = np.zeros(3)
        return np.concatenate([self.axis, zero] if self.kind == "prismatic" else [zero, self.axis])

    @property
    def rest(self) -> float:
        """Default position: 0, or the limit closest to it."""
        return min(max(0.0, self.lower), self.upper)

    @property
    def model(self) -> JointModel:
        """Kinematic model."""
        x, y, z = self.axis.tolist()
        return JointModel(self.kind == "prismatic", (x, y, z))

    def values(self, errors: Mapping[JointParameter, float] | None = None) -> Array:
        """Return all parameters (7,) in the order of `JOINT_PARAMETERS`: the description's plus the errors."""
        T = self.T_parent_joint
        values = np.concatenate([T[:3, 3], rotations.to_rpy(T[:3, :3]), [0.0]])
        for parameter, error in (errors or {}).items():
            values[JOINT_PARAMETERS.index(parameter)] += error
        return values

    def transform(self, positions: Array) -> Array:
        """Return ``T_parent_child`` (N, 4, 4) at each of the positions (N,)."""
        steps = np.asarray(positions, float)[..., None] * self.axis
        if self.kind == "prismatic":
            return self.T_parent_joint @ translation(steps)
        if self.is_movable:
            return self.T_parent_joint @ transform(rotations.exp(steps), np.zeros(3))
        return np.broadcast_to(self.T_parent_joint, (*steps.shape[:-1], 4, 4))


@dataclass(frozen=True, eq=False)
class Robot:
    """Tree of links and joints."""

    path: Path
    """File that it was read from."""
    name: str
    joints: tuple[Joint, ...]
    """Joints in the order of the file."""

    @cached_property
    def tree(self) -> FrameTree:
        """Tree of the links' frames."""
        return FrameTree(self.by_edge)

    @cached_property
    def by_edge(self) -> Mapping[Edge, Joint]:
        """The joints, by (parent link, child link)."""
        return {joint.edge: joint for joint in self.joints}

    @cached_property
    def movable(self) -> Mapping[str, Joint]:
        """The joints with a position of their own, by name."""
        return {joint.name: joint for joint in self.joints if joint.is_movable and joint.mimic is None}

    def transforms(self, joint_positions: Mapping[str, Array], count: int = 1) -> dict[Edge, Array]:
        """Forward kinematics: ``T_parent_child`` of every joint, (N, 4, 4), by (parent, child).

        Args:
            joint_positions: by joint name, (N,) each, rad or m. Other joints are at their default position.
            count: N if no joint is given.

        Raises:
            InputError: a joint is unknown or not movable, or a position is outside its limits.
        """
        for name, positions in joint_positions.items():
            self._check_position(name, np.asarray(positions, float))
        shape = np.broadcast_shapes(*(np.shape(p) for p in joint_positions.values())) if joint_positions else (count,)
        rest = {name: np.array(joint.rest) for name, joint in self.movable.items()}
        own = {name: np.broadcast_to(joint_positions.get(name, at), shape) for name, at in rest.items()}
        unmoved = np.zeros(shape)
        return {
            joint.edge: joint.transform(
                own.get(joint.name, unmoved) if joint.mimic is None else joint.mimic.positions(own[joint.mimic.joint])
            )
            for joint in self.joints
        }

    def _check_position(self, name: str, positions: Array) -> None:
        joint = self.movable.get(name)
        if joint is None:
            named = next((each for each in self.joints if each.name == name), None)
            problem = (
                "is not in the robot"
                if named is None
                else f"{named.without_position or 'is fixed'} and has no position"
            )
            problem = "follows another joint and has no position of its own" if named and named.mimic else problem
            known = ", ".join(self.movable) or "none"
            raise InputError(f"{self.path}: joint '{name}' {problem} (joints that move: {known})")
        outside = ~((positions >= joint.lower) & (positions <= joint.upper))  # also true for NaN
        if outside.any():
            pose = int(outside.argmax())
            raise InputError(
                f"{self.path}: joint '{name}' at {positions.flat[pose]:g} in pose {pose + 1} "
                f"is outside its limits {joint.lower:g} to {joint.upper:g}"
            )


def compose(tree: FrameTree, transforms: Mapping[Edge, Array], start: str, end: str) -> Array:
    """Return ``T_start_end`` (N, 4, 4) along the tree, from the transforms of its edges.

    Raises:
        InputError: a frame is not in the tree.
    """
    count = len(next(iter(transforms.values())))
    T = np.broadcast_to(np.eye(4), (count, 4, 4))
    for step in tree.path(start, end):
        edge = transforms[step.parent, step.child]
        T = T @ (inverse(edge) if step.inverted else edge)
    return T


def read_robot(path: Path, inputs: XacroInputs = NO_INPUTS) -> Robot:
    """Read a robot from a URDF file, or from a xacro.

    Raises:
        InputError: in one line, with file and joint: not XML, not URDF, a type that
            is not supported, a missing or unknown link, two parents, a loop, a bad number; a xacro that
            cannot be expanded.
        InfrastructureError: xacrodoc is needed and not installed.
    """
    return parse_robot(read_robot_description(path, inputs), path)


def parse_robot(urdf: bytes, path: Path) -> Robot:
    """Parse the content of a URDF file like `read_robot`."""
    try:
        root: Element = defusedxml.ElementTree.fromstring(urdf, forbid_dtd=True)
    except ParseError as error:
        raise InputError(f"{path}: is not XML: {error}") from None
    except DefusedXmlException:
        raise InputError(f"{path}: has a DTD or entities; a robot description needs none") from None
    except (ValueError, LookupError) as error:  # an encoding that does not exist or does not match
        raise InputError(f"{path}: is not XML: {error}") from None
    if root.tag != "robot":
        raise InputError(f"{path}: the root element is <{root.tag}>, not <robot>")
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise InputError(f"{path}: is a xacro; name it robot.urdf.xacro and it is expanded")
    return Robot(path, root.get("name", ""), _read_joints(root, path))


def _read_joints(root: Element, path: Path) -> tuple[Joint, ...]:
    links = {link.get("name") for link in root.findall("link")}
    joints: dict[str, Joint] = {}
    parents: dict[str, Joint] = {}
    for element in root.findall("joint"):
        name = element.get("name")
        if not name:
            raise InputError(f"{path}: a joint has no name")
        where = f"{path}: joint '{name}'"
        joint = _read_joint(element, name, where)
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise InputError(f"{where}: the {role} link '{link}' is not in the robot")
        if name in joints:
            raise InputError(f"{where}: two joints have this name")
        other = parents.setdefault(joint.child, joint)
        if other is not joint:
            raise InputError(
                f"{where}: link '{joint.child}' has two parents, '{other.parent}' by joint '{other.name}' "
                f"and '{joint.parent}'"
            )
        joints[name] = joint
    if not joints:
        raise InputError(f"{path}: there is no joint")
    try:
        FrameTree(joint.edge for joint in joints.values())
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    roots = sorted({joint.parent for joint in joints.values()} - parents.keys())
    if len(roots) > 1:
        raise InputError(f"{path}: the links are not one tree: {', '.join(map(repr, roots))} have no parent")
    return tuple(_with_followed(joint, joints, path) for joint in joints.values())


def _with_followed(joint: Joint, joints: Mapping[str, Joint], path: Path) -> Joint:
    """Return a joint whose mimic names the joint at the end of the chain that it follows.

    One that follows nothing that moves has no position: published hands have such fingers, which no calibration needs.
    """
    mimic, passed = joint.mimic, [joint.name]
    while mimic is not None:
        followed = joints.get(mimic.joint)
        if followed is None or not followed.is_movable:
            reason = f"follows '{mimic.joint}' by <mimic>, which is no joint that moves along or about one axis"
            return replace(joint, mimic=None, without_position=reason)
        if followed.name in passed:
            raise InputError(f"{path}: joint '{joint.name}': follows itself by <mimic>: {', '.join(passed)}")
        if followed.mimic is None:
            break
        passed.append(followed.name)
        multiplier, offset = followed.mimic.multiplier, followed.mimic.offset
        mimic = Mimic(followed.mimic.joint, mimic.multiplier * multiplier, mimic.multiplier * offset + mimic.offset)
    if mimic is not None and not (math.isfinite(mimic.multiplier) and math.isfinite(mimic.offset)):
        raise InputError(
            f"{path}: joint '{joint.name}': its multiplier or offset is infinite, along {', '.join(passed)}"
        )
    return replace(joint, mimic=mimic)


def _read_joint(element: Element, name: str, where: str) -> Joint:
    kind = element.get("type", "")
    if kind not in JOINT_KINDS:
        raise InputError(f"{where}: type '{kind}' is not supported (supported: {', '.join(JOINT_KINDS)})")
    parent, child = (_read_link(element, role, where) for role in ("parent", "child"))
    origin, axis = element.find("origin"), element.find("axis")
    xyz, rpy = (_finite_numbers(origin, key, (0.0, 0.0, 0.0), f"{where}: origin") for key in ("xyz", "rpy"))
    along = np.array(_finite_numbers(axis, "xyz", (1.0, 0.0, 0.0), f"{where}: axis"))
    length = float(np.linalg.norm(along))
    if kind in AXIS_KINDS and length < 1e-9:
        raise InputError(f"{where}: axis xyz has length 0")
    limits = _read_limits(element, kind, where)
    mimic = _read_mimic(element, where) if kind in AXIS_KINDS else None
    free = f"is {kind}" if kind in ("floating", "planar") else ""
    return Joint(name, kind, parent, child, from_xyz_rpy(xyz, rpy), along / max(length, 1e-9), *limits, mimic, free)


def _read_link(element: Element, role: str, where: str) -> str:
    found = element.find(role)
    if found is None or not (link := found.get("link", "")):
        raise InputError(f"{where}: has no {role} link")
    return link


def _read_mimic(element: Element, where: str) -> Mimic | None:
    mimic = element.find("mimic")
    if mimic is None:
        return None
    if not (followed := mimic.get("joint", "")):
        raise InputError(f"{where}: mimic has no joint")
    (multiplier,) = _finite_numbers(mimic, "multiplier", (1.0,), f"{where}: mimic")
    (offset,) = _finite_numbers(mimic, "offset", (0.0,), f"{where}: mimic")
    return Mimic(followed, multiplier, offset)


def _read_limits(element: Element, kind: str, where: str) -> tuple[float, float]:
    limit = element.find("limit")
    if limit is None or kind not in ("revolute", "prismatic"):
        return -math.inf, math.inf
    (lower,), (upper,) = (_finite_numbers(limit, key, (0.0,), f"{where}: limit") for key in ("lower", "upper"))
    if lower > upper:
        raise InputError(f"{where}: limit lower {lower:g} is above upper {upper:g}")
    return lower, upper


def _finite_numbers(element: Element | None, key: str, default: tuple[float, ...], where: str) -> tuple[float, ...]:
    """Return the finite numbers of an attribute, as many as in the default; the default if it is absent."""
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if len(values) != len(default) or not all(map(math.isfinite, values)):
        expected = "a finite number" if len(default) == 1 else f"{len(default)} finite numbers"
        raise InputError(f"{where}: {key} is '{text[:80]}', expected {expected}")
    return values


MAX_ERROR = 1.0
"""m and rad: limit of a parameter's error."""
JointErrors = Mapping[str, Mapping[JointParameter, Annotated[float, between(-MAX_ERROR, MAX_ERROR)]]]
"""Errors of joint parameters by the joint's name, to be added to the description's values, m and rad."""


def with_errors(robot: Robot, errors: JointErrors) -> Robot:
    """Return the robot with erroneous joints; the same object if there are no errors.

    The bias of a joint's position is added to its origin: both precede the motion by the position.
    """

    def moved(joint: Joint) -> Joint:
        own = errors.get(joint.name)
        return replace(joint, T_parent_joint=joint.model.pose(joint.values(own))) if own else joint

    return replace(robot, joints=tuple(moved(joint) for joint in robot.joints)) if any(errors.values()) else robot


def check_calibrated_joints(joints: Mapping[str, tuple[str, ...]], robot: Robot, where: str) -> None:
    """Check that the calibrated joints and parameters of a configuration exist in the robot.

    Raises:
        InputError: begins with ``where``; a joint is not movable, or a parameter is unknown or missing.
    """
    for name, parameters in joints.items():
        if name not in robot.movable:
            known = ", ".join(robot.movable) or "none"
            raise InputError(f"{where}/{name}: {robot.path} has no joint '{name}' that moves (there are: {known})")
        unknown = [parameter for parameter in parameters if parameter not in JOINT_PARAMETERS]
        if unknown or not parameters:
            found = f"found '{unknown[0]}'" if unknown else "found no parameter"
            raise InputError(
                f"{where}/{name}/params_to_calibrate: {found}, expected one or more of {', '.join(JOINT_PARAMETERS)}"
            )
