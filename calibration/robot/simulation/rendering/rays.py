"""Rays of a camera's pixels, and the samples of a pixel."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses.charts import IN_FRONT
from calibration.robot.simulation.rendering.facets import Bounds

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
