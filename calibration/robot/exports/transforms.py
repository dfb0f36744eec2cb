"""Calibrated transforms outside of a URDF: launch files of static transforms, and YAML."""

import json
import re

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.geometry.rotations import to_quaternion, to_rpy
from calibration.robot.exports.calibrated import Calibrated
from calibration.robot.exports.yaml_text import yaml_text

AUTOWARE_BASE = "base_link"
FRAME = re.compile(r"[\w./:+-]+")
"""Allowed in a launch file's attributes: blanks would separate arguments, ``$(...)`` would be evaluated."""


def _frame(name: str) -> str:
    """Return a frame's name, checked for use in a launch file's attribute.

    Raises:
        InputError: it contains other characters than those of `FRAME`.
    """
    if not FRAME.fullmatch(name):
        raise InputError(f"frame {name!r}: expected letters, digits and _ - . / : + in a frame of a launch file")
    return name


def _parts(T: Array) -> tuple[list[float], list[float]]:
    """Return translation, and rotation as a quaternion xyzw."""
    return [float(v) + 0.0 for v in T[:3, 3]], [float(v) + 0.0 for v in to_quaternion(T[:3, :3])]


def ros1_launch(of: Calibrated) -> str:
    """Return a ROS 1 launch file with one ``static_transform_publisher`` per transform."""
    lines = ["<launch>"]
    for i, ((parent, child), T) in enumerate(of.transforms.items()):
        xyz, quat = _parts(T)
        arguments = " ".join([*map(repr, (*xyz, *quat)), _frame(parent), _frame(child)])
        node = f'pkg="tf2_ros" type="static_transform_publisher" name="calibrated_{i}"'
        lines.append(f'  <node {node} args="{arguments}"/>')
    return "\n".join([*lines, "</launch>", ""])


def ros2_xml(of: Calibrated) -> str:
    """Return a ROS 2 launch file in XML with one ``static_transform_publisher`` per transform."""
    lines = ["<launch>"]
    for arguments in _ros2_arguments(of):
        text = " ".join([*arguments[:-3], _frame(arguments[-3]), arguments[-2], _frame(arguments[-1])])
        lines.append(f'  <node pkg="tf2_ros" exec="static_transform_publisher" args="{text}"/>')
    return "\n".join([*lines, "</launch>", ""])


def ros2_launch(of: Calibrated) -> str:
    """Return a ROS 2 launch file in Python with one ``static_transform_publisher`` per transform."""
    lines = [
        "from launch import LaunchDescription",
        "from launch_ros.actions import Node",
        "",
        "",
        "def generate_launch_description():",
        "    transforms = [",
        *(f"        {json.dumps(arguments)}," for arguments in _ros2_arguments(of)),
        "    ]",
        '    package, executable = "tf2_ros", "static_transform_publisher"',
        "    return LaunchDescription(",
        "        [Node(package=package, executable=executable, arguments=each) for each in transforms]",
        "    )",
        "",
    ]
    return "\n".join(lines)


def _ros2_arguments(of: Calibrated) -> list[list[str]]:
    found = []
    for (parent, child), T in of.transforms.items():
        names = ("--x", "--y", "--z", "--qx", "--qy", "--qz", "--qw")
        xyz, quat = _parts(T)
        numbers = [part for name, value in zip(names, (*xyz, *quat), strict=True) for part in (name, repr(value))]
        found.append([*numbers, "--frame-id", parent, "--child-frame-id", child])
    return found


def tf_static(of: Calibrated) -> str:
    """Return the transforms as YAML, in the form of ``/tf_static`` messages."""
    messages = []
    for (parent, child), T in of.transforms.items():
        xyz, quat = _parts(T)
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
        f"{parent}_to_{child}": {
            "xyz": " ".join(repr(float(v) + 0.0) for v in T[:3, 3]),
            "rpy": " ".join(repr(float(v) + 0.0) for v in to_rpy(T[:3, :3])),
        }
        for (parent, child), T in {**of.transforms, **of.joints}.items()
    }
    return yaml_text(origins)
