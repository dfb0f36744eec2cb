"""Unknowns that are fixed: by the user, or because a common motion of them changes no label (gauge freedom).

Cut the tree of frames at the unknown transforms, and it falls into bodies. A body with neither a
sensor's frame nor a pattern is never observed itself: its unknown edges may have any common motion. Only
motion inside the body, such as of an arm between two of its unknown edges, determines it; an edge that is
free per collection is degenerate with any such motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import BoolArray
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.estimation.problem.blocks import Block, Pose
from calibration.engine.estimation.residuals.views import ViewGroup


def held_blocks(dataset: Dataset, blocks: Sequence[Block], hold: Sequence[str]) -> tuple[Block, ...]:
    """Return the blocks, with those named in ``hold`` fixed.

    A name is that of a sensor, of a transform ("parent-child"), of a pattern, of a joint
    ("joint-elbow") or of one of its parameters ("joint-elbow-origin_yaw"); of the intrinsics of a camera
    ("intrinsics-left") or of one of them ("intrinsics-left-k3").

    Raises:
        InputError: a name is unknown, or a fixed pattern has no pose in the dataset.
    """
    out = list(blocks)
    names = [_names_of_block(dataset, block) for block in blocks]
    for name in hold:
        found = [i for i in range(len(blocks)) if name in names[i]]
        for i in found:
            out[i] = _fix_block(out[i], name)
            _refuse_pattern_without_pose(dataset, blocks[i])
        if not found:
            known = [each for of_block in names for each in of_block]
            raise InputError(
                f"{dataset.path}: nothing to hold is called '{name}' (there are {', '.join(dict.fromkeys(known))})"
            )
    return tuple(out)


def _names_of_block(dataset: Dataset, block: Block) -> list[str]:
    """Return the names of a block."""
    names = [block.name, "-".join(block.edge)] if block.edge else [block.name]
    names += [sensor.name for sensor in dataset.sensors.values() if sensor.edge == block.edge]
    return names + [f"{block.name}-{parameter}" for parameter in block.parameters.free]


def _fix_block(block: Block, name: str) -> Block:
    """Fix a block; or only the named parameter of a joint or a camera."""
    parameter = name.removeprefix(f"{block.name}-")
    if isinstance(block.parameters, Pose) or parameter not in block.parameters.free:
        return replace(block, held=True)
    rest = block.parameters.without(parameter)
    return replace(block, parameters=rest, held=block.held or not rest.free)


def _refuse_pattern_without_pose(dataset: Dataset, block: Block) -> None:
    """Refuse to fix a pattern without a pose."""
    if block.name in dataset.patterns and block.edge:
        poses = dataset.transforms.get(block.edge)
        for i, collection in enumerate(dataset.collections):
            seen = any(pattern == block.name for pattern, _ in collection.labels)
            if seen and (poses is None or np.isnan(poses[i]).any()):
                key = "-".join(block.edge)
                raise InputError(
                    f"{dataset.path}: collections/{collection.key}/transforms: no '{key}', so pattern "
                    f"'{block.name}' cannot be held there"
                )


RIGID_TOLERANCE = 1e-9
"""Tolerance (m, and elements of rotations) of transforms that are the same in all collections."""


@dataclass(frozen=True)
class Gauge:
    """Fixed transforms, if the data determine only relative poses."""

    sensor: str | None = None
    """Its calibrated transform is fixed at its initial guess."""
    patterns: tuple[str, ...] = ()
    """Fixed patterns that are held constant at the pose of their first views by the guess."""


def free_gauge(dataset: Dataset, groups: Sequence[ViewGroup], blocks: Sequence[Block]) -> Gauge:
    """Return the transforms to fix.

    A free body is fixed by a sensor, or by a fixed pattern if no sensor is rigidly attached to it: this only
    chooses an origin. It is not fixed if it has an additional transform that is the same in all collections:
    that one and its neighbour are degenerate with each other, which the data cannot resolve and
    `calibration.engine.estimation.least_squares.observability` reports; unless the motion of that body is unknown in
    each collection, as of a mobile base.

    Raises:
        UndeterminedError: sensors are not connected by common views, or two transforms that are free per collection
            are degenerate with each other.
    """
    parts = _connected_sensors(dataset, groups, blocks)
    free = [bodies for part in parts if (bodies := _free_bodies(dataset, part, groups, blocks))]
    if free and len(parts) > 1:
        listed = " and ".join("{" + ", ".join(part) + "}" for part in parts)
        raise UndeterminedError(
            f"{dataset.path}: the sensors {listed} share no collection of a pattern, so their relative pose is not "
            f"determined; add collections in which they see the pattern together"
        )
    gauge = Gauge()
    for attached in (body for bodies in free for body in bodies):
        additional = any(block.edge in dataset.additional_transforms for block in attached)
        if not additional or any(block.per_collection for block in attached):
            gauge = _with_body_fixed(dataset, gauge, attached)
    return gauge


def with_gauge_fixed(
    dataset: Dataset, groups: Sequence[ViewGroup], blocks: Sequence[Block]
) -> tuple[Gauge, tuple[Block, ...]]:
    """Return what fixes a free gauge, and the blocks with that held; errors as `free_gauge`."""
    gauge = free_gauge(dataset, groups, blocks)
    fixing = [dataset.patterns[name].edge for name in gauge.patterns]
    fixing += [dataset.sensors[gauge.sensor].edge] if gauge.sensor else []
    return gauge, tuple(replace(block, held=block.held or block.edge in fixing) for block in blocks)


def _with_body_fixed(dataset: Dataset, gauge: Gauge, attached: Sequence[Block]) -> Gauge:
    """Return the gauge with one more body fixed, by one of the blocks attached to it."""
    constant = [block.edge for block in attached if not block.per_collection]
    for sensor in dataset.sensors.values():
        if gauge.sensor is None and sensor.edge in constant:
            return Gauge(sensor.name, gauge.patterns)
    for pattern in dataset.patterns.values():
        if pattern.edge in constant:
            return Gauge(gauge.sensor, (*gauge.patterns, pattern.name))
    names = " and ".join(f"'{block.name}'" for block in attached)
    raise UndeterminedError(
        f"{dataset.path}: {names} make up for each other, so no label tells them; hold one of them or leave it out"
    )


def _connected_sensors(dataset: Dataset, groups: Sequence[ViewGroup], blocks: Sequence[Block]) -> list[list[str]]:
    """Return groups of connected sensors, in the dataset's order.

    Two sensors are connected if they see the same pattern, at any time for a fixed one, in the same
    collection for a moving one; or if the same unknown motion carries both in the same collection.
    """
    N = len(dataset.collections)
    witnesses: dict[str, dict[str, BoolArray]] = {}
    for group in groups:
        fixed = dataset.patterns[group.pattern].fixed
        own = witnesses.setdefault(group.sensor, {})
        moving = {blocks[link.block].name for link in group.chain.links if blocks[link.block].per_collection}
        for name in moving | {group.pattern}:
            seen = own.setdefault(name, np.zeros(N, bool))
            seen[slice(None) if name == group.pattern and fixed else group.collections] = True
    parts: list[tuple[list[str], dict[str, BoolArray]]] = []
    for sensor in (s for s in dataset.sensors if s in witnesses):
        names, of_part = [sensor], witnesses[sensor]
        for part in [p for p in parts if any((p[1][name] & of_part[name]).any() for name in p[1].keys() & of_part)]:
            parts.remove(part)
            names = part[0] + names
            both = {name: np.zeros(N, bool) for name in part[1].keys() | of_part}
            of_part = {name: part[1].get(name, none) | of_part.get(name, none) for name, none in both.items()}
        parts.append((names, of_part))
    return [sorted(names, key=list(dataset.sensors).index) for names, _ in parts]


def _free_bodies(
    dataset: Dataset, sensors: Sequence[str], groups: Sequence[ViewGroup], blocks: Sequence[Block]
) -> list[list[Block]]:
    """Return the bodies whose pose these sensors' views do not determine: of each, the blocks attached to it."""
    views = [group for group in groups if group.sensor in sensors]
    used = [blocks[i] for i in sorted({link.block for group in views for link in group.chain.links})]
    bodies = _Bodies(dataset, [block.edge for block in blocks if block.edge and not block.joint])
    seen = {bodies.of(dataset.sensors[group.sensor].frame) for group in views}
    seen |= {bodies.of(dataset.patterns[group.pattern].link) for group in views}
    attached: dict[str, list[tuple[Block, str]]] = {}
    for block in used:
        for frame in () if block.joint else block.edge or ():
            attached.setdefault(bodies.of(frame), []).append((block, frame))
    free = []
    for body, ends in attached.items():
        constant = [frame for block, frame in ends if not block.per_collection]
        if body not in seen and not any(block.held for block, _ in ends) and _are_rigid(dataset, constant):
            free.append([block for block, _ in ends])
    return free


def _are_rigid(dataset: Dataset, frames: Sequence[str]) -> bool:
    """Whether the frames of one body are rigidly connected."""
    relative = [dataset.transform(frames[0], frame) for frame in dict.fromkeys(frames[1:])]
    return all(np.abs(T - T[0]).max() < RIGID_TOLERANCE for T in relative)


class _Bodies:
    """Bodies: the frames of a dataset, connected along all edges but some."""

    def __init__(self, dataset: Dataset, cut: Sequence[Edge]) -> None:
        self._body: dict[str, str] = {}
        for parent, child in dataset.transforms:
            if (parent, child) not in cut:
                self._body[self.of(child)] = self.of(parent)

    def of(self, frame: str) -> str:
        """Return the identifier of a frame's body."""
        while (parent := self._body.get(frame, frame)) != frame:
            frame = parent
        return frame
