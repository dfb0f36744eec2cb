"""Two sensors of one kind with a constant relative pose: OpenCV's stereo calibration, and ICP.

As in ATOM's comparison, OpenCV re-estimates the intrinsics from the given ones, which increases the
error of the extrinsics; the variant with fixed intrinsics shows by how much. Only the
relative pose is used: evaluations keep the dataset's own intrinsics.

With re-estimated intrinsics the results of OpenCV 4 and 5 differ, though the optimum is the same: 4 stops after ATOM's
limit of 100 iterations, near the given intrinsics; 5 converges within them, with a smaller reprojection error
and intrinsics further from those of the dataset. With enough iterations 4 converges there too (t2rgb: 0.097 px after
100 iterations, 0.287 px at the end, 0.290 px with OpenCV 5).

ICP aligns the points that two LiDARs or depth cameras see on the pattern. As in ATOM's comparison: point to point,
started from the transforms in the dataset (so a bad initial guess fails), with a threshold on the distance of matches,
one collection after the other; the result is the average over collections, or the one with the best fit. A third
variant uses all collections at once, which prevents sliding along a single board.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import Array
from calibration.base.optional import optional
from calibration.engine.dataset.modalities import MODALITIES, Modality
from calibration.engine.dataset.model import CornerLabels, Dataset, PointLabels, Sensor
from calibration.engine.evaluation.two_sensors import nearest
from calibration.engine.geometry import rotations
from calibration.engine.geometry.lenses import PlumbBob, Rational
from calibration.engine.geometry.transforms import apply, distance, inverse, transform

Modalities = tuple[Modality, ...]
CAMERA_MODALITIES: Modalities = tuple(each for each in MODALITIES.values() if each.has_corners)
RANGE_SENSORS: Modalities = tuple(each for each in MODALITIES.values() if not each.has_corners and not each.is_planar)
"""Modalities whose views of a pattern are surface points."""


def pair_of(dataset: Dataset, modalities: Modalities) -> tuple[Sensor, Sensor]:
    """Return the two sensors of these modalities, in the dataset's order; check `why_not_pair` first."""
    first, second = _of_kind(dataset, modalities)
    return first, second


def only_pair(dataset: Dataset, modalities: Modalities) -> Dataset:
    """Remove all sensors but the two from a dataset."""
    pair = {sensor.name: sensor for sensor in pair_of(dataset, modalities)}
    return replace(dataset, sensors=pair, anchored=dataset.anchored if dataset.anchored in pair else None)


def why_not_pair(dataset: Dataset, modalities: Modalities, wanted: str) -> str | None:
    """Return the reason why the dataset has no such pair, in one line; None if it has."""
    if len(_of_kind(dataset, modalities)) != 2:
        kinds = ", ".join(f"'{s.name}' ({s.modality})" for s in dataset.sensors.values())
        return f"it needs two {wanted}, and there are {kinds}"
    if dataset.additional_transforms:
        return f"it cannot calibrate additional transforms, such as '{'-'.join(dataset.additional_transforms[0])}'"
    first, second = pair_of(dataset, modalities)
    T = dataset.transform(first.frame, second.frame)
    if max(values.max() for values in distance(T[:1], T)) > 1e-6:
        return f"it needs sensors that keep their places, and '{second.name}' moves against '{first.name}'"
    return None


def with_pair(dataset: Dataset, modalities: Modalities, T_first_second: Array) -> Dataset:
    """Set the relative pose (4, 4) of the two sensors in a dataset; the second one moves, unless it is anchored."""
    first, second = pair_of(dataset, modalities)
    if dataset.anchored == second.name:
        first, second, T_first_second = second, first, inverse(T_first_second)
    return dataset.with_transforms({second.edge: _edge_transform(dataset, first, second, T_first_second)})


def _of_kind(dataset: Dataset, modalities: Modalities) -> list[Sensor]:
    return [sensor for sensor in dataset.sensors.values() if sensor.modality in modalities]


def _edge_transform(dataset: Dataset, reference: Sensor, sensor: Sensor, T_reference_sensor: Array) -> Array:
    """Return the sensor's calibrated transform (4, 4) that yields this relative pose of its data frame."""
    once = dataset.with_collections([0])
    T_parent_reference = once.transform(sensor.calibration_parent, reference.frame)[0]
    T_frame_child = once.transform(sensor.frame, sensor.calibration_child)[0]
    return np.asarray(T_parent_reference @ T_reference_sensor @ T_frame_child)


USER_NAME = "OpenCV's stereo calibration"
MINIMUM_CORNERS = 6
"""Minimum of corners of a view. OpenCV starts from a homography, which four corners determine without redundancy."""
MINIMUM_VIEWS = 3
"""Minimum of views: from fewer of a plane the intrinsics cannot be estimated (Z. Zhang, 2000)."""


def opencv_stereo(dataset: Dataset, *, fixed: bool = False) -> Dataset:
    """Calibrate the second camera by `cv2.stereoCalibrate` and return the new dataset.

    Views in which both cameras see the whole pattern are used, as in ATOM; if there are fewer than
    `MINIMUM_VIEWS` of them, all views are used, with the corners that both cameras see.

    Args:
        dataset: the views.
        fixed: whether the intrinsics are those of the dataset, or re-estimated.

    Raises:
        InputError: the method does not apply (`why_not_stereo`).
        UndeterminedError: OpenCV finds no solution.
        InfrastructureError: OpenCV is not installed.
    """
    if reason := why_not_stereo(dataset):
        raise InputError(f"{dataset.path}: OpenCV's stereo calibration does not apply: {reason}")
    first, second = pair_of(dataset, CAMERA_MODALITIES)
    return with_pair(dataset, CAMERA_MODALITIES, inverse(_relative_pose(dataset, first, second, fixed=fixed)))


def opencv_version(_: Dataset) -> str:
    """Return the implementation used."""
    return f"OpenCV {optional('cv2', USER_NAME).__version__}"


def why_not_stereo(dataset: Dataset) -> str | None:
    """Return the reason why the method does not apply to a dataset, in one line; None if it does."""
    reason = why_not_pair(dataset, CAMERA_MODALITIES, "cameras")
    if reason:
        return reason
    first, second = pair_of(dataset, CAMERA_MODALITIES)
    for sensor in (first, second):
        if sensor.camera is not None and sensor.camera.skew:
            return f"it knows no skew as that of '{sensor.name}'"
        if sensor.camera is not None and not isinstance(sensor.camera.distortion, (PlumbBob, Rational)):
            return f"it knows no lens {sensor.camera.distortion.ros_name} as that of '{sensor.name}'"
    views = len(_common_views(dataset, first, second))
    if views < MINIMUM_VIEWS:
        return (
            f"it needs {MINIMUM_VIEWS} views of {MINIMUM_CORNERS} corners seen by both cameras, and there are {views}"
        )
    return None


View = tuple[Array, Array, Array]
"""Corners (K, 3) in the pattern's frame, their pixels (K, 2) in the first camera and in the second; float32."""


def _common_views(dataset: Dataset, first: Sensor, second: Sensor) -> list[View]:
    """Return the common views of both cameras: whole patterns if there are enough, else their common corners."""
    views: list[tuple[bool, View]] = []
    for collection in dataset.collections:
        for pattern in dataset.patterns.values():
            a, b = (collection.labels.get((pattern.name, sensor.name)) for sensor in (first, second))
            if not isinstance(a, CornerLabels) or not isinstance(b, CornerLabels):
                continue
            ids, in_a, in_b = np.intersect1d(a.ids, b.ids, assume_unique=True, return_indices=True)
            if len(ids) >= MINIMUM_CORNERS:
                view = (pattern.corners[ids], a.pixels[in_a], b.pixels[in_b])
                views.append((len(ids) == len(pattern.corners), view))
    complete = [view for whole, view in views if whole]
    return complete if len(complete) >= MINIMUM_VIEWS else [view for _, view in views]


def _relative_pose(dataset: Dataset, first: Sensor, second: Sensor, *, fixed: bool) -> Array:
    """Estimate ``T_second_first`` (4, 4) by OpenCV."""
    cv2 = optional("cv2", USER_NAME)
    corners, *pixels = (
        [np.float32(array) for array in arrays] for arrays in zip(*_common_views(dataset, first, second), strict=True)
    )
    intrinsics = [part for s in (first, second) if s.camera for part in (s.camera.K, s.camera.distortion.coefficients)]
    size = (first.camera.width, first.camera.height) if first.camera is not None else None
    flags = cv2.CALIB_FIX_INTRINSIC if fixed else cv2.CALIB_USE_INTRINSIC_GUESS
    if any(s.camera and isinstance(s.camera.distortion, Rational) for s in (first, second)):
        flags |= cv2.CALIB_RATIONAL_MODEL
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 100, 1e-5)
    try:
        answer = cv2.stereoCalibrate(corners, *pixels, *intrinsics, size, flags=flags, criteria=criteria)
    except cv2.error as error:
        raise UndeterminedError(
            f"{dataset.path}: OpenCV's stereo calibration: {' '.join(str(error).split())}"
        ) from None
    R, t = answer[5], answer[6]
    T: Array = transform(R, np.ravel(t))
    if not np.isfinite(T).all():
        raise UndeterminedError(f"{dataset.path}: OpenCV's stereo calibration finds no finite pose")
    return T


MAX_MATCH_DISTANCE_M = 0.1
"""Largest distance of matched points, m."""
MINIMUM_POINTS = 10
"""Minimum of points of a view."""
MOST_POINTS = 1000
"""Maximum of points of a view; of more, an evenly spaced subset is used."""
MAX_ITERATIONS = 100
MAX_SETTLED_CHANGE = 1e-3
"""Convergence limit on the change of the fraction of matched points and on the relative change of their error."""

Clouds = tuple[Array, Array]
"""Points on the pattern of the first sensor (N, 3) and of the second (M, 3), each in its own frame."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Result of ICP."""

    T_first_second: Array
    rms: float
    """Root mean square distance of the matched points, m; infinite without matches."""


def icp(dataset: Dataset, result: Literal["together", "average", "best"] = "together") -> Dataset:
    """Calibrate the second sensor by ICP and return the new dataset.

    Args:
        dataset: the views, and the initial guess.
        result: of all collections at once; the mean of the poses of each collection; that of the one that fits best.

    Raises:
        InputError: the method does not apply (`why_not_icp`).
        UndeterminedError: no points match at the initial guess.
    """
    if reason := why_not_icp(dataset):
        raise InputError(f"{dataset.path}: ICP does not apply: {reason}")
    first, second = pair_of(dataset, RANGE_SENSORS)
    views, start = _cloud_pairs(dataset), dataset.transform(first.frame, second.frame)[0]
    groups = [views] if result == "together" else [[view] for view in views]
    good = [each for group in groups if np.isfinite((each := align(group, start)).rms)]
    if not good:
        raise UndeterminedError(
            f"{dataset.path}: ICP finds no points within {MAX_MATCH_DISTANCE_M} m of each other; "
            "it starts from the dataset's transforms, which lie too far off"
        )
    T = min(good, key=lambda alignment: alignment.rms).T_first_second
    if result == "average":
        mean = np.stack([alignment.T_first_second for alignment in good]).mean(0)
        T = transform(rotations.nearest(mean[:3, :3]), mean[:3, 3])
    return with_pair(dataset, RANGE_SENSORS, T)


def why_not_icp(dataset: Dataset) -> str | None:
    """Return the reason why the method does not apply to a dataset, in one line; None if it does."""
    reason = why_not_pair(dataset, RANGE_SENSORS, "LiDARs or depth cameras")
    if reason is None and not _cloud_pairs(dataset):
        return f"it needs a view of {MINIMUM_POINTS} points by both sensors, and there is none"
    return reason


def align(views: list[Clouds], start: Array) -> Alignment:
    """Return the pose that aligns the second sensor's points with the first's.

    Args:
        views: with the same relative pose.
        start: ``T_first_second`` (4, 4).
    """
    T, before = start, (-1.0, np.inf)
    total = sum(len(second) for _, second in views)
    for _ in range(MAX_ITERATIONS):
        to, come = _match_points(views, T)
        if not len(to):
            return Alignment(T, np.inf)
        T = _rigid_transform(to, come)
        now = len(to) / total, float(np.sqrt(((apply(T, come) - to) ** 2).sum(-1).mean()))
        if abs(now[0] - before[0]) < MAX_SETTLED_CHANGE and abs(now[1] - before[1]) <= MAX_SETTLED_CHANGE * before[1]:
            break
        before = now
    return Alignment(T, now[1])


def _match_points(views: list[Clouds], T: Array) -> tuple[Array, Array]:
    """Return pairs of nearest points: the first's, and the second's in its own frame, (K, 3) each."""
    to, come = [], []
    for first, second in views:
        moved = apply(T, second)
        partner = first[nearest(moved, first)]
        near = np.linalg.norm(partner - moved, axis=-1) < MAX_MATCH_DISTANCE_M
        to.append(partner[near])
        come.append(second[near])
    return np.concatenate(to), np.concatenate(come)


def _rigid_transform(to: Array, come: Array) -> Array:
    """Return the transform that maps points to others, by least squares (K. Arun et al., 1987)."""
    centre, origin = to.mean(0), come.mean(0)
    R = rotations.nearest((to - centre).T @ (come - origin))
    return transform(R, centre - R @ origin)


def _cloud_pairs(dataset: Dataset) -> list[Clouds]:
    names = [sensor.name for sensor in pair_of(dataset, RANGE_SENSORS)]
    views = []
    for collection in dataset.collections:
        for pattern in dataset.patterns:
            first, second = (collection.labels.get((pattern, name)) for name in names)
            if (
                isinstance(first, PointLabels)
                and isinstance(second, PointLabels)
                and min(len(first.points), len(second.points)) >= MINIMUM_POINTS
            ):
                views.append((_thin_points(first.points), _thin_points(second.points)))
    return views


def _thin_points(points: Array) -> Array:
    count = min(len(points), MOST_POINTS)
    return points[np.arange(count) * len(points) // count]
