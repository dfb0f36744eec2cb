"""Collections in simulation: a motion is played, and at each pose every sensor labels what it sees."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from calibration.dataset.model import CornerLabels, Edge
from calibration.errors import InputError
from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array
from calibration.simulation.collection.camera_labels import label_corners
from calibration.simulation.collection.lidar_labels import PatternPoints, label_cloud
from calibration.simulation.motion.sequence import Motion
from calibration.simulation.placement import Placement, place
from calibration.simulation.random_streams import stream
from calibration.simulation.rendering.lidar import Board, scan
from calibration.simulation.system import System


@dataclass(frozen=True, eq=False)
class SimulatedCollection:
    """The truth at one pose, and what the sensors made of it."""

    key: str
    """Such as "000"."""
    transforms: Mapping[Edge, Array]
    """``T_parent_child`` (4, 4) of the robot."""
    patterns: Mapping[str, Array]
    """``T_world_pattern`` (4, 4)."""
    corners: Mapping[tuple[str, str], CornerLabels | None]
    """By (pattern, camera); None where it is not detected."""
    points: Mapping[tuple[str, str], PatternPoints | None]
    """By (pattern, LiDAR); None where it is not detected."""
    clouds: Mapping[str, Array]
    """(N, 3) in the frame of each LiDAR, m."""

    def detected(self, sensor: str) -> bool:
        """Whether the sensor detected any pattern."""
        return any(
            labels is not None and name == sensor
            for found in (self.corners, self.points)
            for (_, name), labels in found.items()
        )


def collect(system: System, motion: Motion, seed: int) -> Iterator[SimulatedCollection]:
    """Play a motion, one collection for each pose.

    What a sensor sees in a collection depends on the seed, the number of the collection and the
    sensor's name alone, so any part of a motion's collections is a part of the whole.

    Raises:
        InputError: the motion does not fit the system (see `place`), or brings a sensor into a box
            or under the ground. Before the first collection.
    """
    placement = place(system, motion)
    free = placement.sensors_are_free(system.scene)
    if not free.all():
        raise InputError(f"{motion.source}: a sensor is in a box or under the ground in pose {free.argmin() + 1}")
    return (_collect_one(system, placement, i, seed) for i in range(len(motion)))


def _collect_one(system: System, placement: Placement, number: int, seed: int) -> SimulatedCollection:
    T_world_pattern = {name: poses[number] for name, poses in placement.patterns.items()}
    corners: dict[tuple[str, str], CornerLabels | None] = {}
    for camera, simulated in system.cameras.items():
        T_world_camera = placement.sensors[camera][number]
        for name, pattern in system.patterns.items():
            corners[name, camera] = label_corners(
                simulated,
                pattern,
                inverse(T_world_camera) @ T_world_pattern[name],
                system.scene.hides(T_world_camera[:3, 3], apply(T_world_pattern[name], pattern.corners)),
                stream(seed, number, camera, name),
            )
    points: dict[tuple[str, str], PatternPoints | None] = {}
    clouds: dict[str, Array] = {}
    boards = [Board(T_world_pattern[name], pattern.outline) for name, pattern in system.patterns.items()]
    for name, lidar in system.lidars.items():
        T_world_lidar = placement.sensors[name][number]
        measured = scan(lidar, T_world_lidar, system.scene, boards, stream(seed, number, name))
        cloud = label_cloud(lidar, measured, boards, T_world_lidar)
        clouds[name] = cloud.points
        points.update({(pattern, name): found for pattern, found in zip(system.patterns, cloud.patterns, strict=True)})
    transforms = {edge: T[number] for edge, T in placement.transforms.items()}
    return SimulatedCollection(f"{number:03d}", transforms, T_world_pattern, corners, points, clouds)
