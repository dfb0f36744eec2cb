"""Check for wrong units: millimetres in place of metres, degrees in place of radians."""

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, Edge, Joint, PointLabels, PoseLabels
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import distance
from calibration.engine.statistics import median

MM_PER_METRE = 1000.0
METRES_PER_UNIT = {"millimetres": 1 / MM_PER_METRE, "centimetres": 0.01, "inches": 0.0254}
LARGEST_SQUARE = 1.0
"""m: limit of the squares of a pattern, and of the border around it."""
FARTHEST_POINT = 200.0
"""m: limit of the range of labelled points."""
FARTHEST_MEASURED = 50.0
"""m: limit of the distance of a pattern whose poses are measured."""
TOO_FAR, MOVES_TOO_FAR = 10.0, 5.0
"""Two sensors, or two poses of one, that see the same board are at most the sum of their distances to it apart.
Transforms that separate sensors, or the poses of one, by more than this multiple are in other units; relative poses
of sensors have a larger factor, as they may be a bad initial guess.
"""
MAX_CHECKED_COLLECTIONS = 30
"""Number of collections that are checked."""
LEAST_CORNERS = 6
"""Minimum of corners: with fewer, a distance is imprecise."""
MAX_JOINT_ANGLE = 4 * np.pi
"""rad: limit of a joint's position."""
MAX_AGREEING_DISTANCE, MIN_DISAGREEING_DISTANCE = 0.02, 0.2
"""m or rad: a joint agrees with its transform within the first, and disagrees beyond the second."""


def check_units(dataset: Dataset) -> None:
    """Refuse patterns and points of implausible size, transforms in millimetres, joints in degrees.

    Raises:
        InputError: names the value, and what it looks like.
    """
    for name, pattern in dataset.patterns.items():
        _check_pattern(dataset, name, pattern)
    _check_points(dataset)
    _check_measured_poses(dataset)
    for name, joint in dataset.joints.items():
        _check_joint(dataset, name, joint)
    _check_transforms(dataset)


def _check_pattern(dataset: Dataset, name: str, pattern: Pattern) -> None:
    where = f"{dataset.path}: pattern '{name}'"
    side = square(pattern)
    if side > LARGEST_SQUARE:
        looks = [f"{unit}: {side * size:.3g} m" for unit, size in METRES_PER_UNIT.items() if 0.01 <= side * size <= 0.3]
        raise InputError(
            f"{where}: found squares of {side:g} m, expected {LARGEST_SQUARE:g} m at most; this looks like "
            f"{' or '.join(looks) or 'another unit'}"
        )
    low, high = pattern.corners[:, :2].min(0), pattern.corners[:, :2].max(0)
    border = max(float((low - pattern.outline.min(0)).max()), float((pattern.outline.max(0) - high).max())) - side
    if border > LARGEST_SQUARE:
        raise InputError(
            f"{where}: found a border of {border:g} m around the squares, expected {LARGEST_SQUARE:g} m at most; this "
            f"looks like millimetres: {border / MM_PER_METRE:g} m"
        )


def square(pattern: Pattern) -> float:
    """Side of a pattern's squares, m."""
    return float(np.linalg.norm(pattern.corners[1] - pattern.corners[0]))


def _check_points(dataset: Dataset) -> None:
    for sensor in dataset.sensors:
        ranges = [
            median(np.linalg.norm(label.points, axis=-1))
            for collection in dataset.collections
            for (_, name), label in collection.labels.items()
            if name == sensor and isinstance(label, PointLabels) and len(label.points)
        ]
        if ranges and (far := median(np.array(ranges))) > FARTHEST_POINT:
            raise InputError(
                f"{dataset.path}: sensor '{sensor}': found the pattern {far:g} m away, expected {FARTHEST_POINT:g} m "
                f"at most; this looks like millimetres: {far / MM_PER_METRE:g} m"
            )


def _check_measured_poses(dataset: Dataset) -> None:
    for sensor in dataset.sensors:
        distances = [
            float(np.linalg.norm(label.T[:3, 3]))
            for collection in dataset.collections
            for (_, name), label in collection.labels.items()
            if name == sensor and isinstance(label, PoseLabels)
        ]
        if distances and (far := median(np.array(distances))) > FARTHEST_MEASURED:
            raise InputError(
                f"{dataset.path}: sensor '{sensor}': found measured poses of the pattern {far:g} m away, expected "
                f"{FARTHEST_MEASURED:g} m at most; this looks like millimetres: {far / MM_PER_METRE:g} m (in "
                "import.yml: 'units: mm' in 'samples')"
            )


def _check_joint(dataset: Dataset, name: str, joint: Joint) -> None:
    """Refuse a joint whose transform agrees with its parameters only if they are in degrees or millimetres."""
    if not joint.model.prismatic and (far := float(np.abs(joint.positions).max())) > MAX_JOINT_ANGLE:
        raise InputError(
            f"{dataset.path}: joint '{name}': found a position of {far:.4g} rad, expected two turns at most; this "
            f"looks like degrees"
        )
    T = dataset.transforms[joint.edge]
    T = T[~np.isnan(T[:, 0, 0])]
    if not len(T) or _distance_of_joint(joint, joint.values, joint.positions, T) <= MIN_DISAGREEING_DISTANCE:
        return
    angles = np.array(
        [parameter.startswith(("origin_roll", "origin_pitch", "origin_yaw")) for parameter in JOINT_PARAMETERS]
    )
    lengths = np.array([parameter in ("origin_x", "origin_y", "origin_z") for parameter in JOINT_PARAMETERS])
    position = (1 / MM_PER_METRE, "millimetres") if joint.model.prismatic else (np.pi / 180, "degrees")
    units = (
        (np.where(angles, np.pi / 180, 1.0), 1.0),
        (np.where(lengths, 1 / MM_PER_METRE, 1.0), 1.0),
        (np.ones(7), position[0]),
    )
    for (scale, moved), what, unit in zip(
        units, ("origin's angles", "origin", "position"), ("degrees", "millimetres", position[1]), strict=True
    ):
        if _distance_of_joint(joint, joint.values * scale, joint.positions * moved, T) < MAX_AGREEING_DISTANCE:
            raise InputError(
                f"{dataset.path}: joint '{name}': its {what} and its transform '{'-'.join(joint.edge)}' do not go "
                f"together; this looks like {unit}, expected {'radians' if unit == 'degrees' else 'metres'}"
            )


def _distance_of_joint(joint: Joint, values: Array, positions: Array, T: Array) -> float:
    """Distance of a joint's first transform from that of its parameters and positions, m or rad."""
    return max(float(d) for d in distance(T[0], joint.model.pose(values) @ joint.model.motion(positions)[0]))


def _check_transforms(dataset: Dataset) -> None:
    """Refuse transforms by which sensors that see the same pattern are much farther apart than from the pattern."""
    some = sorted({round(i) for i in np.linspace(0, len(dataset.collections) - 1, MAX_CHECKED_COLLECTIONS).tolist()})
    dataset = dataset.with_collections(some)
    seen = _distances_of_patterns(dataset)
    for a, b, pattern, apart, near, path in _pairs_of_poses(dataset, seen):
        if len(apart) and median(apart / near) > (MOVES_TOO_FAR if a == b else TOO_FAR):
            edge, size, moves = _largest_transform(dataset, path, a == b)
            far, away = f"{median(apart):.3g} m", f"{median(near) / 2:.2g} m away"
            mend = " (in import.yml: 'units: mm' in 'samples')" if moves and not dataset.joints else ""
            so = f"'{a}' moves by {far}" if a == b else f"'{a}' and '{b}' are {far} apart"
            raise InputError(
                f"{dataset.path}: transform '{'-'.join(edge)}': found {'a motion' if moves else 'a translation'} of "
                f"{size:.3g} m, by which {so}, although {'it sees' if a == b else 'both see'} '{pattern}' {away}; "
                f"expected metres, this looks like millimetres{mend}"
            )


def _distances_of_patterns(dataset: Dataset) -> Mapping[tuple[str, str], Array]:
    """Distance (N,) of each sensor from each pattern, from its own view, m; NaN without a view."""
    N = len(dataset.collections)
    found = {}
    for pattern, board in dataset.patterns.items():
        for name, sensor in dataset.sensors.items():
            away = found[pattern, name] = np.full(N, np.nan)
            pixels = np.full((N, len(board.corners), 2), np.nan)
            for i, label in dataset.detections(pattern, name):
                if isinstance(label, PointLabels):
                    away[i] = np.linalg.norm(label.points.mean(0)) if len(label.points) else np.nan
                elif isinstance(label, PoseLabels):
                    away[i] = np.linalg.norm(label.T[:3, 3])
                elif len(label.ids) >= LEAST_CORNERS:
                    pixels[i, label.ids] = label.pixels
            if sensor.camera and sensor.modality.has_corners:
                seen = np.isfinite(pixels[..., 0])
                views = seen.any(-1)
                places = board.corners - board.centre
                term = CornerTerm(sensor.camera, places, pixels[views].swapaxes(-1, -2), seen[views])
                away[views] = np.linalg.norm(term.linear_poses[:, :3, 3], axis=-1)
    return found


def _pairs_of_poses(
    dataset: Dataset, seen: Mapping[tuple[str, str], Array]
) -> Iterator[tuple[str, str, str, Array, Array, tuple[Edge, ...]]]:
    """Yield pairs of poses that see the same pattern: sensors, pattern, distance (n,), its limit (n,), and edges."""
    for pattern, board in dataset.patterns.items():
        for a, b in combinations(dataset.sensors, 2):
            both = np.isfinite(seen[pattern, a] + seen[pattern, b])
            if both.any():
                way = (dataset.sensors[a].frame, dataset.sensors[b].frame)
                t = dataset.transform(*way)[both, :3, 3]
                yield (
                    a,
                    b,
                    pattern,
                    np.linalg.norm(t, axis=-1),
                    (seen[pattern, a] + seen[pattern, b])[both],
                    _edges_between(dataset, *way),
                )
        for a, sensor in dataset.sensors.items():
            own = np.isfinite(seen[pattern, a])
            if board.fixed and own.sum() > 1:
                way = (board.parent_link, sensor.frame)
                t, away = dataset.transform(*way)[own, :3, 3], seen[pattern, a][own]
                yield (
                    a,
                    a,
                    pattern,
                    np.linalg.norm(t - t.mean(0), axis=-1),
                    away + away.mean(),
                    _edges_between(dataset, *way),
                )


def _edges_between(dataset: Dataset, start: str, end: str) -> tuple[Edge, ...]:
    return tuple((step.parent, step.child) for step in dataset.tree.path(start, end))


def _largest_transform(dataset: Dataset, path: tuple[Edge, ...], moving: bool) -> tuple[Edge, float, bool]:
    """Return the transform with the largest motion in a chain, or the longest one; its size, m; whether it moves."""
    t = {edge: dataset.transforms[edge][:, :3, 3] for edge in path}
    moves = {edge: float(np.linalg.norm(each - each.mean(0), axis=-1).max()) for edge, each in t.items()}
    lengths = {edge: float(np.linalg.norm(each, axis=-1).max()) for edge, each in t.items()}
    sizes = moves if moving and max(moves.values()) > LARGEST_SQUARE else lengths
    edge = max(sizes, key=lambda edge: sizes[edge])
    return edge, sizes[edge], sizes is moves
