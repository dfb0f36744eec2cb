"""Build the least-squares problem of a dataset: the usable labels, and the unknown transforms that they depend on."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import CornerLabels, Dataset, Edge, Labels, PointLabels, PoseLabels, Sensor
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.problem.blocks import Block, CalibratedIntrinsics, FreeJoint
from calibration.engine.estimation.problem.fixing import held_blocks, with_gauge_fixed
from calibration.engine.estimation.problem.intrinsics import intrinsics_blocks
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.planar_pose import determines_pose
from calibration.engine.estimation.residuals.pose_residuals import PoseTerm
from calibration.engine.estimation.residuals.ray_residuals import (
    BorderTerm,
    RangeTerm,
    depth_border_rays,
    scan_border_rays,
)
from calibration.engine.estimation.residuals.views import Chain, Link, Term, ViewGroup
from calibration.engine.estimation.start.single_views import Sight, corner_term, sights_of
from calibration.engine.geometry.transforms import inverse, translation

MINIMUM_CORNERS = 4
"""Minimum of corners: fewer do not determine a pattern's pose, and would add flipped ones."""


def usable_labels(dataset: Dataset) -> tuple[Dataset, tuple[str, ...]]:
    """Remove labels that determine nothing, and collections and patterns that have none left.

    Views of a LiDAR or a depth camera need a camera that saw the pattern: at the same moment, or ever when it is fixed.

    Returns:
        The dataset, and descriptions of the removed labels with the reasons.

    Raises:
        InputError: a sensor has no labels left.
        UndeterminedError: fewer than two collections are left.
    """
    faults = _faulty_labels(dataset)
    kept: list[Mapping[tuple[str, str], Labels]] = [collection.labels for collection in dataset.collections]
    ignored = []
    for i in sorted({i for i, _ in faults}):
        labels = kept[i]
        ignored += [f"collection {dataset.keys[i]}, {k[1]}: {faults[i, k]}" for k in labels if (i, k) in faults]
        kept[i] = {key: label for key, label in labels.items() if (i, key) not in faults}
    modalities = [sensor.modality for sensor in dataset.sensors.values()]
    if any(modality.points for modality in modalities):
        fixed = {p for labels in kept for p in _seen_by_cameras(labels) if dataset.patterns[p].fixed}
        for i, collection in enumerate(dataset.collections):
            known = fixed | _seen_by_cameras(kept[i])
            if unknown := [key for key in kept[i] if key[0] not in known]:
                kept[i] = {key: label for key, label in kept[i].items() if key not in unknown}
                ignored += [f"collection {collection.key}, {key[1]}: no camera saw '{key[0]}'" for key in unknown]
    views = set().union(*kept)
    for sensor in dataset.sensors:
        if not any(s == sensor for _, s in views):
            raise InputError(f"{dataset.path}: sensor '{sensor}': no collection has enough labels of it")
    seen = {pattern for pattern, _ in views}
    ignored += [
        f"pattern '{name}': no collection has enough labels of it" for name in dataset.patterns if name not in seen
    ]
    keep = [i for i, labels in enumerate(kept) if labels]
    if len(keep) < 2:
        raise UndeterminedError(
            f"{dataset.path}: {len(keep)} collection has labels; at least 2 are needed, because one view of a flat "
            f"pattern cannot be told from its mirror image"
        )
    if not ignored and len(keep) == len(kept):
        return dataset, ()
    usable = replace(
        dataset,
        patterns={name: pattern for name, pattern in dataset.patterns.items() if name in seen},
        collections=tuple(
            c if labels is c.labels else replace(c, labels=labels)
            for c, labels in zip(dataset.collections, kept, strict=True)
        ),
    )
    return usable if len(keep) == len(kept) else usable.with_collections(keep), tuple(ignored)


def _seen_by_cameras(labels: Mapping[tuple[str, str], Labels]) -> set[str]:
    """Return the patterns with corners or measured poses."""
    return {pattern for (pattern, _), label in labels.items() if isinstance(label, CornerLabels | PoseLabels)}


def _faulty_labels(dataset: Dataset) -> dict[tuple[int, tuple[str, str]], str]:
    """Return the labels that determine too little, by collection and by (pattern, sensor), with the reasons."""
    K = {name: len(pattern.corners) for name, pattern in dataset.patterns.items()}
    faults = {}
    partial: dict[str, dict[tuple[int, tuple[str, str]], IntArray]] = {}
    for i, collection in enumerate(dataset.collections):
        for key, label in collection.labels.items():
            if isinstance(label, CornerLabels):
                count = len(label.ids)
                if count < MINIMUM_CORNERS:
                    faults[i, key] = f"{count} corners, at least {MINIMUM_CORNERS} are needed"
                elif count < K[key[0]]:
                    partial.setdefault(key[0], {})[i, key] = label.ids
            elif isinstance(label, PointLabels):
                count, minimum = len(label.points), dataset.sensors[key[1]].modality.point_data.minimum
                if count < minimum:
                    faults[i, key] = f"{count} points, at least {minimum} are needed"
    for pattern, views in partial.items():
        seen = np.zeros((len(views), K[pattern]), bool)
        for row, ids in zip(seen, views.values(), strict=True):
            row[ids] = True
        usable = determines_pose(dataset.patterns[pattern].corners, seen)
        faults |= {view: "its corners lie on a line" for view, ok in zip(views, usable, strict=True) if not ok}
    return faults


@dataclass(frozen=True, eq=False)
class Setup:
    """Problem, with the meaning of its blocks in the dataset."""

    dataset: Dataset
    """Only the used collections."""
    problem: Problem
    """Its blocks: those of sensors and additional transforms first, then joints, patterns, intrinsics."""
    gauge: str | None
    """Sensor that is fixed to remove a free gauge; None if there is none."""
    gauge_patterns: tuple[str, ...]
    """Fixed patterns that are held constant for the same reason: only poses relative to them are determined."""
    ignored: tuple[str, ...]
    """Views that are not used, with the reasons."""

    def block(self, edge: Edge) -> int:
        """Return the block of an edge."""
        return self._block_of_edge[edge]

    @cached_property
    def _block_of_edge(self) -> dict[Edge, int]:
        return {block.edge: i for i, block in enumerate(self.problem.blocks) if block.edge}

    @cached_property
    def sights(self) -> tuple[Sight, ...]:
        """Views of each group, with the poses or points that their labels alone determine."""
        return sights_of(self.problem.groups)

    def pattern_edge(self, pattern: str) -> Edge:
        """Return the edge of a pattern, from its parent to its link."""
        p = self.dataset.patterns[pattern]
        return p.edge


def build_with(dataset: Dataset, options: Options) -> Setup:
    """Build the problem of a dataset by the options of its calibration; see `build`."""
    return build(dataset, options.hold, options.intrinsics, options.known_intrinsics())


def build(
    dataset: Dataset,
    hold: Sequence[str] = (),
    intrinsics: Sequence[str] = (),
    intrinsics_covariance: Mapping[str, CalibratedIntrinsics] | None = None,
) -> Setup:
    """Build the problem of a dataset.

    Args:
        dataset: the labels and the transforms.
        hold: names of fixed parameters (see `calibration.engine.estimation.problem.fixing`).
        intrinsics: the cameras with free intrinsics (see `calibration.engine.estimation.problem.intrinsics`).
        intrinsics_covariance: by camera, prior covariance of its intrinsics.

    Raises:
        InputError: there are no usable labels, or a sensor has none; a name in ``hold`` is unknown.
        UndeterminedError: sensors are not connected by common views, there are no unknowns, or no label
            depends on a transform.
    """
    dataset, ignored = usable_labels(dataset)
    blocks = (*_unknown_blocks(dataset), *intrinsics_blocks(dataset, intrinsics, intrinsics_covariance or {}))
    known = [pattern.name for pattern in dataset.patterns.values() if pattern.known_pose]
    blocks = held_blocks(dataset, blocks, (*hold, *known))
    groups = tuple(groups_of_views(dataset, blocks))
    gauge, blocks = with_gauge_fixed(dataset, groups, blocks)
    problem = Problem(blocks, groups, len(dataset.collections))
    if all(blocks[i].name in dataset.patterns for i in (*problem.shared, *problem.local)):
        raise UndeterminedError(
            f"{dataset.path}: nothing to calibrate: the only transforms that could change are held "
            f"({', '.join(b.name for b in blocks if b.held)}); "
            f"a single sensor needs a robot that moves it or the pattern: say what the "
            f"pattern is fixed to (in import.yml parent: flange, or fixed: true in the world), or calibrate its lens "
            f"(intrinsics: all)"
        )
    used = {link.block for group in groups for link in group.chain.links}
    idle = [block.name for i, block in enumerate(blocks) if i not in used and not block.held and block.edge]
    if idle:
        raise UndeterminedError(
            f"{dataset.path}: '{idle[0]}' does not lie between any sensor and a pattern that it sees, so no label "
            f"tells it; leave it out, or add the sensor that needs it"
        )
    return Setup(dataset, problem, gauge.sensor, gauge.patterns, ignored)


def _unknown_blocks(dataset: Dataset) -> list[Block]:
    """Return the blocks of all unknown transforms."""
    blocks: dict[Edge, Block] = {}
    for sensor in dataset.sensors.values():
        held = sensor.name == dataset.anchored or (sensor.edge in blocks and blocks[sensor.edge].held)
        blocks[sensor.edge] = Block("-".join(sensor.edge), held=held)
    for edge in dataset.additional_transforms:
        blocks.setdefault(edge, Block("-".join(edge), per_collection=edge in dataset.moving_transforms))
    for joint in dataset.joints.values():
        blocks[joint.edge] = Block(f"joint-{joint.name}", parameters=FreeJoint(joint.model, joint.parameters))
    for pattern in dataset.patterns.values():
        blocks[pattern.edge] = Block(pattern.name, per_collection=not pattern.fixed)
    return [replace(block, edge=edge) for edge, block in blocks.items()]


def groups_of_views(dataset: Dataset, blocks: Sequence[Block]) -> Iterator[ViewGroup]:
    """Yield the views of each sensor and pattern."""
    intrinsics = {block.intrinsics.sensor: i for i, block in enumerate(blocks) if block.intrinsics}
    for pattern in dataset.patterns.values():
        for sensor in dataset.sensors.values():
            detections = dataset.detections(pattern.name, sensor.name)
            if detections:
                collections = np.array([i for i, _ in detections])
                chain = _chain_of_views(dataset, sensor, pattern, blocks, collections)
                terms = _terms_of_labels(sensor, pattern, [label for _, label in detections])
                yield ViewGroup(sensor.name, pattern.name, collections, chain, terms, intrinsics.get(sensor.name))


def _chain_of_views(
    dataset: Dataset, sensor: Sensor, pattern: Pattern, blocks: Sequence[Block], collections: IntArray
) -> Chain:
    """Return the chain of ``T_sensor_pattern`` as constants and blocks; neighbouring constants are multiplied.

    The encoder position of a joint is a constant: it follows the joint's block.
    """
    at = {block.edge: i for i, block in enumerate(blocks)}
    dataset = dataset.seen_by(sensor.name)
    motions = {
        joint.edge: dataset.moved_by_lag(sensor.name, joint.edge, joint.model.motion(joint.positions))[collections]
        for joint in dataset.joints.values()
    }
    before: Array | None = None
    links: list[Link] = []

    def follow_with(constant: Array | None) -> None:
        nonlocal before
        if not links:
            before = constant
        else:
            links[-1] = replace(links[-1], after=constant)

    others = {p.edge: p.name for p in dataset.patterns.values()}
    constant: Array | None = None
    for step in dataset.tree.path(sensor.frame, pattern.parent_link):
        edge = (step.parent, step.child)
        if edge in others:
            raise InputError(
                f"{dataset.path}: pattern '{pattern.name}': its parent '{pattern.parent_link}' hangs on pattern "
                f"'{others[edge]}', expected a frame of the robot or the world"
            )
        if edge in at:
            motion = motions.get(edge, _in_the_lag(dataset, sensor, edge, collections))
            if motion is not None and step.inverted:
                constant = inverse(motion) if constant is None else constant @ inverse(motion)
            follow_with(_simplify_constant(constant))
            links.append(Link(at[edge], step.inverted))
            constant = None if step.inverted else motion
        else:
            T = dataset.transform(*(edge if not step.inverted else edge[::-1]))[collections]
            constant = T if constant is None else constant @ T
    follow_with(_simplify_constant(constant))
    own = pattern.edge
    centre = translation(pattern.centre)
    motion = _in_the_lag(dataset, sensor, own, collections)
    motion = None if motion is None else inverse(centre) @ motion @ centre
    links.append(Link(at[own], inverted=False, after=motion))
    return Chain(before, tuple(links))


def _in_the_lag(dataset: Dataset, sensor: Sensor, edge: Edge, collections: IntArray) -> Array | None:
    """Return the motion (V, 4, 4) of an edge's child in its own frame during a sensor's lag; None without any."""
    if not sensor.lag or edge not in dataset.velocities:
        return None
    return dataset.moved_by_lag(sensor.name, edge, np.eye(4)[None])[collections]


def _simplify_constant(T: Array | None) -> Array | None:
    """Reduce a constant (V, 4, 4) to (4, 4) if it is the same for all views, to None if it is the identity."""
    if T is None or np.abs(T - T[0]).max() > 0.0:
        return T
    return None if (T[0] == np.eye(4)).all() else T[0]


def _terms_of_labels(sensor: Sensor, pattern: Pattern, labels: list[Labels]) -> tuple[Term, ...]:
    corners = [label for label in labels if isinstance(label, CornerLabels)]
    if corners:
        if sensor.camera is None:
            raise InputError(f"sensor '{sensor.name}' has corner labels but no camera intrinsics")
        return (corner_term(sensor.camera, pattern, corners),)
    poses = [label.T for label in labels if isinstance(label, PoseLabels)]
    if poses:
        measured = np.stack(poses) @ translation(pattern.centre)
        return PoseTerm(measured, "pose_translation"), PoseTerm(measured, "pose_rotation")
    return _point_terms(sensor, pattern, [label for label in labels if isinstance(label, PointLabels)])


def _point_terms(sensor: Sensor, pattern: Pattern, labels: list[PointLabels]) -> tuple[Term, ...]:
    ranges, present, rays = _pad_points([label.points for label in labels])
    range_kind, border_kind = sensor.modality.point_data.noise
    terms: list[Term] = [RangeTerm(rays, ranges, present, range_kind)]
    ranges, present, rays = _pad_points(_border_rays(sensor, labels))
    if present.any():
        corners = pattern.outline - pattern.centre[:2]
        along = np.roll(corners, -1, axis=0) - corners
        # outward, because the outline goes from the top left to the top right
        normals = np.stack([along[:, 1], -along[:, 0]], -1) / np.linalg.norm(along, axis=-1, keepdims=True)
        offsets = (normals * corners).sum(-1)
        terms.append(BorderTerm(rays, ranges, present, normals, offsets, border_kind))
    return tuple(terms)


def _border_rays(sensor: Sensor, labels: list[PointLabels]) -> list[Array]:
    """Return points (L, 3) on the rays to the border of each view."""
    if sensor.camera is not None:
        return [depth_border_rays(label.points, label.limits, sensor.camera) for label in labels]
    counts = [len(label.points) for label in labels]
    starts = np.cumsum([0, *counts])
    points, limits = np.concatenate([label.points for label in labels]), [label.limits for label in labels]
    at = np.concatenate([each + start for each, start in zip(limits, starts[:-1], strict=True)])
    rays = scan_border_rays(points, at, np.repeat(np.arange(len(labels)), counts))
    return np.split(rays, np.cumsum([len(each) for each in limits])[:-1])


def _pad_points(points: list[Array]) -> tuple[Array, BoolArray, Array]:
    """Convert points (n, 3) of each view to lengths (V, L), mask of present ones (V, L), unit directions (V, 3, L).

    NaN points are not present, nor are those at the origin, which LiDARs store for rays without a return.
    """
    counts = [len(p) for p in points]
    V, L = len(points), max([1, *counts])
    together = np.concatenate(points).T.copy()
    norms = np.sqrt((together * together).sum(0))
    own = np.arange(L) < np.array(counts)[:, None]  # the places of each view's points
    lengths, rays = np.zeros((V, L)), np.zeros((3, V, L))
    lengths[own], rays[:, own] = norms, together
    present = lengths > 0
    lengths[~present] = 1.0
    rays[:, ~present] = np.array([0.0, 0.0, 1.0])[:, None]
    return lengths, present, np.ascontiguousarray((rays / lengths).swapaxes(0, 1))
