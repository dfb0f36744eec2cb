"""Part of the page: 3D view of the sensors, patterns and the robot's frames."""

from collections.abc import Iterator

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import CalibrationError
from calibration.ci.pages.charts import thinned
from calibration.ci.pages.html import Html, element, join
from calibration.ci.pages.scene import Line, scene
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.geometry.transforms import apply

MAX_BOARDS = 30
FRUSTUM_DEPTH = 0.06
"""Depth of a camera's frustum, and radius of a LiDAR's circle, as a fraction of the scene's size."""
MIN_SCENE_SIZE = 0.1
"""Minimum size of a scene, m."""
MIN_LINK = 1e-3
"""m: minimum distance of two frames that are connected by a line."""
LINE_KINDS = {
    "camera": ("blue", "cameras"),
    "range": ("violet", "LiDARs and depth cameras"),
    "pattern": ("orange", "the pattern, by collection"),
    "robot": ("green", "the robot's links"),
    "before": ("soft", "before the calibration"),
}
"""Colours and legends of the lines."""


def in_space(dataset: Dataset, before: Dataset | None) -> Html:
    """Return the 3D view; empty if no pose is known.

    Args:
        dataset: calibrated; its first collection is drawn, and the patterns of some of the others.
        before: the given dataset.
    """
    first = dataset.with_collections([0])
    lines = [Line(outline, "pattern") for outline in _pattern_outlines(dataset)]
    places = [T[:3, 3] for sensor in dataset.sensors.values() if (T := _pose_in_world(first, sensor.frame)) is not None]
    if not places:
        return Html("")
    everything = np.concatenate([np.stack(places), *(line.points for line in lines)])
    depth = FRUSTUM_DEPTH * max(float(np.linalg.norm(np.ptp(everything, axis=0))), MIN_SCENE_SIZE)
    lines += [Line(link, "robot") for link in _links_of_frames(first)]
    lines += (
        [Line(outline, "before") for _, outline in _placed_sensors(before.with_collections([0]), depth)]
        if before
        else []
    )
    lines += [
        Line(outline, "range" if sensor.camera is None else "camera", sensor.name)
        for sensor, outline in _placed_sensors(first, depth)
    ]
    title = f"Sensors, patterns and links in the first of {len(dataset.collections)} collections"
    return join([element("h3", "In space"), element("figure", scene(lines, title), _colour_legend(lines))])


def _colour_legend(lines: list[Line]) -> Html:
    used = {line.class_ for line in lines}
    entries = [
        element("span", element("i", style=f"border-color: var(--{colour})"), words)
        for kind, (colour, words) in LINE_KINDS.items()
        if kind in used
    ]
    return element("figcaption", *entries, class_="legend")


def _pose_in_world(first: Dataset, frame: str) -> Array | None:
    """Return ``T_world_frame`` (4, 4) in a dataset's only collection; None if it is unknown."""
    try:
        T = first.transform(first.world, frame)[0]
    except CalibrationError:
        return None
    return T if np.isfinite(T).all() else None


def _placed_sensors(first: Dataset, depth: float) -> Iterator[tuple[Sensor, Array]]:
    for sensor in first.sensors.values():
        if (T := _pose_in_world(first, sensor.frame)) is not None:
            yield sensor, apply(T, _frustum_edges(sensor, depth) if sensor.camera else _lidar_circle(depth))


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


def _pattern_outlines(dataset: Dataset) -> Iterator[Array]:
    """Iterate over the patterns' outlines in evenly spaced collections; a fixed one only once."""
    for pattern in dataset.patterns.values():
        seen = [i for i, each in enumerate(dataset.collections) if any(p == pattern.name for p, _ in each.labels)]
        chosen = [seen[k] for k in thinned(len(seen), MAX_BOARDS)]
        (x0, y0, _), (x1, y1, _) = pattern.corners.min(axis=0), pattern.corners.max(axis=0)
        outline = np.array([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0), (x0, y0, 0)])
        for i in chosen:
            if (T := _pose_in_world(dataset.with_collections([i]), pattern.link)) is not None:
                yield apply(T, outline)


def _links_of_frames(first: Dataset) -> Iterator[Array]:
    """Iterate over the origins (2, 3) of consecutive frames."""
    patterns = {pattern.link for pattern in first.patterns.values()}
    for parent, child in first.transforms:
        ends = [_pose_in_world(first, frame) for frame in (parent, child)]
        if child in patterns or ends[0] is None or ends[1] is None:
            continue
        if np.linalg.norm(ends[1][:3, 3] - ends[0][:3, 3]) > MIN_LINK:
            yield np.stack([ends[0][:3, 3], ends[1][:3, 3]])
