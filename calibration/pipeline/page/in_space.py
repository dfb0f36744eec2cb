"""Part of the page: 3D view of the sensors, patterns, points of LiDARs and the robot's frames."""

from collections.abc import Iterator, Mapping

import numpy as np

from calibration.base import CalibrationError
from calibration.base.arrays import Array
from calibration.ci.pages.charts import thinned
from calibration.ci.pages.figures import Cloud, Kind, Line, scene
from calibration.ci.pages.html import Html, element, join
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.evaluation.label_errors import Residuals
from calibration.engine.geometry.transforms import apply

MAX_BOARDS = 30
"""Maximum number of collections that are drawn, evenly spaced."""
MAX_CLOUD_POINTS = 3000
"""Maximum number of points of a sensor that are drawn."""
MAX_RESIDUAL_IN_RMS = 3.0
"""Residual of a point from which its colour stays the same, as a multiple of the RMS."""
FRUSTUM_DEPTH = 0.06
"""Depth of a camera's frustum, and radius of a LiDAR's circle, as a fraction of the scene's size."""
MIN_SCENE_SIZE = 0.1
"""Minimum size of a scene, m."""
MIN_LINK = 1e-3
"""m: minimum distance of two frames that are connected by a line."""
MIN_MOTION = 1e-6
"""m: what moves less between collections is drawn once."""
KINDS = {
    "camera": Kind("blue", "cameras"),
    "range": Kind("violet", "LiDARs and depth cameras"),
    "pattern": Kind("orange", "the pattern, by collection", filled=True),
    "robot": Kind("green", "the robot's links"),
    "before": Kind("soft", "before the calibration", dashed=True),
    "accepted": Kind("amber", "as accepted", dashed=True),
    "cloud": Kind("violet", "points on it: blue ones fit, red ones are off by 3 times the RMS"),
    "x": Kind("red", ""),
    "y": Kind("green", ""),
    "z": Kind("blue", ""),
}


def in_space(
    dataset: Dataset,
    before: Dataset | None,
    accepted: Dataset | None = None,
    residuals: Mapping[str, Residuals] | None = None,
) -> Html:
    """Return the 3D view; empty if no pose is known.

    Args:
        dataset: calibrated; its first collection is drawn, and some of the others where a reader chooses them.
        before: the given dataset.
        accepted: the dataset with the accepted transforms, if they differ.
        residuals: residuals of the sensors, for the colours of points.
    """
    shown = thinned(len(dataset.collections), MAX_BOARDS).tolist()
    lines = list(_pattern_outlines(dataset))
    places = [T[0, :3, 3] for sensor in dataset.sensors.values() if (T := _poses(dataset, sensor.frame)) is not None]
    if not places:
        return Html("")
    everything = np.concatenate([np.stack(places), *(line.points for line in lines)])
    depth = FRUSTUM_DEPTH * max(float(np.linalg.norm(np.ptp(everything, axis=0))), MIN_SCENE_SIZE)
    lines += _links_of_frames(dataset, shown)
    for kind, other in (("before", before), ("accepted", accepted)):
        if other is not None:
            lines += _placed_sensors(other.with_collections([0]), [0], depth, kind)
    lines += _placed_sensors(dataset, shown, depth)
    lines += _axes(2 * depth)
    title = f"Sensors, patterns and links in the first of {len(dataset.collections)} collections"
    clouds = list(_clouds(dataset, residuals or {}))
    return join([element("h3", "In space"), scene(lines, title, KINDS, clouds, dataset.keys)])


def _poses(dataset: Dataset, frame: str) -> Array | None:
    """Return ``T_world_frame`` (N, 4, 4) in every collection; None if it is unknown in one."""
    try:
        T = dataset.transform(dataset.world, frame)
    except CalibrationError:
        return None
    return T if np.isfinite(T).all() else None


def _in_collections(outlines: Array, shown: list[int], kind: str, label: str = "") -> Iterator[Line]:
    """Yield a line (N, P, 3) once if it stays where it is, else as it is in each of some collections."""
    if np.ptp(outlines, axis=0).max() < MIN_MOTION:
        yield Line(outlines[0], kind, label)
    else:
        yield from (Line(outlines[i], kind, label, i, i == shown[0]) for i in shown)


def _placed_sensors(dataset: Dataset, shown: list[int], depth: float, kind: str | None = None) -> Iterator[Line]:
    """Yield the outlines of all sensors, with their axes and names unless another kind is given."""
    for sensor in dataset.sensors.values():
        if (T := _poses(dataset, sensor.frame)) is None:
            continue
        outline = _frustum_edges(sensor, depth) if sensor.camera else _lidar_circle(depth)
        own = "camera" if sensor.camera else "range"
        yield from _in_collections(apply(T, outline), shown, kind or own, "" if kind else sensor.name)
        if kind is None:
            for axis in _axes(depth):
                yield from _in_collections(apply(T, axis.points), shown, axis.class_)


def _axes(length: float) -> Iterator[Line]:
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        yield Line(np.stack([np.zeros(3), length * direction]), axis)


def _frustum_edges(sensor: Sensor, depth: float) -> Array:
    """Return a polyline (N, 3) along all edges of a camera's frustum, up to a depth."""
    camera = sensor.camera
    if camera is None:
        raise AssertionError(f"{sensor.name} has no intrinsics")
    x, y = 0.5 * camera.width / camera.fx * depth, 0.5 * camera.height / camera.fy * depth
    a, b, c, d = ((-x, -y, depth), (x, -y, depth), (x, y, depth), (-x, y, depth))
    centre = (0.0, 0.0, 0.0)
    return np.array([centre, a, b, c, d, a, centre, b, c, centre, d])


def _lidar_circle(radius: float) -> Array:
    angle = np.linspace(0, 2 * np.pi, 25)
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(25)], axis=-1)


def _pattern_outlines(dataset: Dataset) -> Iterator[Line]:
    """Yield the patterns' outlines in evenly spaced collections; one that stays where it is only once."""
    for pattern in dataset.patterns.values():
        seen = [i for i, each in enumerate(dataset.collections) if any(p == pattern.name for p, _ in each.labels)]
        (x0, y0, _), (x1, y1, _) = pattern.corners.min(axis=0), pattern.corners.max(axis=0)
        outline = np.array([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0), (x0, y0, 0)])
        found = {}
        for i in (seen[k] for k in thinned(len(seen), MAX_BOARDS)):
            if (T := _poses(dataset.with_collections([i]), pattern.link)) is not None:
                found[i] = apply(T[0], outline)
        if found and np.ptp(np.stack(list(found.values())), axis=0).max() < MIN_MOTION:
            yield Line(next(iter(found.values())), "pattern")
        else:
            yield from (Line(points, "pattern", collection=i) for i, points in found.items())


def _links_of_frames(dataset: Dataset, shown: list[int]) -> Iterator[Line]:
    """Yield lines between the origins of consecutive frames."""
    patterns = {pattern.link for pattern in dataset.patterns.values()}
    for parent, child in dataset.transforms:
        ends = [_poses(dataset, frame) for frame in (parent, child)]
        if child in patterns or ends[0] is None or ends[1] is None:
            continue
        lines = np.stack([ends[0][:, :3, 3], ends[1][:, :3, 3]], axis=1)
        if np.linalg.norm(lines[0, 1] - lines[0, 0]) > MIN_LINK:
            yield from _in_collections(lines, shown, "robot")


def _clouds(dataset: Dataset, residuals: Mapping[str, Residuals]) -> Iterator[Cloud]:
    """Yield the points of each sensor that measures them, by collection."""
    for name, of_sensor in residuals.items():
        T = _poses(dataset, dataset.sensors[name].frame)
        if T is None or of_sensor.values.shape[-1] != 1:
            continue
        sizes = of_sensor.sizes
        values = np.minimum(sizes / (MAX_RESIDUAL_IN_RMS * float(np.sqrt(np.mean(sizes**2))) or 1.0), 1.0)
        chosen = thinned(len(sizes), MAX_CLOUD_POINTS)
        for i in np.unique(of_sensor.collections[chosen]).tolist():
            own = chosen[of_sensor.collections[chosen] == i]
            yield Cloud(apply(T[i], of_sensor.where[own]), values[own], "cloud", i)
