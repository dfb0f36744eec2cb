"""Depth images: 16-bit PNG files of depth along the optical axis, in tenths of a millimetre."""

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.base import InputError, read_bytes
from calibration.base.arrays import Array, IntArray
from calibration.base.optional import optional
from calibration.engine.dataset.document import shown
from calibration.engine.geometry.cameras import Camera

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
