"""A dataset as a least-squares problem: which transforms are unknown, and how the labels depend on them."""

from dataclasses import dataclass

import numpy as np

from calibration.dataset.model import CornerLabels, Dataset, Edge, Labels, PointLabels, Sensor
from calibration.dataset.pattern import Pattern
from calibration.errors import InputError, UndeterminedError
from calibration.estimation.depth_border import depth_border_rays
from calibration.estimation.problem import Block, Chain, Link, NoiseKind, Problem, Term, ViewGroup
from calibration.estimation.residuals import BorderTerm, RangeTerm
from calibration.estimation.scan import border_rays
from calibration.estimation.single_views import corner_term
from calibration.estimation.usable_labels import usable_labels
from calibration.geometry.types import Array, BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Setup:
    """A problem and what its blocks are in the dataset."""

    dataset: Dataset
    """Only the collections that count."""
    problem: Problem
    edges: tuple[Edge, ...]
    """The edge of each block: those of sensors and additional transforms first, then the patterns."""
    gauge: str | None
    """The sensor that is held because nothing else fixes the world; None where something does."""
    ignored: tuple[str, ...]
    """Views that do not count, and why."""

    def block(self, edge: Edge) -> int:
        """The block of an edge."""
        return self.edges.index(edge)

    def pattern_edge(self, pattern: str) -> Edge:
        """The edge of a pattern: its parent to its link."""
        p = self.dataset.patterns[pattern]
        return (p.parent_link, p.link)


def build(dataset: Dataset) -> Setup:
    """State the problem of a dataset.

    Raises:
        InputError: no labels count, or a sensor has none.
        UndeterminedError: sensors are not linked to each other, nothing is left to calibrate, or no label
            depends on a transform.
    """
    dataset, ignored = usable_labels(dataset)
    blocks, edges = _blocks(dataset)
    groups = tuple(_groups(dataset, edges))
    gauge = _free_gauge(dataset, groups)
    if gauge is not None:
        held = edges.index(dataset.sensors[gauge].edge)
        blocks = tuple(Block(b.name, b.per_collection, b.held or i == held) for i, b in enumerate(blocks))
    problem = Problem(blocks, groups, len(dataset.collections))
    if not problem.shared or all(blocks[i].name in dataset.patterns for i in problem.shared):
        raise UndeterminedError(
            f"{dataset.path}: nothing to calibrate: the only transforms that could change are held "
            f"({', '.join(b.name for b in blocks if b.held)}); "
            f"a single sensor needs a robot that moves it or the pattern"
        )
    used = {link.block for group in groups for link in group.chain.links}
    if idle := [block.name for i, block in enumerate(blocks) if i not in used and not block.held]:
        raise UndeterminedError(
            f"{dataset.path}: '{idle[0]}' does not lie between any sensor and a pattern that it sees, so no label "
            f"tells it; leave it out, or add the sensor that needs it"
        )
    return Setup(dataset, problem, edges, gauge, ignored)


def _blocks(dataset: Dataset) -> tuple[tuple[Block, ...], tuple[Edge, ...]]:
    blocks: dict[Edge, Block] = {}
    for sensor in dataset.sensors.values():
        held = sensor.name == dataset.anchored or (sensor.edge in blocks and blocks[sensor.edge].held)
        blocks[sensor.edge] = Block("-".join(sensor.edge), held=held)
    for edge in dataset.additional_transforms:
        blocks.setdefault(edge, Block("-".join(edge)))
    for pattern in dataset.patterns.values():
        blocks[pattern.parent_link, pattern.link] = Block(pattern.name, per_collection=not pattern.fixed)
    return tuple(blocks.values()), tuple(blocks)


def _groups(dataset: Dataset, edges: tuple[Edge, ...]) -> list[ViewGroup]:
    groups = []
    for pattern in dataset.patterns.values():
        for sensor in dataset.sensors.values():
            detections = dataset.detections(pattern.name, sensor.name)
            if detections:
                collections = np.array([i for i, _ in detections])
                chain = _chain(dataset, sensor, pattern, edges, collections)
                labels = [label for _, label in detections]
                terms = _terms(sensor, pattern, labels)
                groups.append(ViewGroup(sensor.name, pattern.name, collections, chain, terms))
    return groups


def _chain(dataset: Dataset, sensor: Sensor, pattern: Pattern, edges: tuple[Edge, ...], collections: IntArray) -> Chain:
    """``T_sensor_pattern`` as constants and blocks; neighbouring constants are multiplied out."""
    before: Array | None = None
    links: list[Link] = []

    def follow_with(constant: Array | None) -> None:
        nonlocal before
        if not links:
            before = constant
        else:
            links[-1] = Link(links[-1].block, links[-1].inverted, constant)

    others = {(p.parent_link, p.link): p.name for p in dataset.patterns.values()}
    constant: Array | None = None
    for step in dataset.tree.path(sensor.frame, pattern.parent_link):
        edge = (step.parent, step.child)
        if edge in others:
            raise InputError(
                f"{dataset.path}: pattern '{pattern.name}': its parent '{pattern.parent_link}' hangs on pattern "
                f"'{others[edge]}', expected a frame of the robot or the world"
            )
        if edge in edges:
            follow_with(_simplified(constant))
            links.append(Link(edges.index(edge), step.inverted))
            constant = None
        else:
            T = dataset.transform(*(edge if not step.inverted else edge[::-1]))[collections]
            constant = T if constant is None else constant @ T
    follow_with(_simplified(constant))
    links.append(Link(edges.index((pattern.parent_link, pattern.link)), inverted=False))
    return Chain(before, tuple(links))


def _simplified(T: Array | None) -> Array | None:
    """A constant (V, 4, 4) as (4, 4) where it is the same for all views, None where it is the identity."""
    if T is None or np.abs(T - T[0]).max() > 0.0:
        return T
    return None if (T[0] == np.eye(4)).all() else T[0]


def _terms(sensor: Sensor, pattern: Pattern, labels: list[Labels]) -> tuple[Term, ...]:
    corners = [label for label in labels if isinstance(label, CornerLabels)]
    points = [label for label in labels if isinstance(label, PointLabels)]
    if not corners:
        return _point_terms(sensor, pattern, points)
    if sensor.camera is None:
        raise InputError(f"sensor '{sensor.name}' has corner labels but no camera intrinsics")
    return (corner_term(sensor.camera, pattern, corners),)


def _point_terms(sensor: Sensor, pattern: Pattern, labels: list[PointLabels]) -> tuple[Term, ...]:
    ranges, present, rays = _padded([label.points for label in labels])
    terms: list[Term] = [RangeTerm(rays, ranges, present)]
    ranges, present, rays = _padded([_border_rays(sensor, label) for label in labels])
    if present.any():
        corners = pattern.outline - pattern.centre[:2]
        along = np.roll(corners, -1, axis=0) - corners
        # outward, because the outline runs from the top left to the top right
        normals = np.stack([along[:, 1], -along[:, 0]], -1) / np.linalg.norm(along, axis=-1, keepdims=True)
        offsets = (normals * corners).sum(-1)
        kind: NoiseKind = "depth_border" if sensor.modality == "depth" else "border"
        terms.append(BorderTerm(rays, ranges, present, normals, offsets, kind))
    return tuple(terms)


def _border_rays(sensor: Sensor, label: PointLabels) -> Array:
    if sensor.camera is None:
        return border_rays(label.points, label.limits)
    return depth_border_rays(label.points, label.limits, sensor.camera)


def _padded(points: list[Array]) -> tuple[Array, BoolArray, Array]:
    """Points (n, 3) of each view as lengths (V, L), which of them exist (V, L), and unit directions (V, 3, L).

    Points that are NaN do not exist, nor do those at the origin, where LiDARs put rays without a return.
    """
    L = max([1, *(len(p) for p in points)])
    lengths, present = np.ones((len(points), L)), np.zeros((len(points), L), bool)
    rays = np.zeros((len(points), 3, L))
    rays[:, 2] = 1.0
    for v, p in enumerate(points):
        norms = np.linalg.norm(p, axis=-1)
        at = np.flatnonzero(norms > 0)
        lengths[v, at] = norms[at]
        rays[v][:, at] = (p[at] / lengths[v, at, None]).T
        present[v, at] = True
    return lengths, present, rays


def _free_gauge(dataset: Dataset, groups: tuple[ViewGroup, ...]) -> str | None:
    """The sensor to hold where the whole of sensors and patterns could move together; None where it can't.

    Sensors are linked where they see the same pattern: a fixed one ever, a moving one in the same
    collection. Linked sensors can move together, each with its own constant motion, when nothing that
    moves lies between the parents of their transforms (and of the fixed patterns): the patterns, one
    pose a collection, make up for it. An anchored sensor stops that.
    """
    parts = _linked(dataset, groups)
    free = [part for part in parts if dataset.anchored not in part and _moves_as_one(dataset, part, groups)]
    if free and len(parts) > 1:
        listed = " and ".join("{" + ", ".join(part) + "}" for part in parts)
        raise UndeterminedError(
            f"{dataset.path}: the sensors {listed} share no collection of a pattern, so their relative pose is not "
            f"determined; add collections in which they see the pattern together"
        )
    return free[0][0] if free else None


def _linked(dataset: Dataset, groups: tuple[ViewGroup, ...]) -> list[list[str]]:
    """The sensors, in groups that are linked, in the dataset's order."""
    witnesses: dict[str, set[tuple[str, int]]] = {}
    for group in groups:
        fixed = dataset.patterns[group.pattern].fixed
        seen = {(group.pattern, -1)} if fixed else {(group.pattern, int(c)) for c in group.collections}
        witnesses.setdefault(group.sensor, set()).update(seen)
    parts: list[tuple[list[str], set[tuple[str, int]]]] = []
    for sensor in (s for s in dataset.sensors if s in witnesses):
        names, seen = [sensor], set(witnesses[sensor])
        for part in [p for p in parts if p[1] & seen]:
            parts.remove(part)
            names, seen = part[0] + names, part[1] | seen
        parts.append((names, seen))
    return [sorted(names, key=list(dataset.sensors).index) for names, _ in parts]


def _moves_as_one(dataset: Dataset, sensors: list[str], groups: tuple[ViewGroup, ...]) -> bool:
    """Whether nothing that moves lies between the parents of these sensors and of the fixed patterns they see."""
    origin = dataset.sensors[sensors[0]].calibration_parent
    parents = {dataset.sensors[s].calibration_parent for s in sensors}
    patterns = {dataset.patterns[g.pattern] for g in groups if g.sensor in sensors}
    parents |= {p.parent_link for p in patterns if p.fixed}
    relative = [dataset.transform(origin, parent) for parent in sorted(parents)]
    return all(np.abs(T - T[0]).max() < 1e-9 for T in relative)
