"""LiDARs of a bag against the motion of what carries them, by the crispness of the map that their scans make."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.witness.checks import MIN_IMAGES, POSE_NOISE, WitnessAnswer, standstill_of
from calibration.addons.guard.witness.displacement import displacement_of, drift_of_poses
from calibration.addons.guard.witness.plane_map import RANGE_SIGMAS, patches_of_scans, plane_evidence
from calibration.addons.guard.witness.recorded_frames import Carriage, RecordedFrames, evenly_chosen
from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument
from calibration.engine.dataset.modalities import LIDAR3D
from calibration.engine.geometry.transforms import inverse_adjoint
from calibration.robot.importing.bags.bag import LIVOX_TYPES, NS_PER_S, Bag, open_bag
from calibration.robot.importing.bags.messages import frame_of
from calibration.robot.importing.bags.motion import MotionLog
from calibration.robot.importing.bags.range_views import cloud_of, livox_points
from calibration.robot.importing.bags.survey import MODALITY_OF_MESSAGE, add_motion, motion_topics

METHOD = "the map's crispness, by the motion of what carries it"
MIN_PLANES = 40
"""Parts of planes that fit."""
SCAN_TIME = 0.1
"""s: time that a scan takes."""
MAX_CANDIDATES = 2000
"""Scans of which the motion is looked at, evenly over the recording."""
LOCALISED_IN = "map"
"""Frame in which a robot is localised (REP 105), mostly by its LiDAR, which is no witness against itself."""
NO_WITNESS_OF_LIDAR = (
    f"nothing that moves carries it: found no pose by joints or odometry in the recording, and one in '{LOCALISED_IN}' "
    "may come from the LiDAR itself"
)
MAX_SKEW_M, MAX_SKEW_RAD = 0.01, 0.003
"""m and rad: limits of the motion during a scan, which bends its planes."""


@dataclass(frozen=True, eq=False)
class MovingLidar:
    """A LiDAR with its scans, and where the link that carries it was."""

    name: str
    carriage: Carriage
    scans: Sequence[Array]
    """Points (N, 3) of each of the K scans, m, in the frame of its data."""


def check_by_map(seen: MovingLidar) -> SensorCheck:
    """Return whether a LiDAR is where it was accepted: what several scans see of a plane must coincide."""
    way, stamps = seen.carriage, seen.carriage.stamps
    answer = WitnessAnswer(seen.name, METHOD, (stamps - stamps[0]) / NS_PER_S, is_camera=False)
    if len(stamps) < MIN_IMAGES:
        return answer.cannot_tell(
            f"found {len(stamps)} scans with a known pose and less motion during them than {1e3 * MAX_SKEW_M:g} mm and "
            f"{np.degrees(MAX_SKEW_RAD):.1f} degrees, expected {MIN_IMAGES}: stop now and then"
        )
    if fault := standstill_of(way.T_root_link):
        return answer.cannot_tell(fault)
    poses = way.T_root_link @ way.T_link_sensor
    evidence = plane_evidence(patches_of_scans(seen.scans, poses))
    planes = 0 if evidence is None else len(np.unique(evidence.patches.planes))
    if evidence is None or planes < MIN_PLANES:
        return answer.cannot_tell(f"found {planes} parts of planes that several scans see, expected {MIN_PLANES}")
    velocities = way.velocities @ inverse_adjoint(way.T_link_sensor).T
    drift = drift_of_poses(poses) if way.drives else None
    found = displacement_of(evidence, velocities, POSE_NOISE, RANGE_SIGMAS, way.covariance, drift)
    return answer.by(found)


def map_checks_of_bag(path: Path, accepted: CalibrationDocument) -> Iterator[SensorCheck]:
    """Check the accepted LiDARs of a bag by the motion that carries them.

    Args:
        path: the bag.
        accepted: the calibration.

    Raises:
        InputError: the bag cannot be read.
    """
    with open_bag([path]) as bag:
        if not (clouds := cloud_topics(bag)):
            return
        log, moving = MotionLog(), motion_topics(bag)
        stamps: dict[str, dict[int, int]] = {topic: {} for topic in clouds}
        frame: dict[str, str] = {}
        for message in bag.messages({*clouds, *moving}):
            if message.topic in moving:
                add_motion(bag, message, log)
            else:
                stamps[message.topic][bag.stamp(message)] = message.recorded
                if message.topic not in frame:
                    frame[message.topic] = frame_of(bag.decode(message))
        frames = RecordedFrames(log, accepted, LOCALISED_IN)
        for pose in accepted.poses:
            own = [topic for topic, name in frame.items() if pose.sensor and is_of(pose, topic, name)]
            if own:
                try:
                    if not frames.moves(frames.root(pose.parent), pose.parent):
                        raise InputError(NO_WITNESS_OF_LIDAR)
                    found = check_by_map(_moving_lidar(bag, pose, frames, own[0], frame[own[0]], stamps[own[0]]))
                except InputError as error:
                    found = SensorCheck(sensor=pose.name, method=METHOD, outcome="cannot-tell", reason=str(error))
                yield found


def cloud_topics(bag: Bag) -> list[str]:
    """Return the topics of clouds."""
    return [topic for topic, kind in bag.topics.items() if MODALITY_OF_MESSAGE.get(kind) == LIDAR3D]


def cloud_at(bag: Bag, topic: str, recorded: Mapping[int, int], stamp: int) -> Array:
    """Return the points (N, 3) of the scan of a stamp, ns.

    Args:
        bag: the bag.
        topic: of clouds.
        recorded: recording time, ns, by stamp.
        stamp: ns.

    Raises:
        InputError: it cannot be decoded.
    """
    message = next(iter(bag.messages({topic}, recorded[stamp], recorded[stamp] + 1)))
    where, content = f"{bag.path}: {topic} at {stamp / NS_PER_S:.3f}", bag.decode(message)
    return (livox_points if bag.topics[topic] in LIVOX_TYPES else cloud_of)(content, where)


def is_of(pose: CalibratedPose, topic: str, frame: str) -> bool:
    """Whether a topic is a sensor's, by its first part or by the frame of its data."""
    return topic.strip("/").split("/")[0] == pose.sensor or frame == pose.child


def _moving_lidar(
    bag: Bag, pose: CalibratedPose, frames: RecordedFrames, topic: str, frame: str, recorded: dict[int, int]
) -> MovingLidar:
    """Return the scans of a topic that took little motion, and where the link was.

    Raises:
        InputError: a scan cannot be decoded, or no pose of the link was recorded near any.
    """
    stamps = np.array(sorted(recorded))
    every = frames.carriage(pose, frame, stamps[:: len(stamps) // MAX_CANDIDATES + 1], topic)
    skew = np.linalg.norm(SCAN_TIME * every.velocities.reshape(-1, 2, 3), axis=-1)
    slow = every.stamps[(skew < [MAX_SKEW_M, MAX_SKEW_RAD]).all(-1)]
    if not len(slow):
        slow = every.stamps[:1]
    carriage = frames.carriage(pose, frame, evenly_chosen(slow), topic)
    scans = [cloud_at(bag, topic, recorded, stamp) for stamp in carriage.stamps.tolist()]
    return MovingLidar(pose.name, carriage, scans)
