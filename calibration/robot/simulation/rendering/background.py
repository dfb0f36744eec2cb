"""Rays of a camera's pixels, and the background of its image, without patterns: ground, boxes and sky.

Every pixel's ray is intersected with the scene, and a pixel that differs from a neighbour is averaged over samples of
it. Colours are blue, green, red, in grey levels before the camera's exposure.
"""

from collections.abc import Iterator
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses.model import IN_FRONT
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.simulation.scene import GROUND_SURFACE, NO_SURFACE, Box, Scene, turned

SAMPLES_PER_PIXEL = 16
"""Number of samples of a pixel that sees several surfaces."""
_SAMPLE_OFFSETS = [
    ((i + 0.5) / SAMPLES_PER_PIXEL - 0.5, (int(f"{i:04b}"[::-1], 2) + 0.5) / SAMPLES_PER_PIXEL - 0.5)
    for i in range(SAMPLES_PER_PIXEL)
]
"""(y, x) of the samples from the pixel's centre, px: J. M. Hammersley's points (1960). No two share one of 16 rows
or columns, so an edge along an axis is found to 1/16 px."""


@lru_cache(maxsize=8)
def rays(camera: Camera) -> Array:
    """Return the rays (3, height + 2, width + 2) of all pixels, with a margin of one on every side.

    With the margin every pixel of the image has differences to both neighbours. A ray to the front is (x, y, 1), so
    that the distance along it is the depth along the optical axis. Others, of a lens of more than 180 degrees, have the
    length 1. NaN where the distortion has no inverse.
    """
    v, u = np.mgrid[-1 : camera.height + 1, -1 : camera.width + 1].astype(float)
    found = _camera_rays(camera, u, v)
    found.flags.writeable = False
    return found


def sample_rays(camera: Camera, rows: IntArray, columns: IntArray) -> Array:
    """Return the rays (3, SAMPLES, N) of the samples of N pixels."""
    dv, du = np.array(_SAMPLE_OFFSETS).T[..., None]
    return _camera_rays(camera, columns + du, rows + dv)


def _camera_rays(camera: Camera, u: Array, v: Array) -> Array:
    chart = camera.distortion.chart
    found = chart.rays(*camera.from_pixels(u, v))
    return found if chart is IN_FRONT else np.asarray(found / np.where(found[2] > 0, found[2], 1.0))


def rounded(T: Array) -> Array:
    """Round a pose (4, 4) to a picometre, so that rounding errors of the arithmetic have no effect on an image."""
    return np.round(T, 12)


_TILE_SIZE_M = 0.5
"""Size of the ground's tiles, m; a power of two, so that its inverse is exact."""
_TILE_CONTRAST = 0.05
_GROUND_COLOUR = (124.0, 128.0, 130.0)
_HORIZON_COLOUR, _ZENITH_COLOUR = np.array([196.0, 192.0, 188.0]), np.array([188.0, 170.0, 152.0])


def colours(
    scene: Scene, origin: Array, directions: Array, distance: Array, surface: NDArray[np.integer[Any]]
) -> Array:
    """Return the colours (3, N) seen along rays.

    Args:
        scene: the scene.
        origin: (3,), origin of the rays, in the world frame.
        directions: (3, N), in the world frame; those with NaN are black.
        distance: (N,), and ``surface`` (N,): the result of `Scene.hit`.
        surface: see distance.
    """
    seen = np.empty((3, len(surface)))
    for index in range(NO_SURFACE, len(scene.boxes)):
        (where,) = np.nonzero(surface == index)
        if not len(where):
            continue
        there, away = directions.take(where, axis=1), distance[where]
        if index == NO_SURFACE:
            seen[:, where] = sky_colours(scene, there)
        elif index == GROUND_SURFACE:
            seen[:, where] = ground_colours(scene, origin, there, away)
        else:
            seen[:, where] = _box_colours(scene, scene.boxes[index], origin, there, away)
    return seen


def sky_colours(scene: Scene, directions: Array) -> Array:
    """Return the sky's colours (3, N): lighter at the horizon, scaled by the light."""
    x, y, z = directions
    height = np.clip(z / np.sqrt(x * x + y * y + z * z), 0, 1)
    brightness = (scene.light.ambient + scene.light.intensity / 2) / 0.925  # 1 for the usual light
    colour: Array = (_ZENITH_COLOUR - _HORIZON_COLOUR)[:, None] * height
    colour += _HORIZON_COLOUR[:, None]
    colour *= brightness
    colour[:, np.isnan(height)] = 0
    return colour


def ground_colours(scene: Scene, origin: Array, directions: Array, distance: Array) -> Array:
    """Return the ground's colours (3, N): tiles of slightly different brightness, uniform at a distance."""
    brightness = _shade_of_tile(*(_tile_indices(origin[axis], directions[axis], distance) for axis in range(2)))
    brightness *= _TILE_CONTRAST
    fading = distance / 10
    fading *= fading
    fading += 1
    brightness /= fading
    brightness += 1
    brightness *= scene.light.on(np.array([0.0, 0.0, 1.0]))
    return np.asarray(brightness * np.array(_GROUND_COLOUR)[:, None])


def _tile_indices(start: float, directions: Array, distance: Array) -> IntArray:
    """Return the indices (N,) of the tiles along an axis of the world, limited to a million."""
    place = distance * directions
    place += start
    place *= 1 / _TILE_SIZE_M
    np.clip(place, -1e6, 1e6, out=place)
    return np.floor(place, out=place).astype(np.int64)


def _shade_of_tile(column: IntArray, row: IntArray) -> Array:
    mixed = ((column * 73856093) ^ (row * 19349663)) * 2654435761  # hash of the tile's indices
    return (mixed >> 20) % 251 / 125 - 1


def _box_colours(scene: Scene, box: Box, origin: Array, directions: Array, distance: Array) -> Array:
    """Return a box's colours (3, N), one per face. The face that is hit is that whose plane is closest to the point."""
    T_box_world = inverse(box.T_world_box)
    along = turned(T_box_world, directions)
    points = apply(T_box_world, origin[None]).T + distance * along
    x, y, z = np.abs(points) / (box.size[:, None] / 2)
    first, second = (x >= y) & (x >= z), y >= z
    axis = np.where(first, 0, np.where(second, 1, 2))
    towards = -np.sign(np.where(first, along[0], np.where(second, along[1], along[2])))  # also inside, to the viewer
    return np.asarray(face_colours(scene, box).take(3 * axis + 1 + towards.astype(np.int64), axis=1))


def face_colours(scene: Scene, box: Box) -> Array:
    """Return the colours (3, 9) of a box's faces, for each of its axes with a normal along -1, 0 and 1."""
    signs = np.array([-1.0, 0.0, 1.0])
    light = scene.light.on(box.T_world_box[:3, :3].T[:, None] * signs[:, None])
    return np.array(box.colour[::-1])[:, None] * light.reshape(-1)


STEPS_PER_GREY_LEVEL = 64
"""Radiance steps per grey level: images have 16 bits until the camera's exposure."""

_MAX_GREY_DIFFERENCE = 6
"""Pixels that differ from a neighbour by more grey levels are supersampled."""
_ROWS_PER_BATCH = 48
"""Number of rows of an image per batch, whose rays fit into the cache."""
_PIXELS_PER_BATCH = 3000
"""Number of pixels that are supersampled at once. A lens is inverted by iterations that end for all of them at once, so
the last bits of a ray depend on it."""


class Background:
    """Background of a camera's image at a pose. Its images are rendered when they are asked for."""

    def __init__(self, camera: Camera, T_world_camera: Array, scene: Scene) -> None:
        self._camera, self._T_world_camera, self._scene = camera, T_world_camera, scene

    def _row_batches(self) -> Iterator[tuple[slice, Array]]:
        """Yield rows of the image, and the rays (3, rows, width) of their pixels in the world frame."""
        pixels = rays(self._camera)[:, 1:-1, 1:-1]
        for row in range(0, self._camera.height, _ROWS_PER_BATCH):
            rows = slice(row, min(row + _ROWS_PER_BATCH, self._camera.height))
            yield rows, turned(self._T_world_camera, pixels[:, rows])

    @cached_property
    def _hits(self) -> tuple[Array, NDArray[np.int16]]:
        """(height, width): distances along the rays of all pixels, and surfaces; see `Scene.hit`."""
        distance = np.empty((self._camera.height, self._camera.width))
        surface = np.empty(distance.shape, np.int16)
        for rows, world in self._row_batches():
            distance[rows], surface[rows] = self._scene.hit(self._T_world_camera[:3, 3], world)
        distance.flags.writeable = False
        return distance, surface

    @property
    def depth(self) -> Array:
        """(height, width): distances along the rays of `rays`, to the front the depth, m; infinite for the sky."""
        return self._hits[0]

    @cached_property
    def radiance(self) -> NDArray[np.uint16]:
        """(height, width, 3): blue, green, red, in `STEPS_PER_GREY_LEVEL` of a grey level."""
        distance, surface = self._hits
        colour = np.empty((3, *distance.shape), np.float32)
        for rows, world in self._row_batches():
            hit = distance[rows].ravel(), surface[rows].ravel()
            seen = colours(self._scene, self._T_world_camera[:3, 3], world.reshape(3, -1), *hit)
            colour[:, rows] = seen.reshape(world.shape)
        found = np.asarray(cv2.merge(list(in_steps(colour))), np.uint16)
        uneven = _uneven_pixels(np.clip(colour, 0, 255).astype(np.uint8))
        for first in range(0, len(uneven), _PIXELS_PER_BATCH):
            pixels = np.divmod(uneven[first : first + _PIXELS_PER_BATCH], self._camera.width)
            _, seen = self.along(sample_rays(self._camera, *pixels))
            found[pixels] = in_steps((seen.sum(axis=1) / SAMPLES_PER_PIXEL).astype(np.float32)).T
        found.flags.writeable = False
        return found

    def along(self, rays: Array) -> tuple[Array, Array]:
        """Return the distances (...) and the colours (3, ...) along rays (3, ...) in the camera's frame."""
        origin, world = self._T_world_camera[:3, 3], turned(self._T_world_camera, rays.reshape(3, -1))
        distance, surface = self._scene.hit(origin, world)
        seen = colours(self._scene, origin, world, distance, surface)
        return distance.reshape(rays.shape[1:]), seen.reshape(rays.shape)


def background(camera: Camera, T_world_camera: Array, scene: Scene) -> Background:
    """Return the background for a camera; cached for a camera at rest."""
    return _cached_background(camera, np.ascontiguousarray(T_world_camera, float).tobytes(), scene)


@lru_cache(maxsize=8)
def _cached_background(camera: Camera, pose: bytes, scene: Scene) -> Background:
    return Background(camera, np.frombuffer(pose).reshape(4, 4), scene)


def in_steps(levels: Array | NDArray[np.float32]) -> NDArray[np.uint16]:
    """Convert grey levels to `STEPS_PER_GREY_LEVEL` per level, rounded."""
    return np.asarray(np.rint(np.clip(levels * STEPS_PER_GREY_LEVEL, 0, 65535)).astype(np.uint16))


def _uneven_pixels(levels: NDArray[np.uint8]) -> IntArray:
    """Return the pixels, counted row by row, that differ from one of their eight neighbours in a colour (3, H, W)."""
    square = np.ones((3, 3), np.uint8)
    blue, green, red = (cv2.morphologyEx(each, cv2.MORPH_GRADIENT, square) for each in levels)
    return np.flatnonzero(cv2.max(cv2.max(blue, green), red) > _MAX_GREY_DIFFERENCE)
