"""Documents of a simulated dataset: ATOM's ``dataset.json``, version 3.0, and its ground truth.

Numbers are rounded (poses to a nanometre and a nanoradian, estimated ones to 10 micrometres and
microradians, labels to a ten-thousandth of a pixel), so that the rounding errors of a machine's
arithmetic have no effect.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePosixPath
from typing import Any

from calibration.engine.dataset.configuration import SensorConfiguration
from calibration.engine.dataset.model import Edge
from calibration.engine.dataset.pattern import pattern_document
from calibration.engine.dataset.sensors import camera_document
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.joints import JOINT_PARAMETERS
from calibration.robot.simulation.collection.record import POSE_DECIMALS, Record, message_header, pose_document
from calibration.robot.simulation.joints import joint_values
from calibration.robot.simulation.placement import Play
from calibration.robot.simulation.system import System

RECORDING_USER = "calibration-ci"
RECORDING_DATE = "Thu Jan  1 00:00:00 1970"
RECORDING_TIMESTAMP = "0.0"
"""Constant, so that the same input gives the same bytes."""


def dataset_document(system: System, kept: Sequence[Record]) -> dict[str, Any]:
    """Return the content of ``dataset.json``, with the transforms of the nominal robot."""
    configuration = system.configuration
    return {
        "_metadata": {
            "dataset_name": system.name,
            "date": RECORDING_DATE,
            "package_name": configuration.package_name,
            "robot_name": system.robot.name,
            "timestamp": RECORDING_TIMESTAMP,
            "user": RECORDING_USER,
            "version": "3.0",
        },
        "additional_sensor_data": {},
        "calibration_config": configuration.to_document(),
        "sensors": {name: _sensor_document(system, sensor) for name, sensor in configuration.sensors.items()},
        "patterns": {
            name: pattern_document(pattern, {record.key: dict(record.initial[name]) for record in kept})
            for name, pattern in system.patterns.items()
        },
        "transforms": _edge_documents(system),
        "collections": {record.key: record.collection for record in kept},
    }


def truth_document(play: Play, kept: Sequence[Record]) -> dict[str, Any]:
    """Return the content of ``ground_truth.json``: the values that a calibration of the dataset should find."""
    system = play.system
    config = system.configuration

    def constant(edge: Edge) -> dict[str, Any]:
        return pose_document(edge, play.true.transforms[edge][0])

    noises = [sensor.noise for sensor in system.sensors.values() if sensor.modality.family == "lidar"]
    constants = [edge for edge in config.additional_tfs.values() if edge not in system.unknown_motions]
    fixed = [(pattern.parent_link, pattern.link) for pattern in system.patterns.values() if pattern.fixed]
    errors = [error for record in kept for error in record.errors.values()]
    corners = sum(error.count for error in errors)
    return {
        "sensors": {name: constant((s.parent_link, s.child_link)) for name, s in config.sensors.items()},
        "patterns": {r.key: list(r.truth) if len(r.truth) > 1 else r.truth[0] for r in kept},
        **({"pattern": constant(fixed[0])} if len(fixed) == 1 else {}),
        "transforms": [constant(edge) for edge in (*constants, *fixed)],
        **({"joints": _true_joints(system)} if config.joints else {}),
        "seed": play.seed,
        "corner_rms_px": round((sum(e.count * e.rms**2 for e in errors) / corners) ** 0.5, 4) if corners else None,
        "lidar_sigma": max([0.0, *noises]),
    }


def _true_joints(system: System) -> dict[str, dict[str, float]]:
    """Return the true values of the calibrated parameters of joints, m and rad."""
    joints = {}
    for name, parameters in system.configuration.joints.items():
        values = joint_values(system.nominal.movable[name], system.joint_errors.get(name)).tolist()
        by_name = dict(zip(JOINT_PARAMETERS, values, strict=True))
        joints[name] = {p: round(value, POSE_DECIMALS) + 0.0 for p, value in by_name.items() if p in parameters}
    return joints


def _sensor_document(system: System, sensor: SensorConfiguration) -> dict[str, Any]:
    simulated = system.sensors[sensor.name]
    steps = system.robot.tree.path(system.configuration.world_link, sensor.link)
    document: dict[str, Any] = {
        "_name": sensor.name,
        "calibration_child": sensor.child_link,
        "calibration_parent": sensor.parent_link,
        "chain": [{"parent": s.parent, "child": s.child, "key": f"{s.parent}-{s.child}"} for s in steps],
        "modality": sensor.modality,
        "msg_type": simulated.modality.message,
        "parent": sensor.link,
        "topic": sensor.topic_name,
    }
    if simulated.intrinsics:
        document["camera_info_topic"] = str(PurePosixPath(sensor.topic_name).parent / "camera_info")
        document["camera_info"] = _camera_info(simulated.intrinsics, sensor.link)
    return document


def _camera_info(camera: Camera, frame: str) -> dict[str, Any]:
    fx, fy, cx, cy = (round(value, 9) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    return {
        "header": message_header(frame, 0),
        **camera_document(replace(camera, fx=fx, fy=fy, cx=cx, cy=cy)),
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def _edge_documents(system: System) -> dict[str, Any]:
    """Return the attributes of every edge of the tree; "multiple" if it differs between collections."""
    calibrated = {(s.parent_link, s.child_link) for s in system.configuration.sensors.values()}
    calibrated |= set(system.configuration.additional_tfs.values())
    return {
        f"{joint.parent}-{joint.child}": {
            "parent": joint.parent,
            "child": joint.child,
            "type": "multiple" if joint.is_movable else "fixed",
            "joint_name": joint.name,
            "joint_params_calibrated": list(system.configuration.joints.get(joint.name, ())),
            "is_transformation_calibrated": joint.edge in calibrated or joint.name in system.configuration.joints,
            "from_bag": joint.is_movable,
            "weight": 1,
        }
        for joint in system.robot.joints
    }
