"""Table of the export formats: names, help, and the functions that write their files."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from calibration.exports.calibrated import Calibrated
from calibration.exports.cameras import camera_info, kalibr_camchain, opencv_storage
from calibration.exports.transforms import (
    autoware,
    ros1_launch,
    ros2_launch,
    ros2_xml,
    tf_static,
    xacro_properties,
)

URDF = "urdf"
"""The only format that needs an input file: the robot's URDF."""


class Format(NamedTuple):
    """Export format, one or several files."""

    what: str
    """Description of the format, for help texts."""
    files: Callable[[Calibrated], Mapping[str, str]]
    """Function that returns the texts of the files by name."""


FORMATS: Mapping[str, Format] = {
    "xacro": Format("properties for xacro macros", lambda of: {"calibrated.yaml": xacro_properties(of)}),
    "ros1": Format("static transforms for roslaunch", lambda of: {"calibrated.ros1.launch": ros1_launch(of)}),
    "ros2": Format("static transforms for ros2 launch", lambda of: {"calibrated.launch.py": ros2_launch(of)}),
    "ros2-xml": Format("the same as XML", lambda of: {"calibrated.launch.xml": ros2_xml(of)}),
    "tf-static": Format("messages of /tf_static", lambda of: {"tf_static.yaml": tf_static(of)}),
    "autoware": Format("Autoware's sensors_calibration.yaml and sensor_kit_calibration.yaml", autoware),
    "camera-info": Format(
        "camera_info of each camera",
        lambda of: {f"{file_name(name)}.yaml": camera_info(camera, name) for name, camera in of.cameras.items()},
    ),
    "kalibr": Format("Kalibr's camchain", lambda of: {"camchain.yaml": kalibr_camchain(of)}),
    "opencv": Format("OpenCV's FileStorage", lambda of: {"opencv.yml": opencv_storage(of)}),
}


def file_name(name: str) -> str:
    """Turn a name into a safe file name: no separators, not hidden."""
    kept = "".join(each if each.isalnum() or each in "_-." else "_" for each in name)
    return f"camera_info_{kept}"
