"""Data of LiDARs and depth cameras at one moment: from the message of a bag, and with a detector of patterns.

`RANGE_MODALITIES` has one entry for each modality.
"""

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from calibration.base import InputError, write_atomically
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import Configuration
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.modalities import DEPTH, LIDAR2D, LIDAR3D
from calibration.engine.dataset.model import Edge
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.dataset.sensor_data import (
    decode_message,
    read_depth_image,
    read_points,
    read_scan,
    write_points,
)
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.frames import FrameTree
from calibration.engine.geometry.transforms import inverse
from calibration.robot.importing.bags.bag import LIVOX_TYPES
from calibration.robot.importing.bags.messages import depth_of
from calibration.robot.importing.bags.survey import SensorTopic
from calibration.robot.importing.image_views import LabelledMoment, encoded
from calibration.robot.labelling.depth import label_depth
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.points import PatternPoints, label_points
from calibration.robot.labelling.scan_line import label_scan_line
from calibration.robot.simulation.capture import estimate_pose
from calibration.robot.urdf import compose

MAX_POINTS = 20_000_000
"""Limit of the points of one cloud."""
Detector: TypeAlias = Callable[[Pattern, Array], PatternPoints | NotDetected]
"""Function that finds a pattern in a sensor's data, from its geometry and its expected ``T_sensor_pattern`` (4, 4)."""


@dataclass(frozen=True, eq=False)
class RangeView:
    """Data of a LiDAR or a depth camera at one moment."""

    message: Mapping[str, Any]
    """ROS message in the dataset's form, without the name of its file."""
    file: Path | None
    """File of a cloud or a depth image; the ranges of a scan are in the message."""

    @property
    def points(self) -> Array:
        """(N, 3): in the sensor's frame, m; NaN without a return."""
        if self.file is not None:
            return np.asarray(read_points(self.file), float)
        return read_scan(Node(Path("LaserScan"), (), dict(self.message)))


@dataclass(frozen=True)
class RangeModality:
    """Import of the data of one modality."""

    view: Callable[[Any, str, SensorTopic, Path], RangeView]
    """Function that converts a message and writes its file, if it needs one. Its arguments: the message, its place for
    error messages, the topic, and the path of the file without its ending."""
    detector: Callable[[RangeView, Camera | None], Detector]
    """Function that returns the detector for a view; its second argument is the intrinsics."""


def _cloud_view(message: Any, where: str, _: SensorTopic, stem: Path) -> RangeView:
    is_livox = message.__msgtype__ in LIVOX_TYPES
    points = livox_points(message, where) if is_livox else cloud_of(message, where)
    file = stem.with_name(f"{stem.name}.pcd")
    write_points(file, points)
    return RangeView(cloud_message(points), file)


def _scan_view(message: Any, where: str, _: SensorTopic, __: Path) -> RangeView:
    return RangeView(scan_message(message, where), None)


def _depth_view(message: Any, where: str, topic: SensorTopic, stem: Path) -> RangeView:
    depth, file = depth_of(message, where), stem.with_name(f"{stem.name}.png")
    height, width = depth.shape
    if (known := topic.camera) is not None and (known.width, known.height) != (width, height):
        raise InputError(
            f"{where}: found a depth image of {width} x {height} pixels, expected {known.width} x {known.height} as "
            f"camera_info has for '{topic.described.name}'"
        )
    write_atomically(file, encoded(depth))
    size = {"height": height, "width": width, "step": 2 * width}
    return RangeView({**size, "encoding": "16UC1", "is_bigendian": 0}, file)


def _depth_detector(view: RangeView, camera: Camera | None) -> Detector:
    if camera is None or view.file is None:
        raise AssertionError("a depth camera has intrinsics, and its images are files")
    return partial(label_depth, read_depth_image(view.file, camera).depth, camera)


RANGE_MODALITIES: Mapping[str, RangeModality] = {
    LIDAR3D.name: RangeModality(_cloud_view, lambda view, _: partial(label_points, view.points)),
    LIDAR2D.name: RangeModality(_scan_view, lambda view, _: partial(label_scan_line, view.points)),
    DEPTH.name: RangeModality(_depth_view, _depth_detector),
}
"""By the name of the modality."""


def cloud_of(message: Any, where: str) -> Array:
    """Convert a PointCloud2 to points (N, 3), in the order of its rows.

    Raises:
        InputError: it has no floating-point x, y, z, or its data are truncated.
    """
    if message.width * message.height > MAX_POINTS:
        raise InputError(f"{where}: found {message.width} x {message.height} points, expected {MAX_POINTS} at most")
    document = {key: int(getattr(message, key)) for key in ("point_step", "row_step", "height", "width")}
    fields = [{key: getattr(field, key) for key in ("name", "offset", "datatype")} for field in message.fields]
    data = base64.b64encode(bytes(message.data)).decode()
    whole = {**document, "fields": fields, "data": data, "is_bigendian": bool(message.is_bigendian)}
    return np.asarray(decode_message(Node(Path(where), (), whole)), float)


def livox_points(message: Any, where: str) -> Array:
    """Convert a CustomMsg of Livox's drivers to points (N, 3), m; NaN where there is no return, which it has as 0.

    Raises:
        InputError: it has too many points.
    """
    if len(message.points) > MAX_POINTS:
        raise InputError(f"{where}: found {len(message.points)} points, expected {MAX_POINTS} at most")
    points = np.array([(each.x, each.y, each.z) for each in message.points], float).reshape(-1, 3)
    points[~points.any(-1)] = np.nan
    return points


def cloud_message(points: Array) -> dict[str, Any]:
    """Return a dataset's message of a cloud (N, 3) in a separate file."""
    return {
        "fields": [{"name": axis, "offset": 4 * i, "datatype": 7, "count": 1} for i, axis in enumerate("xyz")],
        "height": 1,
        "is_bigendian": False,
        "is_dense": bool(np.isfinite(points).all()),
        "point_step": 12,
        "row_step": 12 * len(points),
        "width": len(points),
    }


def scan_message(message: Any, where: str) -> dict[str, Any]:
    """Convert a LaserScan to the dataset's form.

    Raises:
        InputError: it is invalid.
    """
    angles = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")
    values = {key: float(getattr(message, key)) for key in angles}
    document: dict[str, Any] = {key: value for key, value in values.items() if math.isfinite(value)}
    document["ranges"] = [float(r) if math.isfinite(r) else None for r in message.ranges.tolist()]
    document["intensities"] = []
    read_scan(Node(Path(where), (), document))
    return document


@dataclass(frozen=True, eq=False)
class LabelledRange:
    """Data of a LiDAR or a depth camera at one moment, and the patterns in them."""

    view: RangeView
    found: Mapping[str, PatternPoints | NotDetected]
    """Detected points of each pattern, or the reason why it is not detected."""


def labelled_ranges(
    views: Sequence[Mapping[str, RangeView]],
    moments: Sequence[LabelledMoment],
    configuration: Configuration,
    cameras: Mapping[str, Camera],
    transforms: Mapping[Edge, Array],
) -> list[dict[str, LabelledRange]]:
    """Detect the patterns in the data of every LiDAR and depth camera at N moments.

    Args:
        views: their data, by name.
        moments: the cameras' detections.
        configuration: the sensors and the patterns.
        cameras: the intrinsics, of depth cameras too.
        transforms: (N, 4, 4) of each edge, for the expected pose of a pattern that a camera detects.
    """
    tree = FrameTree(transforms)
    place = {
        name: compose(tree, transforms, configuration.world_link, sensor.link)
        for name, sensor in configuration.sensors.items()
    }
    labelled = []
    for i, (ranges, moment) in enumerate(zip(views, moments, strict=True)):
        guesses = {
            pattern: _seen_by_cameras(moment, pattern, configuration, cameras, {n: T[i] for n, T in place.items()})
            for pattern in configuration.patterns
        }
        labelled.append(
            {
                name: _label_range(name, view, guesses, configuration, place[name][i], cameras.get(name))
                for name, view in ranges.items()
            }
        )
    return labelled


def _seen_by_cameras(
    moment: LabelledMoment,
    pattern: str,
    configuration: Configuration,
    cameras: Mapping[str, Camera],
    place: Mapping[str, Array],
) -> Array | None:
    """Return ``T_world_pattern`` (4, 4) by the camera that sees most of it; None if none does."""
    views = {name: labels for name, view in moment.views.items() if (labels := view.found[pattern].labels) is not None}
    if not views:
        return None
    best = max(views, key=lambda name: len(views[name].ids))
    T = estimate_pose(cameras[best], configuration.patterns[pattern].pattern(), views[best])
    return place[best] @ T if np.isfinite(T).all() else None


def _label_range(
    name: str,
    view: RangeView,
    guesses: Mapping[str, Array | None],
    configuration: Configuration,
    T_world_sensor: Array,
    camera: Camera | None,
) -> LabelledRange:
    found: dict[str, PatternPoints | NotDetected] = {}
    detect = RANGE_MODALITIES[configuration.sensors[name].modality].detector(view, camera)
    for pattern, T_world_pattern in guesses.items():
        if T_world_pattern is None:
            found[pattern] = NotDetected("no camera sees it at that moment")
        else:
            own = configuration.patterns[pattern].pattern()
            found[pattern] = detect(own, inverse(T_world_sensor) @ T_world_pattern)
    return LabelledRange(view, found)
