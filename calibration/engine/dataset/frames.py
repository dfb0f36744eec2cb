"""Checks of a dataset's frames: they form a tree that has every chain needed for a calibration."""

from collections.abc import Iterable, Sequence

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.model import Dataset, Edge, Joint
from calibration.engine.geometry.frames import FrameTree, Step
from calibration.engine.geometry.transforms import distance, inverse

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
        if reason := _why_no_tree([*edges, (pattern.parent_link, pattern.link)]):
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
        off: Array = np.max(distance(moved, joint.model.motion(since)), axis=0)
    return off


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
