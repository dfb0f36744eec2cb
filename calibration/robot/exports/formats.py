"""Table of the export formats: the functions that write their files."""

from collections.abc import Callable, Mapping

from calibration.robot.exports.calibrated import Calibrated
from calibration.robot.exports.cameras import camera_info, kalibr_camchain, opencv_storage
from calibration.robot.exports.transforms import (
    autoware,
    ros1_launch,
    ros2_launch,
    ros2_xml,
    tf_static,
    xacro_properties,
)

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
"""Function of each of `calibration.robot.exports.names.FORMATS` that returns the texts of its files by name."""


def file_name(name: str) -> str:
    """Turn a name into a safe file name: no separators, not hidden."""
    kept = "".join(each if each.isalnum() or each in "_-." else "_" for each in name)
    return f"camera_info_{kept}"
