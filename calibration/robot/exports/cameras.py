"""Camera parameters in other tools' file formats: ROS's camera_info, Kalibr's camchain, OpenCV's FileStorage."""

from itertools import pairwise

import numpy as np

from calibration.base.errors import InputError
from calibration.base.optional import optional
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses.model import KalibrName
from calibration.engine.geometry.transforms import inverse
from calibration.robot.exports.calibrated import Calibrated
from calibration.robot.exports.yaml_text import yaml_text


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
