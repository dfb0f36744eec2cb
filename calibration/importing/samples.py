"""Hand-eye samples: poses of a robot arm, each with an image of the pattern, or with its measured pose."""

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.dataset.document import Node
from calibration.dataset.edges import FAR, QUATERNION_TOLERANCE
from calibration.errors import InputError
from calibration.files import read_bytes
from calibration.geometry.rotations import nearest
from calibration.geometry.transforms import from_quaternion, inverse, transform
from calibration.geometry.types import Array
from calibration.importing.pictures import MAX_CSV, MOST_IMAGES
from calibration.yaml_file import read_yaml

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Keys and columns of a pose: metres, and a quaternion."""
IMAGE, PATTERN = "image", "pattern_"
"""Column of images, and prefix of the columns of the pattern's pose."""
MOVEIT = ("effector_wrt_world", "object_wrt_sensor")
ORTHOGONAL = 1e-3
"""Tolerance of a rotation matrix's orthogonality; it is projected to a rotation."""


@dataclass(frozen=True, eq=False)
class Sample:
    """Pose of the arm, with its observation."""

    where: str
    """Location in the file, for messages."""
    image: Path | None
    """The camera's image there, if the file names it."""
    T_base_tool: Array
    """(4, 4)."""
    T_camera_pattern: Array | None = None
    """(4, 4): measured pose of the pattern, if available."""


def read_samples(path: Path, in_hand: bool) -> list[Sample]:
    """Read samples from a file: CSV, or YAML of robot_cal_tools, easy_handeye2 or MoveIt.

    Args:
        path: path of the file.
        in_hand: whether the arm carries the camera; if it carries the pattern, easy_handeye2 stores inverse poses.

    Raises:
        InputError: the file, or one that it names, cannot be read, or something in it is missing or wrong.
    """
    samples = list(_table(path) if path.suffix.lower() == ".csv" else _document(path, in_hand))
    if not samples:
        raise InputError(f"{path}: found no pose, expected one for each image")
    unseen = [each for each in samples if each.T_camera_pattern is None]
    if 0 < len(unseen) < len(samples):
        lacking = unseen[0]
        raise InputError(f"{lacking.where}: found no pose of the pattern, expected one as the others have")
    if len(samples) > MOST_IMAGES:
        raise InputError(f"{path}: found {len(samples)} poses, expected {MOST_IMAGES} at most")
    images: dict[Path, str] = {}
    for sample in samples:
        if sample.image is not None and (other := images.setdefault(sample.image, sample.where)) != sample.where:
            raise InputError(f"{sample.where}: found the image of {other} again, expected one for each pose")
    return samples


def _document(path: Path, in_hand: bool) -> Iterator[Sample]:
    root = Node(path, (), read_yaml(path, "hand-eye samples"))
    if isinstance(root.value, dict):
        return _of_easy_handeye(root, in_hand)
    elements = list(root.elements())
    moveit = bool(elements) and isinstance(elements[0].value, dict) and MOVEIT[0] in elements[0].value
    return _of_moveit(elements) if moveit else _listed(elements)


def _of_easy_handeye(root: Node, in_hand: bool) -> Iterator[Sample]:
    """Parse easy_handeye2's samples; if the arm carries the pattern, its poses are inverse."""
    stated = parameters.get("calibration_type") if (parameters := root.get("parameters")) else None
    if stated and stated.text() and stated.text() != (expected := "eye_in_hand" if in_hand else "eye_on_base"):
        raise stated.unexpected(
            f"'{expected}' as import.yml has it: the parent of the {'sensor' if in_hand else 'pattern'} is the tool"
        )
    for node in root["samples"].elements():
        robot, seen = (_of_message(node[key]) for key in ("robot", "tracking"))
        yield Sample(_where(node), None, robot if in_hand else inverse(robot), seen)


def _of_message(node: Node) -> Array:
    """Return (4, 4) of a geometry_msgs/Transform."""
    places = {"x": "translation", "y": "translation", "z": "translation"} | dict.fromkeys(
        ("qx", "qy", "qz", "qw"), "rotation"
    )
    values = {key: node[place][key[-1]].within(-FAR, FAR) for key, place in places.items()}
    return _transform(values, _where(node))


def _of_moveit(elements: Sequence[Node]) -> Iterator[Sample]:
    """Parse MoveIt's samples: matrices, row by row."""
    for node in elements:
        effector, seen = (_matrix(node[key]) for key in MOVEIT)
        yield Sample(_where(node), None, effector, seen)


def _matrix(node: Node) -> Array:
    T = np.array(node.numbers(16)).reshape(4, 4)
    R = T[:3, :3]
    rigid = np.abs(T).max() <= FAR and np.abs(R @ R.T - np.eye(3)).max() <= ORTHOGONAL and np.linalg.det(R) > 0
    if not rigid or not np.array_equal(T[3], (0, 0, 0, 1)):
        raise node.fault("found no rigid transform, expected a rotation and a translation, m, as a matrix by its rows")
    return transform(nearest(R), T[:3, 3])


def _where(node: Node) -> str:
    return f"{node.file}: {'/'.join(node.keys)}"


def _listed(elements: Sequence[Node]) -> Iterator[Sample]:
    """Parse robot_cal_tools' samples: files with poses."""
    for node in elements:
        pose = _beside(node["pose"])
        entry = Node(pose, (), read_yaml(pose, "a pose"))
        if image := node.get(IMAGE):
            yield Sample(f"{node.file}: {node.keys[-1]}", _beside(image), _pose(entry))
        else:
            yield Sample(f"{node.file}: {node.keys[-1]}", None, _pose(entry))


def _pose(node: Node) -> Array:
    values = {key: node[key].within(-FAR, FAR) for key in POSE}
    return _transform(values, str(node.file))


def _table(path: Path) -> Iterator[Sample]:
    content = read_bytes(path, MAX_CSV, "a CSV file of poses")
    try:
        rows = list(csv.DictReader(io.StringIO(content.decode("utf-8-sig")), strict=True))
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: this is no CSV file: {error}") from None
    for line, row in enumerate(rows, 2):
        cells = {(key or "").strip(): value for key, value in row.items() if isinstance(value, str)}
        where = f"{path}:{line}"
        image = cells.get(IMAGE, "").strip()
        seen = _of_cells(cells, PATTERN, where) if any(key.startswith(PATTERN) for key in cells) else None
        yield Sample(where, path.parent / image if image else None, _of_cells(cells, "", where), seen)


def _of_cells(cells: Mapping[str, str], prefix: str, where: str) -> Array:
    """Return the pose (4, 4) in the columns with this prefix."""
    if missing := [key for key in POSE if prefix + key not in cells]:
        expected = ", ".join(prefix + key for key in POSE)
        raise InputError(f"{where}: missing column '{prefix}{missing[0]}', expected {expected}")
    values = {}
    for key in POSE:
        found = cells[prefix + key]
        try:
            values[key] = float(found)
        except ValueError:
            values[key] = math.nan
        if not abs(values[key]) <= FAR:
            raise InputError(f"{where}: found '{found}' as {prefix}{key}, expected a finite number")
    return _transform(values, where)


def _transform(values: Mapping[str, float], where: str) -> Array:
    """Return (4, 4) of a pose, whose quaternion must be normalised."""
    quaternion = [values[key] for key in POSE[3:]]
    if not abs((length := math.hypot(*quaternion)) - 1) <= QUATERNION_TOLERANCE:
        raise InputError(
            f"{where}: found a quaternion of length {length:.6g}, expected qx, qy, qz, qw of length 1 (within "
            f"{QUATERNION_TOLERANCE:g})"
        )
    return from_quaternion([values[key] for key in POSE[:3]], quaternion)


def _beside(name: Node) -> Path:
    """Return a file in the folder of the document."""
    path = name.file.parent / name.name()
    try:
        if path.resolve().is_relative_to(name.file.parent.resolve()):
            return path
    except (OSError, ValueError, RuntimeError):  # a NUL or a lone surrogate; too long; a loop of links
        pass
    raise name.unexpected("a file in the folder of this one")
