"""Rays of a camera's pixels and of their samples, and the surfaces of the scene that they hit.

The surfaces are polygons in the plane z = 1 of the camera's frame. Which of them a ray (x, y, 1) hits is decided by the
signs of linear functions of x and y: for every edge of a face, of the plane through the camera and that edge, and for
the face itself, of its nearness, which is the inverse of the depth. In a rectangle of rays such a function is between
its values in the corners. Signs that rounding errors could change are left undecided, so that a decision is always that
of `Scene.hit`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses.model import IN_FRONT
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.simulation.scene import GROUND_SURFACE, Box, Scene, between_faces

UNKNOWN_FACET = -1
"""Index of a facet that is not known."""
_MIN_SIGNED_VALUE = 1e-8
"""Limit of the values that have no sign, relative to the coordinates of a ray; rounding errors are a hundredth of it
at most."""
_LEAST_SLOPE = 0.5
"""Least slope of an edge's function that is scaled to 1; only edges far from the camera's axis have less."""
_MAX_TOUCH_DISTANCE = 1e-5
"""Limit of a camera's distance to a plane or an edge, relative to its coordinates: from nearer they are not known."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """N rectangles of rays, in the plane z = 1 of the camera's frame."""

    middle: Array
    """(2, N): x and y."""
    half: Array
    """(2, N): half of width and height; NaN if the lens shows nothing in part of it, or what is not in front."""
    margin: Array
    """(N,): limit of the values that have no sign for a ray in the rectangle."""

    @classmethod
    def of(cls, rays: Array) -> "Bounds":
        """Bounds of N times K rays (3, N, K)."""
        in_front = np.where(rays[2] == 1, rays[:2], np.nan)
        low, high = in_front.min(axis=-1), in_front.max(axis=-1)
        far = np.maximum(np.abs(low), np.abs(high)).sum(axis=0)
        return cls((low + high) / 2, (high - low) / 2, _MIN_SIGNED_VALUE * (1 + far))

    def range(self, functions: Array) -> tuple[Array, Array]:
        """Minima and maxima (F, N) of linear functions (F, 3), each widened by the margin, which covers rounding."""
        value = functions[:, :2] @ self.middle
        value += functions[:, 2:]
        reach = np.abs(functions[:, :2]) @ self.half
        reach += self.margin
        return value - reach, value + reach


@dataclass(frozen=True, eq=False)
class Facet:
    """A surface that can be seen from a camera: the ground, or a face of a box."""

    surface: int
    """Index of the box, or `GROUND_SURFACE`."""
    face: int
    """Index of a box's face, as in `calibration.robot.simulation.rendering.background.face_colours`."""
    edges: Array
    """(4, 3), unit vectors in the camera's frame: a ray hits the surface if its products with all are above 0."""
    nearness: Array
    """(3,), in the camera's frame: its product with a ray is the inverse of the depth, 1/m. NaN if it is not known."""

    def distance(self, scene: Scene, origin: Array, directions: Array) -> Array:
        """Return the distances (...) along rays (3, ...) in the world frame that hit it, as `Scene.hit` does."""
        if self.surface == GROUND_SURFACE:
            assert scene.ground is not None  # noqa: S101 (it is seen)
            return np.asarray((scene.ground - origin[2]) / directions[2])
        enter, leave = between_faces(scene.boxes[self.surface], self.face // 3, origin, directions)
        return np.where(enter > 0, enter, leave)


def facets(scene: Scene, T_world_camera: Array) -> list[Facet]:
    """Return the surfaces that can be seen from a pose."""
    origin, R = T_world_camera[:3, 3], T_world_camera[:3, :3]
    found = [] if scene.ground is None else [_ground_facet(scene.ground, origin, R)]
    for index, box in enumerate(scene.boxes):
        found += _box_faces(index, box, origin, R)
    return found


def _ground_facet(height: float, origin: Array, R: Array) -> Facet:
    away = height - origin[2]
    if abs(away) <= _MAX_TOUCH_DISTANCE * (abs(height) + np.abs(origin).max()):
        return _touched_facet(GROUND_SURFACE)
    return Facet(GROUND_SURFACE, 0, np.tile(math.copysign(1, away) * R[2], (4, 1)), R[2] / away)


def _box_faces(index: int, box: Box, origin: Array, R: Array) -> Iterator[Facet]:
    """Yield the faces of a box that are towards a camera; from inside all six."""
    half, centre = box.size / 2, box.T_world_box[:3, 3]
    place = apply(inverse(box.T_world_box), origin[None])[0]
    least = _MAX_TOUCH_DISTANCE * (np.abs(origin).max() + np.abs(centre).max() + half.max())
    beyond = (np.abs(place) - half).max()
    if abs(beyond) <= least:
        yield _touched_facet(index)
        return
    R_box_camera = box.T_world_box[:3, :3].T @ R
    for axis, sign in product(range(3), (-1, 1)):
        away = sign * half[axis] - place[axis]
        if beyond > 0 and sign * away > least:
            continue
        edges, nearness = np.zeros((4, 3)), np.zeros(3)
        for edge, (other, side) in zip(edges, product({0, 1, 2} - {axis}, (-1, 1)), strict=True):
            # the plane holds the camera and an edge of the box: its normal is square to both
            beside = side * half[other] - place[other]
            length = math.hypot(away, beside)
            if length > least:
                edge[axis], edge[other] = math.copysign(side, side * away) * beside, -side * abs(away)
                edge /= length
        nearness[axis] = 1 / away if abs(away) > least else np.nan
        towards = sign if beyond > 0 else -sign
        yield Facet(index, 3 * axis + 1 + towards, edges @ R_box_camera, nearness @ R_box_camera)


def _touched_facet(surface: int) -> Facet:
    """Return the facet of a surface that the camera touches: any ray may hit it."""
    return Facet(surface, 0, np.zeros((4, 3)), np.full(3, np.nan))


@dataclass(frozen=True, eq=False)
class Sight:
    """What a camera sees of M facets in N rectangles."""

    functions: Array
    """(M, 5, 3): edges and nearness, scaled so that no value, and no difference of two nearnesses, changes by more than
    the x or the y of a ray, whichever changes more."""
    may: BoolArray
    """(M + 1, N): whether a facet may be seen; the last is none of them."""
    crossed: BoolArray
    """(M, 4, N): whether an edge of a facet may cross the rectangle."""
    margin: Array
    """(N,): limit of the values that have no sign."""
    depth: Array
    """(N,): lower bound of the depth, m; NaN if none is known."""

    @classmethod
    def of(cls, some: list[Facet], bounds: Bounds) -> "Sight":
        """Find what is seen in rectangles."""
        nearness = np.array([each.nearness for each in some]).reshape(-1, 3)
        lengths = 2 * np.abs(nearness).sum(axis=1)
        scale = lengths[~np.isnan(lengths)].max(initial=0.0) or 1.0
        edges = np.array([each.edges for each in some]).reshape(-1, 4, 3)
        edges /= np.maximum(np.abs(edges[..., :2]).sum(axis=2, keepdims=True), _LEAST_SLOPE)
        functions = np.concatenate([edges, nearness[:, None] / scale], axis=1)
        shape = len(some), bounds.margin.size
        may, crossed = np.ones((shape[0] + 1, shape[1]), bool), np.empty((shape[0], 4, shape[1]), bool)
        near, nearest = np.zeros(may.shape), np.zeros(shape[1])
        for index, each in enumerate(functions):
            low, high = bounds.range(each)
            crossed[index], near[index] = ~(low[:4] > 0), high[4]
            inside = ~crossed[index].any(axis=0)
            may[index] = ~(high[:4] < 0).any(axis=0)
            may[-1] &= ~inside
            np.maximum(nearest, np.where(inside, low[4], 0.0), out=nearest)
        may &= ~(near < nearest)
        with np.errstate(divide="ignore"):
            depth = 1 / (scale * np.where(may, near, 0.0).max(axis=0))
        return cls(functions, may, crossed, bounds.margin, depth)

    @cached_property
    def only(self) -> IntArray:
        """(N,): the only facet that is seen, M for none of them, or `UNKNOWN_FACET`."""
        return np.where(self.may.sum(axis=0) == 1, self.may.argmax(axis=0), UNKNOWN_FACET)

    def hit(self, rays: Array, where: IntArray) -> tuple[NDArray[np.int16], Array]:
        """Find the facets that rays hit.

        Args:
            rays: (3, n, K), in the camera's frame: (x, y, 1).
            where: (n,), the rectangles that they are in.

        Returns:
            The facets (n, K), M for none of them, or `UNKNOWN_FACET`; and limits (n, K): rays of the rectangle whose x
            and y differ by less hit the same facet. NaN, or 0 and below, if it is not decided.
        """
        xy, may, used = np.ascontiguousarray(rays[:2]), self.may.take(where, axis=1), np.zeros(self.margin.shape, bool)
        used[where] = True
        found, nearest = np.full(xy.shape[1:], len(may) - 1, np.int16), np.zeros(xy.shape[1:])
        limit = np.full(nearest.shape, np.inf)
        for index, (*edges, nearness_of) in enumerate(self.functions):
            (some,) = np.nonzero(may[index])
            if not len(some):
                continue
            (x, y), before = xy.take(some, axis=1), nearest.take(some, axis=0)
            now = _evaluate_linear(nearness_of, x, y)
            lead = now - before
            for number in np.flatnonzero((self.crossed[index] & self.may[index] & used).any(axis=1)):
                np.minimum(lead, _evaluate_linear(edges[number], x, y), out=lead)
            hit = lead > 0
            nearest[some] = np.where(hit, now, before)
            found[some] = np.where(hit, np.int16(index), found.take(some, axis=0))
            limit[some] = np.minimum(limit.take(some, axis=0), np.abs(lead, out=lead))
        limit -= self.margin[where, None]
        found[~(limit > 0)] = UNKNOWN_FACET
        return found, limit


def _evaluate_linear(function: Array, x: Array, y: Array) -> Array:
    """Values (n, K) of a linear function (3,), in one pass."""
    a, b, c = function.tolist()
    return np.asarray(cv2.addWeighted(x, a, y, b, c), float)


SAMPLES_PER_PIXEL = 16
"""Number of samples of a pixel that sees several surfaces."""
CELL_SIZE = (8, 16)
"""Height and width of a cell of the image, px."""
_SAMPLE_REACH = 0.5
"""Limit of a sample's distance to its pixel's centre, px; more than the distance, because rays are not quite even."""
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


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of a camera's image, `CELL_SIZE` pixels each, row by row; the last ones may reach beyond the image."""

    size: tuple[int, int]
    """Height and width of the image, px."""
    shape: tuple[int, int]
    """Rows and columns of cells."""
    rays: Array
    """(3, N, K), of the pixels' centres; those beyond the image are equal to the nearest in it."""
    reach: Array
    """(N,): limit of the differences in x and in y of a sample's ray to its pixel's; NaN as in `bounds`."""
    bounds: Bounds
    """Of all that the cells see."""

    def of_pixels(self, rows: IntArray, columns: IntArray) -> IntArray:
        """Return the cells (...) that pixels (...) are in."""
        found: IntArray = rows // CELL_SIZE[0] * self.shape[1] + columns // CELL_SIZE[1]
        return found

    def around(self, part: tuple[slice, slice]) -> tuple[slice, slice]:
        """Return the rows and columns of the cells of a part of the image."""
        rows, columns = (slice(each.start // n, -(-each.stop // n)) for each, n in zip(part, CELL_SIZE, strict=True))
        return rows, columns


@lru_cache(maxsize=8)
def cells(camera: Camera) -> Cells:
    """Return the cells of a camera's image."""
    size = camera.height, camera.width
    shape = -(-size[0] // CELL_SIZE[0]), -(-size[1] // CELL_SIZE[1])
    beyond = [(0, cells * n - pixels) for cells, n, pixels in zip(shape, CELL_SIZE, size, strict=True)]
    wider = np.pad(rays(camera), ((0, 0), *beyond), mode="edge")
    found = in_cells(wider[:, 1:-1, 1:-1]).reshape(3, shape[0] * shape[1], -1)
    found.flags.writeable = False
    # a pixel reaches half of the way to its neighbours
    with_margin = sliding_window_view(wider, (CELL_SIZE[0] + 2, CELL_SIZE[1] + 2), axis=(1, 2))[
        :, :: CELL_SIZE[0], :: CELL_SIZE[1]
    ]
    bounds = Bounds.of(with_margin.reshape(*found.shape[:2], -1))
    right, down = (np.abs(np.diff(with_margin[:2], axis=axis)).max(axis=(-2, -1)) for axis in (-1, -2))
    return Cells(size, shape, found, _SAMPLE_REACH * (right + down).max(axis=0).ravel(), bounds)


def in_cells(images: NDArray[Any]) -> NDArray[Any]:
    """View images (..., R * height, C * width) as cells of `CELL_SIZE` pixels: (..., R, C, height, width)."""
    *batch, height, width = images.shape
    rows, columns = height // CELL_SIZE[0], width // CELL_SIZE[1]
    return images.reshape(*batch, rows, CELL_SIZE[0], columns, CELL_SIZE[1]).swapaxes(-3, -2)


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
