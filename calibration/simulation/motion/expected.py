"""The dataset that a motion would give if nothing erred: every sensor's exact labels at every pose."""

from pathlib import Path

import numpy as np

from calibration.dataset.configuration import SensorConfiguration
from calibration.dataset.modalities import DEPTH, LIDAR2D, LIDAR3D, RGB, Modality
from calibration.dataset.model import Collection, CornerLabels, Dataset, Joint, Labels, PointLabels, Sensor
from calibration.dataset.pattern import Pattern
from calibration.geometry.joints import JOINT_PARAMETERS
from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array
from calibration.simulation.joints import joint_model, joint_values
from calibration.simulation.motion.expected_depth import pixels_on
from calibration.simulation.motion.views import camera_views, depth_camera_detects, lidar2d_detects, lidar_detects
from calibration.simulation.placement import Placement
from calibration.simulation.scene import Scene
from calibration.simulation.sensors import (
    SimulatedCamera,
    SimulatedDepthCamera,
    SimulatedLidar,
    SimulatedLidar2d,
    SimulatedSensor,
)
from calibration.simulation.system import System


def expected_dataset(system: System, placement: Placement) -> Dataset:
    """The exact labels of all views that a detector would find, one collection for each of N poses.

    The transforms and joints are the true ones. The collections' keys are the numbers of the poses, from "0".
    """
    config = system.configuration
    poses = next(iter(placement.transforms.values()))
    labels: list[dict[tuple[str, str], Labels]] = [{} for _ in poses]
    for pattern in system.patterns:
        for sensor, simulated in system.sensors.items():
            for number, label in _LABELS[type(simulated)](system, sensor, pattern, placement).items():
                labels[number][pattern, sensor] = label
    return Dataset(
        path=Path(system.name),
        version="3.0",
        world=config.world_link,
        sensors={name: _sensor(system, sensor) for name, sensor in config.sensors.items()},
        patterns=system.patterns,
        anchored=config.anchored_sensor,
        additional_transforms=tuple(config.additional_tfs.values()),
        collections=tuple(Collection(str(number), found) for number, found in enumerate(labels)),
        transforms=placement.transforms,
        document={},
        moving_transforms=system.unknown_motions,
        joints={name: _joint(system, name, placement) for name in config.joints},
    )


def _joint(system: System, name: str, placement: Placement) -> Joint:
    nominal, asked = system.nominal.movable[name], system.configuration.joints[name]
    return Joint(
        name=name,
        edge=nominal.edge,
        model=joint_model(nominal),
        parameters=tuple(parameter for parameter in JOINT_PARAMETERS if parameter in asked),
        values=joint_values(nominal, system.joint_errors.get(name)),
        positions=placement.joints[name],
    )


def _sensor(system: System, sensor: SensorConfiguration) -> Sensor:
    simulated = system.sensors[sensor.name]
    return Sensor(
        name=sensor.name,
        modality=_MODALITIES[type(simulated)],
        frame=sensor.link,
        calibration_parent=sensor.parent_link,
        calibration_child=sensor.child_link,
        camera=None if isinstance(simulated, SimulatedLidar | SimulatedLidar2d) else simulated.camera,
    )


def _corners(system: System, sensor: str, pattern: str, placement: Placement) -> dict[int, Labels]:
    """By the number of the pose."""
    views = camera_views(system, sensor, pattern, placement)
    found: dict[int, Labels] = {}
    for number in np.flatnonzero(views.detectable).tolist():
        ids = np.flatnonzero(views.seen[number])
        found[number] = CornerLabels(ids, views.pixels[number, ids])
    return found


def _points(system: System, sensor: str, pattern: str, placement: Placement) -> dict[int, Labels]:
    """By the number of the pose."""
    lidar, board = system.lidars[sensor], system.patterns[pattern]
    T_lidar_pattern, T_world_lidar = placement.pattern_in(sensor, pattern), placement.sensors[sensor]
    return {
        number: points_on(lidar, board, T_lidar_pattern[number], system.scene, T_world_lidar[number])
        for number in np.flatnonzero(lidar_detects(system, sensor, pattern, placement)).tolist()
    }


def _cuts(system: System, sensor: str, pattern: str, placement: Placement) -> dict[int, Labels]:
    """By the number of the pose."""
    lidar, board = system.lidars2d[sensor], system.patterns[pattern]
    T_lidar_pattern, T_world_lidar = placement.pattern_in(sensor, pattern), placement.sensors[sensor]
    return {
        number: points_on(lidar, board, T_lidar_pattern[number], system.scene, T_world_lidar[number])
        for number in np.flatnonzero(lidar2d_detects(system, sensor, pattern, placement)).tolist()
    }


def _pixels(system: System, sensor: str, pattern: str, placement: Placement) -> dict[int, Labels]:
    """By the number of the pose."""
    depth_camera, board = system.depth_cameras[sensor], system.patterns[pattern]
    T_camera_pattern, T_world_camera = placement.pattern_in(sensor, pattern), placement.sensors[sensor]
    return {
        number: pixels_on(depth_camera, board, T_camera_pattern[number], system.scene, T_world_camera[number])
        for number in np.flatnonzero(depth_camera_detects(system, sensor, pattern, placement)).tolist()
    }


_LABELS = {
    SimulatedCamera: _corners,
    SimulatedDepthCamera: _pixels,
    SimulatedLidar: _points,
    SimulatedLidar2d: _cuts,
}
_MODALITIES: dict[type[SimulatedSensor], Modality] = {
    SimulatedCamera: RGB,
    SimulatedDepthCamera: DEPTH,
    SimulatedLidar: LIDAR3D,
    SimulatedLidar2d: LIDAR2D,
}


def points_on(
    lidar: SimulatedLidar | SimulatedLidar2d,
    pattern: Pattern,
    T_lidar_pattern: Array,
    scene: Scene,
    T_world_lidar: Array,
) -> PointLabels:
    """Where the rays of one scan meet a pattern, and which are the outermost of their rings.

    Args:
        lidar: the sensor.
        pattern: what it looks at.
        T_lidar_pattern: (4, 4).
        scene: what may stand before the pattern.
        T_world_lidar: (4, 4).
    """
    rays = _rays_towards(lidar, pattern, T_lidar_pattern) if isinstance(lidar, SimulatedLidar) else lidar.directions()
    normal, origin = T_lidar_pattern[:3, 2], T_lidar_pattern[:3, 3]
    with np.errstate(divide="ignore"):
        distance = (normal @ origin) / (rays @ normal)
    points = distance[..., None] * rays
    (left, top), (right, bottom) = pattern.outline.min(0), pattern.outline.max(0)
    x, y = np.moveaxis(apply(inverse(T_lidar_pattern), points)[..., :2], -1, 0)
    hits = (distance > 0) & (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
    outermost = np.zeros_like(hits)
    ring = np.flatnonzero(hits.any(1))
    outermost[ring, hits[ring].argmax(1)] = True
    outermost[ring, hits.shape[1] - 1 - hits[ring, ::-1].argmax(1)] = True
    points, outermost = points[hits], outermost[hits]
    ranges = np.linalg.norm(points, axis=-1)
    visible = (ranges >= lidar.least_range) & (ranges <= lidar.most_range)
    visible &= ~scene.hides(T_world_lidar[:3, 3], apply(T_world_lidar, points))
    return PointLabels(points[visible], np.flatnonzero(outermost[visible]))


def _rays_towards(lidar: SimulatedLidar, pattern: Pattern, T_lidar_pattern: Array) -> Array:
    """(rings, A, 3): the unit directions of the rays of all rings whose azimuth is that of some part of the pattern."""
    corners = apply(T_lidar_pattern, np.column_stack([pattern.outline, np.zeros(4)]))
    middle = np.arctan2(*corners.mean(0)[[1, 0]])
    beside = (np.arctan2(corners[:, 1], corners[:, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
    first, last = (middle + np.array([beside.min(), beside.max()]) + np.pi) / lidar.step
    azimuth = lidar.step * np.arange(np.ceil(first), np.floor(last) + 1) - np.pi  # the first ray points backwards
    elevation = np.array(lidar.elevations)[:, None]
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    return np.stack([x, y, np.broadcast_to(np.sin(elevation), x.shape)], -1)
