"""Cameras of a bag, by the motion of what carries them, by each other, and by the LiDARs beside them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from calibration.addons.guard.features import find_features
from calibration.addons.guard.fixed_check import accepted_camera
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.witness.checks import POSE_NOISE, MovingCamera, check_by_each_other, check_by_motion
from calibration.addons.guard.witness.depth_edges import CameraAndLidar, check_by_edges, stands_still
from calibration.addons.guard.witness.plane_map import cloud_at, cloud_topics, is_of
from calibration.addons.guard.witness.recorded_frames import RecordedFrames, evenly_chosen
from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument
from calibration.engine.dataset.modalities import LIDAR3D
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import adjoint, inverse
from calibration.robot.importing.bags.bag import NS_PER_S, Bag, open_bag
from calibration.robot.importing.bags.survey import SensorTopic, Survey, cameras_of, survey
from calibration.robot.importing.bags.video_packets import ImageReader
from calibration.robot.importing.description import Bags, ImportDescription, SensorDescription
from calibration.robot.labelling.detection import Image, grey

MAX_APART = 0.03
"""s: limit of the time between two images that are taken for one moment."""
MAX_APART_OF_SCAN = 0.1
"""s: limit of the time between an image and a scan of one moment, in which nothing moves."""
LENS_SIGMAS = np.array([5e-4, 1e-3, 1e-3])
"""Standard deviations of the relative focal length and the principal point, in focal lengths, if nobody knows them."""
NO_WITNESS = (
    "nothing that moves carries it, no other sensor sees the same, and it has no reference (accept --reference)"
)


def checks_of_bag(
    path: Path, accepted: CalibrationDocument, told: Mapping[str, SensorCheck] | None = None
) -> Iterator[SensorCheck]:
    """Check the accepted cameras of a bag by the motion that carries them, else by each other and by LiDARs.

    Args:
        path: the bag.
        accepted: the calibration.
        told: what is known of its sensors; of those of which it is told whether they have moved, nothing is said.

    Raises:
        InputError: the bag cannot be read.
    """
    told = {name: each for name, each in (told or {}).items() if each.outcome != "cannot-tell"}
    with open_bag([path]) as bag:
        if not cameras_of(bag):
            return
        clouds = (SensorDescription(topic, topic=topic) for topic in cloud_topics(bag))
        found = survey(bag, ImportDescription((), sensors=(*cameras_of(bag), *clouds), bags=Bags((path,))))
        carried = _Carried(bag, found, accepted)
        cameras = [each for each in accepted.poses if each.sensor in found.cameras]
        said: dict[str, SensorCheck] = {}
        for pose in cameras:
            try:
                if pose.name not in told and carried.moves(pose):
                    said[pose.name] = check_by_motion(carried.camera(pose), POSE_NOISE)
            except InputError as error:
                said[pose.name] = _untold(pose.name, str(error))
        told |= {name: each for name, each in said.items() if each.outcome != "cannot-tell"}
        pairs = [carried.check_pair(*pair) for pair in combinations(cameras, 2) if not told.keys() >= _names(pair)]
        for lidar, topic in carried.lidars:
            near = [pose for pose in cameras if not told.keys() >= _names((pose, lidar))]
            pairs += [carried.check_by_lidar(pose, lidar, topic) for pose in near]
        for check in blamed([each for each in pairs if each is not None], told):
            if check.sensor not in told and (check.outcome != "cannot-tell" or check.sensor not in said):
                said[check.sensor] = check
    yield from said.values()
    yield from (_untold(each.name, NO_WITNESS) for each in cameras if each.name not in {*said, *told})


def _names(pair: tuple[CalibratedPose, CalibratedPose]) -> set[str]:
    return {each.name for each in pair}


def blamed(
    pairs: Sequence[tuple[str, SensorCheck]], told: Mapping[str, SensorCheck] | None = None
) -> list[SensorCheck]:
    """Return what pairs of sensors say of each: one that has moved differs from all others, which agree.

    Args:
        pairs: the first sensor of each pair, and what was found of the second relative to it.
        told: what is known of sensors otherwise.
    """
    found: dict[str, SensorCheck] = {}
    reds = [name for first, check in pairs if check.red for name in (first, check.sensor)]
    reds += [name for name, each in (told or {}).items() if each.red for _ in pairs]
    greens = {name for first, check in pairs if check.outcome == "unmoved" for name in (first, check.sensor)}
    greens |= {name for name, each in (told or {}).items() if not each.red}
    for first, check in sorted(pairs, key=lambda pair: not pair[1].red):
        for name, other in ((check.sensor, first), (first, check.sensor)):
            if not check.red:
                found.setdefault(name, replace(check, sensor=name, method=check.method.replace(name, other)))
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
        method=check.method.replace(check.sensor, other),
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
        self._poses = [each for each in accepted.poses if each.sensor]
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
        features = [find_features(image) for image in self._images(topic, camera, chosen.tolist())]
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
            carriage.drives,
        )

    @property
    def lidars(self) -> list[tuple[CalibratedPose, SensorTopic]]:
        """Accepted LiDARs with clouds in the bag, and their topics."""
        topics = [each for each in self._found.range_sensors.values() if each.modality == LIDAR3D]
        of_pose = [(pose, [topic for topic in topics if is_of(pose, topic.topic, topic.frame)]) for pose in self._poses]
        return [(pose, own[0]) for pose, own in of_pose if own]

    def check_by_lidar(
        self, pose: CalibratedPose, lidar: CalibratedPose, topic: SensorTopic
    ) -> tuple[str, SensorCheck] | None:
        """Check a camera by the edges that a LiDAR sees too; None if they move relative to each other."""
        try:
            if self._frames.moves(pose.parent, lidar.parent):
                return None
            return lidar.name, check_by_edges(self._camera_and_lidar(pose, lidar, topic))
        except InputError as error:
            return lidar.name, _untold(pose.name, str(error))

    def _camera_and_lidar(self, pose: CalibratedPose, lidar: CalibratedPose, cloud: SensorTopic) -> CameraAndLidar:
        """Return images and scans of the moments at which nothing moves, evenly over the recording."""
        topic = self._found.cameras[pose.sensor or ""]
        camera = self._camera(topic, pose)
        every, scans = (np.array(sorted(each.stamps.values())) for each in (topic, cloud))
        recorded = {stamp: at for at, stamp in cloud.stamps.items()}
        moments, images, points = [], [], []
        at = np.searchsorted(scans, every[:-1])
        apart = [np.abs(scans[side.clip(0, len(scans) - 1)] - every[:-1]) for side in (at - 1, at)]
        near = every[:-1][np.minimum(*apart) <= MAX_APART_OF_SCAN * NS_PER_S]
        for stamp in evenly_chosen(near).tolist() if len(near) else ():
            scan = int(scans[np.abs(scans - stamp).argmin()])
            later = int(every[np.searchsorted(every, stamp) + 1])
            image, after = self._images(topic, camera, (stamp, later))
            if stands_still(image, after):
                moments.append(stamp)
                images.append(image)
                points.append(cloud_at(self._bag, cloud.topic, recorded, scan))
        time = float(every[0])
        T_camera, C_camera = self._frames.mount(pose, topic.frame, time)
        T_lidar, C_lidar = self._frames.mount(lidar, cloud.frame, time)
        T = inverse(self._frames.transform(lidar.parent, pose.parent, time) @ T_camera) @ T_lidar
        to_camera = adjoint(T)
        return CameraAndLidar(
            pose.name, lidar.name, images, points, camera, lens_sigmas(self._accepted, pose.name), T,
            C_camera + to_camera @ C_lidar @ to_camera.T, (np.array(moments) - every[0]) / NS_PER_S,
        )  # fmt: skip

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
            return one.name, check_by_each_other(
                first, replace(second, T_root_link=first.T_root_link @ T, drives=False)
            )
        except InputError as error:
            return one.name, _untold(other.name, str(error))

    def _camera(self, topic: SensorTopic, pose: CalibratedPose) -> Camera:
        if topic.camera is None:
            raise InputError(f"{self._bag.path}: {topic.topic}: found no camera_info beside it, expected its lens")
        return accepted_camera(topic.camera, self._accepted, pose.name)

    def _images(self, topic: SensorTopic, camera: Camera, stamps: Sequence[int]) -> Iterator[Image]:
        """Yield the grey images of some stamps, ns.

        Raises:
            InputError: one cannot be decoded, or has another size than the camera's.
        """
        recorded = {stamp: at for at, stamp in topic.stamps.items()}
        reader = ImageReader(self._bag, self._found.key_frames)
        for stamp in stamps:
            _, decode = next(iter(reader.images({topic.topic}, recorded[stamp], recorded[stamp] + 1)))
            image = grey(decode())
            if image.shape != (camera.height, camera.width):
                raise InputError(
                    f"{self._bag.path}: {topic.topic}: found images of {image.shape[1]} x {image.shape[0]} pixels, "
                    f"expected {camera.width} x {camera.height}"
                )
            yield image
