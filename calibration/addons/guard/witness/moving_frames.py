"""Cameras of a bag with the motion of what carries them, by its frames and joints and the accepted calibration."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from calibration.addons.guard.features import Features, find_features
from calibration.addons.guard.keeping import accepted_camera
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.witness.checks import POSE_NOISE, MovingCamera, check_by_each_other, check_by_motion
from calibration.addons.guard.witness.recorded_frames import RecordedFrames, evenly_chosen
from calibration.base.arrays import Array, IntArray
from calibration.base.errors import InputError
from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument
from calibration.engine.geometry.cameras import Camera
from calibration.robot.importing.bags.bag import NS_PER_S, Bag, open_bag
from calibration.robot.importing.bags.survey import SensorTopic, Survey, cameras_of, survey
from calibration.robot.importing.bags.video_packets import ImageReader
from calibration.robot.importing.description import Bags, ImportDescription
from calibration.robot.labelling.detection import grey

MAX_APART = 0.03
"""s: limit of the time between two images that are taken for one moment."""
LENS_SIGMAS = np.array([5e-4, 1e-3, 1e-3])
"""Standard deviations of the relative focal length and the principal point, in focal lengths, if nobody knows them."""
NO_WITNESS = (
    "nothing that moves carries it, no other camera sees the same, and it has no reference (accept --reference)"
)


def checks_of_bag(path: Path, accepted: CalibrationDocument, skipped: Sequence[str] = ()) -> Iterator[SensorCheck]:
    """Check the accepted cameras of a bag by the motion that carries them, else by each other.

    Args:
        path: the bag.
        accepted: the calibration.
        skipped: sensors that need no check.

    Raises:
        InputError: the bag cannot be read.
    """
    with open_bag([path]) as bag:
        if not cameras_of(bag):
            return
        found = survey(bag, ImportDescription((), bags=Bags((path,))))
        carried = _Carried(bag, found, accepted)
        cameras = [each for each in accepted.poses if each.sensor in found.cameras and each.sensor not in skipped]
        said: dict[str, SensorCheck] = {}
        for pose in cameras:
            try:
                if carried.moves(pose):
                    said[pose.name] = check_by_motion(carried.camera(pose), POSE_NOISE)
            except InputError as error:
                said[pose.name] = _untold(pose.name, str(error))
        open_ones = {each.name for each in cameras} - {
            name for name, each in said.items() if each.outcome != "cannot-tell"
        }
        pairs = [pair for pair in combinations(cameras, 2) if open_ones & {each.name for each in pair}]
        found_of_pairs = [of for pair in pairs if (of := carried.check_pair(*pair)) is not None]
        for check in blamed(found_of_pairs):
            if check.sensor in open_ones and (check.outcome != "cannot-tell" or check.sensor not in said):
                said[check.sensor] = check
    yield from said.values()
    yield from (_untold(each.name, NO_WITNESS) for each in cameras if each.name not in said)


def blamed(pairs: Sequence[tuple[str, SensorCheck]]) -> list[SensorCheck]:
    """Return what pairs of cameras say of each: one that has moved differs from all others, which agree.

    Args:
        pairs: the first camera of each pair, and what was found of the second relative to it.
    """
    found: dict[str, SensorCheck] = {}
    reds = [name for first, check in pairs if check.red for name in (first, check.sensor)]
    greens = {name for first, check in pairs if check.outcome == "unmoved" for name in (first, check.sensor)}
    for first, check in sorted(pairs, key=lambda pair: not pair[1].red):
        for name, other in ((check.sensor, first), (first, check.sensor)):
            if not check.red:
                found.setdefault(name, replace(check, sensor=name, method=f"what {other} sees too"))
            elif reds.count(name) >= reds.count(other) and name not in greens:
                tie = "" if reds.count(name) > reds.count(other) or other in greens else f", or {other} has moved"
                if name not in found and not (tie and other in found):
                    moved = replace(check, sensor=name, reason=f"{check.reason}{tie}")
                    found[name] = moved if name == check.sensor else _seen_from_other(moved, other)
    return list(found.values())


def _seen_from_other(check: SensorCheck, other: str) -> SensorCheck:
    """Return what was found of a pair's second camera as that of the first, whose axes it is not in."""
    return replace(
        check,
        method=f"what {other} sees too",
        reason=f"{other} seen from it {check.reason.removeprefix('it ')}: it has moved itself, as {other} fits others",
        rotation_deg=None, rotation_sigma_deg=None, translation_mm=None, translation_sigma_mm=None,
    )  # fmt: skip


def lens_sigmas(accepted: CalibrationDocument, sensor: str) -> Array:
    """Return the standard deviations (3,) of a camera's relative focal length and principal point."""
    lens = accepted.lens(sensor)
    if lens is None:
        return LENS_SIGMAS
    _, values, C = lens
    return np.asarray(np.sqrt(np.diag(C)[[0, 2, 3]]) / values[0])


def _untold(sensor: str, reason: str) -> SensorCheck:
    return SensorCheck(sensor=sensor, method="a witness", outcome="cannot-tell", reason=reason)


class _Carried:
    """Cameras of a bag, and the frames that carry them."""

    def __init__(self, bag: Bag, found: Survey, accepted: CalibrationDocument) -> None:
        self._bag, self._found, self._accepted = bag, found, accepted
        self._frames = RecordedFrames(found.log, accepted)

    def moves(self, pose: CalibratedPose) -> bool:
        """Whether what carries a camera moves."""
        return self._frames.moves(self._frames.root(pose.parent), pose.parent)

    def camera(self, pose: CalibratedPose, stamps: IntArray | None = None) -> MovingCamera:
        """Return what a camera saw, evenly over the recording or at some stamps, ns, and where its link was.

        Raises:
            InputError: its lens or a frame is not known, or an image cannot be decoded.
        """
        topic = self._found.cameras[pose.sensor or ""]
        camera = self._camera(topic, pose)
        every = np.array(sorted(topic.stamps.values()))
        chosen = evenly_chosen(every) if stamps is None else every[np.abs(every[:, None] - stamps).argmin(0)]
        carriage = self._frames.carriage(pose, topic.frame, chosen, topic.topic)
        chosen = carriage.stamps
        features = self._features(topic, camera, chosen.tolist())
        return MovingCamera(
            pose.name,
            camera,
            lens_sigmas(self._accepted, pose.name),
            carriage.T_link_sensor,
            carriage.covariance,
            (chosen - chosen[0]) / NS_PER_S,
            features,
            carriage.T_root_link,
            carriage.velocities,
        )

    def check_pair(self, one: CalibratedPose, other: CalibratedPose) -> tuple[str, SensorCheck] | None:
        """Check two cameras by each other; None if they move relative to each other, or have no images at one time."""
        try:
            if self._frames.moves(one.parent, other.parent):
                return None
            stamps = [np.array(sorted(self._found.cameras[each.name].stamps.values())) for each in (one, other)]
            chosen = evenly_chosen(stamps[0])
            apart = np.abs(stamps[1][:, None] - chosen).min(0)
            chosen = chosen[apart <= MAX_APART * NS_PER_S]
            if not len(chosen):
                return None
            first, second = self.camera(one, chosen), self.camera(other, chosen)
            T = self._frames.transform(one.parent, other.parent, float(chosen[0]))
            return one.name, check_by_each_other(first, replace(second, T_root_link=first.T_root_link @ T))
        except InputError as error:
            return one.name, _untold(other.name, str(error))

    def _camera(self, topic: SensorTopic, pose: CalibratedPose) -> Camera:
        if topic.camera is None:
            raise InputError(f"{self._bag.path}: {topic.topic}: found no camera_info beside it, expected its lens")
        return accepted_camera(topic.camera, self._accepted, pose.name)

    def _features(self, topic: SensorTopic, camera: Camera, stamps: Sequence[int]) -> list[Features]:
        recorded = {stamp: at for at, stamp in topic.stamps.items()}
        reader = ImageReader(self._bag, self._found.key_frames)
        found: list[Features] = []
        for stamp in stamps:
            _, decode = next(iter(reader.images({topic.topic}, recorded[stamp], recorded[stamp] + 1)))
            image = grey(decode())
            if image.shape != (camera.height, camera.width):
                raise InputError(
                    f"{self._bag.path}: {topic.topic}: found images of {image.shape[1]} x {image.shape[0]} pixels, "
                    f"expected {camera.width} x {camera.height}"
                )
            found.append(find_features(image))
        return found
