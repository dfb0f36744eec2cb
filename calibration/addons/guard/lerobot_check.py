"""Whether the cameras of a dataset of robot learning stay where they are, between and within its episodes.

One answer a camera and episode, a table for the dataset's card, and the file ``meta/calibration.json`` of the dataset:
its accepted cameras, and what was found of each episode. There the lens is in ROS's order and names, so that a reader
needs no more than this file to project points.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np

from calibration.addons.guard.features import REFERENCE_FILE, KeptCamera, find_features, read_reference
from calibration.addons.guard.fixed_check import accepted_camera, check_fixed_camera, kept_camera
from calibration.addons.guard.lerobot_episodes import Episode, EpisodeVideo, SoughtFrame, episodes_of, frames_at
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.recording import CameraImages
from calibration.addons.guard.witness.checks import POSE_NOISE, MovingCamera, check_by_motion
from calibration.addons.guard.witness.moving_frames import LENS_SIGMAS
from calibration.addons.guard.witness.recorded_frames import MAX_MOMENTS, MOMENT_STEP
from calibration.base import InputError, read_json, write_atomically
from calibration.base.arrays import Array
from calibration.base.records import Misfit, between, field, length, read, record, text_of
from calibration.engine.baseline.calibration_document import CalibrationDocument, Name, Number, Positive, Three
from calibration.engine.baseline.document import read_baseline
from calibration.engine.estimation.options import LensModel
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS
from calibration.engine.geometry.rotations import from_quaternion, from_rpy
from calibration.engine.geometry.transforms import from_xyz_rpy, local, transform
from calibration.robot.labelling.detection import Image

CALIBRATION_FILE = Path("meta", "calibration.json")
MAX_CALIBRATION_BYTES = 16_000_000
Pixels = Annotated[int, between(1, 100_000)]
MAX_EPISODES = 500
"""Episodes that are looked at, evenly chosen."""
IMAGES_OF_EPISODE = 8
"""Images of a fixed camera in an episode that are looked at first."""
LONGEST_SECONDS = 3600.0
"""s: an episode whose video says no length is looked at up to here."""
FOCAL_OF_WIDTH = 0.9
"""Focal length of a camera of which nobody knows it, in widths of its image: 58 degrees of view."""
PART_OF_COLUMN = re.compile(r"\[(\d{1,4}):(\d{1,4})\]$")
"""Of the name of a column: those of its numbers that are the pose."""
NO_DATA = "0" * 64


@record(kw_only=True)
class DatasetCamera:
    """A camera of a dataset, as accepted."""

    sensor: Name = field("Its name in the baseline.")
    width: Pixels = field("Of its images.", unit="px")
    height: Pixels = field("Of its images.", unit="px")
    model: LensModel = field("Lens model, as ROS names it.")
    intrinsics: Annotated[tuple[Number, ...], length(4, 40)] = field("fx, fy, cx, cy and the coefficients.")
    parent: Name | None = field("The frame in which its pose is: of a camera in the hand, the hand.", default=None)
    child: Name | None = field("Its own frame.", default=None)
    xyz_mm: Three | None = field("Its translation there.", unit="mm", default=None)
    rpy_deg: Three | None = field("Its rotation, as roll, pitch and yaw.", unit="degrees", default=None)
    sigma_mm: tuple[Positive, ...] | None = field("Standard deviations of the translation.", unit="mm", default=None)
    sigma_deg: tuple[Positive, ...] | None = field("And of the rotation.", unit="degrees", default=None)
    pose_column: Name | None = field(
        "Column with the pose of its parent in a frame that stands: x, y, z and roll, pitch, yaw, or a quaternion "
        "xyzw; of a camera that is carried. NAME[0:6] of one with more numbers.",
        default=None,
    )

    def __post_init__(self) -> None:
        """Refuse a lens of another number of parameters, and a carried camera without its mount.

        Raises:
            Misfit: names the key.
        """
        if len(self.intrinsics) != len(self.camera.parameters) or min(self.intrinsics[:2]) <= 0:
            raise Misfit(f"expected {', '.join(self.camera.parameters)}, with focal lengths above 0", "intrinsics")
        if self.pose_column is not None and (self.xyz_mm is None or self.rpy_deg is None):
            raise Misfit("found a column of poses, expected the camera's place there: xyz-mm and rpy-deg")

    @property
    def camera(self) -> Camera:
        """The camera."""
        plain = Camera(1.0, 1.0, 0.0, 0.0, self.width, self.height, MODELS[self.model]())
        return plain.with_intrinsics(np.array(self.intrinsics))

    @property
    def T_parent_camera(self) -> Array:
        """Its pose (4, 4); the identity if none is known."""
        return from_xyz_rpy(1e-3 * np.array(self.xyz_mm or (0, 0, 0)), np.radians(self.rpy_deg or (0, 0, 0)))

    @property
    def covariance(self) -> Array:
        """Covariance (6, 6) of its pose, m and rad; 0 where none is known."""
        sigmas = [*(1e-3 * np.array(self.sigma_mm or [0] * 3)), *np.radians(self.sigma_deg or [0] * 3)]
        return np.diag(np.square(sigmas))


@record
class DatasetCalibration:
    """What is accepted of the cameras of a dataset."""

    version: Literal[1] = field("Version of this format.")
    cameras: Annotated[Mapping[Name, DatasetCamera], length(0, 1000)] = field("By the keys of their features.")
    episodes: Annotated[Mapping[Name, Mapping[Name, str]], length(0, 1_000_000)] = field(
        "What a check said of each episode and camera.", default_factory=dict
    )


def read_dataset_calibration(path: Path) -> DatasetCalibration:
    """Read the file of a dataset; empty if there is none.

    Raises:
        InputError: it is not valid; names file and key.
    """
    if path.is_symlink():
        raise InputError(f"{path}: found a symbolic link, expected the file itself")
    if not path.exists():
        return DatasetCalibration(1, {})
    return read(DatasetCalibration, read_json(path, MAX_CALIBRATION_BYTES, "a dataset's calibration"), str(path))


def write_dataset_calibration(
    folder: Path, known: DatasetCalibration, checks: Mapping[str, tuple[SensorCheck, ...]]
) -> None:
    """Write what was checked into the file of a dataset.

    Raises:
        InfrastructureError: it cannot be written.
    """
    episodes = {name: {each.sensor: each.outcome for each in found} for name, found in checks.items()}
    written = DatasetCalibration(1, known.cameras, {**known.episodes, **episodes})
    write_atomically(folder / CALIBRATION_FILE, text_of(written))


def camera_of_dataset(
    sensor: str, camera: Camera, accepted: CalibrationDocument, pose_column: str | None = None
) -> DatasetCamera:
    """Return a camera of a dataset from an accepted calibration."""
    lens = accepted_camera(camera, accepted, sensor)
    pose = next((each for each in accepted.poses if each.sensor == sensor), None)
    return DatasetCamera(
        sensor=sensor,
        width=lens.width,
        height=lens.height,
        model=cast("LensModel", lens.distortion.ros_name),
        intrinsics=tuple(lens.intrinsics.tolist()),
        parent=pose.parent if pose else None,
        child=pose.child if pose else None,
        xyz_mm=pose.xyz_mm if pose else None,
        rpy_deg=pose.rpy_deg if pose else None,
        sigma_mm=pose.sigma_mm if pose else None,
        sigma_deg=pose.sigma_deg if pose else None,
        pose_column=pose_column,
    )


def check_dataset(
    folder: Path,
    known: DatasetCalibration,
    kept: Sequence[KeptCamera],
) -> dict[str, tuple[SensorCheck, ...]]:
    """Check the cameras of each episode, by the name of the episode.

    A fixed camera is compared with its accepted reference, else with what it saw in the first episode; one that is
    carried is checked by the motion that its column of poses says.

    Args:
        folder: of the dataset.
        known: what ``meta/calibration.json`` says of its cameras.
        kept: references of accepted cameras.

    Raises:
        InputError: the dataset cannot be read.
        InfrastructureError: a library is not installed.
    """
    references: dict[str, KeptCamera | str] = {}
    found: dict[str, tuple[SensorCheck, ...]] = {}
    for episode in episodes_of(folder, MAX_EPISODES):
        checks = []
        for key, video in episode.videos.items():
            camera = known.cameras.get(key)
            if camera is not None and camera.pose_column is not None:
                checks.append(_check_carried(key, camera, episode, video))
                continue
            if key not in references:
                references[key] = _reference(key, kept, camera, video)
            reference = references[key]
            if isinstance(reference, str):
                checks.append(_untold(key, reference))
            else:
                checks.append(replace(check_fixed_camera(reference, _images_of_episode(video)), sensor=key))
        found[episode.name] = tuple(checks)
    return found


def check_folder(folder: Path, baseline: Path, annotate: bool) -> dict[str, tuple[SensorCheck, ...]]:
    """Check a dataset by what is accepted of its cameras, if anything is.

    Args:
        folder: of the dataset.
        baseline: file of the accepted calibrations, with the reference beside it; either may be absent.
        annotate: whether what is accepted, and what was found, is written into the dataset.

    Raises:
        InputError: a file or the dataset cannot be read.
        InfrastructureError: a library is not installed, or a file cannot be written.
    """
    known, reference = (
        read_dataset_calibration(folder / CALIBRATION_FILE),
        read_reference(baseline.with_name(REFERENCE_FILE)),
    )
    accepted, kept = read_baseline(baseline), reference.cameras if reference else ()
    found = check_dataset(folder, known, kept)
    if annotate:
        cameras = dict(known.cameras)
        for key in dict.fromkeys(each.sensor for checks in found.values() for each in checks):
            for each in kept:
                if each.sensor in _names_of_camera(key) and accepted and each.system in accepted.systems:
                    cameras.setdefault(key, camera_of_dataset(each.sensor, each.camera, accepted.systems[each.system]))
        write_dataset_calibration(folder, replace(known, cameras=cameras), found)
    return found


def card_table(checks: Mapping[str, tuple[SensorCheck, ...]]) -> str:
    """Return a table in Markdown for the card of a dataset: a row for episodes in a row of the same outcome."""
    lines = ["| camera | episodes | calibration | what was found |", "| --- | --- | --- | --- |"]
    for key in dict.fromkeys(each.sensor for found in checks.values() for each in found):
        own = [(name, each) for name, found in checks.items() for each in found if each.sensor == key]
        for _, run in groupby(own, lambda pair: (pair[1].outcome, pair[1].outcome == "unmoved" or pair[1].reason)):
            rows = list(run)
            names = rows[0][0] if len(rows) == 1 else f"{rows[0][0]} to {rows[-1][0]}"
            worst = max((each for _, each in rows), key=lambda each: each.unseen_deg or 0.0)
            cells = (key, names, worst.outcome.replace("-", " "), worst.reason)
            lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return "\n".join(lines) + "\n"


def _untold(sensor: str, reason: str) -> SensorCheck:
    return SensorCheck(sensor=sensor, method="the first episode", outcome="cannot-tell", reason=reason)


def _images_of_episode(video: EpisodeVideo) -> CameraImages:
    """Return the images of an episode; those of the same times are decoded once."""
    seconds = video.seconds
    if math.isinf(seconds):
        first = next(frames_at(video.path, [0.0]), None)
        seconds = min(first.seconds if first else 0.0, LONGEST_SECONDS)

    @cache
    def frames(first: float, last: float, most: int) -> list[SoughtFrame]:
        times = video.begin + np.unique(np.linspace(first, min(last, seconds), most))
        return list(frames_at(video.path, times.tolist()))

    def read(first: float, last: float, most: int) -> Iterator[tuple[float, Image]]:
        for each in frames(first, last, min(most, IMAGES_OF_EPISODE)):
            yield each.time - video.begin, each.image

    return CameraImages(str(video.path), seconds, read)


def _reference(
    key: str, kept: Sequence[KeptCamera], camera: DatasetCamera | None, video: EpisodeVideo
) -> KeptCamera | str:
    """Return what a camera saw when it was accepted, else in an episode; or why that is none."""
    names = _names_of_camera(key) | ({camera.sensor} if camera else set())
    if of_name := [each for each in kept if each.sensor in names]:
        return of_name[0]
    images = _images_of_episode(video)
    try:
        lens = camera.camera if camera else _nominal_camera(images)
        return kept_camera("dataset", key, lens, images, NO_DATA)
    except InputError as error:
        return str(error)


def _names_of_camera(key: str) -> set[str]:
    """Return the names that a sensor may have in a baseline: observation.images.top is top."""
    return {key, key.rpartition(".")[2]}


def _nominal_camera(images: CameraImages) -> Camera:
    for _, image in images.read(0.0, images.seconds, IMAGES_OF_EPISODE):
        height, width = image.shape
        focal = FOCAL_OF_WIDTH * width
        return Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)
    raise InputError(f"{images.place}: found no image, expected a video")


def _check_carried(key: str, camera: DatasetCamera, episode: Episode, video: EpisodeVideo) -> SensorCheck:
    name, *part = PART_OF_COLUMN.split(camera.pose_column or "")
    times, values = episode.column(name)
    values = values[:, slice(*map(int, filter(None, part)))] if part else values
    T = _poses_of_column(values, f"{episode.data}: {camera.pose_column}")
    number = min(MAX_MOMENTS, int((times[-1] - times[0]) / MOMENT_STEP) + 1)
    wanted = np.linspace(times[0], times[-1], number)
    frames = list(frames_at(video.path, (video.begin + wanted - times[0]).tolist()))
    if any(each.image.shape != (camera.height, camera.width) for each in frames):
        raise InputError(f"{video.path}: found no images of {camera.width} x {camera.height} pixels, as {key} has")
    at = np.array([np.abs(times - times[0] - (each.time - video.begin)).argmin() for each in frames], int)
    before, after = np.maximum(at - 1, 0), np.minimum(at + 1, len(times) - 1)
    seen = MovingCamera(
        key,
        camera.camera,
        LENS_SIGMAS,
        camera.T_parent_camera,
        camera.covariance,
        times[at] - times[0],
        [find_features(each.image) for each in frames],
        T[at],
        local(T[before], T[after]) / np.maximum(times[after] - times[before], 1e-3)[:, None],
    )
    return check_by_motion(seen, POSE_NOISE)


def _poses_of_column(values: Array, where: str) -> Array:
    """Return poses (n, 4, 4) from x, y, z and roll, pitch, yaw, or a quaternion xyzw."""
    if values.shape[1] == 6:
        return transform(from_rpy(values[:, 3:]), values[:, :3])
    if values.shape[1] == 7 and (np.linalg.norm(values[:, 3:], axis=1) > 0.5).all():
        return transform(from_quaternion(values[:, 3:]), values[:, :3])
    raise InputError(f"{where}: found {values.shape[1]} numbers a row, expected a pose: 6, or 7 with a quaternion xyzw")
