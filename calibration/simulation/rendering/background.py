"""Background of a camera's image, without patterns: ground, boxes and sky.

Colours are blue, green, red, in grey levels before the camera's exposure.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import apply, inverse
from calibration.geometry.types import Array, BoolArray, IntArray
from calibration.simulation.rendering.rays import SAMPLES, TILE, cones, rays, sample_rays
from calibration.simulation.scene import GROUND, NOTHING, Box, Scene, turned

STEPS = 64
"""Radiance steps per grey level: images have 16 bits until the camera's exposure."""

_TILE = 0.5
"""Size of the ground's tiles, m."""
_TILE_CONTRAST = 0.05
_GROUND = (124.0, 128.0, 130.0)
_HORIZON, _ZENITH = np.array([196.0, 192.0, 188.0]), np.array([188.0, 170.0, 152.0])
_EDGE = 6
"""Pixels that differ from a neighbour by more grey levels are supersampled."""
_PART = 16_000
"""Number of rays per batch, which fit into the cache."""


@dataclass(frozen=True, eq=False)
class Background:
    """Rendered background."""

    radiance: NDArray[np.uint16]
    """(height, width, 3): blue, green, red, in `STEPS` of a grey level."""
    depth: Array
    """(height, width): depth along the optical axis at each pixel's centre, m; infinite for the sky."""


def background(camera: Camera, T_world_camera: Array, scene: Scene) -> Background:
    """Render the scene for a camera; cached for a camera at rest."""
    return _background(camera, np.ascontiguousarray(T_world_camera, float).tobytes(), scene)


@lru_cache(maxsize=8)
def _background(camera: Camera, pose: bytes, scene: Scene) -> Background:
    T_world_camera = np.frombuffer(pose).reshape(4, 4)
    directions, axes, sines = rays(camera)[:, 1:-1, 1:-1], *cones(camera)
    near = scene.near(T_world_camera[:3, 3], axes @ T_world_camera[:3, :3].T, sines)
    colour, depth = np.empty((*directions.shape[1:], 3), np.float32), np.empty(directions.shape[1:])
    for row, tiles in zip(range(0, camera.height, TILE[0]), near.swapaxes(0, 1), strict=True):
        part = slice(row, row + TILE[0])
        colour[part], depth[part] = _seen(scene, T_world_camera, directions[:, part], list(map(_columns, tiles)))
    rows, columns = np.nonzero(_uneven(colour))
    step = _PART // SAMPLES
    for first in range(0, len(rows), step):
        where = rows[first : first + step], columns[first : first + step]
        there = [(np.flatnonzero(each),) for each in near[:, where[0] // TILE[0], where[1] // TILE[1]]]
        colour[where] = _seen(scene, T_world_camera, sample_rays(camera, *where), there)[0].mean(axis=1)
    radiance = in_steps(colour)
    for array in (radiance, depth):
        array.flags.writeable = False
    return Background(radiance, depth)


def in_steps(levels: Array | NDArray[np.float32]) -> NDArray[np.uint16]:
    """Convert grey levels to `STEPS` per level, rounded."""
    steps: NDArray[np.uint16] = np.rint(np.clip(levels * STEPS, 0, 65535)).astype(np.uint16)
    return steps


def _uneven(colour: NDArray[np.float32]) -> BoolArray:
    """Return a mask (H, W) of the pixels that differ from one of their eight neighbours."""
    image, square = np.clip(colour, 0, 255).astype(np.uint8), np.ones((3, 3), np.uint8)
    differences = np.asarray(cv2.morphologyEx(image, cv2.MORPH_GRADIENT, square))
    blue, green, red = np.moveaxis(differences > _EDGE, -1, 0)
    return np.asarray(blue | green | red)


def _columns(tiles: BoolArray) -> tuple[slice, slice]:
    """Index of the columns of a row of tiles between the first and the last that are set."""
    set_ = np.flatnonzero(tiles)
    return slice(None), slice(set_[0] * TILE[1], (set_[-1] + 1) * TILE[1]) if len(set_) else slice(0)


def _seen(scene: Scene, T_world_camera: Array, directions: Array, near: Sequence[Any]) -> tuple[Array, Array]:
    origin, world = T_world_camera[:3, 3], turned(T_world_camera, directions)
    distance, surface = scene.hit(origin, world, near)
    return colours(scene, origin, world, distance, surface), distance


def colours(scene: Scene, origin: Array, directions: Array, distance: Array, surface: IntArray) -> Array:
    """Return the colours (..., 3) seen along rays.

    Args:
        scene: the scene.
        origin: (3,), origin of the rays, in the world frame.
        directions: (3, ...), in the world frame; those with NaN are black.
        distance: (...), and ``surface`` (...): the result of `Scene.hit`.
        surface: see distance.
    """
    flat, rays_, distances = surface.ravel(), directions.reshape(3, -1), distance.ravel()
    seen = np.empty((len(flat), 3))
    for index in range(NOTHING, len(scene.boxes)):
        where = np.flatnonzero(flat == index)
        if not len(where):
            continue
        only = _only_face(scene, scene.boxes[index], origin) if index >= 0 else None
        if only is not None:
            seen[where] = only
            continue
        there, away = rays_.take(where, axis=1), distances[where]
        if index == NOTHING:
            seen[where] = _sky(scene, there)
        elif index == GROUND:
            seen[where] = _ground(scene, origin[:, None] + away * there, away)
        else:
            seen[where] = _box(scene, scene.boxes[index], origin, away, there)
    return seen.reshape(*surface.shape, 3)


def _sky(scene: Scene, directions: Array) -> Array:
    """Return the sky's colour: lighter at the horizon, scaled by the light."""
    x, y, z = directions
    height = np.clip(z / np.sqrt(x * x + y * y + z * z), 0, 1)[..., None]
    brightness = (scene.light.ambient + scene.light.intensity / 2) / 0.925  # 1 for the usual light
    colour: Array = np.nan_to_num((_HORIZON + (_ZENITH - _HORIZON) * height) * brightness)
    return colour


def _ground(scene: Scene, points: Array, distance: Array) -> Array:
    """Return the ground's colour: tiles of slightly different brightness, uniform at a distance."""
    column, row = np.floor(np.clip(points[:2] / _TILE, -1e6, 1e6)).astype(np.int64)
    mixed = ((column * 73856093) ^ (row * 19349663)) * 2654435761  # hash of the tile's indices
    shade = (mixed >> 20) % 251 / 125 - 1
    brightness = 1 + _TILE_CONTRAST * shade / (1 + (distance / 10) ** 2)
    colour: Array = (brightness * scene.light.on(np.array([0.0, 0.0, 1.0])))[..., None] * np.array(_GROUND)
    return colour


def _box(scene: Scene, box: Box, origin: Array, distance: Array, directions: Array) -> Array:
    """Return a box's colour, one per face. The face that is hit is the one whose plane is closest to the point."""
    T_box_world = inverse(box.T_world_box)
    along = turned(T_box_world, directions)
    points = apply(T_box_world, origin[None]).T + distance * along
    x, y, z = np.abs(points) / (box.size[:, None] / 2)
    first, second = (x >= y) & (x >= z), y >= z
    axis = np.where(first, 0, np.where(second, 1, 2))
    towards = -np.sign(np.where(first, along[0], np.where(second, along[1], along[2])))  # also inside, to the viewer
    colour: Array = _faces(scene, box).take(3 * axis + 1 + towards.astype(np.int64), axis=0)
    return colour


def _only_face(scene: Scene, box: Box, origin: Array) -> Array | None:
    """Return the colour (3,) of the only face of a box that is visible from a point; None if others are too."""
    place = apply(inverse(box.T_world_box), origin[None])[0]
    (outside,) = np.nonzero(np.abs(place) > box.size / 2)
    if len(outside) != 1:
        return None
    colour: Array = _faces(scene, box)[3 * outside[0] + 1 + int(np.sign(place[outside[0]]))]
    return colour


def _faces(scene: Scene, box: Box) -> Array:
    """Return the colours (9, 3) of the faces, for each axis of the box with a normal along -1, 0 and 1."""
    signs = np.array([-1.0, 0.0, 1.0])
    light = scene.light.on(box.T_world_box[:3, :3].T[:, None] * signs[:, None])
    found: Array = light.reshape(-1, 1) * np.array(box.colour[::-1])
    return found
