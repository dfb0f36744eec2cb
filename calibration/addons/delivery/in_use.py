"""Transforms and cameras that are in use on a robot, read from its files: nothing is executed."""

import ast
import math
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.parsers.expat import ExpatError, ParserCreate

from calibration.base import InputError, one_line, read_bytes, shorten
from calibration.base.optional import optional

if TYPE_CHECKING:
    from calibration.robot.importing.bags.bag import Bag

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Pose(NamedTuple):
    """``T_parent_child``."""

    trans: Vector
    quat: Quaternion
    """As it is in use: it may not have the length 1."""

    def __matmul__(self, other: "Pose") -> "Pose":
        moved = _rotated(self.quat, other.trans)
        x, y, z = (a + b for a, b in zip(self.trans, moved, strict=True))
        return Pose((x, y, z), _product(self.quat, other.quat))


def pose_of(numbers: Sequence[float]) -> Pose:
    """Return the pose of x, y, z and a quaternion xyzw."""
    x, y, z, *quat = numbers
    a, b, c, d = quat
    return Pose((x, y, z), (a, b, c, d))


def pose_of_angles(xyz: Sequence[float], rpy: Sequence[float]) -> Pose:
    """Return the pose of a translation, and of roll, pitch and yaw about fixed axes, rad, as in a URDF."""
    (x, y, z), quat = xyz, (0.0, 0.0, 0.0, 1.0)
    for axis, angle in enumerate(rpy):
        turn = [0.0, 0.0, 0.0, math.cos(angle / 2)]
        turn[axis] = math.sin(angle / 2)
        quat = _product((turn[0], turn[1], turn[2], turn[3]), quat)
    return Pose((x, y, z), quat)


def distance_of_poses(one: Pose, other: Pose) -> tuple[float, float]:
    """Return the distance of two poses, mm and degrees; a quaternion whose length is not 1 counts as a rotation too."""
    same, opposite = (math.dist(one.quat, tuple(sign * value for value in other.quat)) for sign in (1.0, -1.0))
    return 1e3 * math.dist(one.trans, other.trans), math.degrees(2 * min(same, opposite))


def _product(p: Quaternion, q: Quaternion) -> Quaternion:
    (px, py, pz, pw), (qx, qy, qz, qw) = p, q
    return (
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )


def _rotated(quat: Quaternion, vector: Vector) -> Vector:
    length = sum(value * value for value in quat) or 1.0
    x, y, z, w = quat
    found = _product(_product(quat, (*vector, 0.0)), (-x, -y, -z, w))
    return found[0] / length, found[1] / length, found[2] / length


MAX_FILE_BYTES = 16 * 1024**2
MAX_LAUNCH_BYTES = 1024**2
BAG_ENDINGS = (".bag", ".db3", ".mcap")
SUPPORTED_FILES = "a URDF, a launch file, YAML of Autoware, of camera_info or of messages, or a bag"
_POSITION, _QUATERNION, _ANGLES = (
    ("--x", "--y", "--z"),
    ("--qx", "--qy", "--qz", "--qw"),
    ("--roll", "--pitch", "--yaw"),
)
_MATRICES = ("K", "D", "R", "P")
_STATIC_TOPIC, _CAMERA_INFO_TYPE = "/tf_static", "sensor_msgs/msg/CameraInfo"
_AUTOWARE_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_DOCUMENT_END = re.compile(rb"^---[ \t]*$", re.MULTILINE)


@dataclass(frozen=True)
class UsedTransform:
    """Transform that is in use."""

    parent: str
    child: str
    pose: Pose
    moves: bool = False
    """Whether it is a joint that moves, at position 0."""


@dataclass(frozen=True)
class UsedCamera:
    """Intrinsics that are in use."""

    place: str
    """File, or topic of a bag."""
    name: str | None
    """Name of the camera, where the file or the user says it."""
    frame: str | None
    """Frame of its images, where a message says it."""
    values: Mapping[str, Any]
    """Size, distortion_model, K, D, R and P."""


@dataclass(frozen=True)
class InUse:
    """Content of one file or bag."""

    place: str
    transforms: tuple[UsedTransform, ...] = ()
    cameras: tuple[UsedCamera, ...] = ()
    has_joints: bool = False
    """Whether it could have joints that move: it is a URDF."""


def read_in_use(path: Path, camera: str | None = None) -> InUse:
    """Read what is in use from a file or a bag.

    Args:
        path: the file.
        camera: name of the camera that loads it; None to take the name in the file.

    Raises:
        InputError: it cannot be read, or is of no supported kind.
        InfrastructureError: a bag is given, and the package for bags is not installed.
    """
    if path.is_dir() or path.suffix in BAG_ENDINGS:
        return _read_bag(path)
    content = read_bytes(path, MAX_FILE_BYTES, SUPPORTED_FILES)
    start = content.lstrip()[:1]
    if path.suffix == ".py":
        return InUse(str(path), tuple(_launch_transforms(_literal_lists(content, path), path)))
    if start == b"<":
        return _read_xml(content, path)
    return _read_yaml(content, path, camera)


def _read_xml(content: bytes, path: Path) -> InUse:
    elements: list[tuple[tuple[str, ...], dict[str, str]]] = []
    _parse_xml(content, path, lambda tags, attributes: elements.append((tags, attributes)))
    root = elements[0][0][0] if elements else ""
    if root == "robot":
        return InUse(str(path), tuple(_joints(elements, path)), has_joints=True)
    if root == "launch":
        arguments = (
            shlex.split(attributes["args"])
            for tags, attributes in elements
            if tags[-1] == "node" and "args" in attributes and _publishes_static(attributes)
        )
        return InUse(str(path), tuple(_launch_transforms(arguments, path)))
    raise InputError(f"{path}: found XML with the root '{shorten(root)}', expected {SUPPORTED_FILES}")


def _publishes_static(attributes: Mapping[str, str]) -> bool:
    return "static_transform_publisher" in (attributes.get("exec"), attributes.get("type"))


def _parse_xml(content: bytes, path: Path, found: Callable[[tuple[str, ...], dict[str, str]], None]) -> None:
    """Call a function for each element with the names of it and those around it, and its attributes."""
    tags: list[str] = []
    parser = ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        tags.append(tag)
        if len(tags) > 100:
            raise InputError(f"{path}: its elements are nested more than 100 deep")
        found(tuple(tags), attributes)

    def refuse(*_: object) -> None:
        raise InputError(f"{path}: it has a document type, which may declare entities: remove it")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: tags.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except (ExpatError, ValueError, LookupError) as error:
        raise InputError(f"{path}: this is not valid XML: {error}") from None


def _joints(elements: Sequence[tuple[tuple[str, ...], dict[str, str]]], path: Path) -> Iterator[UsedTransform]:
    """Yield the joints of a URDF, at position 0."""
    joint: dict[str, str] = {}

    def finished() -> Iterator[UsedTransform]:
        if joint:
            where = f"{path}: joint '{joint.get('name')}'"
            if "parent" not in joint or "child" not in joint:
                raise InputError(f"{where}: expected a parent and a child")
            xyz, rpy = (_floats(joint.get(key, "0 0 0").split(), 3, f"{where}: {key}") for key in ("xyz", "rpy"))
            yield UsedTransform(joint["parent"], joint["child"], pose_of_angles(xyz, rpy), joint["type"] != "fixed")

    for tags, attributes in elements:
        if tags == ("robot", "joint"):
            yield from finished()
            joint = {"name": attributes.get("name", ""), "type": attributes.get("type", "")}
        elif tags[:2] == ("robot", "joint") and len(tags) == 3:
            if tags[2] == "origin":
                joint |= {key: attributes[key] for key in ("xyz", "rpy") if key in attributes}
            elif tags[2] in ("parent", "child"):
                joint[tags[2]] = attributes.get("link", "")
    yield from finished()


def _literal_lists(content: bytes, path: Path) -> Iterator[list[str]]:
    """Yield the lists of texts and numbers that stand in a launch file in Python."""
    if len(content) > MAX_LAUNCH_BYTES:
        raise InputError(f"{path}: found {len(content)} bytes, expected a launch file of at most {MAX_LAUNCH_BYTES}")
    try:
        tree = ast.parse(content)
        for node in ast.walk(tree):
            if isinstance(node, ast.List | ast.Tuple):
                values = [_literal(each) for each in node.elts]
                if all(value is not None for value in values):
                    yield [str(value) for value in values]
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(
            f"{path}: this is no launch file in Python: {one_line(str(error)) or 'it is too deep'}"
        ) from None


def _literal(node: ast.expr) -> object:
    """Return the value of a text or a number, with its sign; None for anything else."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and isinstance(node.operand, ast.Constant):
        value = node.operand.value
        return -value if isinstance(value, int | float) and not isinstance(value, bool) else None
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str | int | float) else None


def _launch_transforms(lists: Iterator[list[str]], path: Path) -> Iterator[UsedTransform]:
    """Yield the transforms in arguments of ``static_transform_publisher``, of ROS 1 and ROS 2."""
    for arguments in lists:
        if "--child-frame-id" in arguments:
            yield _of_options(arguments, path)
        else:
            count = next((i for i, each in enumerate(arguments) if not _NUMBER.fullmatch(each)), len(arguments))
            if count in (6, 7) and len(arguments) in (count + 2, count + 3):
                parent, child = arguments[count : count + 2]
                numbers = _floats(arguments[:count], count, f"{path}: {child}")
                # Six numbers are x y z yaw pitch roll.
                pose = pose_of(numbers) if count == 7 else pose_of_angles(numbers[:3], numbers[:2:-1])
                yield UsedTransform(_frame(parent), _frame(child), pose)


def _of_options(arguments: Sequence[str], path: Path) -> UsedTransform:
    given = dict(pairwise(arguments))
    if "--frame-id" not in given or "--child-frame-id" not in given:
        raise InputError(f"{path}: found --child-frame-id, expected --frame-id too, each with a frame")
    parent, child = given["--frame-id"], given["--child-frame-id"]
    where = f"{path}: {child}"
    trans = _floats([given.get(key, "0") for key in _POSITION], 3, where)
    if any(key in given for key in _ANGLES):
        return UsedTransform(
            _frame(parent),
            _frame(child),
            pose_of_angles(trans, _floats([given.get(key, "0") for key in _ANGLES], 3, where)),
        )
    quat = _floats([given.get(key, "1" if key == "--qw" else "0") for key in _QUATERNION], 4, where)
    return UsedTransform(_frame(parent), _frame(child), pose_of([*trans, *quat]))


def _read_yaml(content: bytes, path: Path, camera: str | None) -> InUse:
    """Read camera_info of camera_info_manager, and messages of /tf_static and camera_info as ROS's tools print."""
    from calibration.base.yaml_loading import parse_yaml  # slow to import

    transforms: list[UsedTransform] = []
    cameras: list[UsedCamera] = []
    for part in _DOCUMENT_END.split(content):
        document = parse_yaml(part, path) if part.strip() else None
        if isinstance(document, Mapping) and "transforms" in document:
            transforms += _transforms_of_message(document["transforms"], path)
        elif isinstance(document, Mapping) and ("camera_matrix" in document or {"k", "K"} & document.keys()):
            cameras.append(_camera_of_document(document, path, camera))
        elif isinstance(document, Mapping) and all(map(_is_autoware, document.values())):
            transforms += _transforms_of_autoware(document, path)
        elif document is not None:
            raise InputError(f"{path}: found no transforms and no camera's matrix, expected {SUPPORTED_FILES}")
    if not transforms and not cameras:
        raise InputError(f"{path}: found nothing, expected {SUPPORTED_FILES}")
    return InUse(str(path), tuple(transforms), tuple(cameras))


def _transforms_of_message(entries: Any, path: Path) -> Iterator[UsedTransform]:
    try:
        for entry in entries:
            of = entry["transform"]
            numbers = [*(of["translation"][key] for key in "xyz"), *(of["rotation"][key] for key in "xyzw")]
            parent, child = str(entry["header"]["frame_id"]), str(entry["child_frame_id"])
            yield UsedTransform(_frame(parent), _frame(child), pose_of(_floats(numbers, 7, f"{path}: {child}")))
    except (LookupError, TypeError) as error:
        raise InputError(f"{path}: expected transforms as in messages of /tf_static: {error!r}") from None


def _is_autoware(children: object) -> bool:
    """Return whether a value is what Autoware's files have below a frame: ``{child: {x, y, z, roll, pitch, yaw}}``."""
    return isinstance(children, Mapping) and all(
        isinstance(each, Mapping) and {*_AUTOWARE_KEYS} <= each.keys() for each in children.values()
    )


def _transforms_of_autoware(document: Mapping[Any, Any], path: Path) -> Iterator[UsedTransform]:
    for parent, children in document.items():
        for child, of in children.items():
            numbers = _floats([of[key] for key in _AUTOWARE_KEYS], 6, f"{path}: {child}")
            yield UsedTransform(_frame(str(parent)), _frame(str(child)), pose_of_angles(numbers[:3], numbers[3:]))


def _camera_of_document(document: Mapping[Any, Any], path: Path, camera: str | None) -> UsedCamera:
    def matrix(key: str, of_file: str) -> Any:
        found = document.get(of_file, {}).get("data") if of_file in document else document.get(key.lower())
        found = document.get(key) if found is None else found
        numbers = found if isinstance(found, list) else []
        return _floats(numbers, len(numbers), f"{path}: {key}")

    try:
        values = {
            "width": document.get("image_width", document.get("width")),
            "height": document.get("image_height", document.get("height")),
            "distortion_model": document.get("distortion_model"),
            "K": matrix("K", "camera_matrix"),
            "D": matrix("D", "distortion_coefficients"),
            "R": matrix("R", "rectification_matrix"),
            "P": matrix("P", "projection_matrix"),
        }
        frame = document.get("header", {}).get("frame_id")
    except (AttributeError, TypeError):
        raise InputError(f"{path}: expected camera_info, as camera_info_manager or topic echo write it") from None
    name = document.get("camera_name")
    place = f"{path}, loaded by {camera}" if camera else str(path)
    return UsedCamera(place, camera or (str(name) if name else None), _frame(str(frame)) if frame else None, values)


def _floats(values: Sequence[object], count: int, where: str) -> list[float]:
    try:
        found = [float(value) for value in values if isinstance(value, str | int | float)]
    except (ValueError, OverflowError):
        found = []
    if len(found) != count or len(values) != count or not all(map(math.isfinite, found)):
        raise InputError(f"{where}: found {shorten(one_line(str(list(values))))}, expected {count} finite numbers")
    return found


def _frame(name: str) -> str:
    """Return a frame without the slash that ROS 1 allows before it."""
    return name.removeprefix("/")


def _read_bag(path: Path) -> InUse:
    """Read the static transforms and the intrinsics of a bag; each that changes is there several times."""
    optional("rosbags", "reading bags")  # which a robot may lack, with numpy
    from calibration.robot.importing.bags.bag import open_bag

    with open_bag([path]) as bag:
        transforms = tuple(dict.fromkeys(_static_transforms_of_bag(bag)))
        cameras = tuple(_cameras_of_bag(bag))
    return InUse(str(path), transforms, cameras)


def _static_transforms_of_bag(bag: "Bag") -> Iterator[UsedTransform]:
    for message in bag.messages([_STATIC_TOPIC]):
        for entry in bag.decode(message).transforms:
            t, q = entry.transform.translation, entry.transform.rotation
            numbers = [float(value) for value in (t.x, t.y, t.z, q.x, q.y, q.z, q.w)]
            yield UsedTransform(_frame(entry.header.frame_id), _frame(entry.child_frame_id), pose_of(numbers))


def _cameras_of_bag(bag: "Bag") -> Iterator[UsedCamera]:
    seen: set[tuple[str, bytes]] = set()
    for message in bag.messages(bag.of_type(_CAMERA_INFO_TYPE)):
        key = (message.topic, bag.without_stamp(message))
        if key not in seen:
            seen.add(key)
            info = bag.decode(message)
            values: dict[str, Any] = {
                "width": int(info.width),
                "height": int(info.height),
                "distortion_model": info.distortion_model,
            }
            for name in _MATRICES:  # capitals in ROS 1
                numbers = getattr(info, name.lower(), None)
                values[name] = [float(each) for each in (getattr(info, name) if numbers is None else numbers)]
            frame = _frame(info.header.frame_id) or None
            yield UsedCamera(f"{bag.path}, {message.topic}", None, frame, values)
