"""Try other conventions where the labels do not fit, and name the one by which they do."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.pattern import UNMARKED_KINDS
from calibration.engine.diagnosis.conventions.arm_hypotheses import (
    FEWEST_POSES,
    joints,
    other_rotations,
    robot_poses,
    scales,
)
from calibration.engine.diagnosis.conventions.changed import (
    with_exchanged_cameras,
    with_exchanged_labels,
    with_later_labels,
    with_mirrored,
    with_mirrored_numbering,
)
from calibration.engine.diagnosis.conventions.hypotheses import (
    Hypothesis,
    Misfit,
    Recording,
    improved,
    misfit,
    misfit_at,
)
from calibration.engine.diagnosis.finding import Finding, FindingKind, first_names
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.ambiguous_views import LOOKS_THE_SAME, trace_differences, with_turned
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.rotations import angle
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


Hypotheses = Callable[[Recording], Iterator[Hypothesis]]

HYPOTHESES_BY_PRIORITY: tuple[Hypotheses, ...] = (
    robot_poses,
    shifted,
    exchanged,
    scales,
    left_handed,
    turned_boards,
    lenses,
    joints,
)
"""In the order in which equally good ones are named."""
SLOW_HYPOTHESES: tuple[Hypotheses, ...] = (other_rotations,)
"""Tried where none of the others fits."""
WORTH_TRYING = 0.15
"""Misfit below which nothing is tried, in multiples of what is noticeable (1 px, 1 cm)."""
MAX_FITTING_MISFIT = 3.0
"""Misfit above which nothing fits, likewise."""
MAX_MISFIT_RATIO, MAX_MISFIT_RATIO_OF_POSES = 0.1, 0.2
"""Misfit of a convention that is named, relative to that of the recording as it is; of measured poses, whose own errors
no view tells."""
MAX_MISFIT_RATIO_WITHOUT_RESULT = 0.25
"""The same where there is no result as it is: an arm that errs by some mm fits no convention ten times better."""
BETTER_IN_NOISE, IN_NOISE = 0.5, 1.5
"""The same for a misfit that is as small, up to this factor, as that of each view's own fit."""
MAX_RATIO_TO_BEST = 2.0
"""Misfit of other conventions that are named with it, relative to the best."""
LEFT_OUT = 0.05
"""Share of views that a calibration may have left out to be a measure of the recording."""
MAX_REFINED_CONVENTIONS = 16
"""Number of conventions that are compared after a few steps from their linear start: those with the best of these."""
KINDS_THAT_CAST_DOUBT: tuple[FindingKind, ...] = ("contradiction",)
"""Findings, red or not, on which other conventions are tried;"""
KINDS_WITHOUT_DOUBT: tuple[FindingKind, ...] = ("precision", "too-few")
"""and red ones on which they are not: all may fit."""
MIN_DIFFERENCE_OF_OTHER_IMAGES = 0.5
"""Median difference of traces of an arm's rotations and of the pattern's, above which they are of different moments."""
MAX_NAMED_CONVENTIONS = 3
"""Number of conventions that fit alike that a message names."""


def conventions(calibration: Calibration | None, description: Dataset, options: Options) -> tuple[Finding, ...]:
    """Name the convention by which the labels of a recording fit ten times better than as it was read.

    Args:
        calibration: the result; None if there is none.
        description: the dataset, without the noise of an initial guess. It is not changed.
        options: options of the calibration.
    """
    now = _as_it_is(calibration, description, options)
    if now.noticed < WORTH_TRYING:
        return ()
    recording = Recording(description)
    better = MAX_MISFIT_RATIO_OF_POSES if recording.has_measured_poses else MAX_MISFIT_RATIO
    fitting: list[tuple[Hypothesis, Misfit]] = []
    tried: list[tuple[Hypothesis, Misfit]] = []
    for table in (HYPOTHESES_BY_PRIORITY, SLOW_HYPOTHESES):
        if not fitting:
            tried += _nearest_hypotheses(recording, table, options)
            fitting = [each for each in tried if _fits(each[1], now, better)]
    if not fitting and not _has_result(calibration):
        fitting = [each for each in tried if each[1].noticed < MAX_MISFIT_RATIO_WITHOUT_RESULT * now.noticed]
    if not fitting:
        return _poses_of_other_images(recording)
    best = min(found.noticed for _, found in fitting)
    alike = [each for each in fitting if each[1].noticed <= MAX_RATIO_TO_BEST * best]
    told = [h.told_apart(found) if h.told_apart else (h.name, h.remedy) for h, found in alike]
    sensors = tuple(dict.fromkeys(name for h, _ in alike for name in h.sensors))
    names = ", or ".join(dict.fromkeys(name for name, _ in told))
    remedies = "; or ".join(dict.fromkeys(remedy for _, remedy in told))
    fit = "fit" if _fits(alike[0][1], now, better) else "fit better, though not well"
    text = f"with {names}, the labels {fit}: {alike[0][1].text} (as they are: {now.text}); {remedies}"
    return (Finding("convention", "red", text, sensors),)


def _poses_of_other_images(recording: Recording) -> tuple[Finding, ...]:
    """Report an arm that turns by other angles than the pattern that it, or its camera, moves: by no mounting."""
    arm, view = recording.arm, recording.view
    if arm is None or view is None or len(view.collections) < FEWEST_POSES:
        return ()
    turned = recording.dataset.transforms[arm][view.collections][:, :3, :3]
    off = trace_differences(turned, view.seen[:, :3, :3])
    if np.median(off) < MIN_DIFFERENCE_OF_OTHER_IMAGES:
        return ()
    pair = np.unravel_index(off.argmax(), off.shape)
    by_arm, by_pattern = (np.degrees(angle(R[pair[0]].T @ R[pair[1]])) for R in (turned, view.seen[:, :3, :3]))
    first, second = (recording.dataset.collections[view.collections[i]].key for i in sorted(pair))
    text = (
        f"poses and images do not belong together: between collections {first} and {second} the robot turns by "
        f"{by_arm:.0f} deg, '{view.pattern}' as '{view.sensor}' sees it by {by_pattern:.0f} deg, and no convention or "
        "mounting makes these angles equal; does each pose stand with its own image, of this arm and this camera?"
    )
    return (Finding("convention", "red", text, (view.sensor,), (first, second)),)


def doubts(calibration: Calibration, found: tuple[Finding, ...]) -> bool:
    """Whether a result is bad enough to try other conventions, by what was found and by the residuals."""
    bad = any(
        f.kind in KINDS_THAT_CAST_DOUBT
        or (f.kind == "wrong-views" and (f.value or 0.0) > LEFT_OUT)
        or (f.severity == "red" and f.kind not in KINDS_WITHOUT_DOUBT)
        for f in found
    )
    return bad or not calibration.converged or _misfit_of_calibration(calibration).noticed > 1


def _as_it_is(calibration: Calibration | None, description: Dataset, options: Options) -> Misfit:
    """Return the misfit of the recording as it was read; of a calibration, if that is better."""
    found = misfit(description, options)
    if calibration is None or not _has_result(calibration):
        return found
    reached = _misfit_of_calibration(calibration)
    views = sum(len(collection.labels) for collection in description.collections)
    most_are_used = len(calibration.dropped_views) <= LEFT_OUT * views
    return reached if most_are_used and reached.noticed < found.noticed else found


def _misfit_of_calibration(calibration: Calibration) -> Misfit:
    return misfit_at(calibration.solution.setup, calibration.solution.values)


def _has_result(calibration: Calibration | None) -> bool:
    """Whether a calibration is one of all that was asked for."""
    return calibration is not None and calibration.converged and not calibration.not_determined


def _nearest_hypotheses(
    recording: Recording, table: Sequence[Hypotheses], options: Options
) -> list[tuple[Hypothesis, Misfit]]:
    """Return the hypotheses of a table by which a recording fits best, in its order, after a few steps."""
    tried = [
        (each, misfit(each.dataset(), options, steps=False)) for hypotheses in table for each in hypotheses(recording)
    ]
    nearest = sorted(found.noticed for _, found in tried if found.exists)[:MAX_REFINED_CONVENTIONS]
    return [(each, improved(found)) for each, found in tried if found.exists and found.noticed <= nearest[-1]]


def _fits(found: Misfit, now: Misfit, better: float) -> bool:
    limit = BETTER_IN_NOISE if found.above_noise < IN_NOISE else better
    return found.noticed < MAX_FITTING_MISFIT and found.noticed < limit * now.noticed
