"""Intrinsics in files: of ROS, Kalibr, OpenCV, anipose, our own calibrations, and of the tools of `other_cameras`."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import Configuration
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.model import Edge, LensUncertainty
from calibration.engine.dataset.sensors import MAX_INTRINSIC, MAX_PIXELS, read_camera
from calibration.engine.estimation.problem.intrinsics import read_calibrated
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS, SYNONYMS
from calibration.engine.geometry.transforms import inverse, transform
from calibration.robot.importing.files import other_cameras
from calibration.robot.importing.files.structured_files import read_structured

KALIBR_MODELS = {
    (model.kalibr.camera_model, distortion): model
    for model in reversed(MODELS.values())  # the simplest one counts: a pinhole without distortion is plumb_bob
    if model.kalibr
    for distortion in dict.fromkeys((model.kalibr.distortion_model, "none"))
}
"""Lens models by Kalibr's camera_model and distortion_model; other ones (fov) have no equivalent."""
KALIBR_BASELINE_KEY = "T_cn_cnm1"
"""Kalibr's key of a camera: the pose of the one before in its frame."""
MAX_BASELINE = 1e4
"""Limit of a baseline, m."""
MAX_ROTATION_ROUNDING = 1e-2
"""Limit of how far an element of a rotation in a file is off."""
_KEYS_OF_VALUE = {
    "width": ("image_width", "width", "image_Width", "imageWidth", "img_width"),
    "height": ("image_height", "height", "image_Height", "imageHeight", "img_height"),
    "K": (
        *("camera_matrix", "K", "k", "Camera_Matrix", "cameraMatrix", "intrinsic_matrix", "mtx", "matrix", "cam_mat"),
        *("intrinsics", "camera_intrinsics", "intrinsics_K", "intrinsic", "Intrinsic"),
    ),
    "D": (
        *("distortion_coefficients", "D", "d", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "distortion"),
        *("dist", "distortions", "distortion_coeffs", "coeffs"),
    ),
}
"""Keys of ROS, of OpenCV's samples, and of those who save what OpenCV returns."""
_SIZE_KEYS = ("cameraResolution", "size", "image_size", "img_size", "resolution", "image_size_wh")
"""Keys of width and height: of OpenCV's interactive-calibration, of anipose and multical."""
_MODEL_KEYS = ("distortion_model", "camera_model")
"""Keys of the lens model: of camera_info, and of the files of camera_calibration."""
_FISHEYE_KEYS = ("fisheye", "fisheye_model", "use_fisheye")
"""Keys that are true for a fisheye: of anipose, of OpenCV's sample."""
ROS_NAME_OF_MODEL = {
    **SYNONYMS,
    "opencv_fisheye": "equidistant",
    "radial-tangential": "plumb_bob",
    "opencv_radtan": "plumb_bob",
    "standard": "plumb_bob",
    "pinhole": "",
    "none": "plumb_bob",
}
"""ROS's names of others' lens models; '' where it tells nothing of the distortion."""
AMBIGUOUS_COEFFICIENTS = 4
"""Number of coefficients that plumb_bob (k1, k2, p1, p2) and a fisheye of cv2.fisheye (k1 to k4) both have."""
_DEVIATION_KEYS = (
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


def read_lens(
    path: Path, name: str | None = None, model: str | None = None, distortion: Path | None = None
) -> KnownLens:
    """Read the intrinsics from a file, whose format is recognised by its keys.

    Args:
        path: path of the file.
        name: of the camera, in a file of several.
        model: lens model, whatever the file says of it.
        distortion: file of the coefficients, if the first is a matrix alone.

    Raises:
        InputError: the file cannot be read, has an unknown format, has several cameras or none of this name, or
            something in it is missing or wrong.
    """
    chosen = None if model is None else known_model(path, model)
    root = read_structured(path, "a file of intrinsics")
    if isinstance(root.value, list):  # a matrix alone, as numpy.save and numpy.savetxt write it
        root = Node(path, (), {"K": root.value})
    if distortion is not None:
        root = _with_coefficients(root, distortion)
    found = _read_lens(root, name, chosen)
    camera = found.camera
    if found.has_size and not (0 <= camera.cx <= camera.width and 0 <= camera.cy <= camera.height):
        raise InputError(
            f"{path}: found the principal point ({camera.cx:g}, {camera.cy:g}) px outside of an image of "
            f"{camera.width} x {camera.height}, expected one inside: were they calibrated at another resolution? "
            "Correct the size, or leave out 'intrinsics' and let them be calibrated"
        )
    return found


def _with_coefficients(root: Node, path: Path) -> Node:
    """Return a camera's matrix with the distortion of another file."""
    if _first_present(root, _KEYS_OF_VALUE["D"]) or not _first_present(root, _KEYS_OF_VALUE["K"]):
        raise root.fault("found no matrix alone, expected one beside the file 'distortion' of import.yml")
    other = read_structured(path, "a file of distortion coefficients")
    coefficients = other if isinstance(other.value, list) else _first_present(other, _KEYS_OF_VALUE["D"])
    if coefficients is None:
        raise other.fault(f"found no coefficients, expected numbers alone, or one of {', '.join(_KEYS_OF_VALUE['D'])}")
    return Node(root.file, (), {**root.mapping(), "D": other_cameras.flat_numbers(coefficients)})


def known_model(path: Path, model: str) -> str:
    """Return a lens model of import.yml by its name here.

    Raises:
        InputError: it is unknown; the message begins with the path.
    """
    if (known := ROS_NAME_OF_MODEL.get(model, model)) in MODELS:
        return known
    raise InputError(f"{path}: found the lens model '{model}' in import.yml, expected one of {', '.join(MODELS)}")


def _read_lens(root: Node, name: str | None, model: str | None) -> KnownLens:
    document = root.mapping()
    if "value0" in document:
        info, T_chain_camera = other_cameras.basalt_as_camera_info(root, name)
        return KnownLens(root.file, read_camera(info), has_size=True, T_chain_camera=T_chain_camera)
    if "components" in document:
        root, name = other_cameras.metrical_as_camera_info(root["components"], name), None
    elif "camera" in document and isinstance(document["camera"], dict) and "model" in document["camera"]:
        root = other_cameras.visp_as_camera_info(root["camera"])
    elif "model_type" in document:
        root = other_cameras.camodocal_as_camera_info(root)
    elif cameras := _cameras_by_name(root):
        chosen = other_cameras.choose_camera(root, list(cameras), name)
        node, name = cameras[chosen], None
        if "camera_info" in node.value:
            return _of_our_calibration(node)
        if "camera_model" in node.value and "camera_matrix" not in node.value:
            return replace(_read_kalibr_lens(node), T_chain_camera=_pose_in_chain(root, chosen))
        root = node
    elif numbered := [key[len("name_") :] for key in document if isinstance(key, str) and key.startswith("name_")]:
        return _of_our_storage(root, numbered, name)
    if name is not None:
        raise root.fault(f"has one camera without a name, expected '{name}': leave out 'camera'")
    if "intrinsics" in root.value and isinstance(root.value.get("distortion"), dict) and "type" in root.value:
        root = other_cameras.aslam_as_camera_info(root)
    return _camera_info(root, model)


def _cameras_by_name(root: Node) -> dict[str, Node]:
    """Return the cameras of a file of several by their names: Kalibr's, aslam's, anipose's, caliscope's, our own."""
    listed = root.get("cameras") or root
    if isinstance(listed.value, list):
        nodes = [each.get("camera") or each for each in listed.elements()]
        return {each["label"].text() if each.get("label") else str(i): each for i, each in enumerate(nodes)}
    found = {}
    for key, node in listed.items():
        if not isinstance(node.value, dict) or {"rows", "cols", "data"} <= set(node.value):
            continue
        if {"camera_info", "camera_model"} & set(node.value) or _first_present(node, _KEYS_OF_VALUE["K"]):
            found[node["name"].text() if node.get("name") else key] = node
    return found


def _of_our_calibration(node: Node) -> KnownLens:
    """Parse a camera in the ``intrinsics.json`` of a calibration, with its covariance."""
    camera, found = read_camera(node["camera_info"]), read_calibrated(node)
    uncertainty = LensUncertainty(found.parameters, found.sigmas, found.covariance)
    return KnownLens(node.file, camera, has_size=True, uncertainty=uncertainty)


def _of_our_storage(root: Node, numbered: list[str], name: str | None) -> KnownLens:
    """Parse a camera in the FileStorage of ``export``: ``name_0``, ``size_0``, ``model_0``, ``K_0``, ``D_0``."""
    names = {root[f"name_{number}"].text(): number for number in numbered}
    number = names[other_cameras.choose_camera(root, list(names), name)]
    width, height = Node(root.file, (f"size_{number}",), other_cameras.flat_numbers(root[f"size_{number}"])).numbers(2)
    info = {
        "width": width,
        "height": height,
        "K": other_cameras.flat_numbers(root[f"K_{number}"]),
        "D": other_cameras.flat_numbers(root[f"D_{number}"]),
        "distortion_model": root[f"model_{number}"].text(),
    }
    return KnownLens(root.file, read_camera(Node(root.file, root.keys, info)), has_size=True)


def _read_kalibr_lens(node: Node) -> KnownLens:
    camera, name = node["camera_model"], node.get("distortion_model")
    distortions = [distortion for known, distortion in KALIBR_MODELS if known == camera.text()]
    if not distortions:
        raise camera.unexpected(f"one of {', '.join(dict.fromkeys(known for known, _ in KALIBR_MODELS))}")
    if name and name.text() not in distortions:
        raise name.unexpected(f"a distortion of {camera.value}: {', '.join(distortions)}")
    model = KALIBR_MODELS[camera.value, name.value if name else "none"]
    coefficients = node.get("distortion_coeffs")
    before = model.kalibr.intrinsics if model.kalibr else 0
    numbers = node["intrinsics"].numbers(before + 4)
    D = [*numbers[:before], *(coefficients.sequence() if coefficients else [])]
    info = other_cameras.as_camera_info(node, numbers[before:], D, model.ros_name, node["resolution"].numbers(2))
    return KnownLens(node.file, read_camera(info), has_size=True)


def _pose_in_chain(root: Node, name: str) -> Array | None:
    """Return the pose of a camera in the frame of cam0, from the baselines between them; None if one is missing."""
    numbered = re.fullmatch(r"cam([0-9]{1,3})", name)
    if numbered is None:
        return None
    pose = np.eye(4)
    for i in range(1, int(numbered[1]) + 1):
        camera = root.get(f"cam{i}")
        baseline = camera.get(KALIBR_BASELINE_KEY) if camera else None
        if baseline is None:
            return None
        pose = pose @ inverse(_rigid_transform(baseline))
    return pose


def _rigid_transform(node: Node) -> Array:
    """Parse a transform of four rows (4, 4); its rotation may be rounded."""
    rows = [row.numbers(4) for row in node.elements()]
    T = np.array(rows) if len(rows) == 4 else np.zeros((4, 4))
    R = rotations.nearest(np.clip(T[:3, :3], -2, 2))
    if (
        abs(T[:3, :3] - R).max() > MAX_ROTATION_ROUNDING
        or (T[3] != [0, 0, 0, 1]).any()
        or abs(T[:3, 3]).max() > MAX_BASELINE
    ):
        raise node.fault("is no transform, expected four rows of four numbers: a rotation, a translation, 0 0 0 1")
    return transform(R, T[:3, 3])


def _flat_matrix(node: Node) -> list[Any]:
    """Return a camera's matrix as a flat list, from its numbers, or from fx, fy, cx, cy (librealsense: ppx, ppy)."""
    if not isinstance(node.value, dict) or "fx" not in node.value:
        return other_cameras.flat_numbers(node)
    principal_point = ("ppx", "ppy") if "ppx" in node.value else ("cx", "cy")
    fx, fy, cx, cy = (node[key].number() for key in ("fx", "fy", *principal_point))
    return [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]


def _camera_info(root: Node, model: str | None) -> KnownLens:
    found = {what: node for what, keys in _KEYS_OF_VALUE.items() if (node := _first_present(root, keys)) is not None}
    if "fx" in root.mapping():
        found["K"] = root
    if "K" not in found:
        raise root.fault(
            "found no camera in it, expected ROS's camera_info (camera_matrix), Kalibr's camchain (cam0) or "
            "OpenCV's FileStorage (camera_matrix or K)"
        )
    D = found.get("D")
    coefficients = other_cameras.flat_numbers(D) if D else []
    stated = model or _stated_model(root)
    if not stated and len(coefficients) == AMBIGUOUS_COEFFICIENTS and any(coefficients) and D:
        raise D.fault(
            "found 4 coefficients and no lens model, which may be plumb_bob (k1, k2, p1, p2) or a fisheye of "
            "cv2.fisheye (k1 to k4): add 'model: plumb_bob' or 'model: equidistant' to the sensor in import.yml"
        )
    stated = stated or ("rational_polynomial" if len(coefficients) > 5 else "plumb_bob")
    info: dict[str, Any] = {
        "K": _flat_matrix(found["K"]),
        "D": _of_the_model(D, coefficients, stated) if D else [],
        "distortion_model": stated,
    }
    if (size := _first_present(root, _SIZE_KEYS)) is not None:
        named = isinstance(size.value, dict) and "width" in size.value
        sides = [size[key].value for key in ("width", "height")] if named else other_cameras.flat_numbers(size)
        info["width"], info["height"] = Node(size.file, size.keys, sides).numbers(2)
    elif "width" in found and "height" in found:
        info |= {"width": found["width"].value, "height": found["height"].value}
    else:
        return replace(_without_size(root, info), uncertainty=_read_standard_deviations(root, info))
    camera = read_camera(Node(root.file, root.keys, info))
    return KnownLens(root.file, camera, has_size=True, uncertainty=_read_standard_deviations(root, info))


def _stated_model(root: Node) -> str:
    """Return ROS's name of the lens model that a file states; '' if it states none."""
    fisheye = _first_present(root, _FISHEYE_KEYS)
    if fisheye is not None and fisheye.value not in (False, 0, "0", "false"):
        return "equidistant"
    for node in (root.get(key) for key in _MODEL_KEYS):
        if node is not None and (name := ROS_NAME_OF_MODEL.get(node.text(), node.text())):
            if name not in MODELS:
                raise node.unexpected(f"a known distortion model: {', '.join(MODELS)}, or 'fisheye'")
            return name
    return ""


def _of_the_model(D: Node, coefficients: list[float], model: str) -> list[float]:
    """Return the coefficients without the zeros beyond the model's."""
    names = MODELS[model].names()
    kept, beyond = coefficients[: len(names)], coefficients[len(names) :]
    if any(beyond):
        is_rational = model == "plumb_bob" and not any(coefficients[8:])
        hint = "; if they are k4 to k6, write 'model: rational_polynomial' at the sensor in import.yml"
        raise D.fault(
            f"found {len(coefficients)} coefficients, expected the {len(names)} of {model} ({', '.join(names)}) and "
            f"zeros after them{hint if is_rational else ''}"
        )
    return kept


def _read_standard_deviations(root: Node, info: Mapping[str, Any]) -> LensUncertainty | None:
    """Return OpenCV's standard deviations, if the file has any; 0 stands for what was not calibrated."""
    names = ("fx", "fy", "cx", "cy", *MODELS[info["distortion_model"] or "plumb_bob"].names())
    found: dict[str, float] = {}
    for keys, of in _DEVIATION_KEYS:
        if (node := _first_present(root, keys)) is not None:
            flat = Node(root.file, node.keys, other_cameras.flat_numbers(node))
            values = [each.within(0, MAX_INTRINSIC) for each in flat.elements()]
            found |= {name: value for name, value in zip(names[of], values, strict=False) if value > 0}
    parameters = tuple(name for name in names if name in found)
    return LensUncertainty(parameters, np.array([found[name] for name in parameters])) if found else None


def _without_size(node: Node, info: Mapping[str, Any]) -> KnownLens:
    sized = {**info, "width": MAX_PIXELS, "height": MAX_PIXELS}
    return KnownLens(node.file, read_camera(Node(node.file, node.keys, sized)), has_size=False)


def _first_present(root: Node, keys: tuple[str, ...]) -> Node | None:
    return next((node for key in keys if (node := root.get(key))), None)


def with_baselines(
    transforms: Mapping[Edge, Array],
    configuration: Configuration,
    lenses: Mapping[str, KnownLens],
    known: Collection[Edge] = (),
) -> dict[Edge, Array]:
    """Place the cameras of a camchain that hang on one frame relative to the first of them, which stays.

    Args:
        transforms: ``T_parent_child`` (N, 4, 4) at each moment; of unknown ones the identity.
        configuration: the sensors.
        lenses: intrinsics of the cameras that have a file.
        known: transforms that the description or the recording has; these stay.
    """
    placed = dict(transforms)
    first: dict[tuple[Path, str], Array] = {}
    for name, sensor in configuration.sensors.items():
        edge = (sensor.parent_link, sensor.child_link)
        lens = lenses.get(name)
        if lens is None or lens.T_chain_camera is None or edge in known:
            continue
        T_first_chain = first.setdefault((lens.path, sensor.parent_link), inverse(lens.T_chain_camera))
        placed[edge] = placed[edge] @ T_first_chain @ lens.T_chain_camera
    return placed
