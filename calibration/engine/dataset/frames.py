"""Frames of a dataset: joints, velocities, and the check that they form a tree with every chain that is needed.

A time offset of a sensor is multiplied by velocities: ``collections/000/velocities/parent-child: {parent, child, twist:
[vx, vy, vz, wx, wy, wz]}``: the velocity of the child's frame in the parent's, along the child's own axes, m/s and
rad/s. A transform without one stands still then. Beside ``twist`` there may be ``acceleration`` and ``jerk``, 6 numbers
each, m/s^2 and m/s^3 ...: a time t later the transform is ``retract(T, twist t + acceleration t^2 / 2 + jerk t^3 /
6)``, by `calibration.engine.geometry.transforms`.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import read_links
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.model import Dataset, Edge, Joint
from calibration.engine.geometry.frames import JOINT_PARAMETERS, FrameTree, JointModel, JointParameter, Step
from calibration.engine.geometry.transforms import distance, inverse

_IS_PRISMATIC = {"revolute": False, "continuous": False, "prismatic": True}
MAX_JOINT_VALUE = 1e6
"""m or rad: limit of a joint's origin."""
_MAX_ORIGIN_DIFFERENCE = 1e-9
"""Tolerance (m, rad) of a joint's origin between collections."""


def read_joints(config: Node, collections: Sequence[Node]) -> dict[str, Joint]:
    """Parse the joints of a dataset's ``calibration_config/joints``, with their positions in each collection.

    The origin, the axis and the kind are those of the first collection, and the same in all.

    Raises:
        InputError: something in them is missing or wrong.
    """
    if not (asked := config.get("joints")):
        return {}
    there = collections[0]["joints"].mapping() if asked.mapping() else {}
    for name, node in asked.items():
        if name not in there:
            raise node.fault(
                f"collection {collections[0].keys[-1]} has no joint of this name "
                f"(there are: {', '.join(there) or 'none'})"
            )
    return {name: _read_joint(name, node, collections) for name, node in asked.items()}


def joint_values(joint: Joint) -> dict[str, float]:
    """Return the current parameters of a joint, by the names that they have in a document."""
    return dict(zip(JOINT_PARAMETERS, joint.values.tolist(), strict=True))


def joint_document(joint: Joint, read: Mapping[str, Any], i: int) -> dict[str, Any]:
    """Return the document entry of a joint in collection i, with its current parameters."""
    values = joint_values(joint)
    bias = values.pop("position_bias")
    document = {**read, **values, "position": float(joint.positions[i])}
    return {**document, "position_bias": bias} if bias or "position_bias" in read else document


def _read_joint(name: str, asked: Node, collections: Sequence[Node]) -> Joint:
    entries = [collection["joints"][name] for collection in collections]
    model, edge, values = _read_model(entries[0]), read_links(entries[0]), _read_values(entries[0])
    for entry in entries[1:]:
        if (
            read_links(entry) != edge
            or _read_model(entry) != model
            or np.abs(_read_values(entry) - values).max() > _MAX_ORIGIN_DIFFERENCE
        ):
            raise entry.fault(
                f"differs from collection {collections[0].keys[-1]}; only the position of a joint changes"
            )
    return Joint(
        name=name,
        edge=edge,
        model=model,
        parameters=_calibrated_parameters(asked),
        values=values,
        positions=np.array([entry["position"].within(-MAX_JOINT_VALUE, MAX_JOINT_VALUE) for entry in entries]),
    )


def _calibrated_parameters(asked: Node) -> tuple[JointParameter, ...]:
    chosen = {element.name(): element for element in asked["params_to_calibrate"].elements()}
    for name, element in chosen.items():
        if name not in JOINT_PARAMETERS:
            raise element.unexpected(f"one of {', '.join(JOINT_PARAMETERS)}")
    if not chosen:
        raise asked["params_to_calibrate"].unexpected("at least one parameter")
    return tuple(parameter for parameter in JOINT_PARAMETERS if parameter in chosen)


def _read_model(entry: Node) -> JointModel:
    kind = entry["joint_type"]
    if kind.text() not in _IS_PRISMATIC:
        raise kind.unexpected("a joint that moves: " + " or ".join(_IS_PRISMATIC))
    axis = np.array([entry[f"axis_{c}"].number() for c in "xyz"])
    length = float(np.linalg.norm(axis))
    if not 1e-6 < length < 1e6:
        raise entry["axis_x"].fault(f"found the axis ({axis[0]:g}, {axis[1]:g}, {axis[2]:g}), expected a direction")
    x, y, z = (axis / length).tolist()
    return JointModel(_IS_PRISMATIC[kind.value], (x, y, z))


def _read_values(entry: Node) -> Array:
    bias = entry.get("position_bias")
    origin = [entry[parameter].within(-MAX_JOINT_VALUE, MAX_JOINT_VALUE) for parameter in JOINT_PARAMETERS[:6]]
    return np.array([*origin, bias.within(-MAX_JOINT_VALUE, MAX_JOINT_VALUE) if bias else 0.0])


VELOCITIES_KEY = "velocities"
MAX_VELOCITY = 1e3
"""m/s and rad/s: limit of a velocity."""


ACCELERATION_KEYS = ("acceleration", "jerk")
FASTEST_CHANGE = 1e6
"""m/s^2, rad/s^2, m/s^3 and rad/s^3: limit of an acceleration and of a jerk."""


def read_velocities(collections: Sequence[Node]) -> tuple[dict[Edge, Array], dict[Edge, Array]]:
    """Parse the velocities (N, 6) of N collections, of each edge that has one, and (N, 2, 6) accelerations and jerks.

    Raises:
        InputError: something in them is missing or wrong.
    """
    velocities: dict[Edge, Array] = {}
    accelerations: dict[Edge, Array] = {}
    for number, collection in enumerate(collections):
        node = collection.get(VELOCITIES_KEY)
        for key, entry in node.items() if node else ():
            edge = (entry["parent"].name(), entry["child"].name())
            if key != "-".join(edge):
                raise entry.fault(f"found parent '{edge[0]}' and child '{edge[1]}', expected those of the key")
            own = _six_numbers(entry["twist"], MAX_VELOCITY, "m/s and rad/s")
            velocities.setdefault(edge, np.zeros((len(collections), 6)))[number] = own
            for order, name in enumerate(ACCELERATION_KEYS):
                if change := entry.get(name):
                    own = _six_numbers(change, FASTEST_CHANGE, "in m, rad and s,")
                    accelerations.setdefault(edge, np.zeros((len(collections), 2, 6)))[number, order] = own
    for each in (*velocities.values(), *accelerations.values()):
        each.flags.writeable = False
    return velocities, accelerations


def _six_numbers(node: Node, limit: float, units: str) -> list[float]:
    numbers = [each.within(-limit, limit) for each in node.elements()]
    if len(numbers) != 6:
        raise node.unexpected(f"6 numbers: {units} in the child's frame")
    return numbers


def velocity_documents(motions: Mapping[Edge, Array], number: int) -> dict[str, Any]:
    """Return the entries of one collection, by its number, of velocities, accelerations and jerks (N, 3, 6)."""
    return {
        "-".join(edge): {
            "parent": edge[0],
            "child": edge[1],
            **dict(zip(("twist", *ACCELERATION_KEYS), motion[number].tolist(), strict=True)),
        }
        for edge, motion in motions.items()
        if motion[number].any()
    }


MOTION_TOLERANCE = 0.2
"""m or rad: tolerance between the motion of a joint's position and that of its transform. They are recorded one after
the other, and the robot may still be moving.
"""


def check_frames(dataset: Dataset, root: Node, collections: Sequence[Node]) -> None:
    """Check the tree, the frames of sensors, patterns and additional transforms, and the chains between them.

    Raises:
        InputError: the first fault.
    """
    _check_tree(dataset, collections)
    config = root["calibration_config"]
    world = config["world_link"]
    _check_is_known(dataset.tree, world)
    needed = {
        **_sensor_chains(dataset, root["sensors"], world),
        **_pattern_chains(dataset, config, world),
        **_additional_edges(dataset, config),
        **_joint_edges(dataset, config),
    }
    _check_motions(dataset, collections)
    for (parent, child), reason in needed.items():
        missing = np.isnan(dataset.transforms[parent, child][:, 0, 0])
        if missing.any():
            transforms = collections[int(missing.argmax())]["transforms"]
            raise transforms.fault(f"missing key '{parent}-{child}', which {reason} needs")


def _check_tree(dataset: Dataset, collections: Sequence[Node]) -> None:
    """Build the tree; on failure report the first transform that cannot be part of it."""
    try:
        _ = dataset.tree
    except InputError:
        edges = list(dataset.transforms)
        low, high = 0, len(edges) - 1
        while low < high:  # bisection for the smallest number of edges that are not a tree
            middle = (low + high) // 2
            low, high = (low, middle) if _why_no_tree(edges[: middle + 1]) else (middle + 1, high)
        parent, child = edges[high]
        present = ~np.isnan(dataset.transforms[parent, child][:, 0, 0])
        transforms = collections[int(present.argmax())]["transforms"]
        raise transforms[f"{parent}-{child}"].fault(_why_no_tree(edges[: high + 1])) from None


def _why_no_tree(edges: Iterable[Edge]) -> str:
    """Return the reason why edges are not a tree; empty if they are."""
    try:
        FrameTree(edges)
    except InputError as error:
        return str(error)
    return ""


def _sensor_chains(dataset: Dataset, sensors: Node, world: Node) -> dict[Edge, str]:
    """Return the edges from the world to every sensor, each with the sensor that needs it."""
    needed = {}
    for name, sensor in dataset.sensors.items():
        for key in ("calibration_parent", "calibration_child"):
            _check_is_known(dataset.tree, sensors[name][key])
        steps = _path_between(dataset.tree, world, sensors[name]["parent"])
        edges = [(step.parent, step.child) for step in steps]
        if sensor.edge not in edges:
            way = ", ".join("-".join(edge) for edge in edges)
            raise sensors[name]["calibration_child"].fault(
                f"the transform to calibrate, '{'-'.join(sensor.edge)}', "
                f"is not on the way from the world to frame '{sensor.frame}' ({way})"
            )
        needed.update(dict.fromkeys(edges, f"sensor '{name}'"))
    return needed


def _pattern_chains(dataset: Dataset, config: Node, world: Node) -> dict[Edge, str]:
    """Return the edges from the world to every pattern's parent, each with the pattern that needs it."""
    needed: dict[Edge, str] = {}
    edges = list(dataset.transforms)
    links: set[str] = set()
    for name, pattern in dataset.patterns.items():
        several = config.get("calibration_patterns")
        node = several[name] if several else config["calibration_pattern"]
        steps = _path_between(dataset.tree, world, node["parent_link"])
        needed.update(dict.fromkeys(((step.parent, step.child) for step in steps), f"pattern '{name}'"))
        if pattern.link in links:
            raise node["link"].unexpected("a frame that no other pattern has")
        if reason := _why_no_tree([*edges, pattern.edge]):
            raise node["link"].fault(f"a pattern cannot be here: {reason}")
        links.add(pattern.link)
    return needed


def _additional_edges(dataset: Dataset, config: Node) -> dict[Edge, str]:
    """Return the additional transforms to calibrate, each with the entry that needs it."""
    if not (node := config.get("additional_tfs")):
        return {}
    for name, edge in zip(node.mapping(), dataset.additional_transforms, strict=True):
        if edge not in dataset.transforms:
            raise node[name].fault(f"'{'-'.join(edge)}' is none of the collections' transforms")
    return dict.fromkeys(dataset.additional_transforms, "additional_tfs")


def _joint_edges(dataset: Dataset, config: Node) -> dict[Edge, str]:
    """Return the edges of the joints to calibrate, each with the joint that needs it."""
    taken = {sensor.edge: f"sensor '{sensor.name}'" for sensor in dataset.sensors.values()}
    taken |= dict.fromkeys(dataset.additional_transforms, "additional_tfs")
    needed: dict[Edge, str] = {}
    for name, joint in dataset.joints.items():
        node, key = config["joints"][name], "-".join(joint.edge)
        if joint.edge not in dataset.transforms:
            raise node.fault(f"its transform, '{key}', is none of the collections' transforms")
        if other := {**taken, **needed}.get(joint.edge):
            raise node.fault(f"its transform, '{key}', is calibrated by {other} already")
        needed[joint.edge] = f"joint '{name}'"
    return needed


def _check_motions(dataset: Dataset, collections: Sequence[Node]) -> None:
    """Refuse joint positions that contradict the transforms: in degrees, of another joint, or not updated.

    The motions since the first collection are compared, which do not depend on the joint's origin and bias.
    """
    for name, joint in dataset.joints.items():
        T = dataset.transforms[joint.edge]
        moved, since = inverse(T[0]) @ T, joint.positions - joint.positions[0]
        off = _difference_from_joint(moved, joint, since)
        if (off > MOTION_TOLERANCE).any():
            i = int(np.nanargmax(off))
            unit, other, scale = (
                ("m", "millimetres", 1e-3) if joint.model.prismatic else ("rad", "degrees", np.pi / 180)
            )
            looks = (
                f", not in {other} as these look"
                if np.nanmax(_difference_from_joint(moved, joint, scale * since)) < MOTION_TOLERANCE
                else ""
            )
            raise collections[i]["joints"][name]["position"].fault(
                f"found {joint.positions[i]:g}, which is {since[i]:.3g} more than in collection "
                f"{collections[0].keys[-1]}, but '{'-'.join(joint.edge)}' has moved otherwise; expected the position "
                f"in {unit} that this transform has{looks}"
            )


def _difference_from_joint(moved: Array, joint: Joint, since: Array) -> Array:
    """Difference (N,) of a joint's motions (N, 4, 4) from those by the changes of its position (N,), m or rad."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.max(distance(moved, joint.model.motion(since)), axis=0))


def _check_is_known(tree: FrameTree, node: Node) -> None:
    if node.value not in tree:
        frames = ", ".join(tree.frames[:30])
        raise node.fault(f"frame '{node.value}' is not in the tree of the collections' transforms (frames: {frames})")


def _path_between(tree: FrameTree, start: Node, end: Node) -> tuple[Step, ...]:
    _check_is_known(tree, end)
    try:
        return tree.path(start.value, end.value)
    except InputError as error:
        raise end.fault(str(error)) from None
