"""OpenCV's stereo calibration: the relative pose of two cameras.

As in ATOM's comparison, OpenCV re-estimates the intrinsics from the given ones, which increases the
error of the extrinsics; the variant with fixed intrinsics shows by how much. Only the
relative pose is used: evaluations keep the dataset's own intrinsics.

With re-estimated intrinsics the results of OpenCV 4 and 5 differ, though the optimum is the same: 4 stops after ATOM's
limit of 100 iterations, near the given intrinsics; 5 converges within them, with a smaller reprojection error
and intrinsics further from those of the dataset. With enough iterations 4 converges there too (t2rgb: 0.097 px after
100 iterations, 0.287 px at the end, 0.290 px with OpenCV 5).
"""

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError, UndeterminedError
from calibration.base.optional import optional
from calibration.engine.comparison.sensor_pair import CAMERA_MODALITIES, pair_of, why_not_pair, with_pair
from calibration.engine.dataset.model import CornerLabels, Dataset, Sensor
from calibration.engine.geometry.lenses import PlumbBob, Rational
from calibration.engine.geometry.transforms import inverse, transform

USER_NAME = "OpenCV's stereo calibration"
MINIMUM_CORNERS = 6
"""Minimum of corners of a view. OpenCV starts from a homography, which four corners determine without redundancy."""
MINIMUM_VIEWS = 3
"""Minimum of views: from fewer of a plane the intrinsics cannot be estimated (Z. Zhang, 2000)."""


def opencv_stereo(dataset: Dataset) -> Dataset:
    """Calibrate the second camera by `cv2.stereoCalibrate` with re-estimated intrinsics and return the new dataset.

    Views in which both cameras see the whole pattern are used, as in ATOM; if there are fewer than
    `MINIMUM_VIEWS` of them, all views are used, with the corners that both cameras see.

    Raises:
        InputError: the method does not apply (`why_not_stereo`).
        UndeterminedError: OpenCV finds no solution.
        InfrastructureError: OpenCV is not installed.
    """
    return _calibrate_stereo(dataset, fixed=False)


def opencv_stereo_fixed(dataset: Dataset) -> Dataset:
    """Calibrate like `opencv_stereo`, with the intrinsics fixed to those of the dataset."""
    return _calibrate_stereo(dataset, fixed=True)


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


def _calibrate_stereo(dataset: Dataset, *, fixed: bool) -> Dataset:
    reason = why_not_stereo(dataset)
    if reason:
        raise InputError(f"{dataset.path}: OpenCV's stereo calibration does not apply: {reason}")
    first, second = pair_of(dataset, CAMERA_MODALITIES)
    return with_pair(dataset, CAMERA_MODALITIES, inverse(_relative_pose(dataset, first, second, fixed=fixed)))


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
