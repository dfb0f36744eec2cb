"""Cameras in the files of other tools, as ROS's camera_info: aslam, MetriCal, ViSP, camodocal (VINS), basalt."""

from collections.abc import Sequence
from typing import Any

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node
from calibration.engine.geometry.lenses import MODELS
from calibration.engine.geometry.transforms import from_quaternion, inverse

METRICAL_MODELS = {"opencv_radtan": "plumb_bob", "opencv_fisheye": "equidistant"}
"""Lens models by MetriCal's names."""
CAMODOCAL_MODELS = {
    "PINHOLE": ("plumb_bob", ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2")),
    "MEI": ("omni", ("gamma1", "gamma2", "u0", "v0"), ("xi", "k1", "k2", "p1", "p2")),
    "KANNALA_BRANDT": ("equidistant", ("mu", "mv", "u0", "v0"), ("k2", "k3", "k4", "k5")),
}
"""By camodocal's names of lenses: the model, and its names of fx, fy, cx, cy and of the coefficients."""
CAMODOCAL_SECTIONS = ("mirror_parameters", "distortion_parameters", "projection_parameters")
BASALT_MODELS = {
    "pinhole": ("plumb_bob", ()),
    "pinhole-radtan8": ("rational_polynomial", MODELS["rational_polynomial"].names()),
    "kb4": ("equidistant", MODELS["equidistant"].names()),
    "ds": ("double_sphere", MODELS["double_sphere"].names()),
    "eucm": ("eucm", MODELS["eucm"].names()),
}
"""By basalt's names of lenses: the model, and the coefficients that a file has."""


def metrical_as_camera_info(components: Node, name: str | None) -> Node:
    """Return a camera of MetriCal's plex, whose pixels begin at the corner of the first one, as camera_info."""
    cameras = {
        node["camera"]["name"].text(): node["camera"]["intrinsics"]
        for node in components.elements()
        if isinstance(node.value, dict) and "camera" in node.value
    }
    if not cameras:
        raise components.fault("found no camera among the components, expected one")
    node = cameras[choose_camera(components, list(cameras), name)]
    pinhole = node["projection"]["pinhole"]
    f, cx, cy = (pinhole[key].number() for key in ("f", "cx", "cy"))
    affinity = node.get("affinity")
    a1 = affinity["a1"] if affinity and affinity.get("a1") else None
    if a1 is not None and a1.number() != 0:
        raise a1.unexpected("0: of the same focal length in x and y")
    D, model = [], ""
    for kind, coefficients in distortion.items() if (distortion := node.get("distortion")) else ():
        known = METRICAL_MODELS.get(kind)
        values = [each.number() for _, each in coefficients.items()]
        if known is None and any(values):
            raise coefficients.unexpected(f"one of the lens models {', '.join(METRICAL_MODELS)}")
        if known is not None:
            D, model = [coefficients[each].number() for each in MODELS[known].names()], known
    size = (node["width"].value, node["height"].value)
    return as_camera_info(node, (f, f, cx - 0.5, cy - 0.5), D, model, size)


def visp_as_camera_info(node: Node) -> Node:
    """Return the camera of ViSP's vpXmlParserCamera as camera_info; its ``kud`` is k1 of plumb_bob."""
    model = node["model"]
    fx, cx, fy, cy = (model[key].number() for key in ("px", "u0", "py", "v0"))
    k1 = model["kud"].number() if model.get("kud") else 0.0
    size = (node["image_width"].value, node["image_height"].value)
    return as_camera_info(node, (fx, fy, cx, cy), [k1, 0.0, 0.0, 0.0, 0.0], "plumb_bob", size)


def aslam_as_camera_info(root: Node) -> Node:
    """Return a camera of aslam's YAML as camera_info."""
    if (projection := root["type"]).text() != "pinhole":
        raise projection.unexpected("pinhole")
    flat = Node(root.file, (*root.keys, "intrinsics"), flat_numbers(root["intrinsics"]))
    distortion = root["distortion"]
    parameters = distortion.get("parameters")
    D, size = flat_numbers(parameters) if parameters else [], (root["image_width"].value, root["image_height"].value)
    return as_camera_info(root, flat.numbers(4), D, distortion["type"].text(), size)


def camodocal_as_camera_info(root: Node) -> Node:
    """Return a camera of camodocal, as VINS-Fusion's configurations have it, as camera_info.

    Its equations are those of our models; of KANNALA_BRANDT the coefficients begin at k2.
    """
    kind = root["model_type"]
    if kind.text() not in CAMODOCAL_MODELS:
        raise kind.unexpected(f"one of {', '.join(CAMODOCAL_MODELS)}")
    model, intrinsics, coefficients = CAMODOCAL_MODELS[kind.text()]
    found = {name: each for key in CAMODOCAL_SECTIONS if (section := root.get(key)) for name, each in section.items()}
    if missing := [name for name in (*intrinsics, *coefficients) if name not in found]:
        sections = ", ".join(CAMODOCAL_SECTIONS)
        raise root.fault(f"has no {', '.join(missing)} in {sections}, expected those of {kind.value}")
    fx, fy, cx, cy = (found[name].number() for name in intrinsics)
    D, size = [found[name].number() for name in coefficients], (root["image_width"].value, root["image_height"].value)
    return as_camera_info(root, (fx, fy, cx, cy), D, model, size)


def basalt_as_camera_info(root: Node, name: str | None) -> tuple[Node, Array | None]:
    """Return a camera of basalt's calibration, ``cam0``, ``cam1`` ..., as camera_info, and its pose (4, 4) in cam0."""
    found = root["value0"]
    cameras = {f"cam{i}": node for i, node in enumerate(found["intrinsics"].elements())}
    number = list(cameras).index(choose_camera(found, list(cameras), name))
    camera = cameras[f"cam{number}"]
    if (kind := camera["camera_type"]).text() not in BASALT_MODELS:
        raise kind.unexpected(f"one of {', '.join(BASALT_MODELS)}")
    model, coefficients = BASALT_MODELS[kind.text()]
    fx, fy, cx, cy, *D = (camera["intrinsics"][each].number() for each in ("fx", "fy", "cx", "cy", *coefficients))
    sizes, poses = list(found["resolution"].elements()), found.get("T_imu_cam")
    if len(sizes) <= number:
        raise found["resolution"].fault(f"has {len(sizes)} sizes, expected one for each of {len(cameras)} cameras")
    T_imu_camera = [_basalt_pose(each) for each in poses.elements()] if poses else []
    T_chain_camera = inverse(T_imu_camera[0]) @ T_imu_camera[number] if number < len(T_imu_camera) else None
    return as_camera_info(camera, (fx, fy, cx, cy), D, model, sizes[number].numbers(2)), T_chain_camera


def _basalt_pose(node: Node) -> Array:
    t, q = ([node[f"{kind}{axis}"].number() for axis in axes] for kind, axes in (("p", "xyz"), ("q", "xyzw")))
    if not 0.99 < sum(each * each for each in q) < 1.01:
        raise node.fault("is no pose, expected a quaternion of length 1 in qx, qy, qz, qw")
    return from_quaternion(t, q)


def as_camera_info(node: Node, intrinsics: Sequence[float], D: Sequence[Any], model: str, size: Sequence[Any]) -> Node:
    """Return a camera as camera_info: fx, fy, cx, cy; coefficients; the name of the lens model; width and height."""
    fx, fy, cx, cy = intrinsics
    K = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    info = {"width": size[0], "height": size[1], "K": K, "D": D, "distortion_model": model}
    return Node(node.file, node.keys, info)


def choose_camera(root: Node, cameras: list[str], name: str | None) -> str:
    """Return the name of a camera of a file: the one that is asked for, else the only one."""
    if name is None and len(cameras) > 1:
        raise root.fault(f"has several cameras: add 'camera' with one of {', '.join(map(str, cameras))}")
    if name is not None and name not in cameras:
        raise root.fault(f"found the cameras {', '.join(map(str, cameras))}, expected '{name}'")
    return name or cameras[0]


def flat_numbers(node: Node) -> list[Any]:
    """Return a matrix as a flat list: from a flat list, from rows, or from ROS's and OpenCV's form with its size."""
    if isinstance(node.value, dict):
        node = node.get("coefficients") or node["data"]
    rows = list(node.elements())
    if rows and all(isinstance(row.value, list) for row in rows):
        return [number.number() for row in rows for number in row.elements()]
    return [number.number() for number in rows]
