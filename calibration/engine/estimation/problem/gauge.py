"""Gauge freedom: common motions of the unknowns that change no label, which are removed by fixing a transform.

Cut the tree of frames at the unknown transforms, and it falls into bodies. A body with neither a
sensor's frame nor a pattern is never observed itself: its unknown edges may have any common motion. Only
motion inside the body, such as of an arm between two of its unknown edges, determines it; an edge that is
free per collection is degenerate with any such motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import BoolArray
from calibration.base.errors import UndeterminedError
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.estimation.problem.blocks import Block
from calibration.engine.estimation.residuals.views import ViewGroup

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
    `calibration.engine.estimation.solve.observability` reports; unless the motion of that body is unknown in each
    collection, as of a mobile base.

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


def _with_body_fixed(dataset: Dataset, gauge: Gauge, attached: Sequence[Block]) -> Gauge:
    """Return the gauge with one more body fixed, by one of the blocks attached to it."""
    constant = [block.edge for block in attached if not block.per_collection]
    for sensor in dataset.sensors.values():
        if gauge.sensor is None and sensor.edge in constant:
            return Gauge(sensor.name, gauge.patterns)
    for pattern in dataset.patterns.values():
        if (pattern.parent_link, pattern.link) in constant:
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
