"""Intrinsics in the files of other tools: ROS, Kalibr, OpenCV and robot_cal_tools; and of our own calibrations."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.dataset.document import Node
from calibration.dataset.lens_uncertainty import LensUncertainty
from calibration.dataset.sensors import MAX_INTRINSIC, MAX_PIXELS, read_camera
from calibration.estimation.intrinsics_file import read_calibrated
from calibration.files import read_bytes
from calibration.geometry import rotations
from calibration.geometry.cameras import Camera
from calibration.geometry.distortion import MODELS
from calibration.geometry.transforms import inverse, transform
from calibration.geometry.types import Array
from calibration.yaml_file import MAX_BYTES
from calibration.yaml_loading import parse_yaml

KALIBR_MODELS = {"radtan": "plumb_bob", "equidistant": "equidistant", "none": "plumb_bob"}
"""ROS's names of Kalibr's distortion models; the other ones (fov) have no equivalent."""
BASELINE = "T_cn_cnm1"
"""Kalibr's key of a camera: the pose of the one before in its frame."""
MAX_BASELINE = 1e4
"""Limit of a baseline, m."""
ROUNDED = 1e-2
"""Limit of how far an element of a rotation in a file is off."""
_KEYS = {
    "width": ("image_width", "width", "image_Width", "imageWidth"),
    "height": ("image_height", "height", "image_Height", "imageHeight"),
    "K": ("camera_matrix", "K", "k", "Camera_Matrix", "cameraMatrix", "intrinsic_matrix"),
    "D": ("distortion_coefficients", "D", "d", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "distortion"),
}
"""Keys of ROS and of OpenCV's samples."""
_SIZE = "cameraResolution"
"""Key of width and height in the files of OpenCV's interactive-calibration."""
_DEVIATIONS = (
    (("stdDeviationsIntrinsics", "std_deviations_intrinsics", "standard_deviations", "stdDeviations"), slice(0, None)),
    (("cameraMatrix_std_dev", "camera_matrix_std_dev"), slice(0, 4)),
    (("dist_coeffs_std_dev", "distCoeffs_std_dev", "distortion_coefficients_std_dev"), slice(4, None)),
)
"""Keys of OpenCV's standard deviations, and which of fx, fy, cx, cy and the coefficients, in this order, they are of.

As programs write what calibrateCameraExtended returns, and in two parts as interactive-calibration does."""


@dataclass(frozen=True)
class KnownLens:
    """Intrinsics from a file."""

    path: Path
    camera: Camera
    has_size: bool
    """Whether the file has the size of the images; else the camera's size must not be used."""
    T_chain_camera: Array | None = None
    """(4, 4): the camera's pose in the frame of cam0, where a camchain has its baselines."""
    uncertainty: LensUncertainty | None = None
    """How well the intrinsics are known, where the file says so."""


def read_lens(path: Path, name: str | None = None) -> KnownLens:
    """Read the intrinsics from a file, whose format is recognised by its keys.

    Args:
        path: path of the file.
        name: of the camera, in a file of several.

    Raises:
        InputError: the file cannot be read, has an unknown format, has several cameras or none of this name, or
            something in it is missing or wrong.
    """
    data = read_bytes(path, MAX_BYTES, "a file of intrinsics")
    if data.startswith(b"%YAML"):  # OpenCV's first line is not valid in YAML 1.1 (``%YAML:1.0``)
        data = b"#" + data
    root = Node(path, (), parse_yaml(data, path))
    document = root.mapping()
    if "cameras" in document:
        return _of_our_calibration(root["cameras"], name)
    if cameras := [key for key, node in root.items() if isinstance(node.value, dict) and "camera_model" in node.value]:
        chosen = _chosen(root, cameras, name)
        return replace(_kalibr(root[chosen]), T_chain_camera=_pose_in_chain(root, chosen))
    if numbered := [key[len("name_") :] for key in document if isinstance(key, str) and key.startswith("name_")]:
        return _of_our_storage(root, numbered, name)
    if name is not None:
        raise root.fault(f"has one camera without a name, expected '{name}': leave out 'camera'")
    if "intrinsics" in document:
        return _robot_cal_tools(root["intrinsics"])
    return _camera_info(root)


def _of_our_calibration(cameras: Node, name: str | None) -> KnownLens:
    """Parse a camera in the ``intrinsics.json`` of a calibration, with its covariance."""
    node = cameras[_chosen(cameras, [each for each, _ in cameras.items()], name)]
    camera, found = read_camera(node["camera_info"]), read_calibrated(node)
    uncertainty = LensUncertainty(found.parameters, found.sigmas, found.covariance)
    return KnownLens(node.file, camera, has_size=True, uncertainty=uncertainty)


def _of_our_storage(root: Node, numbered: list[str], name: str | None) -> KnownLens:
    """Parse a camera in the FileStorage of ``export``: ``name_0``, ``size_0``, ``model_0``, ``K_0``, ``D_0``."""
    names = {root[f"name_{number}"].text(): number for number in numbered}
    number = names[_chosen(root, list(names), name)]
    width, height = Node(root.file, (f"size_{number}",), _numbers(root[f"size_{number}"])).numbers(2)
    info = {
        "width": width,
        "height": height,
        "K": _numbers(root[f"K_{number}"]),
        "D": _numbers(root[f"D_{number}"]),
        "distortion_model": root[f"model_{number}"].text(),
    }
    return KnownLens(root.file, read_camera(Node(root.file, root.keys, info)), has_size=True)


def _chosen(root: Node, cameras: list[str], name: str | None) -> str:
    if name is None and len(cameras) > 1:
        raise root.fault(f"has several cameras: add 'camera' with one of {', '.join(map(str, cameras))}")
    if name is not None and name not in cameras:
        raise root.fault(f"found the cameras {', '.join(map(str, cameras))}, expected '{name}'")
    return name or cameras[0]


def _kalibr(node: Node) -> KnownLens:
    if (model := node["camera_model"]).text() != "pinhole":
        raise model.unexpected("pinhole")
    name = node.get("distortion_model")
    if name and name.text() not in KALIBR_MODELS:
        raise name.unexpected(f"a lens that ROS has too: {', '.join(KALIBR_MODELS)}")
    coefficients = node.get("distortion_coeffs")
    fx, fy, cx, cy = node["intrinsics"].numbers(4)
    width, height = node["resolution"].numbers(2)
    info = {
        "width": width,
        "height": height,
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "D": coefficients.sequence() if coefficients else [],
        "distortion_model": KALIBR_MODELS[name.value] if name else "plumb_bob",
    }
    return KnownLens(node.file, read_camera(Node(node.file, node.keys, info)), has_size=True)


def _pose_in_chain(root: Node, name: str) -> Array | None:
    """Return the pose of a camera in the frame of cam0, from the baselines between them; None if one is missing."""
    numbered = re.fullmatch(r"cam([0-9]{1,3})", name)
    if numbered is None:
        return None
    pose = np.eye(4)
    for i in range(1, int(numbered[1]) + 1):
        camera = root.get(f"cam{i}")
        baseline = camera.get(BASELINE) if camera else None
        if baseline is None:
            return None
        pose = pose @ inverse(_rigid(baseline))
    return pose


def _rigid(node: Node) -> Array:
    """Parse a transform of four rows (4, 4); its rotation may be rounded."""
    rows = [row.numbers(4) for row in node.elements()]
    T = np.array(rows) if len(rows) == 4 else np.zeros((4, 4))
    R = rotations.nearest(np.clip(T[:3, :3], -2, 2))
    if abs(T[:3, :3] - R).max() > ROUNDED or (T[3] != [0, 0, 0, 1]).any() or abs(T[:3, 3]).max() > MAX_BASELINE:
        raise node.fault("is no transform, expected four rows of four numbers: a rotation, a translation, 0 0 0 1")
    return transform(R, T[:3, 3])


def _robot_cal_tools(node: Node) -> KnownLens:
    fx, fy, cx, cy = (node[key].number() for key in ("fx", "fy", "cx", "cy"))
    K = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    return _without_size(node, {"K": K, "D": [], "distortion_model": "plumb_bob"})


def _camera_info(root: Node) -> KnownLens:
    found = {what: node for what, keys in _KEYS.items() if (node := _first(root, keys)) is not None}
    if "K" not in found:
        raise root.fault(
            "found no camera in it, expected ROS's camera_info (camera_matrix), Kalibr's camchain (cam0) or "
            "OpenCV's FileStorage (camera_matrix or K)"
        )
    D = _numbers(found["D"]) if "D" in found else []
    model = root.get("distortion_model")
    info: dict[str, Any] = {
        "K": _numbers(found["K"]),
        "D": D,
        "distortion_model": model.value if model else "rational_polynomial" if len(D) > 5 else "plumb_bob",
    }
    if (size := root.get(_SIZE)) is not None:
        info["width"], info["height"] = size.numbers(2)
    elif "width" in found and "height" in found:
        info |= {"width": found["width"].value, "height": found["height"].value}
    else:
        return replace(_without_size(root, info), uncertainty=_deviations(root, info))
    camera = read_camera(Node(root.file, root.keys, info))
    return KnownLens(root.file, camera, has_size=True, uncertainty=_deviations(root, info))


def _deviations(root: Node, info: Mapping[str, Any]) -> LensUncertainty | None:
    """Return OpenCV's standard deviations, if the file has any; 0 stands for what was not calibrated."""
    names = ("fx", "fy", "cx", "cy", *MODELS[info["distortion_model"] or "plumb_bob"].names())
    found: dict[str, float] = {}
    for keys, of in _DEVIATIONS:
        if (node := _first(root, keys)) is not None:
            flat = Node(root.file, node.keys, _numbers(node))
            values = [each.within(0, MAX_INTRINSIC) for each in flat.elements()]
            found |= {name: value for name, value in zip(names[of], values, strict=False) if value > 0}
    parameters = tuple(name for name in names if name in found)
    return LensUncertainty(parameters, np.array([found[name] for name in parameters])) if found else None


def _without_size(node: Node, info: Mapping[str, Any]) -> KnownLens:
    sized = {**info, "width": MAX_PIXELS, "height": MAX_PIXELS}
    return KnownLens(node.file, read_camera(Node(node.file, node.keys, sized)), has_size=False)


def _first(root: Node, keys: tuple[str, ...]) -> Node | None:
    return next((node for key in keys if (node := root.get(key))), None)


def _numbers(node: Node) -> list[Any]:
    """Return a matrix as a flat list: from a flat list, from rows, or from ROS's and OpenCV's form with its size."""
    if isinstance(node.value, dict):
        node = node["data"]
    rows = list(node.elements())
    if rows and all(isinstance(row.value, list) for row in rows):
        return [number.number() for row in rows for number in row.elements()]
    return [number.number() for number in rows]
