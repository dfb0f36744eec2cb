"""Poses in the files of others: tables, matrices, structured documents, a file for each pose; each a (name, pose)."""

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from glob import has_magic
from pathlib import Path
from typing import Any

import numpy as np

from calibration.base import InputError, read_bytes, shorten
from calibration.base.arrays import Array
from calibration.base.files import matching
from calibration.engine.dataset.document import Node
from calibration.robot.importing.files.pictures import IMAGE_ENDINGS, MAX_CSV, MOST_IMAGES
from calibration.robot.importing.files.pose_form import QUATERNION_CONVENTIONS, PoseForm
from calibration.robot.importing.files.structured_files import is_number, read_structured

TABLE_ENDINGS = (".csv", ".tsv", ".txt", ".dat", ".tum")
"""Endings of text files with a row for each pose, or with matrices by their rows."""
STRUCTURED_ENDINGS = (".yaml", ".yml", ".json", ".xml", ".toml", ".npz", ".npy", ".samples")
MAX_POSE_NUMBERS = 64
"""Limit of the numbers of one pose."""
POSITION_NAMES = ("x", "y", "z")
QUATERNION_NAMES = ("qx", "qy", "qz", "qw")
ANGLE_NAMES = ("rx", "ry", "rz")
MATRIX_NAMES = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
ROTATION_NAMES = (QUATERNION_NAMES, ANGLE_NAMES, MATRIX_NAMES)
"""Names of the numbers of a rotation."""
COLUMNS_BESIDE_AN_IMAGE = {
    4 + len(rotation): ("image", *POSITION_NAMES, *rotation) for rotation in (ANGLE_NAMES, QUATERNION_NAMES)
}
"""Columns of a table without a row of names, by their number, where the first is an image."""
_OTHER_NAMES = {
    **{
        f"{prefix}{axis}": axis
        for axis in POSITION_NAMES
        for prefix in ("t", "t_", "p", "p_", "pos_", "pos", "position_", "position.", "translation_", "translation.")
    },
    **{
        f"{prefix}{axis}": f"q{axis}"
        for axis in "xyzw"
        for prefix in ("q_", "o", "quat_", "orientation_", "orientation.", "rotation.", "quaternion_")
    },
    **{f"{prefix}{axis}": f"r{axis}" for axis in "xyz" for prefix in ("r_", "rot_", "rvec_", "rotvec_", "rotation_")},
    "roll": "rx",
    "pitch": "ry",
    "yaw": "rz",
    "image_file": "image",
    "filename": "image",
    "file": "image",
}
"""Names of columns that others give."""
_TRANSLATION_KEYS = ("translation", "position", "tvec", "t", "trans", "xyz")
_ROTATION_KEYS = ("rotation", "orientation", "quaternion", "rvec", "R", "rot", "rpy", "q")
_LIST_KEYS = ("samples", "data", "poses", "transforms")
"""Keys of a list of poses: easy_handeye's, industrial_calibration's, ours for others."""


@dataclass(frozen=True, eq=False)
class FilePose:
    """A pose in a file."""

    where: str
    """Location in the file, for messages."""
    T: Array
    """(4, 4)."""
    file: Path | None = None
    """The file that has only this one, if each has its own."""
    image: Path | None = None
    """The image beside it, if the file names it."""


@dataclass(frozen=True, eq=False)
class PoseTable:
    """Table of a text file."""

    file: Path
    rows: Sequence[tuple[int, list[str]]]
    """Lines, from 1, and cells; empty lines and comments left out."""


PoseDocument = PoseTable | Node


def open_pose_files(path: Path) -> list[PoseDocument]:
    """Read a file of poses, or all files of a folder, or of a pattern such as ``poses/pose*.txt``.

    Raises:
        InputError: a file cannot be read.
    """
    return [
        PoseTable(file, list(_table_rows(file)))
        if file.suffix.lower() in TABLE_ENDINGS
        else read_structured(file, "poses")
        for file in _list_files(path)
    ]


def poses_in(documents: Sequence[PoseDocument], form: PoseForm, names: Sequence[str] = ()) -> list[FilePose]:
    """Return the poses of files, as a form says that they are written.

    Args:
        documents: of `open_pose_files`.
        form: how they are written.
        names: what the poses are called, where ``form`` does not say it: the first one that is there.

    Raises:
        InputError: what is there is no pose, or there is none.
    """
    found: list[FilePose] = []
    for document in documents:
        poses = [_pose_at(entry, form) for entry in _written_poses(document, form, names)]
        if len(documents) > 1 and len(poses) != 1:
            raise InputError(
                f"{document.file}: found {len(poses)} poses, expected one in each of {len(documents)} files"
            )
        found += [replace(each, file=document.file) for each in poses] if len(documents) > 1 else poses
    if not found:
        raise InputError(f"{documents[0].file}: found no pose, expected one for each image")
    if len(found) > MOST_IMAGES:
        raise InputError(f"{documents[0].file}: found {len(found)} poses, expected {MOST_IMAGES} at most")
    return found


def has_poses(documents: Sequence[PoseDocument], form: PoseForm, name: str) -> bool:
    """Whether there are poses of a name."""
    try:
        return next(iter(_written_poses(documents[0], replace(form, key=None), (name,))), None) is not None
    except _NoSuchKeyError:
        return False


class _NoSuchKeyError(InputError):
    """The file has no pose of the name."""


def _list_files(path: Path) -> list[Path]:
    if has_magic(str(path)) and not path.exists():
        found = [Path(name) for name in matching([str(path)])]
    elif path.is_dir():
        found = [
            each
            for each in path.iterdir()
            if each.suffix.lower() in (*TABLE_ENDINGS, *STRUCTURED_ENDINGS) and each.is_file()
        ]
    else:
        return [path]
    if not found:
        raise InputError(
            f"{path}: found no file of a pose, expected some that end in "
            f"{', '.join(STRUCTURED_ENDINGS + TABLE_ENDINGS)}"
        )
    if len(found) > MOST_IMAGES:
        raise InputError(f"{path}: found {len(found)} files, expected {MOST_IMAGES} at most")
    return sorted(found, key=lambda each: ([int(digits) for digits in re.findall(r"\d+", str(each))], str(each)))


def _written_poses(document: PoseDocument, form: PoseForm, names: Sequence[str]) -> Iterator[Node]:
    """Yield the poses of a file as they are written, each a list of numbers or an object of them."""
    names = (form.key,) if form.key is not None else names
    return (
        _table_entries(document, form, names)
        if isinstance(document, PoseTable)
        else _structured_entries(document, names)
    )


def _table_entries(table: PoseTable, form: PoseForm, names: Sequence[str]) -> Iterator[Node]:
    rows, path = table.rows, table.file
    if not rows:
        return
    (line, first), are_numbers = rows[0], [is_number(cell) for cell in rows[0][1]]
    if form.columns is not None:
        yield from _named_rows(path, form.columns, rows if any(are_numbers) else rows[1:], names)
    elif not any(are_numbers):
        yield from _named_rows(path, first, rows[1:], names)
    elif names and any(cells[0] in names for _, cells in rows):
        yield from _unnamed_rows(path, [(line, cells[1:]) for line, cells in rows if cells[0] in names])
    elif names:
        raise _NoSuchKeyError(f"{path}:{line}: found no names of columns, expected '{names[0]}'")
    elif all(are_numbers):
        yield from _unnamed_rows(path, rows)
    elif Path(first[0]).suffix.lower() in IMAGE_ENDINGS and len(first) in COLUMNS_BESIDE_AN_IMAGE:
        yield from _named_rows(path, COLUMNS_BESIDE_AN_IMAGE[len(first)], rows, names)
    else:
        raise InputError(
            f"{path}:{line}: found '{first[0]}' beside numbers, expected a row of names; or add 'columns' to 'samples' "
            "in import.yml (image, x, y, z, qx, ...), or 'key', the first word of the arm's rows"
        )


def _table_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a table that have cells, and their lines; without brackets and a semicolon at the end."""
    content = read_bytes(path, MAX_CSV, "a CSV file of poses")
    if b"\0" in content:
        raise InputError(f"{path}: this is no CSV file: found a zero byte")
    text = content.decode("utf-8-sig", "replace")  # a comment may be in any encoding
    lines = [line.strip().strip("[];") for line in text.splitlines()]
    first = next((line for line in lines if line and not line.startswith("#")), "")
    delimiter = next((each for each in ",;\t" if each in first), None)
    try:
        for number, line in enumerate(lines, 1):
            if not line or line.startswith("#"):
                continue
            cells = next(csv.reader(io.StringIO(line), delimiter=delimiter, strict=True)) if delimiter else line.split()
            yield number, [cell.strip() for cell in cells]
    except csv.Error as error:
        raise InputError(f"{path}: this is no CSV file: {error}") from None


def _column_name(text: str) -> str:
    """Return a column's name in our words: without its unit and in lower case."""
    bare = re.sub(r"[\[(].*?[\])]", "", text).strip().lower()
    for prefix in ("pattern_", ""):
        if bare.startswith(prefix):
            rest = bare.removeprefix(prefix)
            return prefix + _OTHER_NAMES.get(rest, rest)
    return bare


def _node_at_line(path: Path, line: int, value: Any) -> Node:
    return Node(Path(f"{path}:{line}"), (), value)


def _unnamed_rows(path: Path, rows: Sequence[tuple[int, list[str]]]) -> Iterator[Node]:
    """Yield rows of numbers, or matrices of four rows of four numbers."""
    numbers = [
        (line, [_number_in_cell(path, line, cell, f"number {i}") for i, cell in enumerate(cells, 1)])
        for line, cells in rows
    ]
    if len(numbers) % 4 == 0 and all(len(each) == 4 for _, each in numbers):
        for i in range(0, len(numbers), 4):
            yield _node_at_line(path, numbers[i][0], [each for _, each in numbers[i : i + 4]])
        return
    for line, each in numbers:
        yield _node_at_line(path, line, each)


def _named_rows(
    path: Path, named: Sequence[str], rows: Sequence[tuple[int, list[str]]], names: Sequence[str]
) -> Iterator[Node]:
    """Yield rows as objects of the columns whose names begin with a name, and of the image."""
    titles = [_column_name(each) for each in named]
    prefix = next((name for name in names if any(each.startswith(name) for each in titles)), None)
    if names and prefix is None:
        raise _NoSuchKeyError(
            f"{path}: found the columns {', '.join(titles)}, expected some that begin with '{names[0]}'"
        )
    for line, cells in rows:
        row = dict(zip(titles, cells, strict=False))
        own = {
            _OTHER_NAMES.get(bare, bare): cell
            for title, cell in row.items()
            if (bare := _without_prefix(title, prefix))
        }
        used = next((each for each in ROTATION_NAMES if each[0] in own or each[-1] in own), QUATERNION_NAMES)
        if missing := [each for each in (*POSITION_NAMES, *used) if each not in own]:
            expected = ", ".join(f"{prefix or ''}{each}" for each in (*POSITION_NAMES, *used))
            raise InputError(
                f"{path}:{line}: missing column '{prefix or ''}{missing[0]}', expected {expected}; or say what the "
                "columns are by 'columns' of 'samples' in import.yml"
            )
        value: dict[str, Any] = {
            name: _number_in_cell(path, line, cell, f"{prefix or ''}{name}")
            for name, cell in own.items()
            if name in (*POSITION_NAMES, *used)
        }
        yield _node_at_line(path, line, value | ({"image": image} if (image := row.get("image")) else {}))


def _without_prefix(title: str, prefix: str | None) -> str:
    return title if not prefix else title.removeprefix(prefix) if title.startswith(prefix) else ""


def _number_in_cell(path: Path, line: int, cell: str, name: str) -> float:
    if is_number(cell) and np.isfinite(float(cell)):
        return float(cell)
    raise InputError(f"{path}:{line}: found '{cell}' as {name}, expected a finite number")


def _structured_entries(root: Node, names: Sequence[str]) -> Iterator[Node]:
    """Yield what the key of the poses leads to, else the poses that a document lists."""
    if names:
        found = next((each for name in names if (each := list(_poses_of_name(root, name)))), None)
        if found is None:
            keys = f", but the keys {shorten(', '.join(map(str, root.value)))}" if isinstance(root.value, dict) else ""
            raise _NoSuchKeyError(f"{root.file}: found no poses '{names[0]}'{keys}")
        yield from found
    elif isinstance(root.value, dict) and (key := next((each for each in _LIST_KEYS if each in root.value), None)):
        yield from _poses_in_list(root if _is_matrix(root) else root[key])
    else:
        yield from _poses_in_list(_only_array(root) or root)


def _entries(node: Node) -> Iterator[Node]:
    """Yield the elements of a list, or of an object with numbered keys (``pose_7``), in the order of the numbers."""
    if isinstance(node.value, list):
        yield from node.elements()
    elif isinstance(node.value, dict):
        objects = [(key, value) for key, value in node.items() if isinstance(value.value, dict)]
        numbers = [int(found[1]) for key, _ in objects if (found := re.fullmatch(r"\D*(\d{1,9})", key))]
        if len(numbers) == len(objects) > 1:
            yield from (objects[i][1] for i in np.argsort(numbers, kind="stable"))


def _inner_list(node: Node) -> Node | None:
    """Return where an object's poses are: at its key of a list of them, or at its only object or list."""
    if key := next((each for each in _LIST_KEYS if each in node.value), None):
        return node[key]
    inner = [value for _, value in node.items() if isinstance(value.value, list | dict)]
    return inner[0] if len(inner) == 1 else None


def _only_array(root: Node) -> Node | None:
    """Return the value of an object's only key with numbers in it."""
    if not isinstance(root.value, dict) or _is_matrix(root):
        return None
    below = [node for _, node in root.items() if isinstance(node.value, list | dict)]
    return below[0] if len(below) == 1 and (isinstance(below[0].value, list) or _is_matrix(below[0])) else None


def _poses_of_name(node: Node, name: str) -> Iterator[Node]:
    """Yield the poses of a name: in an object, numbered in it, or in each of its entries or of its list's."""
    keys = [key for key in node.value if isinstance(key, str)] if isinstance(node.value, dict) else []
    numbered = [key for key in keys if re.fullmatch(re.escape(name) + r"[0-9]{1,9}", key)]
    if name in keys:
        yield from _poses_in_list(node[name], node.get("image"))
    elif numbered:
        yield from (node[key] for key in sorted(numbered, key=lambda key: int(key.removeprefix(name))))
    elif f"{name}_rvec" in keys:
        yield Node(node.file, (*node.keys, name), {key: node[f"{name}_{key}"].value for key in ("rvec", "tvec")})
    elif entries := list(_entries(node)):
        found = [list(_poses_of_name(element, name)) for element in entries]
        for element, poses in zip(entries, found, strict=True):
            if not poses and any(found):
                raise element.fault(f"missing key '{name}'")
            yield from poses
    elif keys and (inner := _inner_list(node)):
        yield from _poses_of_name(inner, name)


def _poses_in_list(node: Node, image: Node | None = None) -> Iterator[Node]:
    """Yield the poses of a list, of a matrix with one in each row, or the one that a value is."""
    if isinstance(node.value, dict) and "transforms" in node.value:
        node = node["transforms"]
    if _is_matrix(node) and node["rows"].number() > 1 and node["cols"].number() in (6, 7, 12, 16):
        flat, width = node["data"].sequence(), int(node["cols"].number())
        for i in range(0, len(flat), width):
            yield Node(node.file, (*node.keys, "data", str(i)), flat[i : i + width])
        return
    value = node.value
    if isinstance(value, list) and value and not _is_one_pose(value):
        yield from node.elements()
    elif value != []:
        yield node


def _is_matrix(node: Node) -> bool:
    """Whether it is a matrix of OpenCV or of ROS, with its size."""
    value = node.value
    return isinstance(value, dict) and {"rows", "cols", "data"} <= set(value) and type(value["cols"]) in (int, float)


def _is_one_pose(value: list[Any]) -> bool:
    """Whether a list is of numbers, or a matrix of 3 or 4 rows of 4, or a column of 6 or 7."""
    if not isinstance(value[0], list):
        return not isinstance(value[0], dict)
    widths = {len(each) if isinstance(each, list) else 0 for each in value}
    if any(isinstance(cell, list) for each in value if isinstance(each, list) for cell in each):
        return False
    return (len(value) in (3, 4) and widths == {4}) or (len(value) in (6, 7) and widths == {1})


def _pose_at(entry: Node, form: PoseForm) -> FilePose:
    where = f"{entry.file}: {'/'.join(map(str, entry.keys))}" if entry.keys else str(entry.file)
    value = entry.value
    image = _file_beside(entry["image"]) if isinstance(value, dict) and entry.get("image") else None
    if isinstance(value, dict) and isinstance(value.get("pose"), str):
        file = _file_beside(entry["pose"])
        return FilePose(where, _pose_of(read_structured(file, "a pose"), form), None, image)
    return FilePose(where, _pose_of(entry, form), None, image)


def _pose_of(node: Node, form: PoseForm) -> Array:
    """Return the pose (4, 4) of an object or of numbers."""
    where = f"{node.file}: {'/'.join(map(str, node.keys))}" if node.keys else str(node.file)
    if not isinstance(node.value, dict) or _is_matrix(node):
        return _of_numbers(_numbers_of(node), form, where)
    if all(name in node.value for name in POSITION_NAMES):
        names = next((each for each in ROTATION_NAMES if any(name in node.value for name in each)), QUATERNION_NAMES)
        return form.pose([_finite_number(node[name]) for name in POSITION_NAMES], _in_order(node, names, form), where)
    t_key = next((key for key in _TRANSLATION_KEYS if key in node.value), None)
    R_key = next((key for key in _ROTATION_KEYS if key in node.value), None)
    if t_key and R_key:
        place, rotation = node[t_key], node[R_key]
        is_object = isinstance(place.value, dict) and not _is_matrix(place)
        t = [_finite_number(place[axis]) for axis in POSITION_NAMES] if is_object else _numbers_of(place)
        if R_key == "rvec" and form.rotation is None:
            form = replace(form, rotation="rotvec")
        if len(t) != 3:
            raise place.unexpected("3 numbers: x, y, z")
        if isinstance(rotation.value, dict) and not _is_matrix(rotation):
            return form.pose(t, _in_order(rotation, ("x", "y", "z", "w"), form), where)
        return form.pose(t, _numbers_of(rotation), where)
    below = [each for _, each in node.items() if isinstance(each.value, list | dict)]
    if len(below) != 1:
        raise node.fault(
            f"found the keys {', '.join(map(str, node.value))}, expected a pose: x, y, z, qx, qy, qz, qw; "
            "translation and rotation; or say what it is called there by 'key' of 'samples' in import.yml"
        )
    return _pose_of(below[0], form)


def _in_order(node: Node, names: Sequence[str], form: PoseForm) -> list[float]:
    """Return the numbers of a rotation by their names; of a stated quaternion in their order in the file.

    Whoever states ``quaternion-wxyz`` means the order of the numbers, whatever they are called.
    """
    written = [name for name in node.value if name in names]
    w_first = [*names[-1:], *names[:-1]]
    if form.rotation in QUATERNION_CONVENTIONS and written == w_first:
        names = w_first
    return [_finite_number(node[name]) for name in names]


def _of_numbers(numbers: Sequence[float], form: PoseForm, where: str) -> Array:
    """Return the pose (4, 4) of its numbers: a matrix, or a translation and what tells the rotation."""
    if len(numbers) in (12, 16):
        T = np.array(numbers).reshape(-1, 4)
        if len(numbers) == 16 and (T[:, 3] == (0, 0, 0, 1)).all():
            T = T.T  # by its columns, as libfranka has it
        if len(numbers) == 16 and not np.array_equal(T[3], (0, 0, 0, 1)):
            raise InputError(f"{where}: found no rigid transform, expected a matrix by its rows, the last one 0 0 0 1")
        return replace(form, rotation=None).pose(T[:3, 3].tolist(), T[:3, :3].ravel().tolist(), where)
    if len(numbers) in (6, 7):
        return form.pose(numbers[:3], numbers[3:], where)
    raise InputError(
        f"{where}: found {len(numbers)} numbers, expected 6 or 7 (x, y, z and a rotation), 12 or 16 (a matrix); of a "
        "table with others say what the columns are by 'columns' of 'samples' in import.yml"
    )


def _numbers_of(node: Node) -> list[float]:
    """Return the numbers of a list, of rows, or of a matrix with its size."""
    if isinstance(node.value, dict):
        node = node["data"]
    if len(node.sequence()) > MAX_POSE_NUMBERS:
        raise node.unexpected(f"the numbers of one pose: {MAX_POSE_NUMBERS} at most")
    rows = list(node.elements())
    return [
        number
        for row in rows
        for number in (_numbers_of(row) if isinstance(row.value, list) else [_finite_number(row)])
    ]


def _finite_number(node: Node) -> float:
    """Return a finite number, also one that YAML takes for text (``1e-5``), or raise InputError."""
    if isinstance(node.value, str) and is_number(node.value):
        node = Node(node.file, node.keys, float(node.value))
    return node.number()


def _file_beside(name: Node) -> Path:
    """Return a file in the folder of the document."""
    path = name.file.parent / name.name()
    try:
        if path.resolve().is_relative_to(name.file.parent.resolve()):
            return path
    except (OSError, ValueError, RuntimeError):  # a NUL or a lone surrogate; too long; a loop of links
        pass
    raise name.unexpected("a file in the folder of this one")
