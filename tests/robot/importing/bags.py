"""Bags as a robot would record them, written by the library: t2rgb's images, intrinsics and frames."""

import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calibration.base.arrays import Array
from calibration.engine.geometry.rotations import to_quaternion

Kind = Literal["bag", "db3", "mcap"]
SECOND = 10**9
LIVOX = {
    "CustomPoint": "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line",
    "CustomMsg": "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
    "CustomPoint[] points",
}
"""Messages of Livox's drivers."""
BEGIN = 1_700_000_000 * SECOND


class BagFile:
    """A bag that is written message by message."""

    def __init__(self, path: Path, kind: Kind) -> None:
        self.ros1 = kind == "bag"
        self.types = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            definition = "geometry_msgs/TransformStamped[] transforms"
            self.types.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.writer: Any = Writer1(path) if self.ros1 else Writer2(path, version=9, storage_plugin=plugin)
        self._topics: dict[str, Any] = {}

    def __enter__(self) -> "BagFile":
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def make(self, kind: str, **fields: Any) -> Any:
        """A message."""
        return self.types.types[kind](**fields)

    def header(self, frame: str, stamp: int) -> Any:
        """Of a message."""
        time = self.make("builtin_interfaces/msg/Time", sec=stamp // SECOND, nanosec=stamp % SECOND)
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **({"seq": 0} if self.ros1 else {}))

    def write(self, topic: str, recorded: int, message: Any) -> None:
        """Write a message."""
        kind = message.__msgtype__
        if topic not in self._topics:
            self._topics[topic] = self.writer.add_connection(topic, kind, typestore=self.types)
        data = self.types.serialize_ros1(message, kind) if self.ros1 else self.types.serialize_cdr(message, kind)
        self.writer.write(self._topics[topic], recorded, data)

    def image(
        self, topic: str, stamp: int, image: Array, frame: str, encoding: str = "bgr8", late: int = 3_000_000
    ) -> None:
        """Write an image (H, W, 3), blue first, in an encoding ("jpeg": a CompressedImage), recorded ``late``, ns."""
        header = self.header(frame, stamp)
        if encoding == "jpeg":
            data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
            content = self.make("sensor_msgs/msg/CompressedImage", header=header, format="jpeg", data=data.ravel())
        else:
            pixels, big = ENCODINGS[encoding](image), int("16" in encoding)
            content = self.make(
                "sensor_msgs/msg/Image",
                header=header,
                height=image.shape[0],
                width=image.shape[1],
                encoding=encoding.split()[0],
                is_bigendian=big,
                step=pixels.nbytes // len(pixels),
                data=np.frombuffer(pixels.tobytes(), np.uint8),
            )
        self.write(topic, stamp + late, content)

    def depth(self, topic: str, stamp: int, metres: Array, frame: str, encoding: str) -> None:
        """Write a depth image (H, W), m, NaN where there is nothing: millimetres in 16UC1, big endian, or 32FC1."""
        if ";" in encoding:
            data = compressed_depth(metres, encoding)
            header = self.header(frame, stamp)
            self.write(
                topic, stamp, self.make("sensor_msgs/msg/CompressedImage", header=header, format=encoding, data=data)
            )
            return
        if encoding == "16UC1":
            pixels = np.where(np.isnan(metres), 0, np.rint(1000 * metres)).astype(">u2")
        else:
            pixels = metres.astype("<f4")
        content = self.make(
            "sensor_msgs/msg/Image",
            header=self.header(frame, stamp),
            height=metres.shape[0],
            width=metres.shape[1],
            encoding=encoding,
            is_bigendian=int(encoding == "16UC1"),
            step=pixels.nbytes // metres.shape[0],
            data=np.frombuffer(pixels.tobytes(), np.uint8),
        )
        self.write(topic, stamp, content)

    def cloud(self, topic: str, stamp: int, points: Array, frame: str) -> None:
        """Write points (N, 3): x, y, z of eight bytes, big endian, with an intensity before them, in two rows."""
        kind = np.dtype([("intensity", ">f4"), ("x", ">f8"), ("y", ">f8"), ("z", ">f8")])
        rows = np.zeros(2 * (len(points) // 2), kind)
        for i, axis in enumerate("xyz"):
            rows[axis] = points[: len(rows), i]
        fields = [
            self.make("sensor_msgs/msg/PointField", name=name, offset=int(kind.fields[name][1]), datatype=code, count=1)
            for name, code in (("intensity", 7), ("x", 8), ("y", 8), ("z", 8))
        ]
        content = self.make(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(frame, stamp),
            height=2,
            width=len(rows) // 2,
            fields=fields,
            is_bigendian=True,
            point_step=kind.itemsize,
            row_step=kind.itemsize * len(rows) // 2,
            data=np.frombuffer(rows.tobytes(), np.uint8),
            is_dense=False,
        )
        self.write(topic, stamp, content)

    def livox(self, topic: str, stamp: int, points: Array, frame: str) -> None:
        """Write points (N, 3) as Livox's drivers do: 0 where there is no return."""
        package = "livox_ros_driver" if self.ros1 else "livox_ros_driver2"
        if f"{package}/msg/CustomMsg" not in self.types.fielddefs:
            for name in ("CustomPoint", "CustomMsg"):
                self.types.register(get_types_from_msg(LIVOX[name], f"{package}/msg/{name}"))
        places = np.nan_to_num(points).tolist()
        more = {"reflectivity": 10, "tag": 0, "line": 0}
        made = [
            self.make(f"{package}/msg/CustomPoint", offset_time=i, x=x, y=y, z=z, **more)
            for i, (x, y, z) in enumerate(places)
        ]
        content = self.make(
            f"{package}/msg/CustomMsg",
            header=self.header(frame, stamp),
            timebase=stamp,
            point_num=len(made),
            lidar_id=0,
            rsvd=np.zeros(3, np.uint8),
            points=made,
        )
        self.write(topic, stamp, content)

    def scan(self, topic: str, stamp: int, message: Mapping[str, Any], frame: str) -> None:
        """Write a LaserScan as a dataset holds it."""
        values = {key: np.array(message[key], np.float32) for key in ("ranges", "intensities")}
        rest = {key: message[key] for key in message if key.startswith(("angle", "time_", "scan_", "range_"))}
        content = self.make("sensor_msgs/msg/LaserScan", header=self.header(frame, stamp), **rest, **values)
        self.write(topic, stamp, content)

    def camera_info(
        self, topic: str, stamp: int, frame: str, size: tuple[int, int], focal: float, **changed: Any
    ) -> None:
        """Write the intrinsics of a camera without distortion, but for changed fields, by ROS 2's names."""
        roi = self.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        K = np.array([focal, 0, size[0] / 2 + 0.5, 0, focal, size[1] / 2 + 0.5, 0, 0, 1.0])
        fields = {"d": np.zeros(5), "k": K, "r": np.eye(3).ravel(), "p": np.zeros(12), "roi": roi}
        fields |= {"distortion_model": "plumb_bob", "binning_x": 0, "binning_y": 0} | changed
        if self.ros1:
            fields = {key.upper() if len(key) == 1 else key: value for key, value in fields.items()}
        content = self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(frame, stamp),
            height=size[1],
            width=size[0],
            **fields,
        )
        self.write(topic, stamp, content)

    def transforms(self, topic: str, stamp: int, transforms: Mapping[tuple[str, str], Array]) -> None:
        """Write ``T_parent_child`` (4, 4) of some edges."""
        messages = []
        for (parent, child), T in transforms.items():
            x, y, z, w = to_quaternion(T[:3, :3]).tolist()
            pose = self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", T[:3, 3].tolist(), strict=True))),
                rotation=self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
            )
            header = self.header(parent, stamp)
            messages.append(
                self.make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=pose)
            )
        self.write(topic, stamp, self.make("tf2_msgs/msg/TFMessage", transforms=messages))

    def joints(self, topic: str, stamp: int, positions: Mapping[str, float]) -> None:
        """Write positions of joints."""
        content = self.make(
            "sensor_msgs/msg/JointState",
            header=self.header("", stamp),
            name=list(positions),
            position=np.array(list(positions.values())),
            velocity=np.zeros(0),
            effort=np.zeros(0),
        )
        self.write(topic, stamp, content)

    def text(self, topic: str, stamp: int, text: str) -> None:
        """Write a String."""
        self.write(topic, stamp, self.make("std_msgs/msg/String", data=text))


def compressed_depth(metres: Array, encoding: str) -> Array:
    """As image_transport compresses depths: of 32FC1 inverse depths, up to 10 m in steps of 0.1 mm at 1 m."""
    kind, _, transport = encoding.partition(";")
    a, b = 100.0 * 101.0, 1 - 100.0 * 101.0 / 10
    with np.errstate(invalid="ignore"):
        inverse = np.where(metres < 10, a / metres + b, 0)
        counts = np.nan_to_num(inverse if kind == "32FC1" else np.rint(1000 * metres)).astype(np.uint16)
    data = bytes(cv2.imencode(".png", counts)[1])
    header = struct.pack("<iff", 0, a, b) if "compressedDepth" in transport else b""
    return np.frombuffer(header + data, np.uint8)


def _bayer(image: Array) -> Array:
    """RGGB: each pixel has one colour; red at the top left."""
    mosaic = image[:, :, 1].copy()
    mosaic[::2, ::2] = image[::2, ::2, 2]
    mosaic[1::2, 1::2] = image[1::2, 1::2, 0]
    return mosaic


def _grey(image: Array) -> Array:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def _nv12(image: Array, order: slice) -> Array:
    """Brightness, and below it the two colours of four pixels each in turn."""
    height, width = image.shape[:2]
    planes = cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420)
    colours = planes[height:].reshape(2, -1)[order]
    return np.vstack([planes[:height], colours.T.reshape(height // 2, width)])


ENCODINGS: Mapping[str, Callable[[Array], Array]] = {
    "bgr8": lambda image: image,
    "rgb8": lambda image: image[:, :, ::-1],
    "bgra8": lambda image: np.dstack([image, image[:, :, 0]]),
    "mono8": _grey,
    "mono16": lambda image: (_grey(image).astype(">u2") * 256).astype(">u2"),
    "mono16 of 12 bits": lambda image: (_grey(image).astype(">u2") * 16).astype(">u2"),
    "bayer_rggb8": _bayer,
    "bayer_rggb16": lambda image: (_bayer(image).astype(">u2") * 256).astype(">u2"),
    "nv12": lambda image: _nv12(image, slice(None)),
    "nv21": lambda image: _nv12(image, slice(None, None, -1)),
}
