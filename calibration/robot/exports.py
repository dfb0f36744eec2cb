"""Exports of a calibrated dataset: launch files, YAML and camera parameters as text, and the table of all formats."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.base.optional import optional
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses.model import KalibrName
from calibration.engine.geometry.rotations import to_quaternion, to_rpy
from calibration.engine.geometry.transforms import distance, inverse
from calibration.robot.calibrated_urdf import calibrated_urdf, number_texts
from calibration.robot.robot_description import NO_INPUTS, XacroInputs, read_robot_description

SAME = 1e-9
"""m, rad: tolerance for a calibrated transform to be the same in all collections."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Calibrated transforms, joints and cameras of a robot."""

    name: str
    """Name of the system."""
    transforms: Mapping[Edge, Array]
    """``T_parent_child`` (4, 4) of sensors and additional transforms."""
    joints: Mapping[Edge, Array]
    """``T_parent_child`` (4, 4) of calibrated joints at position 0."""
    cameras: Mapping[str, Camera]
    frames: Mapping[str, str]
    """Frame of each camera's images."""
    poses: Mapping[str, Array]
    """``T_first_camera`` (4, 4) of each camera relative to the first one, if no moving transform is between them."""
    lags: Mapping[str, float] = field(default_factory=dict)
    """s: of the sensors that have one."""


def calibrated(dataset: Dataset) -> Calibrated:
    """Extract the calibrated transforms, joints and cameras from a dataset.

    Patterns are left out: they are not part of the robot.

    Raises:
        InputError: a calibrated transform is missing, or differs between collections.
    """
    joints = {joint.edge: joint.model.pose(joint.values) for joint in dataset.joints.values()}
    edges = dict.fromkeys([sensor.edge for sensor in dataset.sensors.values()])
    edges |= dict.fromkeys(dataset.additional_transforms)
    transforms = {}
    if not dataset.additional_transforms and set(edges) <= _origin(dataset):
        edges = {}  # cameras alone: what is calibrated is in the cameras
    for edge in edges:
        if edge in dataset.moving_transforms or edge in joints:
            continue
        T = dataset.transforms.get(edge)
        if T is None or not np.isfinite(T).all():
            raise InputError(f"{dataset.path}: no transform '{'-'.join(edge)}' in every collection; is it calibrated?")
        if _differs(T):
            raise InputError(
                f"{dataset.path}: found transforms '{'-'.join(edge)}' that differ between collections; expected a "
                f"calibrated dataset, which has the same in all"
            )
        transforms[edge] = T[0]
    cameras = {name: sensor.camera for name, sensor in dataset.sensors.items() if sensor.camera}
    frames = {name: dataset.sensors[name].frame for name in cameras}
    lags = {name: sensor.lag for name, sensor in dataset.sensors.items() if sensor.lag}
    poses = {}
    for name in cameras:
        T = dataset.transform(next(iter(frames.values())), frames[name])
        if not _differs(T):
            poses[name] = T[0]
    return Calibrated(dataset.name, transforms, joints, cameras, frames, poses, lags)


def _origin(dataset: Dataset) -> set[Edge]:
    """Return the transform of the anchored sensor, which is where the others are measured from."""
    return {dataset.sensors[dataset.anchored].edge} if dataset.anchored else set()


def _differs(T: Array) -> bool:
    """Whether transforms (N, 4, 4) differ between collections."""
    return bool(max(float(part.max()) for part in distance(T[0], T)) > SAME)


AUTOWARE_BASE = "base_link"
FRAME = re.compile(r"[\w./:+-]+")
"""Allowed in a launch file's attributes: blanks would separate arguments, ``$(...)`` would be evaluated."""
URDF = "urdf"
"""The only format that needs an input file: the robot's URDF."""
CALIBRATED_URDF = "calibrated.urdf"
OF_CAMERAS = ("camera-info", "kalibr", "opencv")
"""Formats of cameras, which need no calibrated transform."""


def yaml_text(document: Any) -> str:
    """Return a document as YAML, its keys in their order."""
    return str(yaml.safe_dump(document, sort_keys=False, allow_unicode=True))


def _launch_frame(name: str) -> str:
    """Return a frame's name, checked for use in a launch file's attribute.

    Raises:
        InputError: it contains other characters than those of `FRAME`.
    """
    if not FRAME.fullmatch(name):
        raise InputError(f"frame {name!r}: expected letters, digits and _ - . / : + in a frame of a launch file")
    return name


def _position_and_quaternion(T: Array) -> tuple[list[float], list[float]]:
    """Return translation, and rotation as a quaternion xyzw."""
    return [float(v) + 0.0 for v in T[:3, 3]], [float(v) + 0.0 for v in to_quaternion(T[:3, :3])]


def _launch_file(of: Calibrated, node: Callable[[int, str, str, Array], str]) -> str:
    """Return a launch file in XML with one ``static_transform_publisher`` per transform.

    Args:
        of: what is calibrated.
        node: returns the attributes of a node from its number, the parent's and the child's frame and the transform.
    """
    nodes = (
        node(i, _launch_frame(parent), _launch_frame(child), T)
        for i, ((parent, child), T) in enumerate(of.transforms.items())
    )
    return "\n".join(["<launch>", *(f'  <node pkg="tf2_ros" {each}/>' for each in nodes), "</launch>", ""])


def ros1_launch(of: Calibrated) -> str:
    """Return a ROS 1 launch file with one ``static_transform_publisher`` per transform."""

    def node(i: int, parent: str, child: str, T: Array) -> str:
        xyz, quat = _position_and_quaternion(T)
        arguments = " ".join([*map(repr, (*xyz, *quat)), parent, child])
        return f'type="static_transform_publisher" name="calibrated_{i}" args="{arguments}"'

    return _launch_file(of, node)


def ros2_xml(of: Calibrated) -> str:
    """Return a ROS 2 launch file in XML with one ``static_transform_publisher`` per transform."""

    def node(_: int, parent: str, child: str, T: Array) -> str:
        return f'exec="static_transform_publisher" args="{" ".join(_ros2_arguments(parent, child, T))}"'

    return _launch_file(of, node)


def ros2_launch(of: Calibrated) -> str:
    """Return a ROS 2 launch file in Python with one ``static_transform_publisher`` per transform."""
    transforms = (f"        {json.dumps(_ros2_arguments(*edge, T))},\n" for edge, T in of.transforms.items())
    return ROS2_LAUNCH.format(transforms="".join(transforms))


ROS2_LAUNCH = """\
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    transforms = [
{transforms}    ]
    package, executable = "tf2_ros", "static_transform_publisher"
    return LaunchDescription(
        [Node(package=package, executable=executable, arguments=each) for each in transforms]
    )
"""


def _ros2_arguments(parent: str, child: str, T: Array) -> list[str]:
    xyz, quat = _position_and_quaternion(T)
    numbers = zip(("--x", "--y", "--z", "--qx", "--qy", "--qz", "--qw"), map(repr, (*xyz, *quat)), strict=True)
    return [*(part for pair in numbers for part in pair), "--frame-id", parent, "--child-frame-id", child]


def tf_static(of: Calibrated) -> str:
    """Return the transforms as YAML, in the form of ``/tf_static`` messages."""
    messages = []
    for (parent, child), T in of.transforms.items():
        xyz, quat = _position_and_quaternion(T)
        messages.append(
            {
                "header": {"frame_id": parent},
                "child_frame_id": child,
                "transform": {
                    "translation": dict(zip("xyz", xyz, strict=True)),
                    "rotation": dict(zip("xyzw", quat, strict=True)),
                },
            }
        )
    return yaml_text({"transforms": messages})


def autoware(of: Calibrated) -> dict[str, str]:
    """Return Autoware's two files of extrinsics, ``parent: {child: {x, y, z, roll, pitch, yaw}}``, as YAML.

    Children of ``base_link`` go to sensors_calibration.yaml, all others to sensor_kit_calibration.yaml.
    """
    files: dict[str, dict[str, dict[str, dict[str, float]]]] = {
        "sensors_calibration.yaml": {},
        "sensor_kit_calibration.yaml": {},
    }
    for (parent, child), T in of.transforms.items():
        values = [float(v) + 0.0 for v in (*T[:3, 3], *to_rpy(T[:3, :3]))]
        names = ("x", "y", "z", "roll", "pitch", "yaw")
        file = "sensors_calibration.yaml" if parent == AUTOWARE_BASE else "sensor_kit_calibration.yaml"
        files[file].setdefault(parent, {})[child] = dict(zip(names, values, strict=True))
    return {name: yaml_text(content) for name, content in files.items() if content}


def xacro_properties(of: Calibrated) -> str:
    """Return origins by joint as YAML to load in xacro, ``parent_to_child: {xyz: ..., rpy: ...}``.

    ``<xacro:property name="calibrated" value="${xacro.load_yaml('calibrated.yaml')}"/>`` loads it, and
    ``<origin xyz="${calibrated['a_to_b']['xyz']}" rpy="${calibrated['a_to_b']['rpy']}"/>`` uses one.
    """
    origins = {
        f"{parent}_to_{child}": {"xyz": number_texts(T[:3, 3]), "rpy": number_texts(to_rpy(T[:3, :3]))}
        for (parent, child), T in {**of.transforms, **of.joints}.items()
    }
    return yaml_text(origins)


def camera_info(camera: Camera, name: str, lag: float | None = None) -> str:
    """Return a camera's file for ROS's camera_info_manager; a lag, s, as a comment, which has no place in it."""
    fx, fy, cx, cy = (float(v) for v in camera.intrinsics[:4])
    coefficients = camera.distortion.coefficients.tolist()

    def matrix(rows: int, columns: int, data: list[float]) -> dict[str, object]:
        return {"rows": rows, "cols": columns, "data": data}

    document = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": matrix(3, 3, [fx, camera.skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        "distortion_model": camera.distortion.ros_name,
        "distortion_coefficients": matrix(1, len(coefficients), coefficients),
        "rectification_matrix": matrix(3, 3, np.eye(3).ravel().tolist()),
        "projection_matrix": matrix(3, 4, [fx, camera.skew, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    }
    remark = "" if lag is None else f"# lag: {lag!r} s from the stamp of an image to the transforms that it shows\n"
    return remark + yaml_text(document)


def kalibr_camchain(of: Calibrated) -> str:
    """Return Kalibr's camchain: each camera, and its pose relative to the previous one (``T_cn_cnm1``).

    Raises:
        InputError: Kalibr has no such lens model, or it has coefficients that Kalibr's models lack: k3 of plumb_bob.
    """
    document = {}
    for i, (name, camera) in enumerate(of.cameras.items()):
        kalibr, first, coefficients = _in_kalibr(camera, name)
        document[f"cam{i}"] = {
            "camera_model": kalibr.camera_model,
            "intrinsics": [*first, *camera.intrinsics[:4].tolist()],
            "distortion_model": kalibr.distortion_model,
            "distortion_coeffs": coefficients,
            "resolution": [camera.width, camera.height],
            "rostopic": f"/{name}/image_raw",
        }
    for i, (before, name) in enumerate(pairwise(of.cameras), 1):
        if before in of.poses and name in of.poses:
            document[f"cam{i}"]["T_cn_cnm1"] = (inverse(of.poses[name]) @ of.poses[before]).tolist()
    return yaml_text(document)


def _in_kalibr(camera: Camera, name: str) -> tuple[KalibrName, list[float], list[float]]:
    """Return Kalibr's names of a lens model, its parameters before the focal lengths, and its coefficients."""
    lens = camera.distortion
    kalibr = lens.kalibr
    if kalibr is None:
        raise InputError(f"camera '{name}': Kalibr has no lens model {lens.ros_name}; calibrate it with another 'lens'")
    if camera.skew:
        raise InputError(
            f"camera '{name}': found a skew of {camera.skew:g} px, Kalibr has none: export other formats, or "
            "intrinsics that were calibrated without one (OpenCV: CALIB_FIX_SKEW)"
        )
    values, count = lens.coefficients.tolist(), kalibr.intrinsics + kalibr.coefficients
    if any(values[count:]):
        raise InputError(
            f"camera '{name}': Kalibr's {kalibr.distortion_model} has {', '.join(lens.names()[:count])}, found "
            f"{lens.ros_name} with {lens.names()[count]} and more: keep these fixed at 0 "
            f"(hold: [intrinsics-{name}-{lens.names()[count]}])"
        )
    return kalibr, values[: kalibr.intrinsics], values[kalibr.intrinsics : count]


def opencv_storage(of: Calibrated) -> str:
    """Return OpenCV's FileStorage: ``K_i`` and ``D_i`` of each camera, ``R_0_i`` and ``T_0_i`` from the first to each.

    A point X in the first camera's frame is ``R X + T`` in the other's, as in cv2.stereoCalibrate.
    """
    cv2 = optional("cv2", "the export opencv")
    storage = cv2.FileStorage(".yml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    for i, (name, camera) in enumerate(of.cameras.items()):
        storage.write(f"name_{i}", name)
        storage.write(f"size_{i}", np.array([camera.width, camera.height]))
        storage.write(f"model_{i}", camera.distortion.ros_name)
        storage.write(f"K_{i}", camera.K)
        storage.write(f"D_{i}", camera.distortion.coefficients)
        if i and name in of.poses:
            T = inverse(of.poses[name])
            storage.write(f"R_0_{i}", T[:3, :3].copy())
            storage.write(f"T_0_{i}", T[:3, 3].copy())
    return str(storage.releaseAndGetString())


def file_name(name: str) -> str:
    """Turn a name into a safe file name: no separators, not hidden."""
    kept = "".join(each if each.isalnum() or each in "_-." else "_" for each in name)
    return f"camera_info_{kept}"


FILES: Mapping[str, Callable[[Calibrated], Mapping[str, str]]] = {
    "xacro": lambda of: {"calibrated.yaml": xacro_properties(of)},
    "ros1": lambda of: {"calibrated.ros1.launch": ros1_launch(of)},
    "ros2": lambda of: {"calibrated.launch.py": ros2_launch(of)},
    "ros2-xml": lambda of: {"calibrated.launch.xml": ros2_xml(of)},
    "tf-static": lambda of: {"tf_static.yaml": tf_static(of)},
    "autoware": autoware,
    "camera-info": lambda of: {
        f"{file_name(name)}.yaml": camera_info(camera, name, of.lags.get(name)) for name, camera in of.cameras.items()
    },
    "kalibr": lambda of: {"camchain.yaml": kalibr_camchain(of)},
    "opencv": lambda of: {"opencv.yml": opencv_storage(of)},
}
"""Function of each format that returns the texts of its files by name."""
FORMATS = tuple(FILES)


def exported(
    dataset: Dataset, formats: Sequence[str], description: Path | None, inputs: XacroInputs = NO_INPUTS
) -> tuple[dict[str, bytes], list[str]]:
    """Return the files of the requested formats by name, and notes for the user.

    Args:
        dataset: the calibrated dataset.
        formats: names of formats; empty for all that the dataset supports.
        description: the robot's URDF, or a xacro, which is expanded; None if there is none.
        inputs: what the expansion of a xacro needs.

    Raises:
        InputError: the dataset is not calibrated, the URDF does not match it, or the dataset does not support a
            requested format.
    """
    if URDF in formats and description is None:
        raise InputError(f"the format {URDF} needs the robot's own file: give robot-description")
    of = calibrated(dataset)
    files, notes = _texts(of, formats)
    if description is not None and (URDF in formats or not formats):
        made = calibrated_urdf(
            read_robot_description(description, inputs), {**of.transforms, **of.joints}, str(description)
        )
        files = {CALIBRATED_URDF: made.content} | files
        notes = [*made.notes, *notes]
    return files, notes


def _texts(of: Calibrated, formats: Sequence[str]) -> tuple[dict[str, bytes], list[str]]:
    """Return the files by name, and, if all formats are requested, those that the dataset does not support."""
    files: dict[str, bytes] = {}
    notes = []
    for name in (each for each in FORMATS if not formats or each in formats):
        if name not in OF_CAMERAS and not (of.transforms or of.joints):
            if formats:
                raise InputError(
                    f"'{name}' is of transforms, and none is calibrated, only cameras: {', '.join(OF_CAMERAS)}"
                )
            continue
        try:
            files |= {file: text.encode() for file, text in FILES[name](of).items()}
        except InputError as error:
            if formats:
                raise
            notes.append(f"no {name}: {error}")
    return files, notes
