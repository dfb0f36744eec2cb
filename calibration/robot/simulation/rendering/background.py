"""Background of a camera's image, without patterns: ground, boxes and sky, and their colours.

Cells of the image that see one surface are filled; only in the others every ray is intersected with those that it may
hit. Colours are blue, green, red, in grey levels before the camera's exposure.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.simulation.rendering.rays import (
    CELL_SIZE,
    SAMPLES_PER_PIXEL,
    UNKNOWN_FACET,
    Sight,
    cells,
    facets,
    in_cells,
    sample_rays,
)
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


STEPS_PER_GREY_LEVEL = 64
"""Radiance steps per grey level: images have 16 bits until the camera's exposure."""

_MAX_GREY_DIFFERENCE = 6
"""Pixels that differ from a neighbour by more grey levels are supersampled."""
_CELLS_PER_BATCH = 125
"""Number of cells per batch, whose rays fit into the cache."""
_PIXELS_PER_BATCH = 3000
"""Number of pixels that are supersampled at once. A lens is inverted by iterations that end for all of them at once, so
the last bits of a ray depend on it."""


class Background:
    """Background of a camera's image at a pose. Its images are rendered when they are asked for."""

    def __init__(self, camera: Camera, T_world_camera: Array, scene: Scene) -> None:
        self._camera, self._T_world_camera, self._scene = camera, T_world_camera, scene
        self._cells, self._facets = cells(camera), facets(scene, T_world_camera)
        self._sight = Sight.of(self._facets, self._cells.bounds)
        (self._mixed,) = np.nonzero(self._sight.only == UNKNOWN_FACET)
        """Cells that see several facets."""
        self._hit, self._limit = self._sight.hit(self._cells.rays.take(self._mixed, axis=1), self._mixed)
        """(mixed, K): facets of their pixels' centres, and how far from there they are still hit; see `Sight.hit`."""

    def is_beyond(self, part: tuple[slice, slice], depths: Sequence[Array]) -> bool:
        """Whether the background in rows and columns of the image is surely farther than all finite depths, m."""
        nearest = self._sight.depth.reshape(self._cells.shape)[self._cells.around(part)].min()
        return all(each.max(where=np.isfinite(each), initial=-np.inf) < nearest for each in depths)

    @cached_property
    def depth(self) -> Array:
        """(height, width): distances along the rays of `rays`, to the front the depth, m; infinite for the sky."""
        found = np.full(self._cells.rays.shape[1:], np.inf)
        for index in range(len(self._facets)):
            for some in _split_in_batches(np.flatnonzero(self._sight.only == index)):
                found[some] = self._hit_distances(index, self._in_world_frame(self._cells.rays[:, some]))
        world, several = self._in_world_frame(self._cells.rays[:, self._mixed]), np.full(self._hit.shape, np.inf)
        for index in range(UNKNOWN_FACET, len(self._facets)):
            where = self._hit == index
            several[where] = self._hit_distances(index, world[:, where])
        found[self._mixed] = several
        image = np.empty((self._cells.shape[0] * CELL_SIZE[0], self._cells.shape[1] * CELL_SIZE[1]))
        in_cells(image)[:] = found.reshape(*self._cells.shape, *CELL_SIZE)
        image.flags.writeable = False
        return image[: self._cells.size[0], : self._cells.size[1]]

    @cached_property
    def radiance(self) -> NDArray[np.uint16]:
        """(height, width, 3): blue, green, red, in `STEPS_PER_GREY_LEVEL` of a grey level."""
        height, width = self._cells.size
        uniform = self._uniform_colours.astype(np.float32)[:, self._sight.only.reshape(self._cells.shape)]
        steps, levels = (_enlarge_cells(made(uniform)) for made in (in_steps, _in_levels))
        for some, colour in self._varying_cells():
            where = (slice(None), *np.divmod(some, self._cells.shape[1]))
            made = colour.astype(np.float32).reshape(3, len(some), *CELL_SIZE)
            in_cells(steps)[where], in_cells(levels)[where] = in_steps(made), _in_levels(made)
        found = np.asarray(cv2.merge(list(steps[:, :height, :width])), np.uint16)
        uneven = _uneven_pixels(levels[:, :height, :width])
        only = self._only_facet(*np.divmod(uneven, width))
        for index in (
            UNKNOWN_FACET,
            *self._varying_facets,
        ):  # all samples of a pixel that sees another facet have its colour
            for pixels in _split_in_batches(uneven[only == index], _PIXELS_PER_BATCH):
                mean = in_steps(self._mean_colours(index, *np.divmod(pixels, width)).astype(np.float32))
                for plane, values in zip(found.reshape(-1, 3).T, mean, strict=True):
                    plane[pixels] = values
        found.flags.writeable = False
        return found

    def _mean_colours(self, index: int, rows: IntArray, columns: IntArray) -> Array:
        """Return the mean colours (3, n) of pixels that see a facet of `_varying_facets`, or undecided."""
        samples = sample_rays(self._camera, rows, columns)
        if index == UNKNOWN_FACET:
            hit, _ = self._sight.hit(samples.swapaxes(1, 2), self._cells.of_pixels(rows, columns))
            seen = self._colours_along(samples, hit.T)
        else:
            seen = self._colours_of(index, samples.reshape(3, -1)).reshape(samples.shape)
        mean: Array = seen.sum(axis=1) / SAMPLES_PER_PIXEL
        return mean

    def _only_facet(self, rows: IntArray, columns: IntArray) -> IntArray:
        """Return the facet (n,) that all samples of each pixel hit, or `UNKNOWN_FACET`."""
        cell = self._cells.of_pixels(rows, columns)
        found: IntArray = self._sight.only[cell]
        (several,) = np.nonzero(found == UNKNOWN_FACET)
        rows, columns, cell = rows[several], columns[several], cell[several]
        at = (
            np.searchsorted(self._mixed, cell),
            rows % CELL_SIZE[0] * CELL_SIZE[1] + columns % CELL_SIZE[1],
        )  # of `_hit`
        found[several] = np.where(self._limit[at] > self._cells.reach[cell], self._hit[at], UNKNOWN_FACET)
        return found

    def colours(self, rays: Array, rows: IntArray, columns: IntArray) -> Array:
        """Return the colours (3, K, N) along rays (3, K, N), K of each of N pixels; in grey levels."""
        cell = self._cells.of_pixels(rows, columns)
        hit = np.repeat(self._sight.only[None, cell], rays.shape[1], axis=0)
        (mixed,) = np.nonzero(hit[0] == UNKNOWN_FACET)
        hit[:, mixed] = self._sight.hit(rays[:, :, mixed].swapaxes(1, 2), cell[mixed])[0].T
        return self._colours_along(rays, hit)

    def _varying_cells(self) -> Iterator[tuple[IntArray, Array]]:
        """Yield batches of cells (n,) that are not of one colour, and the colours (3, n * K) of their pixels."""
        for index in self._varying_facets:
            for some in _split_in_batches(np.flatnonzero(self._sight.only == index)):
                yield some, self._colours_of(index, self._cells.rays.take(some, axis=1).reshape(3, -1))
        for some in _split_in_batches(np.arange(len(self._mixed))):
            yield (
                self._mixed[some],
                self._colours_along(self._cells.rays.take(self._mixed[some], axis=1), self._hit[some]),
            )

    def _colours_along(self, rays: Array, hit: NDArray[np.integer[Any]]) -> Array:
        """Return the colours (3, ...) along rays (3, ...) that hit facets (...)."""
        flat, facet = rays.reshape(3, -1), hit.ravel()
        found: Array = self._uniform_colours.take(facet, axis=1)
        for index in (UNKNOWN_FACET, *self._varying_facets):
            where = np.flatnonzero(facet == index)
            if len(where):
                for plane, values in zip(found, self._colours_of(index, flat.take(where, axis=1)), strict=True):
                    plane[where] = values
        return found.reshape(rays.shape)

    @cached_property
    def _uniform_colours(self) -> Array:
        """(3, M + 1): colours of the facets that have one each; 0 for the others and for none of them."""
        found = np.zeros((3, len(self._facets) + 1))
        for index, facet in enumerate(self._facets):
            if facet.surface != GROUND_SURFACE:
                found[:, index] = face_colours(self._scene, self._scene.boxes[facet.surface])[:, facet.face]
        return found

    @property
    def _varying_facets(self) -> list[int]:
        """The facets that are not of one colour: the ground, and none of them, which is the sky."""
        return [i for i, facet in enumerate(self._facets) if facet.surface == GROUND_SURFACE] + [len(self._facets)]

    def _colours_of(self, index: int, rays: Array) -> Array:
        """Return the colours (3, n) along rays (3, n) that hit a facet of `_varying_facets`, or undecided."""
        scene, origin, world = self._scene, self._T_world_camera[:3, 3], self._in_world_frame(rays)
        if index == UNKNOWN_FACET:
            return colours(scene, origin, world, *scene.hit(origin, world))
        if index == len(self._facets):
            return sky_colours(scene, world)
        return ground_colours(scene, origin, world, self._hit_distances(index, world))

    def _hit_distances(self, index: int, world: Array) -> Array:
        """Return the distances (...) along rays (3, ...) in the world frame that hit a facet."""
        origin = self._T_world_camera[:3, 3]
        if index == UNKNOWN_FACET:
            return self._scene.hit(origin, world)[0]
        return self._facets[index].distance(self._scene, origin, world)

    def _in_world_frame(self, rays: Array) -> Array:
        """Return rays (3, ...) in the world frame."""
        return turned(self._T_world_camera, rays)


def background(camera: Camera, T_world_camera: Array, scene: Scene) -> Background:
    """Return the background for a camera; cached for a camera at rest."""
    return _cached_background(camera, np.ascontiguousarray(T_world_camera, float).tobytes(), scene)


@lru_cache(maxsize=8)
def _cached_background(camera: Camera, pose: bytes, scene: Scene) -> Background:
    return Background(camera, np.frombuffer(pose).reshape(4, 4), scene)


def in_steps(levels: Array | NDArray[np.float32]) -> NDArray[np.uint16]:
    """Convert grey levels to `STEPS_PER_GREY_LEVEL` per level, rounded."""
    steps: NDArray[np.uint16] = np.rint(np.clip(levels * STEPS_PER_GREY_LEVEL, 0, 65535)).astype(np.uint16)
    return steps


def _in_levels(colour: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Convert grey levels to whole ones of 8 bits."""
    return np.clip(colour, 0, 255).astype(np.uint8)


def _split_in_batches(some: IntArray, size: int = _CELLS_PER_BATCH) -> Iterator[IntArray]:
    for first in range(0, len(some), size):
        yield some[first : first + size]


def _enlarge_cells(values: NDArray[Any]) -> NDArray[Any]:
    """Return images (3, R * height, C * width) with the values (3, R, C) of cells."""
    wide = np.repeat(values, CELL_SIZE[1], axis=-1)
    return np.repeat(wide, CELL_SIZE[0], axis=-2)


def _uneven_pixels(levels: NDArray[np.uint8]) -> IntArray:
    """Return the pixels, counted row by row, that differ from one of their eight neighbours in a colour (3, H, W)."""
    square = np.ones((3, 3), np.uint8)
    blue, green, red = (cv2.morphologyEx(each, cv2.MORPH_GRADIENT, square) for each in levels)
    return np.flatnonzero(cv2.max(cv2.max(blue, green), red) > _MAX_GREY_DIFFERENCE)
