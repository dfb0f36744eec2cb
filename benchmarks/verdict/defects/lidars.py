"""LiDARs that measure otherwise than they should."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.verdict.defects.cameras import one_of
from benchmarks.verdict.scene import Scene
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Labels, PointLabels
from calibration.engine.geometry.transforms import apply, inverse

Change = Callable[[Array, int], Array]


def _mapped(scene: Scene, sensor: str, change: Change) -> Scene:
    def moved(i: int, name: str, labels: Labels) -> Labels:
        if name != sensor or not isinstance(labels, PointLabels):
            return labels
        return replace(labels, points=change(labels.points, i))

    return scene.labelled(moved)


def range_bias(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Lengthen all ranges by a distance, m."""
    return _mapped(scene, one_of(scene.lidars, rng), lambda p, _: p * (1 + size / _ranges(p)))


def range_scale(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Lengthen all ranges by a share."""
    return _mapped(scene, one_of(scene.lidars, rng), lambda p, _: p * (1 + size))


def range_drift(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Ranges that grow as the LiDAR becomes warm, m from the first collection to the last."""
    last = max(1, len(scene.told.collections) - 1)
    return _mapped(scene, one_of(scene.lidars, rng), lambda p, i: p * (1 + size * (i / last) / _ranges(p)))


def intensity_bias(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Black squares that are measured farther away than white ones, m."""
    sensor, corners = one_of(scene.lidars, rng), scene.pattern.corners
    square = np.linalg.norm(corners[1] - corners[0])

    def farther(points: Array, i: int) -> Array:
        places = (apply(inverse(scene.pose(sensor)[i]), points) - corners[0])[:, :2] / square
        black = np.floor(places).sum(1, keepdims=True) % 2
        moved: Array = points * (1 + size * black / _ranges(points))
        return moved

    return _mapped(scene, sensor, farther)


def _turned(points: Array, azimuth: Array) -> Array:
    """Points (N, 3) at other azimuths (N,)."""
    flat = np.linalg.norm(points[:, :2], axis=-1)
    turned: Array = np.c_[flat * np.cos(azimuth), flat * np.sin(azimuth), points[:, 2]]
    return turned


def azimuth_scale(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """An angle between beams that is told too great by a share."""
    return _mapped(scene, one_of(scene.lidars, rng), lambda p, _: _turned(p, np.arctan2(p[:, 1], p[:, 0]) * (1 + size)))


def deskewed(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Points that are deskewed for a drive of so many metres a turn, while the robot stands."""
    angle = rng.uniform(0, 2 * np.pi)
    way = size * np.array([np.cos(angle), np.sin(angle), 0.0])
    return _mapped(
        scene, one_of(scene.lidars, rng), lambda p, _: p + np.outer(np.arctan2(p[:, 1], p[:, 0]) / (2 * np.pi), way)
    )


def ring_angles(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Elevations of the rings, each off by other degrees; rings lie a degree apart at least."""
    errors = np.radians(rng.normal(0, size, 181))

    def bent(points: Array, _: int) -> Array:
        flat, ranges = np.linalg.norm(points[:, :2], axis=-1), _ranges(points)[:, 0]
        elevation = np.arctan2(points[:, 2], flat)
        elevation += errors[np.round(np.degrees(elevation)).astype(int) + 90]
        moved: Array = np.c_[points[:, :2] * (ranges * np.cos(elevation) / flat)[:, None], ranges * np.sin(elevation)]
        return moved

    return _mapped(scene, one_of(scene.lidars, rng), bent)


def tilt(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Elevations of all rings too high, degrees: the rings are cones about z."""

    def raised(points: Array, _: int) -> Array:
        flat = np.linalg.norm(points[:, :2], axis=-1)
        elevation = np.arctan2(points[:, 2], flat) + np.radians(size)
        ranges = _ranges(points)[:, 0]
        moved: Array = np.c_[points[:, :2] * (ranges * np.cos(elevation) / flat)[:, None], ranges * np.sin(elevation)]
        return moved

    return _mapped(scene, one_of(scene.lidars, rng), raised)


def noise(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Ranges that scatter, m."""
    return _mapped(
        scene, one_of(scene.lidars, rng), lambda p, _: p * (1 + rng.normal(0, size, (len(p), 1)) / _ranges(p))
    )


def background(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """A share of the points lies on something behind the pattern."""

    def mixed(points: Array, _: int) -> Array:
        wrong = rng.random((len(points), 1)) < size
        return points * (1 + wrong * rng.uniform(0.1, 0.6, wrong.shape) / _ranges(points))

    return _mapped(scene, one_of(scene.lidars, rng), mixed)


def skew_in_time(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """The pattern moves by so much (m) while a scan goes over it, a direction in each collection."""
    sensor = one_of(scene.lidars, rng)
    ways = rng.normal(size=(len(scene.told.collections), 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)

    def smeared(points: Array, i: int) -> Array:
        azimuth = np.arctan2(points[:, 1], points[:, 0])
        share = (azimuth - azimuth.min()) / max(1e-9, np.ptp(azimuth))
        T = scene.pose(sensor)[i]
        normal = T[:3, 2]
        along = share * size * float(ways[i] @ normal)  # only what moves along the normal changes a range
        rays = points / _ranges(points)
        moved: Array = points + rays * (along / (rays @ normal))[:, None]
        return moved

    return _mapped(scene, sensor, smeared)


def axes(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """1: y points the other way (a mirrored scan), 2: x and y exchanged, 3: z points down."""
    change = {1: np.diag([1.0, -1, 1]), 2: np.eye(3)[[1, 0, 2]], 3: np.diag([1.0, 1, -1])}[int(size)]
    return _mapped(scene, one_of(scene.lidars, rng), lambda p, _: p @ change.T)


def other_frame(scene: Scene, size: float, rng: np.random.Generator) -> Scene:
    """Points that were brought to the camera's frame already by an old calibration, for a share of the collections."""
    sensor = one_of(scene.lidars, rng)
    camera = scene.world.sensors[scene.cameras[0]].frame
    T = scene.world.transform(camera, scene.world.sensors[sensor].frame)
    wrong = rng.random(len(T)) < size
    return _mapped(scene, sensor, lambda p, i: apply(T[i], p) if wrong[i] else p)


def _ranges(points: Array) -> Array:
    ranges: Array = np.linalg.norm(points, axis=-1, keepdims=True)
    return ranges
