"""A dataset as a least-squares problem: which transforms are unknown, and how the labels depend on them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.dataset.model import CornerLabels, Dataset, Edge, Labels, PointLabels, Sensor
from calibration.dataset.pattern import Pattern
from calibration.errors import InputError, UndeterminedError
from calibration.estimation.depth_border import depth_border_rays
from calibration.estimation.gauge import free_gauge
from calibration.estimation.holding import held_blocks
from calibration.estimation.intrinsics import CalibratedIntrinsics
from calibration.estimation.problem import Block, Chain, FreeJoint, Link, Problem, Term, ViewGroup
from calibration.estimation.residuals import BorderTerm, RangeTerm
from calibration.estimation.scan import border_rays
from calibration.estimation.single_views import corner_term
from calibration.estimation.unknown_intrinsics import intrinsics_blocks, intrinsics_name
from calibration.estimation.usable_labels import usable_labels
from calibration.geometry.transforms import inverse
from calibration.geometry.types import Array, BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Setup:
    """A problem and what its blocks are in the dataset."""

    dataset: Dataset
    """Only the collections that count."""
    problem: Problem
    edges: tuple[Edge, ...]
    """The edge of each block of a transform: those of sensors and additional transforms first, then joints, then the
    patterns. Blocks of intrinsics come after them."""
    gauge: str | None
    """The sensor that is held because nothing else fixes the world; None where something does."""
    gauge_patterns: tuple[str, ...]
    """Fixed patterns that are held for the same reason: only poses relative to them can be known."""
    ignored: tuple[str, ...]
    """Views that do not count, and why."""

    def block(self, edge: Edge) -> int:
        """The block of an edge."""
        return self.edges.index(edge)

    def pattern_edge(self, pattern: str) -> Edge:
        """The edge of a pattern: its parent to its link."""
        p = self.dataset.patterns[pattern]
        return (p.parent_link, p.link)


def build(
    dataset: Dataset,
    hold: Sequence[str] = (),
    intrinsics: Sequence[str] = (),
    intrinsics_covariance: Mapping[str, CalibratedIntrinsics] | None = None,
) -> Setup:
    """State the problem of a dataset.

    Args:
        dataset: the labels and the transforms.
        hold: what stays as the dataset has it (see `calibration.estimation.holding`).
        intrinsics: the cameras whose intrinsics are unknown too (see `calibration.estimation.unknown_intrinsics`).
        intrinsics_covariance: by camera, how well intrinsics are known beforehand.

    Raises:
        InputError: no labels count, or a sensor has none; what is to be held is not there.
        UndeterminedError: sensors are not linked to each other, nothing is left to calibrate, or no label
            depends on a transform.
    """
    dataset, ignored = usable_labels(dataset)
    blocks, edges = _blocks(dataset)
    cameras = intrinsics_blocks(dataset, intrinsics, intrinsics_covariance or {})
    blocks = held_blocks(dataset, (*blocks, *cameras), edges, hold)
    transforms, cameras = blocks[: len(edges)], blocks[len(edges) :]
    groups = tuple(_groups(dataset, transforms, edges, [camera.name for camera in cameras]))
    gauge = free_gauge(dataset, groups, transforms, edges)
    fixing = [dataset.sensors[gauge.sensor].edge] if gauge.sensor else []
    fixing += [(p.parent_link, p.link) for p in (dataset.patterns[name] for name in gauge.patterns)]
    transforms = tuple(replace(b, held=b.held or edge in fixing) for b, edge in zip(transforms, edges, strict=True))
    blocks = (*transforms, *cameras)
    problem = Problem(blocks, groups, len(dataset.collections))
    if all(blocks[i].name in dataset.patterns for i in (*problem.shared, *problem.local)):
        raise UndeterminedError(
            f"{dataset.path}: nothing to calibrate: the only transforms that could change are held "
            f"({', '.join(b.name for b in blocks if b.held)}); "
            f"a single sensor needs a robot that moves it or the pattern"
        )
    used = {link.block for group in groups for link in group.chain.links}
    if idle := [block.name for i, block in enumerate(transforms) if i not in used and not block.held]:
        raise UndeterminedError(
            f"{dataset.path}: '{idle[0]}' does not lie between any sensor and a pattern that it sees, so no label "
            f"tells it; leave it out, or add the sensor that needs it"
        )
    return Setup(dataset, problem, edges, gauge.sensor, gauge.patterns, ignored)


def _blocks(dataset: Dataset) -> tuple[tuple[Block, ...], tuple[Edge, ...]]:
    blocks: dict[Edge, Block] = {}
    for sensor in dataset.sensors.values():
        held = sensor.name == dataset.anchored or (sensor.edge in blocks and blocks[sensor.edge].held)
        blocks[sensor.edge] = Block("-".join(sensor.edge), held=held)
    for edge in dataset.additional_transforms:
        blocks.setdefault(edge, Block("-".join(edge), per_collection=edge in dataset.moving_transforms))
    for joint in dataset.joints.values():
        blocks[joint.edge] = Block(f"joint-{joint.name}", joint=FreeJoint(joint.model, joint.parameters))
    for pattern in dataset.patterns.values():
        blocks[pattern.parent_link, pattern.link] = Block(pattern.name, per_collection=not pattern.fixed)
    return tuple(blocks.values()), tuple(blocks)


def _groups(
    dataset: Dataset, blocks: tuple[Block, ...], edges: tuple[Edge, ...], cameras: Sequence[str]
) -> list[ViewGroup]:
    """The views of each sensor and pattern; ``cameras`` are the names of the blocks that come after the transforms'."""
    groups = []
    for pattern in dataset.patterns.values():
        for sensor in dataset.sensors.values():
            detections = dataset.detections(pattern.name, sensor.name)
            if detections:
                collections = np.array([i for i, _ in detections])
                chain = _chain(dataset, sensor, pattern, blocks, edges, collections)
                labels = [label for _, label in detections]
                terms = _terms(sensor, pattern, labels)
                own = intrinsics_name(sensor.name)
                intrinsics = len(edges) + cameras.index(own) if own in cameras else None
                groups.append(ViewGroup(sensor.name, pattern.name, collections, chain, terms, intrinsics))
    return groups


def _chain(
    dataset: Dataset,
    sensor: Sensor,
    pattern: Pattern,
    blocks: tuple[Block, ...],
    edges: tuple[Edge, ...],
    collections: IntArray,
) -> Chain:
    """``T_sensor_pattern`` as constants and blocks; neighbouring constants are multiplied out.

    What the encoder of a joint tells is a constant: it follows the joint's block.
    """
    motions = {joint.edge: joint.model.motion(joint.positions)[collections] for joint in dataset.joints.values()}
    before: Array | None = None
    links: list[Link] = []

    def follow_with(constant: Array | None) -> None:
        nonlocal before
        if not links:
            before = constant
        else:
            links[-1] = replace(links[-1], after=constant)

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
            motion = motions.get(edge)
            if motion is not None and step.inverted:
                constant = inverse(motion) if constant is None else constant @ inverse(motion)
            follow_with(_simplified(constant))
            block = edges.index(edge)
            links.append(Link(block, step.inverted, joint=blocks[block].joint))
            constant = None if step.inverted else motion
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
    range_kind, border_kind = sensor.modality.point_data.noise
    terms: list[Term] = [RangeTerm(rays, ranges, present, range_kind)]
    ranges, present, rays = _padded([_border_rays(sensor, label) for label in labels])
    if present.any():
        corners = pattern.outline - pattern.centre[:2]
        along = np.roll(corners, -1, axis=0) - corners
        # outward, because the outline runs from the top left to the top right
        normals = np.stack([along[:, 1], -along[:, 0]], -1) / np.linalg.norm(along, axis=-1, keepdims=True)
        offsets = (normals * corners).sum(-1)
        terms.append(BorderTerm(rays, ranges, present, normals, offsets, border_kind))
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
