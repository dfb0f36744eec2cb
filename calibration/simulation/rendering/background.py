"""What a camera sees of a scene without its patterns: the ground, boxes, the sky.

Colours are blue, green, red, in grey levels before the camera's exposure.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array, BoolArray, IntArray
from calibration.simulation.rendering.rays import SAMPLES, rays, sample_rays
from calibration.simulation.scene import GROUND, NOTHING, Box, Scene, turned

STEPS = 64
"""Of radiance in a grey level: images are kept in 16 bits until the camera takes them."""

_TILE = 0.5
"""The ground's tiles, m."""
_TILE_CONTRAST = 0.05
_GROUND = (124.0, 128.0, 130.0)
_HORIZON, _ZENITH = np.array([196.0, 192.0, 188.0]), np.array([188.0, 170.0, 152.0])
_EDGE = 6
"""Neighbours that differ by more grey levels are sampled more finely."""
_PART = 16_000
"""So many rays are followed at a time: they stay in the cache."""


@dataclass(frozen=True, eq=False)
class Background:
    """A scene, drawn."""

    radiance: NDArray[np.uint16]
    """(height, width, 3): blue, green, red, in `STEPS` of a grey level."""
    depth: Array
    """(height, width): of what each pixel's centre sees, m along the optical axis; infinite for the sky."""


def background(camera: Camera, T_world_camera: Array, scene: Scene) -> Background:
    """A scene as a camera sees it; drawn once for a camera that stands still."""
    return _background(camera, np.ascontiguousarray(T_world_camera, float).tobytes(), scene)


@lru_cache(maxsize=8)
def _background(camera: Camera, pose: bytes, scene: Scene) -> Background:
    T_world_camera = np.frombuffer(pose).reshape(4, 4)
    directions = rays(camera)[:, 1:-1, 1:-1]
    colour, depth = np.empty((*directions.shape[1:], 3), np.float32), np.empty(directions.shape[1:])
    step = max(1, _PART // camera.width)
    for row in range(0, camera.height, step):
        part = slice(row, row + step)
        colour[part], depth[part] = _seen(scene, T_world_camera, directions[:, part])
    rows, columns = np.nonzero(_uneven(colour))
    step = _PART // SAMPLES
    for first in range(0, len(rows), step):
        where = rows[first : first + step], columns[first : first + step]
        colour[where] = _seen(scene, T_world_camera, sample_rays(camera, *where))[0].mean(axis=1)
    radiance = in_steps(colour)
    for array in (radiance, depth):
        array.flags.writeable = False
    return Background(radiance, depth)


def in_steps(levels: Array | NDArray[np.float32]) -> NDArray[np.uint16]:
    """Grey levels in `STEPS` of one, rounded."""
    steps: NDArray[np.uint16] = np.rint(np.clip(levels * STEPS, 0, 65535)).astype(np.uint16)
    return steps


def _uneven(colour: NDArray[np.float32]) -> BoolArray:
    """The pixels (H, W) that differ from one of the eight around them."""
    image, square = np.clip(colour, 0, 255).astype(np.uint8), np.ones((3, 3), np.uint8)
    differences = np.asarray(cv2.morphologyEx(image, cv2.MORPH_GRADIENT, square))
    return np.asarray((differences > _EDGE).any(axis=-1))


def _seen(scene: Scene, T_world_camera: Array, directions: Array) -> tuple[Array, Array]:
    origin, world = T_world_camera[:3, 3], turned(T_world_camera, directions)
    distance, surface = scene.hit(origin, world)
    return colours(scene, origin, world, distance, surface), distance


def colours(scene: Scene, origin: Array, directions: Array, distance: Array, surface: IntArray) -> Array:
    """The colours (..., 3) that rays bring back.

    Args:
        scene: what they hit.
        origin: (3,), where they start, in the world frame.
        directions: (3, ...), in the world frame; those with NaN are black.
        distance: (...), and ``surface`` (...): what `Scene.hit` says of them.
        surface: see distance.
    """
    seen = np.empty((*surface.shape, 3))
    for index in np.unique(surface):
        mask = surface == index
        distances, rays_there = distance[mask], directions[:, mask]
        if index == NOTHING:
            seen[mask] = _sky(scene, rays_there)
        elif index == GROUND:
            seen[mask] = _ground(scene, origin[:, None] + distances * rays_there, distances)
        else:
            seen[mask] = _box(scene, scene.boxes[index], origin, distances, rays_there)
    return seen


def _sky(scene: Scene, directions: Array) -> Array:
    """Lighter at the horizon; as bright as the light is."""
    x, y, z = directions
    height = np.clip(z / np.sqrt(x * x + y * y + z * z), 0, 1)[..., None]
    brightness = (scene.light.ambient + scene.light.intensity / 2) / 0.925  # 1 for the usual light
    colour: Array = np.nan_to_num((_HORIZON + (_ZENITH - _HORIZON) * height) * brightness)
    return colour


def _ground(scene: Scene, points: Array, distance: Array) -> Array:
    """Tiles, each a little lighter or darker; all the same where they are far."""
    column, row = np.floor(np.clip(points[:2] / _TILE, -1e6, 1e6)).astype(np.int64)
    mixed = ((column * 73856093) ^ (row * 19349663)) * 2654435761  # an arbitrary but fixed number for each tile
    shade = (mixed >> 20) % 251 / 125 - 1
    brightness = 1 + _TILE_CONTRAST * shade / (1 + (distance / 10) ** 2)
    colour: Array = (brightness * scene.light.on(np.array([0.0, 0.0, 1.0])))[..., None] * np.array(_GROUND)
    return colour


def _box(scene: Scene, box: Box, origin: Array, distance: Array, directions: Array) -> Array:
    """One colour a face. The face that is hit is the one whose plane the point is nearest to."""
    T_box_world = inverse(box.T_world_box)
    along = turned(T_box_world, directions)
    points = apply(T_box_world, origin[None]).T + distance * along
    axis = (np.abs(points) / (box.size[:, None] / 2)).argmax(axis=0)
    towards = -np.sign(np.take_along_axis(along, axis[None], 0)[0])  # also inside, the normal is towards the viewer
    light = scene.light.on(box.T_world_box[:3, :3].T[axis] * towards[:, None])
    colour: Array = light[:, None] * np.array(box.colour[::-1])
    return colour
