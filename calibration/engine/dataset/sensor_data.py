"""Data of sensors that measure points: point clouds and scans of LiDARs, depth images.

Clouds are PCD files (ASCII, binary, compressed) or ROS PointCloud2 messages, scans are LaserScan messages. Depth images
are 16-bit PNG files of depth along the optical axis, in tenths of a millimetre.
"""

import binascii
import math
import re
import zlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration.base import InputError, read_bytes, write_atomically
from calibration.base.arrays import Array, IntArray
from calibration.base.optional import optional
from calibration.engine.dataset.document import MAX_BYTES, Node, shown
from calibration.engine.geometry.cameras import Camera

Cloud = NDArray[np.floating[Any]]
"""Points (N, 3) of a cloud in the sensor's frame (m)."""

MAX_DECOMPRESSED = 1 << 29
"""Limit of the bytes of a compressed file's points."""
LZF_RATIO = 100
"""Limit of what LZF saves: three bytes are 264 at most."""
HEADER_BYTES = 1 << 16
"""Limit of the size of a PCD file's header."""
_DATA_LINE = re.compile(rb"^DATA[ \t]+(\S+)[ \t]*\r?\n", re.MULTILINE)


def read_points(path: Path | str) -> Cloud:
    """Read the points (N, 3) of a PCD file, in the file's precision; NaN for points without a return.

    Raises:
        InputError: the file cannot be read, or is not a PCD file with floating-point x, y and z.
    """
    data = read_bytes(path, MAX_BYTES, "a point cloud")
    try:
        return decode_pcd(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def write_points(path: Path | str, points: Array) -> None:
    """Write points (N, 3) as a binary PCD file of float32 x, y, z.

    Raises:
        InfrastructureError: the file cannot be written.
    """
    write_atomically(path, encode_pcd(points))


def encode_pcd(points: Array) -> bytes:
    """Encode points (N, 3) as a binary PCD file of float32 x, y, z."""
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    return header.encode() + np.asarray(points, "<f4").reshape(-1, 3).tobytes()


def decode_pcd(data: bytes) -> Cloud:
    """Decode the points of a PCD file.

    Raises:
        InputError: it is not a supported PCD file; the message does not name the file.
    """
    end = _DATA_LINE.search(data, 0, HEADER_BYTES)
    if end is None:
        raise InputError("found no line 'DATA ...', expected the header of a PCD file")
    lines = data[: end.start()].decode("ascii", "replace").replace("\t", " ").splitlines()
    header = {key: values for key, _, values in (line.partition(" ") for line in lines)}
    layout = _pcd_layout(
        header.get("FIELDS", ""), header.get("SIZE", ""), header.get("TYPE", ""), header.get("COUNT", "")
    )
    count = _pcd_count(header)
    kind = end.group(1)
    if kind == b"binary":
        return layout.points(data, end.end(), count)
    if kind == b"ascii":
        return _decode_ascii(data[end.end() :], count, layout)
    if kind == b"binary_compressed":
        return layout.columns(_decompress_lzf(data[end.end() :], count * layout.step), count)
    found = shown(kind.decode("ascii", "replace"))
    raise InputError(f"found DATA {found}, expected 'binary', 'binary_compressed' or 'ascii'")


def _decompress_lzf(data: bytes, expected: int) -> bytes:
    """Decompress the points of ``binary_compressed``: two sizes (uint32), and LZF (liblzf, lzf_d.c)."""
    if len(data) < 8:
        raise InputError("found no compressed points; is it truncated?")
    packed, size = np.frombuffer(data, "<u4", 2).tolist()
    if size != expected or size > MAX_DECOMPRESSED or size > LZF_RATIO * packed:
        raise InputError(f"found {packed} bytes for {size} bytes of points, expected {expected}")
    if len(data) - 8 < packed:
        raise InputError(f"found {len(data) - 8} bytes of compressed points, expected {packed}; is it truncated?")
    at, end, found = 8, 8 + packed, bytearray()
    try:
        while at < end and len(found) <= size:
            control = data[at]
            at += 1
            if control < 32:  # so many bytes and one more as they are
                found += data[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[at]
                at += 1
            start = len(found) - ((control & 31) << 8) - data[at] - 1
            at += 1
            if start < 0:
                raise IndexError
            length += 2
            again = bytes(found[start : start + length])
            found += (again * -(-length // len(again)))[:length]  # a copy may reach into itself
    except IndexError:
        raise InputError("found compressed points that are damaged") from None
    if len(found) != size:
        raise InputError(f"found {len(found)} bytes of points after decompression, expected {size}")
    return bytes(found)


class _Layout(NamedTuple):
    """Layout of x, y and z in the bytes of a point, or in the words of a line of ASCII."""

    step: int
    offsets: list[int]
    types: list[str]
    width: int = 0
    words: tuple[int, ...] = ()

    def points(self, data: bytes, start: int, count: int) -> Cloud:
        """Decode packed data."""
        if len(data) - start < count * self.step:
            raise InputError(
                f"found {len(data) - start} bytes of points, expected {count * self.step} for {count} points; "
                "is it truncated?"
            )
        packed = np.dtype({"names": "xyz", "formats": self.types, "offsets": self.offsets, "itemsize": self.step})
        found = np.ndarray((count,), packed, data, start) if count else np.empty(0, packed)
        return np.stack([found[axis] for axis in "xyz"], -1)

    def columns(self, data: bytes, count: int) -> Cloud:
        """Decode data in which each field's values of all points follow each other."""
        places = zip(self.types, self.offsets, strict=True)
        return np.stack([np.frombuffer(data, type_, count, offset * count) for type_, offset in places], -1)


@lru_cache(maxsize=16)
def _pcd_layout(fields: str, size: str, type_: str, count: str) -> _Layout:
    names, types = fields.split(), type_.split()
    sizes = [_whole_number("SIZE", each) for each in size.split()]
    counts = [_whole_number("COUNT", each) for each in count.split()] or [1] * len(names)
    for key, values in (("SIZE", sizes), ("TYPE", types), ("COUNT", counts)):
        if len(values) != len(names):
            raise InputError(f"found {len(values)} values of {key} for {len(names)} FIELDS")
    for axis in "xyz":
        if names.count(axis) != 1:
            raise InputError(f"found FIELDS {shown(fields)}, expected one each of x, y and z")
    at = [names.index(axis) for axis in "xyz"]
    for i in at:
        if types[i] != "F" or sizes[i] not in (4, 8) or counts[i] != 1:
            found = f"{counts[i]} {shown(types[i])} of {sizes[i]} bytes"
            raise InputError(f"found '{names[i]}' as {found}, expected one 'F' of 4 or 8")
    bytes_of = [size * count for size, count in zip(sizes, counts, strict=True)]
    return _Layout(
        step=sum(bytes_of),
        offsets=[sum(bytes_of[:i]) for i in at],
        types=[f"<f{sizes[i]}" for i in at],
        width=sum(counts),
        words=tuple(sum(counts[:i]) for i in at),
    )


def _pcd_count(header: dict[str, str]) -> int:
    """Return the number of points in the header."""
    points, width, height = (
        _whole_number(key, header[key].strip()) if key in header else None for key in ("POINTS", "WIDTH", "HEIGHT")
    )
    area = points if width is None else width * (1 if height is None else height)
    if area is None:
        raise InputError("found neither POINTS nor WIDTH, expected the header of a PCD file")
    if points not in (None, area):
        raise InputError(f"found POINTS {points}, expected WIDTH times HEIGHT, {area}")
    return area


def _whole_number(key: str, text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 12):
        raise InputError(f"found {key} {shown(text)}, expected a number")
    return int(text)


def _decode_ascii(data: bytes, count: int, layout: _Layout) -> Cloud:
    words = data.split()
    if len(words) != count * layout.width:
        raise InputError(
            f"found {len(words)} numbers, expected {count * layout.width} for {count} points; is it truncated?"
        )
    try:
        return np.stack([np.array([float(word) for word in words[i :: layout.width]]) for i in layout.words], -1)
    except ValueError as error:
        raise InputError(f"found points that are no numbers: {error}") from None


def decode_message(message: Node) -> Cloud:
    """Decode a PointCloud2 message from a document; ``data`` is base64 text or a list of bytes.

    Raises:
        InputError: something in it is missing or wrong.
    """
    step = message["point_step"].whole(1, 1 << 20)
    rows, columns = message["height"].whole(0, 1 << 30), message["width"].whole(0, 1 << 30)
    row_step = message["row_step"].whole(columns * step, 1 << 50) if rows > 1 else columns * step
    data = _message_bytes(message["data"])
    if len(data) < rows * row_step:
        raise message["data"].fault(f"found {len(data)} bytes, expected {rows} x {columns} points of {step} bytes")
    if row_step > columns * step:  # rows with padding
        data = b"".join(data[i * row_step : i * row_step + columns * step] for i in range(rows))
    big = message.get("is_bigendian")
    if big and big.value not in (0, 1):
        raise big.unexpected("true or false")
    order = ">" if big and big.value else "<"
    fields = {field["name"].text(): field for field in message["fields"].elements()}
    offsets, types = [], []
    for axis in "xyz":
        if axis not in fields:
            raise message["fields"].fault(f"missing field '{axis}'")
        size = 4 if fields[axis]["datatype"].whole(7, 8) == 7 else 8  # sensor_msgs/PointField: FLOAT32, FLOAT64
        types.append(f"{order}f{size}")
        offsets.append(fields[axis]["offset"].whole(0, max(0, step - size)))
    return _Layout(step, offsets, types).points(data, 0, rows * columns)


def _message_bytes(node: Node) -> bytes:
    try:
        if isinstance(node.value, str):
            return binascii.a2b_base64(node.value, strict_mode=True)
        return bytes(node.sequence())
    except (ValueError, TypeError):
        raise node.fault("found no bytes, expected base64 text or a list of numbers from 0 to 255") from None


MAX_RAYS = 1 << 20
"""Limit of the number of rays of a scan."""
_MAX_SCAN_ANGLE = 2 * math.pi * 1.02
"""Limit of a scan's angle: the last rays of a rotating LiDAR may overlap the first."""


def read_scan(message: Node) -> Array:
    """Convert a LaserScan to points (N, 3) in the sensor's frame (m), one for each ray, all with z = 0.

    The ray k points along ``angle_min + k * angle_increment``, from x to y. NaN for a ray without a return: a range
    that is not finite, not above 0, or outside of ``range_min`` to ``range_max`` where the message has them.

    Raises:
        InputError: something in the message is missing or wrong.
    """
    ranges = _read_ranges(message["ranges"])
    start, step = message["angle_min"].within(-10, 10), message["angle_increment"].within(-1, 1)
    if step == 0:
        raise message["angle_increment"].unexpected("the angle between two rays, rad")
    if abs(step) * (len(ranges) - 1) > _MAX_SCAN_ANGLE:
        raise message["angle_increment"].fault(
            f"{len(ranges)} rays of {step:g} rad make more than one revolution; are the angles in degrees?"
        )
    least, most = _read_range_limit(message, "range_min", 0.0), _read_range_limit(message, "range_max", math.inf)
    with np.errstate(invalid="ignore"):
        returned = np.isfinite(ranges) & (ranges > 0) & (ranges >= least) & (ranges <= most)
    r, angle = np.where(returned, ranges, np.nan), start + step * np.arange(len(ranges))
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.where(returned, 0.0, np.nan)], -1)


def _read_ranges(node: Node) -> Array:
    """Return the ranges (N,), NaN for null."""
    values = node.sequence()
    if len(values) > MAX_RAYS:
        raise node.fault(f"found {len(values)} ranges, expected {MAX_RAYS} at most")
    try:
        if set(map(type, values)) <= {float, int, type(None)}:
            return np.array([math.nan if value is None else float(value) for value in values])
    except OverflowError:  # an integer beyond the range of floats
        pass
    wrong = next(element for element in node.elements() if not _is_range(element.value))
    raise wrong.unexpected("a range in m, or NaN, Infinity or null where nothing came back")


def _is_range(value: object) -> bool:
    return value is None or type(value) is float or (type(value) is int and abs(value) < 10**300)


def _read_range_limit(message: Node, key: str, otherwise: float) -> float:
    """Return a limit of the ranges; some drivers set the upper one to infinity."""
    node = message.get(key)
    return otherwise if node is None or node.value == math.inf else node.number()


DEPTH_UNIT_M = 1e-4
"""m: the unit of a depth image."""
NO_RETURN = 65535
"""Value of a pixel without a measurement, as is 0; the largest depth is 6.5534 m."""
MAX_AREA = 1 << 26
"""Limit of the number of pixels of a decoded image."""
_MAX_BYTES = 4 * MAX_AREA
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_FIRST_CHUNK = b"\0\0\0\rIHDR"  # its length and its name
_HEADER_BYTES = 26  # up to bit depth and colour type


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Depth image of a camera."""

    depth: NDArray[np.uint16]
    """(H, W): in units of `DEPTH_UNIT_M`; `NO_RETURN` or 0 for no measurement."""
    camera: Camera

    def __len__(self) -> int:
        return self.depth.size

    def take(self, index: IntArray) -> Array:
        """Return the points (N, 3) of pixels ``y * width + x`` (N,), m, optical frame; NaN without a measurement.

        Raises:
            IndexError: an index is not below the number of pixels.
        """
        counted = self.depth.ravel()[index]
        z = np.where((counted == NO_RETURN) | (counted == 0), np.nan, counted * DEPTH_UNIT_M)
        v, u = np.divmod(index, self.depth.shape[1])
        xy = self.camera.normalise(np.stack([u, v], -1).astype(float))
        return np.concatenate([xy, np.ones((len(index), 1))], -1) * z[:, None]


def read_depth_image(path: Path | str, camera: Camera) -> DepthImage:
    """Read a depth image from a PNG file.

    Args:
        path: path of the PNG file.
        camera: the intrinsics, whose size the image must have.

    Raises:
        InputError: the file cannot be read, or is not a PNG file with one 16-bit channel and the camera's size.
        InfrastructureError: OpenCV, which decodes it, is missing.
    """
    data = read_bytes(path, _MAX_BYTES, "a depth image")
    try:
        return DepthImage(decode_png(data, camera), camera)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def decode_png(data: bytes, camera: Camera | None = None) -> NDArray[np.uint16]:
    """Decode a PNG file of one 16-bit channel to (H, W).

    Args:
        data: the content of the file.
        camera: the intrinsics, whose size the image must have; None for any size.

    Raises:
        InputError: it is not such a file, or it is damaged.
        InfrastructureError: OpenCV, which decodes it, is missing.
    """
    width, height = _checked_size(data, camera)
    _check_chunks(data)
    return _decode_png(data, (height, width))


def _checked_size(data: bytes, camera: Camera | None) -> tuple[int, int]:
    """Width and height in the first chunk of a PNG file (https://www.w3.org/TR/png-3/#11IHDR), if it is supported."""
    if len(data) < _HEADER_BYTES or not data.startswith(_PNG_SIGNATURE + _FIRST_CHUNK):
        raise InputError(f"found {shown(data[:4].decode('latin-1'))} at its begin, expected a PNG file")
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    bits, colour = data[24], data[25]
    if (bits, colour) != (16, 0):
        kind = {0: "grey", 2: "colour", 3: "palette", 4: "grey with alpha", 6: "colour with alpha"}.get(
            colour, "unknown"
        )
        raise InputError(f"found a PNG file of {bits} bits, {kind}, expected 16 bits, grey")
    if camera is not None and (width, height) != (camera.width, camera.height):
        raise InputError(
            f"found an image of {width} x {height} pixels, expected {camera.width} x {camera.height} as in camera_info"
        )
    if not 0 < width * height <= MAX_AREA:
        raise InputError(f"found an image of {width} x {height} pixels, expected {MAX_AREA} pixels at most")
    return width, height


def _check_chunks(data: bytes) -> None:
    """Refuse a truncated or damaged file: a decoder may return a partial image, or trust any length field."""
    at, view = len(_PNG_SIGNATURE), memoryview(data)
    while at + 12 <= len(data):  # length, name, content, checksum of name and content
        end = at + 8 + int.from_bytes(view[at : at + 4], "big")
        if zlib.crc32(view[at + 4 : end]) != int.from_bytes(view[end : end + 4], "big") or end + 4 > len(data):
            break
        if data[at + 4 : at + 8] == b"IEND":
            return
        at = end + 4
    raise InputError(f"the PNG file is damaged from byte {at} on; is it truncated?")


def _decode_png(data: bytes, shape: tuple[int, int]) -> NDArray[np.uint16]:
    cv2 = optional("cv2", "reading depth images")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None or image.dtype != np.uint16 or image.shape != shape:
        raise InputError("the PNG file cannot be decoded; write it again")
    return np.asarray(image, np.uint16)
