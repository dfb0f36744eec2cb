"""Hypotheses on what sensors saw: when, with which lens, mirrored, by whose labels, from which end of a board."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.pattern import UNMARKED_KINDS
from calibration.engine.diagnosis.conventions.changed import (
    with_exchanged_cameras,
    with_exchanged_labels,
    with_later_labels,
    with_mirrored,
    with_mirrored_numbering,
)
from calibration.engine.diagnosis.conventions.misfit import Hypothesis
from calibration.engine.diagnosis.conventions.recording import Recording
from calibration.engine.diagnosis.finding import first_names
from calibration.engine.estimation.start.ambiguous_views import LOOKS_THE_SAME, with_turned
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import distance, inverse

COLLECTION_SHIFTS = (1, -1, 2, -2)
"""Collections by which images and poses may be shifted."""
RELATIVE_IMAGE_SIZES = (2.0, 0.5, 1.5, 2 / 3, 4 / 3, 0.75, 4.0, 0.25)
"""Sizes of images relative to those that intrinsics are of,"""
RELATIVE_IMAGE_WIDTHS = (2.0, 0.5)
"""and widths of those of which only the columns are binned."""
MAX_NAMED_COLLECTIONS = 4
"""Number of collections that a message names."""
MOST_SENSORS = 4
"""Number of sensors, or of pairs of them, of which each is tried."""


def shifted(recording: Recording) -> Iterator[Hypothesis]:
    """Yield images and poses, or the images of two sensors, of collections before or after."""
    dataset = recording.dataset
    every = tuple(dataset.sensors)
    groups: list[tuple[str, ...]] = [every] if recording.moving or len(every) == 1 else []
    groups += [(name,) for name in every[:MOST_SENSORS]] if len(every) > 1 else []
    for by in COLLECTION_SHIFTS:
        for sensors in groups:
            what = f"the views of '{sensors[0]}'" if len(sensors) < len(every) else "the views"
            than = "the robot's poses" if recording.moving else "those of the others"
            yield Hypothesis(
                f"{what} taken from {abs(by)} collection{'s' * (abs(by) > 1)} {'later' if by > 0 else 'earlier'}",
                f"pair them anew with {than}: one is missing or twice near the beginning",
                partial(with_later_labels, dataset, by, sensors),
                sensors,
            )


def exchanged(recording: Recording) -> Iterator[Hypothesis]:
    """Yield two cameras with each other's camera_info, or with each other's images."""
    dataset = recording.dataset
    for a, b in list(combinations(recording.cameras, 2))[:MOST_SENSORS]:
        yield Hypothesis(
            f"the camera_info of '{a}' and '{b}' exchanged",
            "give each camera its own file or topic of intrinsics",
            partial(with_exchanged_cameras, dataset, a, b),
            (a, b),
        )
        yield Hypothesis(
            f"the labels of '{a}' and '{b}' exchanged",
            "look at the topics or folders of the two sensors",
            partial(with_exchanged_labels, dataset, a, b),
            (a, b),
        )
        if keys := _exchanged_in_some(recording, a, b):
            yield Hypothesis(
                f"the labels of '{a}' and '{b}' exchanged in collections {first_names(keys, MAX_NAMED_COLLECTIONS)}",
                "look at what names their files, or the order of the two cameras, in these",
                partial(with_exchanged_labels, dataset, a, b, keys),
                (a, b),
            )


def _exchanged_in_some(recording: Recording, a: str, b: str) -> tuple[str, ...]:
    """Return the fewer collections in which two cameras seem to stand in each other's place: ``T_a_b`` is inverse."""
    dataset = recording.dataset
    for pattern in dataset.patterns:
        one, other = recording.seen_poses(a, pattern), recording.seen_poses(b, pattern)
        if one is None or other is None:
            continue
        both, i, j = np.intersect1d(one.collections, other.collections, return_indices=True)
        T_a_b = one.seen[i] @ inverse(other.seen[j])
        far = np.median(np.linalg.norm(one.seen[i, :3, 3], axis=-1))
        as_it_is, exchanged_ = (_pairwise_distances(T_a_b, each, far) for each in (T_a_b, inverse(T_a_b)))
        like = np.argmin(np.median(np.minimum(as_it_is, exchanged_), axis=1))  # the collection that is most like others
        in_these = exchanged_[like] < as_it_is[like]
        in_these = in_these if 2 * in_these.sum() <= len(both) else ~in_these
        if in_these.any():
            return tuple(dataset.keys[at] for at in both[in_these])
    return ()


def _pairwise_distances(T: Array, others: Array, far: float) -> Array:
    """Return how far apart poses (n, 4, 4) are from others (m, 4, 4), (n, m), m; angles at a distance."""
    metres, radians = distance(T[:, None], others[None])
    apart: Array = metres + far * radians
    return apart


def lenses(recording: Recording) -> Iterator[Hypothesis]:
    """Yield other intrinsics of each camera, and of all of them, as one driver or one file may be wrong for all."""
    found = {name: recording.dataset.sensors[name].camera for name in recording.cameras[:MOST_SENSORS]}
    cameras = {name: camera for name, camera in found.items() if camera is not None}
    yield from (each for name, camera in cameras.items() for each in _other_lenses(recording, {name: camera}))
    if len(cameras) > 1:
        yield from _other_lenses(recording, cameras)


def _other_lenses(recording: Recording, cameras: Mapping[str, Camera]) -> Iterator[Hypothesis]:
    """Yield intrinsics of another resolution, coefficients in another order, images that are rectified already."""
    of = " and ".join(f"'{name}'" for name in cameras)

    def hypothesis(name: str, remedy: str, changed: Mapping[str, Camera]) -> Hypothesis:
        return Hypothesis(name, remedy, partial(recording.dataset.with_cameras, changed), tuple(cameras))

    for by in RELATIVE_IMAGE_SIZES:
        yield hypothesis(
            f"the camera_info of {of} for images {by:.3g} times as large",
            "take the intrinsics of the resolution that was recorded",
            {name: _resized_camera(camera, by, by) for name, camera in cameras.items()},
        )
    for by in RELATIVE_IMAGE_WIDTHS:
        yield hypothesis(
            f"the camera_info of {of} for images {by:.3g} times as wide",
            "take the intrinsics of the resolution that was recorded, with the same binning of columns and rows",
            {name: _resized_camera(camera, by, 1.0) for name, camera in cameras.items()},
        )
    undistorted = {name: replace(camera, distortion=type(camera.distortion)()) for name, camera in cameras.items()}
    if undistorted == cameras:
        return
    if all(isinstance(camera.distortion, PlumbBob) for camera in cameras.values()):
        yield hypothesis(
            f"the distortion of {of} as k1, k2, k3, p1, p2",
            "write the coefficients in camera_info's order, k1, k2, p1, p2, k3",
            {name: _with_radial_first(camera) for name, camera in cameras.items()},
        )
    yield hypothesis(
        f"no distortion of {of}",
        "its images are rectified: give the intrinsics of rectified images (K from P, D zero), or the raw images",
        undistorted,
    )


def _resized_camera(camera: Camera, wide: float, high: float) -> Camera:
    return replace(camera, fx=wide * camera.fx, fy=high * camera.fy, cx=wide * camera.cx, cy=high * camera.cy)


def _with_radial_first(camera: Camera) -> Camera:
    """Return the camera with its five coefficients read as k1, k2, k3, p1, p2."""
    k1, k2, k3, p1, p2 = camera.distortion.coefficients.tolist()
    return replace(camera, distortion=PlumbBob(k1, k2, p1, p2, k3))


def turned_boards(recording: Recording) -> Iterator[Hypothesis]:
    """Yield boards that one of several cameras numbers from their other end."""
    dataset = recording.dataset
    for name, pattern in dataset.patterns.items():
        seeing = [s for s in recording.cameras if dataset.detections(name, s)]
        for sensor in seeing[:MOST_SENSORS] if len(seeing) > 1 and pattern.kind in UNMARKED_KINDS else ():
            yield Hypothesis(
                f"'{name}' turned by 180 degrees in the views of '{sensor}'",
                f"{LOOKS_THE_SAME}: number its corners from the same end in all cameras, or take a charuco board",
                partial(with_turned, dataset, name, sensor),
                (sensor,),
            )


def left_handed(recording: Recording) -> Iterator[Hypothesis]:
    """Yield sensors whose data are mirrored, and a robot's poses in left-handed frames, which is the same to them."""
    dataset = recording.dataset
    for name in [name for name, s in dataset.sensors.items() if not s.modality.has_poses][:MOST_SENSORS]:
        what, why = (
            ("images", "does a driver flip the images, or a detector number the corners from the other side?")
            if dataset.sensors[name].camera
            else ("points", "does an axis of the points' frame point the wrong way, or are two exchanged?")
        )
        said = f"the {what} of '{name}' mirrored back"
        back = with_mirrored(dataset, name)
        yield Hypothesis(said, why, partial(with_mirrored, dataset, name), (name,))
        boards = [board for board, pattern in dataset.patterns.items() if pattern.kind in UNMARKED_KINDS]
        for board in boards if name in recording.cameras else ():  # which look alike mirrored
            for across in (False, True):
                yield Hypothesis(
                    said,
                    why,
                    partial(with_mirrored_numbering, back, name, board, across),
                    (name,),
                )
    if recording.arm:
        arm, y = recording.arm, np.diag([1.0, -1.0, 1.0, 1.0])
        yield Hypothesis(
            "the robot's poses taken from a left-handed frame",
            "negate y, qx and qz in the file of poses",
            partial(dataset.with_transforms, {arm: y @ dataset.transforms[arm] @ y}),
        )
