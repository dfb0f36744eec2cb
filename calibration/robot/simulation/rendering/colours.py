"""Colours of the ground, of boxes and of the sky, along rays.

They are blue, green, red, in grey levels before the camera's exposure.
"""

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.simulation.scene import GROUND_SURFACE, NO_SURFACE, Box, Scene, turned

_TILE_SIZE_M = 0.5
"""Size of the ground's tiles, m; a power of two, so that its inverse is exact."""
_TILE_CONTRAST = 0.05
_GROUND_COLOUR = (124.0, 128.0, 130.0)
_HORIZON_COLOUR, _ZENITH_COLOUR = np.array([196.0, 192.0, 188.0]), np.array([188.0, 170.0, 152.0])
_MAX_STORED_SHADES = 40_000
"""Largest number of tiles whose shades are computed beforehand."""


def colours(scene: Scene, origin: Array, directions: Array, distance: Array, surface: IntArray) -> Array:
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
            box = scene.boxes[index]
            only = _only_face(scene, box, origin)
            seen[:, where] = _box_colours(scene, box, origin, there, away) if only is None else only
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
    brightness = _shades_of_tiles(*(_tile_indices(origin[axis], directions[axis], distance) for axis in range(2)))
    brightness *= _TILE_CONTRAST
    fading = distance / 10
    fading *= fading
    fading += 1
    brightness /= fading
    brightness += 1
    brightness *= scene.light.on(np.array([0.0, 0.0, 1.0]))
    colour: Array = brightness * np.array(_GROUND_COLOUR)[:, None]
    return colour


def _tile_indices(start: float, directions: Array, distance: Array) -> Array:
    """Return the indices (N,) of the tiles along an axis of the world, limited to a million."""
    place = distance * directions
    place += start
    place *= 1 / _TILE_SIZE_M
    np.clip(place, -1e6, 1e6, out=place)
    return np.floor(place, out=place)


def _shades_of_tiles(column: Array, row: Array) -> Array:
    """Return the shades (N,) of tiles at whole columns and rows (N,), -1 to 1."""
    left, top, right, bottom = column.min(), row.min(), column.max(), row.max()
    width, height = right - left + 1, bottom - top + 1
    if width * height > _MAX_STORED_SHADES:
        return _shade_of_tile(column.astype(np.int64), row.astype(np.int64))
    table = _shade_of_tile(
        np.arange(left, right + 1).astype(np.int64), np.arange(top, bottom + 1).astype(np.int64)[:, None]
    )
    index = row * width
    index += column
    index -= top * width + left
    found: Array = table.ravel().take(index.astype(np.int32))
    return found


def _shade_of_tile(column: IntArray, row: IntArray) -> Array:
    mixed = ((column * 73856093) ^ (row * 19349663)) * 2654435761  # hash of the tile's indices
    shade: Array = (mixed >> 20) % 251 / 125 - 1
    return shade


def _box_colours(scene: Scene, box: Box, origin: Array, directions: Array, distance: Array) -> Array:
    """Return a box's colours (3, N), one per face. The face that is hit is that whose plane is closest to the point."""
    T_box_world = inverse(box.T_world_box)
    along = turned(T_box_world, directions)
    points = apply(T_box_world, origin[None]).T + distance * along
    x, y, z = np.abs(points) / (box.size[:, None] / 2)
    first, second = (x >= y) & (x >= z), y >= z
    axis = np.where(first, 0, np.where(second, 1, 2))
    towards = -np.sign(np.where(first, along[0], np.where(second, along[1], along[2])))  # also inside, to the viewer
    colour: Array = face_colours(scene, box).take(3 * axis + 1 + towards.astype(np.int64), axis=1)
    return colour


def _only_face(scene: Scene, box: Box, origin: Array) -> Array | None:
    """Return the colour (3, 1) of the only face of a box that is visible from a point; None if others are too."""
    place = apply(inverse(box.T_world_box), origin[None])[0]
    (outside,) = np.nonzero(np.abs(place) > box.size / 2)
    if len(outside) != 1:
        return None
    face = 3 * outside[0] + 1 + int(np.sign(place[outside[0]]))
    colour: Array = face_colours(scene, box)[:, face : face + 1]
    return colour


def face_colours(scene: Scene, box: Box) -> Array:
    """Return the colours (3, 9) of a box's faces, for each of its axes with a normal along -1, 0 and 1."""
    signs = np.array([-1.0, 0.0, 1.0])
    light = scene.light.on(box.T_world_box[:3, :3].T[:, None] * signs[:, None])
    found: Array = np.array(box.colour[::-1])[:, None] * light.reshape(-1)
    return found
