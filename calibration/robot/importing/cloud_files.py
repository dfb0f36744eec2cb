"""Point clouds of LiDARs in files: PCD, PLY, LAS and LAZ, and text with a point in each line."""

import io
import re
import struct
import warnings
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from calibration.base import InputError, read_bytes
from calibration.base.arrays import Array
from calibration.engine.dataset.sensor_data import read_points, write_points
from calibration.robot.importing.bags.range_views import MAX_POINTS, RangeView, cloud_message
from calibration.robot.importing.files.confined_decoding import confined_decoding
from calibration.robot.importing.files.structured_files import is_number

MAX_CLOUD_BYTES = 1 << 29
"""Limit of a file's size, which at most quadruples in memory."""
MAX_COORDINATE_M = 1e5
"""m: limit of a coordinate; farther ones are those of a map, and float32 would round them."""
_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_HEADER = re.compile(rb"ply[ \t]*\r?\n(.{0,65536}?)end_header[ \t]*\r?\n", re.DOTALL)
# LAS 1.4 R15, table 3: offsets in the header, whose first 227 bytes are those of all versions
_LAS_VERSION, _LAS_POINTS_AT, _LAS_FORMAT, _LAS_SCALES, _LAS_COUNT_1_4 = 24, 96, 104, 131, 247
_LAS_HEADER = 227
_LAS_MAX_FORMAT = 10
_LAZ_BITS = 0xC0
"""Bits of the point format that tell a compressed file."""


def read_cloud(path: Path) -> Array:
    """Read the points (N, 3) of a cloud, m, by the ending of the file's name; NaN for points without a return.

    Raises:
        InputError: the file cannot be read, is damaged or of another kind, has too many points or none, or they are
            too far away; LAZ, and laspy is not installed.
    """
    try:
        points = _READER_OF_ENDING[path.suffix.lower()](path)
    except MemoryError:
        raise InputError(f"{path}: this cloud needs too much memory") from None
    if not len(points):
        raise InputError(f"{path}: found a cloud without points")
    finite = points[np.isfinite(points)]
    if finite.size and (far := float(np.abs(finite).max())) > MAX_COORDINATE_M:
        raise InputError(
            f"{path}: found a coordinate of {far:g} m, expected {MAX_COORDINATE_M:g} at most: coordinates in the "
            "frame of the "
            "LiDAR, not those of a map"
        )
    return points


def cloud_view(path: Path, stem: Path) -> RangeView:
    """Read a cloud, and write it as the dataset has it: ``stem``, a path without its ending, and ``.pcd``."""
    points, file = read_cloud(path), stem.with_name(f"{stem.name}.pcd")
    write_points(file, points)
    return RangeView(cloud_message(points), file)


def _cloud_bytes(path: Path) -> bytes:
    return read_bytes(path, MAX_CLOUD_BYTES, "a point cloud")


def _read_pcd(path: Path) -> Array:
    return np.asarray(read_points(path), float)


def _read_ply(path: Path) -> Array:
    data = _cloud_bytes(path)
    header = _PLY_HEADER.match(data)
    if header is None:
        raise InputError(f"{path}: found no header from 'ply' to 'end_header', expected a PLY file")
    kind, count, fields = _ply_layout(path, header[1].decode("ascii", "replace"))
    columns = [[name for name, _ in fields].index(axis) for axis in "xyz"]
    if kind == "ascii":
        return _parse_columns(path, data[header.end() :], columns, count)
    order = _PLY_ORDERS[kind]
    layout = np.dtype([(name, f"{order}{_PLY_TYPES[type_]}") for name, type_ in fields])
    if len(data) - header.end() < count * layout.itemsize:
        raise InputError(
            f"{path}: found {len(data) - header.end()} bytes of points, expected {count * layout.itemsize} for "
            f"{count} points; is it truncated?"
        )
    points = np.frombuffer(data, layout, count, header.end())
    return np.stack([np.asarray(points[axis], float) for axis in "xyz"], -1)


def _ply_layout(path: Path, header: str) -> tuple[str, int, list[tuple[str, str]]]:
    """Return the format, the number of vertices, and the names and types of their properties."""
    lines = [words for line in header.splitlines() if (words := line.split())]
    kind = next((words[1] for words in lines if words[0] == "format" and len(words) > 1), "")
    if kind != "ascii" and kind not in _PLY_ORDERS:
        raise InputError(f"{path}: found the format '{kind}', expected ascii or {' or '.join(_PLY_ORDERS)}")
    elements = [(i, words) for i, words in enumerate(lines) if words[0] == "element"]
    if not elements or elements[0][1][1:2] != ["vertex"] or len(elements[0][1]) != 3:
        raise InputError(f"{path}: found no vertices as the first element, expected 'element vertex' and their number")
    (start, (*_, text)), end = elements[0], elements[1][0] if len(elements) > 1 else len(lines)
    count = _point_count(path, int(text) if text.isascii() and text.isdigit() and len(text) < 13 else -1)
    fields: list[tuple[str, str]] = []
    for words in lines[start + 1 : end]:
        if words[0] != "property":
            continue
        if len(words) != 3 or words[1] not in _PLY_TYPES or words[2] in [name for name, _ in fields]:
            raise InputError(f"{path}: found '{' '.join(words)[:80]}' of the vertices, expected a type and a name")
        fields.append((words[2], words[1]))
    if missing := [axis for axis in "xyz" if axis not in [name for name, _ in fields]]:
        raise InputError(f"{path}: found no property '{missing[0]}' of the vertices, expected x, y and z")
    return kind, count, fields


def _point_count(path: Path, count: int) -> int:
    if not 0 <= count <= MAX_POINTS:
        raise InputError(f"{path}: found a count of points that is none, or above {MAX_POINTS}, the most that is read")
    return count


def _parse_columns(path: Path, data: bytes, columns: list[int], count: int = MAX_POINTS + 1) -> Array:
    """Return three columns (N, 3) of the numbers in a text; separators are blanks, commas and semicolons."""
    text = data.translate(bytes.maketrans(b",;\t", b"   "))
    try:
        with warnings.catch_warnings(action="ignore"):  # of an empty text
            points = np.loadtxt(io.BytesIO(text), usecols=columns, max_rows=count, comments=("#", "//"), ndmin=2)
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: found a line that has no three numbers: {error}") from None
    if len(points) < count <= MAX_POINTS:
        raise InputError(f"{path}: found {len(points)} points, expected {count}; is it truncated?")
    _point_count(path, len(points))
    return points.reshape(-1, 3)


def _read_text(path: Path) -> Array:
    """Read x, y, z, in columns of these names if the first line has names, else in the first three."""
    data = _cloud_bytes(path)
    first, _, rest = data.partition(b"\n")
    words = re.split(r"[\s,;]+", first.decode("utf-8", "replace").strip().lstrip("#/ \ufeff").lower())
    if all(axis in words for axis in "xyz"):
        return _parse_columns(path, rest, [words.index(axis) for axis in "xyz"])
    if not all(map(is_number, words[:3])) or len(words) == 1:  # a title, or the number of points
        data = rest
    return _parse_columns(path, data, [0, 1, 2])


def _read_las(path: Path) -> Array:
    """Read the points of a LAS file 1.0 to 1.4: in all point formats a record begins with x, y, z as int32."""
    data = _cloud_bytes(path)
    if len(data) < _LAS_HEADER or not data.startswith(b"LASF"):
        raise InputError(f"{path}: found no 'LASF' and a header after it, expected a LAS file")
    major, minor = data[_LAS_VERSION : _LAS_VERSION + 2]
    if major != 1 or minor > 4:
        raise InputError(f"{path}: found version {major}.{minor}, expected LAS 1.0 to 1.4")
    (start,) = struct.unpack_from("<I", data, _LAS_POINTS_AT)
    format_, step, count = struct.unpack_from("<BHI", data, _LAS_FORMAT)
    if minor == 4 and len(data) >= _LAS_COUNT_1_4 + 8:
        (count,) = struct.unpack_from("<Q", data, _LAS_COUNT_1_4)
    count = _point_count(path, count)
    if format_ & _LAZ_BITS:
        return _decompress_laz(path, count)
    if format_ > _LAS_MAX_FORMAT or step < 12:
        raise InputError(
            f"{path}: found point format {format_} of {step} bytes, expected 0 to {_LAS_MAX_FORMAT} of 20 or more"
        )
    if start < _LAS_HEADER or len(data) - start < count * step:
        raise InputError(
            f"{path}: found {max(0, len(data) - start)} bytes of points, expected {count * step} for {count} points; "
            "is it truncated?"
        )
    scales_and_offsets = np.array(struct.unpack_from("<6d", data, _LAS_SCALES))
    if not np.isfinite(scales_and_offsets).all() or not scales_and_offsets[:3].all():
        raise InputError(f"{path}: found scales and offsets {scales_and_offsets.tolist()}, expected finite numbers")
    whole = np.ndarray((count, 3), "<i4", data, start, (step, 4)) if count else np.empty((0, 3))
    with np.errstate(over="ignore"):  # infinite points are no returns
        return np.asarray(whole * scales_and_offsets[:3] + scales_and_offsets[3:], float)


def _decompress_laz(path: Path, count: int) -> Array:
    if find_spec("laspy") is None or find_spec("lazrs") is None:
        raise InputError(
            f"{path}: found compressed points (LAZ), which need a library: pip install 'laspy[lazrs]', or write LAS"
        )
    with confined_decoding("laz", path, "a LAZ file", points=count) as decoded:
        points = decoded.read(count * 24)
    if len(points) < count * 24:
        raise InputError(f"{path}: found {len(points) // 24} points, expected {count}; is it truncated?")
    return np.frombuffer(points, "<f8").reshape(-1, 3)


_READER_OF_ENDING: Mapping[str, Callable[[Path], Array]] = {
    ".pcd": _read_pcd,
    ".ply": _read_ply,
    **dict.fromkeys((".xyz", ".txt", ".csv", ".pts", ".asc"), _read_text),
    **dict.fromkeys((".las", ".laz"), _read_las),
}
CLOUD_ENDINGS = tuple(_READER_OF_ENDING)
"""Endings of files of clouds, in lower case."""
