"""Modalities of sensors: one object for each, with all facts about its labels and data in a dataset.

The engine and the tables use these facts (minimum of points in a view, planar or not, kinds of noise). The
simulation of each modality is in `calibration.robot.simulation.sensors`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.document import Node, locate_existing
from calibration.engine.dataset.sensor_data import decode_message, read_depth_image, read_points, read_scan
from calibration.engine.geometry.cameras import Camera

Family = Literal["camera", "lidar", "depth camera", "tracker"]
NoiseKind = Literal[
    "pixel",
    "range",
    "border",
    "depth_border",
    "lidar2d_range",
    "lidar2d_border",
    "pose_translation",
    "pose_rotation",
]
"""Quantity of a label that has noise: a corner, px; a range, m; the direction to a border point, rad; the position of
a pattern, m, and its rotation, rad.
"""


class IndexedPoints(Protocol):
    """Data of a sensor in a collection: points that labels refer to by index."""

    def __len__(self) -> int:
        """Number of points."""

    def take(self, index: IntArray) -> Array:
        """Return the points (N, 3) of indices (N,), m, in the sensor's frame; NaN without a measurement.

        Raises:
            IndexError: an index is not below the number of points.
        """


@dataclass(frozen=True, eq=False)
class _Points:
    """The points of a cloud or a scan."""

    points: NDArray[np.floating[Any]]
    """(N, 3)."""

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: IntArray) -> Array:
        return np.asarray(self.points.take(index, axis=0), float)


@dataclass(frozen=True)
class PointData:
    """Access to the data of a sensor that measures points, and to labels that index them."""

    count: str
    """Description of an index in error messages: "cloud's {} points"."""
    nothing: str
    """Error message for a label without a measurement: "point {} of the cloud is not finite"."""
    read: Callable[[Node, Camera | None], IndexedPoints]
    """Function that reads the sensor's message in a collection; its second argument is the intrinsics."""
    noise: tuple[NoiseKind, NoiseKind]
    """Kinds of noise of its ranges, and of its border points."""
    minimum: int = 10
    """Minimum of labelled points in a view: fewer hardly determine a plane (ATOM's rule too)."""
    planar: bool = False
    """The points are in one plane of the sensor, so that a view of a pattern is a scan line."""
    limits: tuple[str, ...] = ("idxs_limit_points",)
    """Possible keys of its limit points."""


@dataclass(frozen=True)
class Modality:
    """Modality of a sensor."""

    name: str
    """Name in datasets and configurations."""
    family: Family
    """Tables of errors are per family: ``lidar-to-rgb`` is for every LiDAR."""
    message: str
    """Type of its ROS messages."""
    has_intrinsics: bool = False
    """Whether it projects like a camera: the dataset has its ``camera_info``."""
    points: PointData | None = None
    """Access to its data; None if its labels are corners or poses, which need no data."""
    has_poses: bool = False
    """Whether its labels are poses of patterns, measured by the sensor or by other software."""

    @property
    def has_corners(self) -> bool:
        """Whether its labels are corners in images."""
        return self.points is None and not self.has_poses

    @property
    def point_data(self) -> PointData:
        """Access to its data; not for modalities that `has_corners` or `has_poses`."""
        if self.points is None:
            raise AssertionError(f"labels of a sensor {self.name} are no points")
        return self.points

    @property
    def is_planar(self) -> bool:
        """Whether its view of a pattern is a scan line in one plane."""
        return self.points is not None and self.points.planar

    def __str__(self) -> str:
        return self.name


def _in_file(name: Node, read: Callable[[str], IndexedPoints]) -> IndexedPoints:
    """Read a data file of the dataset; an error names the key that has the file's name.

    Raises:
        MissingFileError: there is no such file.
        InputError: it cannot be read.
    """
    path = locate_existing(name)
    try:
        return read(path)
    except InputError as error:
        raise name.fault(str(error)) from None


def _read_cloud(message: Node, _: Camera | None) -> IndexedPoints:
    if message.get("data"):
        return _Points(decode_message(message))
    return _in_file(message["data_file"], lambda path: _Points(read_points(path)))


def _read_scan(message: Node, _: Camera | None) -> IndexedPoints:
    return _Points(read_scan(message))


def _read_depth(message: Node, camera: Camera | None) -> IndexedPoints:
    if camera is None:
        raise AssertionError("a depth camera has intrinsics")
    return _in_file(message["data_file"], lambda path: read_depth_image(path, camera))


RGB = Modality("rgb", "camera", "Image", has_intrinsics=True)
LIDAR3D = Modality(
    "lidar3d",
    "lidar",
    "PointCloud2",
    points=PointData(
        "cloud's {} points",
        "point {} of the cloud is not finite; a labelled point must be",
        _read_cloud,
        noise=("range", "border"),
    ),
)
LIDAR2D = Modality(
    "lidar2d",
    "lidar",
    "LaserScan",
    points=PointData(
        "scan's {} rays",
        "ray {} of the scan has no range; a labelled ray must",
        _read_scan,
        noise=("lidar2d_range", "lidar2d_border"),
        minimum=3,  # two points determine a line, with no redundancy
        planar=True,
        limits=("idxs_limit_points", "edge_idxs"),  # the latter is ATOM's key
    ),
)
DEPTH = Modality(
    "depth",
    "depth camera",
    "Image",
    has_intrinsics=True,
    points=PointData(
        "image's {} pixels",
        "pixel {} of the image has no depth (or no ray); a labelled pixel must",
        _read_depth,
        noise=("range", "depth_border"),
    ),
)
POSE = Modality("pose", "tracker", "PoseStamped", has_poses=True)
MODALITIES = {modality.name: modality for modality in (RGB, LIDAR3D, LIDAR2D, DEPTH, POSE)}
"""All modalities by name."""
BORDER_NOISE_KINDS: frozenset[NoiseKind] = frozenset(
    each.points.noise[1] for each in MODALITIES.values() if each.points
)
"""Kinds of noise of border points, an angle, in rad."""


def of_family(family: Family) -> tuple[Modality, ...]:
    """Return the modalities of a family."""
    return tuple(modality for modality in MODALITIES.values() if modality.family == family)
