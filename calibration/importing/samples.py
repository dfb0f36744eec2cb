"""Hand-eye samples: poses of a robot arm, each with an image of the pattern."""

import csv
import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from calibration.dataset.document import Node
from calibration.dataset.edges import FAR, QUATERNION_TOLERANCE
from calibration.errors import InputError
from calibration.files import read_bytes
from calibration.geometry.transforms import from_quaternion
from calibration.geometry.types import Array
from calibration.importing.pictures import MAX_CSV, MOST_IMAGES
from calibration.yaml_file import read_yaml

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Keys and columns of a pose: metres, and a quaternion."""
IMAGE = "image"


@dataclass(frozen=True, eq=False)
class Sample:
    """A pose of the arm."""

    where: str
    """Its place in the file, for messages."""
    image: Path | None
    """What the camera saw there, where the file names it."""
    T_base_tool: Array
    """(4, 4)."""


def read_samples(path: Path) -> list[Sample]:
    """The samples in a file: a CSV, or YAML as robot_cal_tools writes it.

    Raises:
        InputError: the file, or one that it names, cannot be read, or something in it is missing or wrong.
    """
    samples = list(_table(path) if path.suffix.lower() == ".csv" else _listed(path))
    if not samples:
        raise InputError(f"{path}: found no pose, expected one for each image")
    if len(samples) > MOST_IMAGES:
        raise InputError(f"{path}: found {len(samples)} poses, expected {MOST_IMAGES} at most")
    images: dict[Path, str] = {}
    for sample in samples:
        if sample.image is not None and (other := images.setdefault(sample.image, sample.where)) != sample.where:
            raise InputError(f"{sample.where}: found the image of {other} again, expected one for each pose")
    return samples


def _listed(path: Path) -> Iterator[Sample]:
    root = Node(path, (), read_yaml(path, "a list of images and poses"))
    for node in root.elements():
        pose = _beside(node["pose"])
        entry = Node(pose, (), read_yaml(pose, "a pose"))
        if image := node.get(IMAGE):
            yield Sample(f"{path}: {node.keys[-1]}", _beside(image), _pose(entry))
        else:
            yield Sample(f"{path}: {node.keys[-1]}", None, _pose(entry))


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
        if missing := [key for key in POSE if key not in cells]:
            raise InputError(f"{path}:{line}: missing column '{missing[0]}', expected {', '.join(POSE)}")
        values = {}
        for key in POSE:
            try:
                values[key] = float(cells[key])
            except ValueError:
                values[key] = math.nan
            if not abs(values[key]) <= FAR:
                raise InputError(f"{path}:{line}: found '{cells[key]}' as {key}, expected a finite number")
        image = cells.get(IMAGE, "").strip()
        yield Sample(f"{path}:{line}", path.parent / image if image else None, _transform(values, f"{path}:{line}"))


def _transform(values: Mapping[str, float], where: str) -> Array:
    """(4, 4): of a pose whose quaternion is of length 1."""
    quaternion = [values[key] for key in POSE[3:]]
    if not abs((length := math.hypot(*quaternion)) - 1) <= QUATERNION_TOLERANCE:
        raise InputError(
            f"{where}: found a quaternion of length {length:.6g}, expected qx, qy, qz, qw of length 1 (within "
            f"{QUATERNION_TOLERANCE:g})"
        )
    return from_quaternion([values[key] for key in POSE[:3]], quaternion)


def _beside(name: Node) -> Path:
    """A file in the folder of the document."""
    path = name.file.parent / name.name()
    try:
        if path.resolve().is_relative_to(name.file.parent.resolve()):
            return path
    except (OSError, ValueError, RuntimeError):  # a NUL or a lone surrogate; too long; a loop of links
        pass
    raise name.unexpected("a file in the folder of this one")
