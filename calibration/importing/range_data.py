"""Clouds, scans and depth images of a recording, and detection of the pattern that a camera sees at the same moment."""

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from calibration.dataset.configuration import Configuration
from calibration.dataset.depth_image import read_depth_image
from calibration.dataset.document import Node
from calibration.dataset.laser_scan import read_scan
from calibration.dataset.model import Edge
from calibration.dataset.pattern import Pattern
from calibration.dataset.pointcloud import decode_message, read_points
from calibration.errors import InputError
from calibration.geometry.cameras import Camera
from calibration.geometry.frames import FrameTree
from calibration.geometry.transforms import inverse
from calibration.geometry.types import Array
from calibration.importing.looking import LabelledMoment
from calibration.labelling.depth import label_depth
from calibration.labelling.detection import NotDetected
from calibration.labelling.points import PatternPoints, label_points
from calibration.labelling.scan_line import label_scan_line
from calibration.simulation.collection.capture import estimate_pose
from calibration.simulation.robot import compose

MAX_POINTS = 20_000_000
"""Limit of the points of one cloud."""


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


@dataclass(frozen=True, eq=False)
class LabelledRange:
    """Data of a LiDAR or a depth camera at one moment, and the patterns in them."""

    view: RangeView
    found: Mapping[str, PatternPoints | NotDetected]
    """Detected points of each pattern, or the reason why it is not detected."""


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
                name: _labelled(name, view, guesses, configuration, place[name][i], cameras.get(name))
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


def _labelled(
    name: str,
    view: RangeView,
    guesses: Mapping[str, Array | None],
    configuration: Configuration,
    T_world_sensor: Array,
    camera: Camera | None,
) -> LabelledRange:
    found: dict[str, PatternPoints | NotDetected] = {}
    label = _labelling(configuration.sensors[name].modality, view, camera)
    for pattern, T_world_pattern in guesses.items():
        if T_world_pattern is None:
            found[pattern] = NotDetected("no camera sees it at that moment")
        else:
            own = configuration.patterns[pattern].pattern()
            found[pattern] = label(own, inverse(T_world_sensor) @ T_world_pattern)
    return LabelledRange(view, found)


def _labelling(
    modality: str, view: RangeView, camera: Camera | None
) -> Callable[[Pattern, Array], PatternPoints | NotDetected]:
    """Return the function that detects a pattern in a sensor's data, from its geometry and expected pose."""
    if modality != "depth":
        return partial(label_points if modality == "lidar3d" else label_scan_line, view.points)
    if camera is None or view.file is None:
        raise AssertionError("a depth camera has intrinsics, and its images are files")
    return partial(label_depth, read_depth_image(view.file, camera).depth, camera)
