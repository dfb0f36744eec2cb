"""The documents of a simulated dataset: ATOM's ``dataset.json``, version 3.0, and the truth beside it.

Numbers are rounded (true poses to a nanometre and a nanoradian, estimated ones to 10 micrometres and
microradians, labels to a ten-thousandth of a pixel), so that the last bits of a machine's arithmetic
do not show.
"""

from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from calibration.dataset.configuration import SensorConfiguration
from calibration.dataset.model import CornerLabels, Edge
from calibration.dataset.pattern import Pattern
from calibration.dataset.pattern_document import pattern_document
from calibration.errors import InputError
from calibration.estimation.single_views import corner_term, fitted_poses
from calibration.geometry import rotations
from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import inverse, translation
from calibration.geometry.types import Array
from calibration.simulation.collection.capture import SimulatedCollection
from calibration.simulation.collection.lidar_labels import PatternPoints
from calibration.simulation.robot import compose
from calibration.simulation.sensors import SimulatedCamera
from calibration.simulation.system import System

USER = "calibration-ci"
DATE = "Thu Jan  1 00:00:00 1970"
TIMESTAMP = "0.0"
"""A simulated dataset is of no day: the same input gives the same bytes."""
_POSE_DECIMALS = 9
_ESTIMATE_DECIMALS = 5
_MESSAGES = {"rgb": "Image", "lidar3d": "PointCloud2"}


def cloud_file(sensor: str, collection: str) -> str:
    """The name of a point cloud's file."""
    return f"{sensor}_{collection}.pcd"


def dataset_document(system: System, collections: Sequence[SimulatedCollection]) -> dict[str, Any]:
    """The content of ``dataset.json``. The calibrated transforms in it are the truth, as in ATOM's simulations.

    Raises:
        InputError: no camera has detected a pattern in any collection.
    """
    if not any(labels for collection in collections for labels in collection.corners.values()):
        raise InputError(f"no camera of {system.name} detects a pattern in any of the {len(collections)} poses")
    configuration = system.configuration
    return {
        "_metadata": {
            "dataset_name": system.name,
            "date": DATE,
            "package_name": configuration.package_name,
            "robot_name": system.robot.name,
            "timestamp": TIMESTAMP,
            "user": USER,
            "version": "3.0",
        },
        "additional_sensor_data": {},
        "calibration_config": configuration.to_document(),
        "sensors": {name: _sensor(system, sensor) for name, sensor in configuration.sensors.items()},
        "patterns": {
            name: pattern_document(pattern, _transforms_initial(system, pattern, collections))
            for name, pattern in system.patterns.items()
        },
        "transforms": _transforms(system),
        "collections": {
            collection.key: _collection(system, collection, number) for number, collection in enumerate(collections)
        },
    }


def truth_document(system: System, collections: Sequence[SimulatedCollection], seed: int) -> dict[str, Any]:
    """The content of ``ground_truth.json``: what a calibration of the dataset should find."""
    config, first = system.configuration, collections[0].transforms

    def constant(edge: Edge) -> dict[str, Any]:
        return _pose(edge, first[edge])

    def of_patterns(collection: SimulatedCollection) -> Any:
        poses = [_pose((config.world_link, system.patterns[name].link), T) for name, T in collection.patterns.items()]
        return poses if len(poses) > 1 else poses[0]

    fixed = [(pattern.parent_link, pattern.link) for pattern in system.patterns.values() if pattern.fixed]
    return {
        "sensors": {name: constant((s.parent_link, s.child_link)) for name, s in config.sensors.items()},
        "patterns": {collection.key: of_patterns(collection) for collection in collections},
        **({"pattern": constant(fixed[0])} if len(fixed) == 1 else {}),
        "transforms": [constant(edge) for edge in (*config.additional_tfs.values(), *fixed)],
        "seed": seed,
        "px_sigma": max((camera.noise for camera in system.cameras.values()), default=0.0),
        "lidar_sigma": max((lidar.noise for lidar in system.lidars.values()), default=0.0),
    }


def _pose(edge: Edge, T: Array, decimals: int = _POSE_DECIMALS) -> dict[str, Any]:
    """A transform as ATOM writes it; of the two quaternions of a rotation the one whose last component is positive."""
    quaternion = np.round(rotations.to_quaternion(T[:3, :3]), decimals)
    last = quaternion[np.flatnonzero(quaternion)[-1]]
    return {
        "parent": edge[0],
        "child": edge[1],
        "trans": (np.round(T[:3, 3], decimals) + 0.0).tolist(),
        "quat": (quaternion * np.sign(last) + 0.0).tolist(),
    }


def _sensor(system: System, sensor: SensorConfiguration) -> dict[str, Any]:
    steps = system.robot.tree.path(system.configuration.world_link, sensor.link)
    document: dict[str, Any] = {
        "_name": sensor.name,
        "calibration_child": sensor.child_link,
        "calibration_parent": sensor.parent_link,
        "chain": [{"parent": s.parent, "child": s.child, "key": f"{s.parent}-{s.child}"} for s in steps],
        "modality": sensor.modality,
        "msg_type": _MESSAGES[sensor.modality],
        "parent": sensor.link,
        "topic": sensor.topic_name,
    }
    simulated = system.sensors[sensor.name]
    if isinstance(simulated, SimulatedCamera):
        document["camera_info_topic"] = str(PurePosixPath(sensor.topic_name).parent / "camera_info")
        document["camera_info"] = _camera_info(simulated.camera, sensor.link)
    return document


def _camera_info(camera: Camera, frame: str) -> dict[str, Any]:
    d = camera.distortion
    fx, fy, cx, cy = (round(value, 9) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    return {
        "header": _header(frame, 0),
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        "D": [d.k1, d.k2, d.p1, d.p2, d.k3],
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def _header(frame: str, number: int) -> dict[str, Any]:
    return {"frame_id": frame, "seq": number, "stamp": {"secs": 10 * number, "nsecs": 0}}


def _transforms(system: System) -> dict[str, Any]:
    """What is known of every edge of the tree; "multiple" means that it differs between collections."""
    calibrated = {(s.parent_link, s.child_link) for s in system.configuration.sensors.values()}
    calibrated |= set(system.configuration.additional_tfs.values())
    return {
        f"{joint.parent}-{joint.child}": {
            "parent": joint.parent,
            "child": joint.child,
            "type": "multiple" if joint.is_movable else "fixed",
            "joint_name": joint.name,
            "joint_params_calibrated": [],
            "is_transformation_calibrated": joint.edge in calibrated,
            "from_bag": joint.is_movable,
            "weight": 1,
        }
        for joint in system.robot.joints
    }


def _collection(system: System, collection: SimulatedCollection, number: int) -> dict[str, Any]:
    return {
        "additional_data": {},
        "data": {
            name: _message(system, collection, sensor, number) for name, sensor in system.configuration.sensors.items()
        },
        "joints": {},
        "labels": {
            pattern: {
                **{name: _corner_labels(collection.corners[pattern, name]) for name in system.cameras},
                **{name: _point_labels(collection.points[pattern, name]) for name in system.lidars},
            }
            for pattern in system.patterns
        },
        "transforms": {f"{p}-{c}": _pose((p, c), T) for (p, c), T in collection.transforms.items()},
    }


def _message(
    system: System, collection: SimulatedCollection, sensor: SensorConfiguration, number: int
) -> dict[str, Any]:
    """The ROS message of a sensor without its data; a camera has no image yet, so no file is named."""
    simulated = system.sensors[sensor.name]
    header = _header(sensor.link, number)
    if isinstance(simulated, SimulatedCamera):
        width, height = simulated.camera.width, simulated.camera.height
        return {
            "encoding": "bgr8",
            "header": header,
            "height": height,
            "is_bigendian": 0,
            "step": 3 * width,
            "width": width,
        }
    points = len(collection.clouds[sensor.name])
    return {
        "data_file": cloud_file(sensor.name, collection.key),
        "fields": [{"name": axis, "offset": 4 * i, "datatype": 7, "count": 1} for i, axis in enumerate("xyz")],
        "header": header,
        "height": 1,
        "is_bigendian": False,
        "is_dense": True,
        "point_step": 12,
        "row_step": 12 * points,
        "width": points,
    }


def _corner_labels(labels: CornerLabels | None) -> dict[str, Any]:
    if labels is None:
        return {"detected": False, "idxs": []}
    rows = zip(labels.ids.tolist(), labels.pixels.tolist(), strict=True)
    return {"detected": True, "idxs": [{"id": i, "x": x, "y": y} for i, (x, y) in rows]}


def _point_labels(labels: PatternPoints | None) -> dict[str, Any]:
    if labels is None:
        return {"detected": False, "idxs": [], "idxs_limit_points": []}
    return {
        "detected": True,
        "idxs": labels.on_pattern.tolist(),
        "idxs_limit_points": labels.on_border.tolist(),
    }


def _transforms_initial(
    system: System, pattern: Pattern, collections: Sequence[SimulatedCollection]
) -> dict[str, dict[str, Any]]:
    """Where the pattern stands in each collection by the labels of the first camera that detected it.

    It is estimated through the transforms in the file, as ATOM does when it collects.
    """
    estimates: dict[str, dict[str, Any]] = {c.key: {"detected": False} for c in collections}
    for name, simulated in reversed(system.cameras.items()):  # so that the first camera has the last word
        seen = [c for c in collections if c.corners[pattern.name, name] is not None]
        if not seen:
            continue
        link = system.configuration.sensors[name].link
        chains = _by_edge(seen)
        T_parent_camera = compose(system.robot.tree, chains, pattern.parent_link, link)
        views = [labels for c in seen if (labels := c.corners[pattern.name, name]) is not None]
        T_parent_pattern = T_parent_camera @ estimate_poses(simulated.camera, pattern, views)
        for collection, T in zip(seen, T_parent_pattern, strict=True):
            pose = _pose((pattern.parent_link, pattern.link), T, _ESTIMATE_DECIMALS)
            estimates[collection.key] = {"detected": True, "sensor": name, **pose}
    return estimates


def _by_edge(collections: Sequence[SimulatedCollection]) -> Mapping[Edge, Array]:
    return {edge: np.array([c.transforms[edge] for c in collections]) for edge in collections[0].transforms}


def estimate_poses(camera: Camera, pattern: Pattern, views: Sequence[CornerLabels]) -> Array:
    """``T_camera_pattern`` (V, 4, 4) of each view alone, from its labels."""
    T_camera_centre, _ = fitted_poses(corner_term(camera, pattern, views))
    return T_camera_centre @ inverse(translation(pattern.centre))
