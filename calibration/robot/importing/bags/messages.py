"""Conversion of ROS messages to arrays: images, intrinsics, poses."""

import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration import MAX_IMAGE_PIXELS
from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.edges import MAX_FRAME_DISTANCE_M, QUATERNION_TOLERANCE
from calibration.engine.dataset.model import Edge
from calibration.engine.dataset.sensor_data import DEPTH_UNIT_M, NO_RETURN, decode_png
from calibration.engine.dataset.sensors import MAX_PIXELS as LONGEST_SIDE
from calibration.engine.dataset.sensors import check_principal_point, read_camera
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import PlumbBob
from calibration.engine.geometry.transforms import from_quaternion
from calibration.robot.importing.image_views import decoded_image, stretched
from calibration.robot.labelling.detection import DepthImage, Image

_CONVERSION_OF_ENCODING = {
    "bgr8": None,
    "8UC3": None,
    "rgb8": cv2.COLOR_RGB2BGR,
    "mono8": None,
    "8UC1": None,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "8UC4": cv2.COLOR_BGRA2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "bayer_rggb8": cv2.COLOR_BayerBG2BGR,  # OpenCV names them by the second row and column
    "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
    "bayer_rggb16": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr16": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg16": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg16": cv2.COLOR_BayerGB2BGR,
    "mono16": None,
    "16UC1": None,
    "bgr16": None,
    "rgb16": cv2.COLOR_RGB2BGR,
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
    "yuyv": cv2.COLOR_YUV2BGR_YUY2,
    "nv12": cv2.COLOR_YUV2BGR_NV12,
    "nv21": cv2.COLOR_YUV2BGR_NV21,
}
"""Encodings of an Image, and OpenCV's conversions to BGR."""
DEPTH_ENCODINGS = {"16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3), "32FC1": ("f4", 1.0)}
"""Encodings of depth images: number type, and unit in m."""
MAX_DEPTH_PIXELS = 1 << 24
"""Limit of a depth image's pixels: its conversion takes some dozens of bytes for each."""
MAX_RECTIFYING_DEG = 0.02
"""Limit of the rotation that rectifies an image: its frame is then the camera's."""
_CHANNELS_OF_ENCODING = {"bgra8": 4, "rgba8": 4, "8UC4": 4, "bgr8": 3, "rgb8": 3, "8UC3": 3, "bgr16": 3, "rgb16": 3}
_DEPTH_HEADER = struct.Struct("<iff")
"""Header of the transport compressedDepth: the kind of compression, and the two parameters of inverse depth."""
_TWO_BYTES = frozenset(name for name in _CONVERSION_OF_ENCODING if name.endswith("16") or name == "16UC1")
VIDEO_CODECS = ("h264", "h265", "hevc", "av1", "vp9")
"""What the format of a CompressedImage says where its data are a frame of a video."""
NO_VIDEO = "record Image or CompressedImage (JPEG or PNG), or convert it by ros2 run image_transport republish"
"""What to do where a bag has video that cannot be decoded."""
INSTALL_PYAV = f"{NO_VIDEO}; or, for h264 and h265, install PyAV (pip install av)"
_HALF_PLANES = frozenset({"nv12", "nv21"})
"""Encodings with half as many rows of colours below those of the brightness."""


def image_of(message: Any, where: str) -> Image:
    """Convert an Image or a CompressedImage to (H, W) or (H, W, 3), 8 bits, BGR.

    Images of 16 bits are stretched: cameras of 10 to 14 bits use the lower ones.

    Raises:
        InputError: its encoding is not known, or its data are truncated.
    """
    if not hasattr(message, "encoding"):
        if any(codec in str(message.format).lower() for codec in VIDEO_CODECS):
            raise InputError(f"{where}: found a frame of a video, {message.format}, expected an image: {INSTALL_PYAV}")
        return decoded_image(bytes(message.data), f"{where} ({message.format})")
    encoding, height, width = message.encoding, message.height, message.width
    if encoding not in _CONVERSION_OF_ENCODING:
        raise InputError(
            f"{where}: found the encoding '{encoding}', expected one of {', '.join(_CONVERSION_OF_ENCODING)}"
        )
    _check_pixels(height, width, MAX_IMAGE_PIXELS, where)
    size = 2 if encoding in _TWO_BYTES else 1
    channels = _CHANNELS_OF_ENCODING.get(encoding, 2 if "yu" in encoding else 1)
    rows = height * 3 // 2 if encoding in _HALF_PLANES else height
    pixels: NDArray[Any] = _image_rows(message, rows, width * channels * size, where)
    if size == 2:
        pixels = stretched(pixels.view(">u2" if message.is_bigendian else "<u2"))
    pixels = pixels.reshape(rows, width, channels)
    code = _CONVERSION_OF_ENCODING[encoding]
    if code is None:
        return np.asarray(pixels[:, :, 0] if channels == 1 else pixels, np.uint8)
    try:
        return np.asarray(cv2.cvtColor(pixels[:, :, 0] if channels == 1 else pixels, code), np.uint8)
    except cv2.error as error:
        raise InputError(
            f"{where}: an image of {width} x {height} in {encoding} cannot be decoded: {error.err}"
        ) from None


def depth_of(message: Any, where: str) -> DepthImage:
    """Convert a depth Image to (H, W) in tenths of a millimetre, as in `calibration.engine.dataset.sensor_data`.

    Raises:
        InputError: its encoding is not one of depth images, or its data are truncated.
    """
    if not hasattr(message, "encoding"):
        return _in_units(_compressed_metres(message, where))
    encoding, height, width = message.encoding, int(message.height), int(message.width)
    if encoding not in DEPTH_ENCODINGS:
        raise InputError(
            f"{where}: found the encoding '{encoding}', expected one of depth: {', '.join(DEPTH_ENCODINGS)}"
        )
    kind, metres = DEPTH_ENCODINGS[encoding]
    _check_pixels(height, width, MAX_DEPTH_PIXELS, where)
    order = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    rows = _image_rows(message, height, width * order.itemsize, where).view(order)
    return _in_units(rows.astype(float) * metres)


def _compressed_metres(message: Any, where: str) -> Array:
    """Decompress a depth image of image_transport, (H, W) in m, 0 or NaN where nothing was measured.

    The transport ``compressed`` holds a PNG file of 16UC1. ``compressedDepth`` holds a header of 12 bytes (an integer
    and two floats a and b) and such a file; of 32FC1 it has ``a / depth + b``
    (http://wiki.ros.org/compressed_depth_image_transport).

    Raises:
        InputError: it is compressed in another way, or its data are truncated.
    """
    data, (encoding, _, transport) = bytes(message.data), str(message.format).partition(";")
    encoding, with_header = encoding.strip(), "compressedDepth" in transport
    known = encoding in DEPTH_ENCODINGS and (with_header or encoding != "32FC1")
    if not known or "rvl" in transport.lower():
        raise InputError(
            f"{where}: found a depth image compressed as '{message.format}', expected '16UC1; compressedDepth png', "
            f"'32FC1; compressedDepth png' or '16UC1; png compressed': set the publisher's format to png"
        )
    a = b = 0.0
    if with_header:
        if len(data) < _DEPTH_HEADER.size:
            raise InputError(f"{where}: found {len(data)} bytes, expected a compressed depth image")
        _, a, b = _DEPTH_HEADER.unpack_from(data)
        data = data[_DEPTH_HEADER.size :]
    try:
        pixels = decode_png(data)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    _check_pixels(pixels.shape[0], pixels.shape[1], MAX_DEPTH_PIXELS, where)
    counts = pixels.astype(float)
    if encoding != "32FC1":
        return counts * DEPTH_ENCODINGS[encoding][1]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(counts > 0, a / (counts - b), np.nan)


def _in_units(metres: Array) -> DepthImage:
    """Convert depths (H, W) in m to units of `DEPTH_UNIT_M`; `NO_RETURN` where nothing was measured."""
    with np.errstate(invalid="ignore", over="ignore"):
        counts = np.rint(metres / DEPTH_UNIT_M)
        measured = (counts > 0) & (counts < NO_RETURN)
    return np.where(measured, counts, NO_RETURN).astype(np.uint16)


def _check_pixels(height: int, width: int, most: int, where: str) -> None:
    if not 0 < height * width <= most:
        raise InputError(f"{where}: found an image of {width} x {height} pixels, expected 1 to {most} pixels")


def _image_rows(message: Any, height: int, row: int, where: str) -> NDArray[np.uint8]:
    """Return the bytes (height, row) of an Image, without padding of its rows.

    Raises:
        InputError: there are fewer.
    """
    data = np.frombuffer(message.data, np.uint8)
    if message.step < row or len(data) < message.step * (height - 1) + row:
        raise InputError(
            f"{where}: found {len(data)} bytes in rows of {message.step}, expected {height} rows of {row} or more"
        )
    # The last row need not be padded, so this is no slice of a reshaped array.
    return np.lib.stride_tricks.as_strided(data, (height, row), (int(message.step), 1)).copy()


@dataclass(frozen=True)
class CameraMessage:
    """Intrinsics of a CameraInfo."""

    raw: Camera
    """Of the images as they are taken."""
    R: tuple[float, ...]
    """Rotation (9,) of the rectified frame relative to the camera's, row by row."""
    P: tuple[float, ...]
    """Projection (12,) of the rectified image, row by row."""

    def rectified(self, where: str) -> Camera:
        """Return the intrinsics of rectified images, which have no distortion.

        Raises:
            InputError: they are turned relative to the camera's frame, or there is no projection.
        """
        angle = (
            float(np.degrees(rotations.angle(rotations.nearest(np.reshape(self.R, (3, 3)))))) if any(self.R) else 0.0
        )
        if angle > MAX_RECTIFYING_DEG:
            raise InputError(
                f"{where}: its images are rectified, and turned by {angle:.2f} deg relative to the camera (R of "
                "camera_info): record the raw images, image_raw"
            )
        fx, _, cx, _, _, fy, cy, *_ = self.P
        if not (fx > 0 and fy > 0):
            raise InputError(
                f"{where}: found no projection P in its camera_info, expected that of the rectified images"
            )
        return replace(self.raw, fx=fx, fy=fy, cx=cx, cy=cy, distortion=PlumbBob())


def camera_of(message: Any, where: str) -> CameraMessage | None:
    """Convert a CameraInfo to intrinsics; None if it is not calibrated (focal lengths of 0).

    Raises:
        InputError: they are invalid.
    """
    letters = "KDRP" if hasattr(message, "K") else "kdrp"  # of ROS 1, of ROS 2
    K, D, R, P = ([float(value) for value in getattr(message, letter)] for letter in letters)
    if not (K[0] and K[4]):
        return None
    roi, width = message.roi, int(message.width)
    if not 0 < width <= LONGEST_SIDE:
        raise InputError(f"{where}: found a width of {width}")
    info = {
        "width": width,
        "height": int(message.height),
        "K": K,
        "D": D,
        "distortion_model": str(message.distortion_model),
        "binning_x": int(message.binning_x),
        "binning_y": int(message.binning_y),
        "roi": {key: int(getattr(roi, key)) for key in ("x_offset", "y_offset", "height", "width")},
    }
    camera = read_camera(Node(Path(where), (), info))
    check_principal_point(camera, where)
    return CameraMessage(camera, tuple(R), tuple(P))


def frame_of(message: Any) -> str:
    """Return the frame of the data of a message, without a leading slash; Foxglove's have no header around it."""
    return str(getattr(message, "header", message).frame_id).lstrip("/")


def transform_of(message: Any) -> tuple[Edge, Array | None]:
    """Convert a TransformStamped: its frames, without leading slashes, and ``T_parent_child`` (4, 4).

    The transform is None if its numbers are no pose, as tf2 refuses them too.
    """
    edge = (message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/"))
    t, q = message.transform.translation, message.transform.rotation
    numbers = np.array([t.x, t.y, t.z, q.x, q.y, q.z, q.w], float)
    good = np.isfinite(numbers).all() and abs(numbers[:3]).max() <= MAX_FRAME_DISTANCE_M
    if not good or abs(np.linalg.norm(numbers[3:]) - 1) > QUATERNION_TOLERANCE:
        return edge, None
    return edge, from_quaternion(numbers[:3], numbers[3:])
