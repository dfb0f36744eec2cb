"""What could move together without changing any label, and so has to be held somewhere.

Cut the tree of frames at the unknown transforms, and it falls into bodies. One that holds neither a
sensor's frame nor a pattern is never seen itself: with its unknown edges it can be anywhere. Only
what moves inside it, an arm between two of its unknown edges, tells it; an edge that each collection
has its own of makes up for any motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.dataset.model import Dataset, Edge
from calibration.errors import UndeterminedError
from calibration.estimation.blocks import Block
from calibration.estimation.views import ViewGroup
from calibration.geometry.types import BoolArray

RIGID = 1e-9
"""Transforms that differ by less (m, and elements of rotations) are the same in all collections."""


@dataclass(frozen=True)
class Gauge:
    """What is held because the data determine only relative poses."""

    sensor: str | None = None
    """Its calibrated transform stays at its guess."""
    patterns: tuple[str, ...] = ()
    """Fixed patterns that stay where their first views put them by the guess."""


def free_gauge(dataset: Dataset, groups: Sequence[ViewGroup], blocks: Sequence[Block]) -> Gauge:
    """What to hold.

    A free body is held by a sensor, or by a fixed pattern where no sensor is fixed to it: only the
    choice of an origin. It is not where an additional transform that is the same in all collections
    stands at it: then that one and its neighbour make up for each other, which the data cannot tell and
    `calibration.estimation.observability` will say; unless the motion of that body is unknown in each
    collection, as of a mobile base.

    Raises:
        UndeterminedError: sensors are not linked to each other, or two transforms that each collection has
            its own of make up for each other.
    """
    parts = _linked(dataset, groups, blocks)
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
            gauge = _held(dataset, gauge, attached)
    return gauge


def _held(dataset: Dataset, gauge: Gauge, attached: Sequence[Block]) -> Gauge:
    """The gauge with one more body held, by one of the blocks attached to it."""
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


def _linked(dataset: Dataset, groups: Sequence[ViewGroup], blocks: Sequence[Block]) -> list[list[str]]:
    """The sensors, in groups that are linked, in the dataset's order.

    Two sensors are linked where they see the same pattern: a fixed one ever, a moving one in the same
    collection; or where the same unknown motion carries both in the same collection.
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
    """The bodies that these sensors' views leave anywhere: of each, the blocks attached to it."""
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
        if body not in seen and not any(block.held for block, _ in ends) and _rigid(dataset, constant):
            free.append([block for block, _ in ends])
    return free


def _rigid(dataset: Dataset, frames: Sequence[str]) -> bool:
    """Whether frames of one body keep their places to each other."""
    relative = [dataset.transform(frames[0], frame) for frame in dict.fromkeys(frames[1:])]
    return all(np.abs(T - T[0]).max() < RIGID for T in relative)


class _Bodies:
    """The frames of a dataset, put together along all edges but some."""

    def __init__(self, dataset: Dataset, cut: Sequence[Edge]) -> None:
        self._body: dict[str, str] = {}
        for parent, child in dataset.transforms:
            if (parent, child) not in cut:
                self._body[self.of(child)] = self.of(parent)

    def of(self, frame: str) -> str:
        """A name for the body of a frame."""
        while (parent := self._body.get(frame, frame)) != frame:
            frame = parent
        return frame
