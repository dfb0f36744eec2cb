"""The modalities of sensors: one object for each, with everything that a dataset says of that kind of sensor.

What the engine and the tables need of it stands here as facts (how many points make a view, whether they lie in a
plane, how they err); how it is simulated, in `calibration.simulation.sensors`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.dataset import pointcloud
from calibration.dataset.depth_image import read_depth_image
from calibration.dataset.document import Node
from calibration.dataset.laser_scan import read_scan
from calibration.dataset.payload import locate_existing
from calibration.errors import InputError
from calibration.geometry.cameras import Camera
from calibration.geometry.types import Array, IntArray

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
"""What is measured of a label: a corner, px; a range, m; the direction in which a border is found, rad; where a
pattern is, m, and how it is turned, rad."""


class IndexedPoints(Protocol):
    """What a sensor measured in a collection: points that labels refer to by their index."""

    def __len__(self) -> int:
        """How many there are."""

    def take(self, index: IntArray) -> Array:
        """The points (N, 3) of indices (N,), m, in the sensor's frame; NaN where nothing was measured.

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
    """How the labels of a sensor that measures points are read."""

    count: str
    """What an index counts, in the words of an error message: "cloud's {} points"."""
    nothing: str
    """What is wrong with a label where nothing was measured: "point {} of the cloud is not finite"."""
    read: Callable[[Node, Camera | None], IndexedPoints]
    """From the sensor's message in a collection, and its intrinsics."""
    noise: tuple[NoiseKind, NoiseKind]
    """How its ranges err, and its points on the border."""
    minimum: int = 10
    """So many labelled points make a view: fewer hardly make a plane (ATOM's rule too)."""
    planar: bool = False
    """They lie in one plane of the sensor, so that a view is a cut through the pattern, a line."""
    limits: tuple[str, ...] = ("idxs_limit_points",)
    """The keys that its limit points may have."""


@dataclass(frozen=True)
class Modality:
    """A kind of sensor."""

    name: str
    """As datasets and configurations write it."""
    family: Family
    """Tables of errors are for all modalities of a family, as ``lidar-to-rgb`` is for every LiDAR."""
    message: str
    """The type of its ROS messages."""
    has_intrinsics: bool = False
    """It is a camera in its geometry: a dataset has its ``camera_info``."""
    points: PointData | None = None
    """How labels refer to its data; None where they are corners or poses, which need no data."""
    has_poses: bool = False
    """Its labels are poses of patterns, that it or a software before it has measured."""

    @property
    def has_corners(self) -> bool:
        """Whether its labels are corners in images."""
        return self.points is None and not self.has_poses

    @property
    def point_data(self) -> PointData:
        """How labels refer to its data; not for those that `has_corners` or `has_poses`."""
        if self.points is None:
            raise AssertionError(f"labels of a sensor {self.name} are no points")
        return self.points

    @property
    def is_planar(self) -> bool:
        """Whether it sees a pattern only where one plane cuts it."""
        return self.points is not None and self.points.planar

    def __str__(self) -> str:
        return self.name


def _in_file(name: Node, read: Callable[[str], IndexedPoints]) -> IndexedPoints:
    """What a file beside the dataset holds; an error names the key that names the file.

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
        return _Points(pointcloud.decode_message(message))
    return _in_file(message["data_file"], lambda path: _Points(pointcloud.read_points(path)))


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
        minimum=3,  # two points make a line, with nothing to check them by
        planar=True,
        limits=("idxs_limit_points", "edge_idxs"),  # the latter is ATOM's
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
"""By name."""
BORDERS: frozenset[NoiseKind] = frozenset(each.points.noise[1] for each in MODALITIES.values() if each.points)
"""How points on a border err, an angle, in rad."""


def of_family(family: Family) -> tuple[Modality, ...]:
    """The modalities of a family."""
    return tuple(modality for modality in MODALITIES.values() if modality.family == family)
