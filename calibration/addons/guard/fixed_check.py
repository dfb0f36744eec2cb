"""Fixed cameras over a recording: what is kept of them at ``accept --reference``, and whether one has moved since.

The images of a recording are a series with levels, and the answer is in words.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import cast

import numpy as np

from calibration.addons.guard.features import (
    REFERENCE_FILE,
    KeptCamera,
    Reference,
    encoded_features,
    find_features,
    read_reference,
    sharpness_at,
    stable_features,
)
from calibration.addons.guard.fixed_camera import FixedCamera, Level, View
from calibration.addons.guard.outcome import Placement, SensorCheck, direction_in_words, smallest_seen
from calibration.addons.guard.recording import CameraImages, camera_named, no_such_camera, open_recordings
from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.options import LensModel
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS
from calibration.engine.statistics import MAD_TO_SIGMA, change_points, noise_of
from calibration.pipeline.baselines import AcceptedSystems
from calibration.robot.labelling.detection import Image

METHOD = "its reference"
MAX_IMAGES = 90
"""Images of a camera that are looked at first, evenly chosen; then those about a change."""
IMAGE_STEP = 0.5
"""s: least time between them."""
MAX_IMAGES_ABOUT_CHANGE = 12
MIN_IMAGES = 3
"""Least number of images of a level."""
MAX_UNRECOGNISED_SHARE = 0.2
"""Share of the images, at the end, from which on nothing is said if they do not show the scene."""
MAX_FOREIGN_SHARE = 0.25
"""Share of images with texture that do not show the scene, from which on nothing is said."""
DARK = 12
"""Level of 255 that no tenth of a dark image exceeds."""
MIN_FEATURES = 40
"""Least number of features of an image with texture."""
STATED_NOISE_PX = 0.05
MIN_NOISE_PX = 0.03
"""px: lower limit of the noise of the series, in which people who pass move the mean by some hundredths."""
MIN_TAIL_PX = 1.0
"""px: from which on a few last images are not taken for noise."""
MAX_SPREAD_PX = 3.0
"""px: standard deviation about the levels from which on a camera is not fixed."""
MAX_UNSEEN_DEG = 0.2
"""Smallest rotation that must be seen, for a camera to be called unmoved."""
MIN_SHARPNESS_SHARE = 0.85
"""Share of the reference's sharpness at which the focus is another: a blur of 1.5 px; noise takes 5 %."""
STATED_SHARPNESS_NOISE = 0.02
MAX_REFERENCE_IMAGES = 30
SHARPNESS_IMAGES = 5


class _Seen:
    """What is seen of the reference in the images of a recording."""

    def __init__(self, kept: KeptCamera, images: CameraImages) -> None:
        self.kept, self.images = kept, images
        self.camera = FixedCamera(kept.camera, kept.features)
        self.views: list[View] = []
        self.lost: list[float] = []
        """Times of the images that do not show the scene of the reference."""
        self.dark = self.bare = 0
        self.sharpness: list[tuple[float, float]] = []
        """Times of images, and their sharpness."""

    def look(self, first: float, last: float, most: int) -> None:
        """Look at images from ``first`` to ``last``, s.

        Raises:
            InputError: an image has another size than the reference, or cannot be decoded.
        """
        known = {view.time for view in self.views} | set(self.lost)
        for time, image in self.images.read(first, last, most):
            if time not in known:
                self._add(time, image)
        self.views.sort(key=lambda view: view.time)
        self.sharpness.sort()

    def _add(self, time: float, image: Image) -> None:
        height, width = image.shape
        if (width, height) != (self.kept.width, self.kept.height):
            raise InputError(
                f"{self.images.place}: found images of {width} x {height} pixels, expected {self.kept.width} x "
                f"{self.kept.height} as the reference of '{self.kept.sensor}' has: another resolution is another camera"
            )
        features = find_features(image)
        view = self.camera.seen_in(features, time)
        if view is None:
            self.lost.append(time)
            self.dark += bool(np.quantile(image, 0.9) < DARK)
            self.bare += len(features) < MIN_FEATURES
            return
        self.views.append(view)
        self.sharpness.append((time, sharpness_at(image, view.pixels)))

    def all_changes(self) -> list[int]:
        """Return the indices of the views at which their level changes."""
        values = np.array([view.values for view in self.views]) / self.camera.units
        noise = noise_of(values, np.full(4, STATED_NOISE_PX))
        return change_points(values, np.clip(noise, MIN_NOISE_PX, STATED_NOISE_PX))  # one too many costs little

    def changes(self) -> list[int]:
        """Return those of `all_changes` that leave `MIN_IMAGES` in each level."""
        edges = [0]
        for at in self.all_changes():
            if at - edges[-1] >= MIN_IMAGES and len(self.views) - at >= MIN_IMAGES:
                edges.append(at)
        return edges[1:]

    def tail(self) -> list[View]:
        """Return the last views where they differ clearly, and are too few for a level."""
        last = self.views[(self.all_changes() or [len(self.views)])[-1] :]
        is_clear = any(np.abs(view.values / self.camera.units).max() > MIN_TAIL_PX for view in last)
        return last if len(last) < MIN_IMAGES and is_clear else []

    def spread_px(self) -> float:
        """Return the standard deviation of the images' values, by the median of their steps."""
        values = np.array([view.values for view in self.views]) / self.camera.units
        return float(MAD_TO_SIGMA / math.sqrt(2) * np.median(np.abs(np.diff(values, axis=0)), axis=0).max())

    def levels(self) -> tuple[list[Level], list[View]]:
        """Return the levels in their order, and the first views of those of which too little is seen."""
        edges = [0, *self.changes(), len(self.views)]
        parts = [self.views[a:b] for a, b in pairwise(edges)]
        found = [(part, self.camera.level(part, len(parts))) for part in parts]
        return [level for _, level in found if level is not None], [part[0] for part, level in found if level is None]


def check_fixed_camera(kept: KeptCamera, images: CameraImages) -> SensorCheck:
    """Compare the images of a fixed camera with its reference.

    Raises:
        InputError: images have another size than the reference, or cannot be decoded.
    """
    seen = _Seen(kept, images)
    if not seen.camera.is_distinct:
        few = f"the reference has {len(seen.camera.kept)} features that stay: is there no texture, or does all move?"
        return _untold(seen, few)
    seen.look(0.0, images.seconds, int(min(MAX_IMAGES, images.seconds / IMAGE_STEP + 1)))
    if why := _why_untold(seen):
        return _untold(seen, why)
    if (spread := seen.spread_px()) > MAX_SPREAD_PX:
        return _untold(seen, f"the camera moves all the time, by {spread:.1f} px: it is not fixed")
    for at in seen.all_changes():
        before, after = seen.views[at - 1].time, seen.views[at].time
        if after - before > IMAGE_STEP:
            seen.look(before, after, MAX_IMAGES_ABOUT_CHANGE)
    levels, unclear = seen.levels()
    if (moved := next((level for level in levels if level.differs), None)) is not None:
        return _moved(seen, levels, moved)
    unclear += seen.tail()
    if unclear:
        return _untold(seen, f"from {unclear[0].time:.1f} s on too little is seen to tell: too few images, or features")
    return _unmoved(seen, levels)


def _why_untold(seen: _Seen) -> str:
    """Return why nothing can be told; empty if something can."""
    lost, total = len(seen.lost), len(seen.lost) + len(seen.views)
    if len(seen.views) < MIN_IMAGES:
        if seen.dark > lost / 2:
            return f"{seen.dark} of {total} images are dark"
        if seen.bare > lost / 2:
            return f"{seen.bare} of {total} images have no texture"
        return (
            f"{lost} of {total} images do not show the scene of the reference: another robot or place, or turned far?"
        )
    foreign = lost - seen.dark - seen.bare
    if foreign > MAX_FOREIGN_SHARE * total:
        return f"{foreign} of {total} images do not show the scene of the reference: is the camera covered, or turned?"
    after = [time for time in seen.lost if time > seen.views[-1].time]
    if len(after) >= max(MIN_IMAGES, MAX_UNRECOGNISED_SHARE * total):
        return f"from {after[0]:.1f} s on the scene of the reference is not seen: covered, dark, or turned far away?"
    return ""


def _untold(seen: _Seen, why: str) -> SensorCheck:
    images = len(seen.views) + len(seen.lost)
    return SensorCheck(sensor=seen.kept.sensor, method=METHOD, outcome="cannot-tell", reason=why, images=images)


def _answer(seen: _Seen, level: Level, outcome: Placement, reason: str, since: float | None = None) -> SensorCheck:
    C, of = level.covariance, level.translation
    rotation, by = (level.values[:3], C[:3, :3]) if of is None else (of.rotation, of.covariance)
    return SensorCheck(
        sensor=seen.kept.sensor,
        method=METHOD,
        outcome=outcome,
        reason=reason,
        since=since,
        rotation_deg=_rounded(np.degrees(rotation)),
        rotation_sigma_deg=_rounded(np.degrees(np.sqrt(np.diagonal(by)))),
        translation_percent=None if of is None else _rounded(of.percent),
        focal_percent=round(100 * float(level.values[3]), 4),
        p=level.p,
        unseen_deg=round(_unseen_deg(level), 4),
        images=len(seen.views) + len(seen.lost),
    )


def _unseen_deg(level: Level) -> float:
    return float(np.degrees(smallest_seen(level.covariance, slice(3), level.limit)))


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{value:.4g}") for value in values)


def _unmoved(seen: _Seen, levels: list[Level]) -> SensorCheck:
    level = max(levels, key=_unseen_deg)
    if (unseen := _unseen_deg(level)) > MAX_UNSEEN_DEG:
        why = f"a turn of less than {unseen:.2f} deg would go unseen, expected {MAX_UNSEEN_DEG:g} at most"
        return _answer(seen, level, "cannot-tell", why)
    if (blurred := _blurred(seen)) is not None:
        since, share = blurred
        return _answer(seen, level, "lens-changed", f"out of focus: {1 - share:.0%} less sharp, {_when(since)}", since)
    return _answer(seen, level, "unmoved", f"a turn of {unseen:.2f} deg would be seen in 99 %")


def _blurred(seen: _Seen) -> tuple[float | None, float] | None:
    """Return since when the images are out of focus, and their share of the sharpness; None if they are not."""
    times, values = np.array(seen.sharpness).T
    values = values / max(seen.kept.sharpness, 1e-6)
    noise = np.maximum(noise_of(values[:, None], np.full(1, STATED_SHARPNESS_NOISE)), STATED_SHARPNESS_NOISE)
    for first, end in pairwise([0, *change_points(values[:, None], noise), len(values)]):
        share = float(np.median(values[first:end]))
        if end - first >= MIN_IMAGES and share < MIN_SHARPNESS_SHARE:
            return (None if first == 0 else round(float(times[first]), 2)), share
    return None


def _when(since: float | None) -> str:
    return "all along" if since is None else f"from {since:.1f} s on"


def _moved(seen: _Seen, levels: list[Level], moved: Level) -> SensorCheck:
    since = None if moved.since <= seen.views[0].time else round(moved.since, 2)
    when = _when(since)
    if after := [level for level in levels if level.since > moved.since and not level.differs]:
        when += f" until {after[0].since:.1f} s"
    what = "; ".join(_in_words(moved))
    return _answer(seen, moved, "lens-changed" if moved.is_zoom else "moved", f"{what}, {when}", since)


def _in_words(level: Level) -> Iterator[str]:
    """Yield what has changed."""
    focal, sigma = 100 * level.values[3], 100 * math.sqrt(level.covariance[3, 3])
    zoomed = f"its focal length has changed by {focal:+.2f} % (+- {sigma:.3f})"
    if level.is_zoom:
        yield zoomed
        return
    of = level.translation
    rotation, C = (level.values[:3], level.covariance) if of is None else (of.rotation, of.covariance)
    size, error = np.linalg.norm(rotation), math.sqrt(np.diagonal(C)[:3].max())
    direction = direction_in_words(rotation.tolist(), is_camera=True)
    yield f"turned by {math.degrees(size):.2f} deg (+- {math.degrees(error):.3f}) {direction}"
    if of is not None:
        axis = int(np.argmax(np.abs(of.percent)))
        sense = (("left", "right"), ("up", "down"), ("back", "forwards"))[axis][int(of.percent[axis] > 0)]
        yield f"moved {sense} by {np.linalg.norm(of.percent):.2f} % of the distance of what it sees"
    elif level.values[3] ** 2 > level.limit * level.covariance[3, 3]:
        yield zoomed


def kept_references(recordings: Sequence[str], accepted: AcceptedSystems) -> dict[Path, str]:
    """Return the reference of accepted systems, by its path.

    Args:
        recordings: bags, videos and folders in which nothing of the cameras moves, see `open_recordings`.
        accepted: the systems.

    Raises:
        InputError: a recording cannot be read, or a camera moves in it, or none of the cameras is in it.
    """
    cameras = {
        (system, name): accepted_camera(camera, accepted.baseline.systems[system], name)
        for system, dataset in accepted.datasets.items()
        for name, sensor in read_dataset(dataset).sensors.items()
        if (camera := sensor.camera) is not None
    }
    found = open_recordings(recordings)
    kept = []
    for (system, name), camera in cameras.items():
        if (images := camera_named(found, name, None, len(cameras))) is not None:
            kept.append(kept_camera(system, name, camera, images, accepted.baseline.systems[system].data))
    if not kept:
        raise InputError(f"{recordings[0]}: {no_such_camera(found, ', '.join(name for _, name in cameras))}")
    path = accepted.file.with_name(REFERENCE_FILE)
    return {path: (read_reference(path) or Reference(1, ())).updated(tuple(kept)).text}


def accepted_camera(camera: Camera, accepted: CalibrationDocument, name: str) -> Camera:
    """Return a camera with its accepted intrinsics, if these were calibrated."""
    if (lens := accepted.lens(name)) is None:
        return camera
    parameters, values, _ = lens
    models = [camera.distortion, *(model() for model in MODELS.values())]
    plain = next(found for each in models if (found := replace(camera, distortion=each)).parameters == parameters)
    return plain.with_intrinsics(values)


def kept_camera(system: str, sensor: str, camera: Camera, images: CameraImages, data: str) -> KeptCamera:
    """Return what a camera sees over a recording.

    Args:
        system: its system.
        sensor: its name.
        camera: its accepted intrinsics.
        images: of the recording.
        data: SHA-256 of the labels of the accepted calibration.

    Raises:
        InputError: the images cannot be read, have another size, or tell nothing of the camera, or it moves.
    """

    def checked() -> Iterator[Image]:
        for _, image in images.read(0.0, images.seconds, MAX_REFERENCE_IMAGES):
            if image.shape != (camera.height, camera.width):
                raise InputError(
                    f"{images.place}: found images of {image.shape[1]} x {image.shape[0]} pixels, expected "
                    f"{camera.width} x {camera.height} as the accepted calibration of '{sensor}' has"
                )
            yield image

    features, number = stable_features(checked())
    few = images.read(0.0, images.seconds, SHARPNESS_IMAGES) if len(features) else ()
    sharpness = [sharpness_at(image, features.pixels) for _, image in few]
    pixels, descriptors = encoded_features(features)
    kept = KeptCamera(
        system=system,
        sensor=sensor,
        data=data,
        place=images.place,
        width=camera.width,
        height=camera.height,
        model=cast("LensModel", camera.distortion.ros_name),
        intrinsics=tuple(camera.intrinsics.tolist()),
        skew=camera.skew,
        images=number,
        sharpness=round(float(np.median(sharpness)), 4) if sharpness else 0.0,
        pixels=pixels,
        descriptors=descriptors,
    )
    found = check_fixed_camera(kept, images)
    if found.outcome != "unmoved":
        raise InputError(f"{images.place}: '{sensor}' has no reference in it: {found.reason}")
    return kept
