"""Derivatives of a view's labels: by its pose, its camera's intrinsics, its LiDAR's errors, its pattern's shape.

The derivative of every residual by a displacement d of its point on the pattern, along the pattern's axes, is given by
the rows of the pose's translation: ``dr = r_t . d`` (`residuals.residuals`). So the column of anything
that displaces points is the product of these rows and a field of displacements: ``d = (0, 0, f(x, y))`` of a bent
pattern, ``d = b R^T u`` of a LiDAR whose ranges are b too long (the point is moved back along its ray u, which is
equivalent to moving the pattern along it). Intrinsics of a camera have rows of their own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.residuals.corner_residuals import ERRORS_BEYOND_LENS_MODEL, CornerTerm
from calibration.engine.estimation.residuals.pose_residuals import PoseTerm
from calibration.engine.estimation.residuals.ray_residuals import RING_GAP, BorderTerm, RangeTerm, elevations
from calibration.engine.estimation.residuals.views import LABELS_PER_CHUNK, MAX_MULTIPLICATIONS, Term
from calibration.engine.geometry.cameras import Camera

POSE_COLUMNS = 6
"""Number of the first columns: the twist of the view's pose in the pattern's frame."""
COLUMNS_OF_BENT_PATTERN = ("size_x", "size_y", "bow_x", "bow_y", "twist")
"""Columns of a pattern: its relative length along x and along y; the height of its centre above its ends (m), bent
about y or about x; the height of opposite corners (m)."""
COLUMNS_OF_PATTERN = (*COLUMNS_OF_BENT_PATTERN, "border")
"""Those, and the outward offset of its border (m), for sensors that see the border."""
COLUMNS_OF_RANGES = ("bias", "scale", "elevation", "sweep_x", "sweep_y", "sweep_z")
"""Columns of a LiDAR or a depth camera: range offset (m) and scale, elevation offset of its beams
(rad), and motion during a sweep (m per revolution, in its own frame)."""
COLUMNS_OF_SHUTTER = ("shutter_x", "shutter_y", "shutter_z")
"""Last columns of a camera: motion while an image is read row by row (m an image, in its own frame)."""
COLUMNS_OF_MEASURED_POSES = ("scale",)
"""Columns of measured poses: by what factor their translations are too long."""
LABELS_PER_PASS = 2 * LABELS_PER_CHUNK
"""Labels per pass: more than `LABELS_PER_CHUNK`, as their rows do not fit into the second-level cache anyway."""


@dataclass(frozen=True)
class ColumnNames:
    """Columns of the views of one sensor and one pattern."""

    camera: Camera | None
    """Camera of a sensor with corner labels."""
    poses: bool = False
    """Whether the labels are poses: but for their scale all of their errors are noise."""
    rings: tuple[float, ...] = ()
    """Elevations of a LiDAR's rings, rad, ascending: each has a column of its own."""

    @cached_property
    def of_sensor(self) -> tuple[str, ...]:
        """Names of the first columns after those of the pose."""
        if self.poses:
            return COLUMNS_OF_MEASURED_POSES
        if self.camera:
            return (*self.camera.parameters, *ERRORS_BEYOND_LENS_MODEL, *COLUMNS_OF_SHUTTER)
        return (*COLUMNS_OF_RANGES, *map(ring_column, self.rings))

    @cached_property
    def of_pattern(self) -> tuple[str, ...]:
        """Names of the columns after those."""
        if self.poses:
            return ()
        return COLUMNS_OF_BENT_PATTERN if self.camera else COLUMNS_OF_PATTERN


def ring_column(elevation: float) -> str:
    """Return the name of the column of a ring's elevation offset (rad), the same for all patterns that it hits."""
    return f"ring {np.degrees(elevation):+.2f} deg"


def products(
    terms: Sequence[Term],
    camera: Camera | None,
    pattern: Pattern,
    T: Array,
    weighting: Weighting,
    rings: Sequence[float] = (),
) -> Iterator[tuple[slice, Array]]:
    """Yield parts of the views, with the products of their columns: M (v, 6 + E + 1, 6 + E + 1).

    The columns are the twist, the E of the labels (`ColumnNames`), and the residuals.

    Args:
        terms: the labels of the views, with the intrinsics at the optimum.
        camera: their camera, if they are corners.
        pattern: the pattern.
        T: ``T_sensor_pattern`` (V, 4, 4), the pattern's frame at the centre of its corners.
        weighting: standard deviations and loss of the residuals.
        rings: elevations of the rings of a LiDAR, rad, ascending.
    """
    if camera is not None:
        terms = [
            term.seen_with(camera, range(len(camera.parameters) + len(ERRORS_BEYOND_LENS_MODEL))) for term in terms
        ]
    step = max(1, LABELS_PER_PASS // max(term.length for term in terms))
    for start in range(0, len(T), step):
        views = slice(start, min(start + step, len(T)))
        first, *others = (
            _products_of_rows(_columns_of_views(term, pattern, T[views], views, weighting, rings)) for term in terms
        )
        yield views, sum(others, first)


def _products_of_rows(rows: Array) -> Array:
    """Return the products (v, C, C) of rows (C, v, n); in parts, for which BLAS starts no threads."""
    C, _, n = rows.shape
    step = max(1, MAX_MULTIPLICATIONS // C**2)
    parts = (rows[..., start : start + step] for start in range(0, n, step))
    first, *others = (part.transpose(1, 0, 2) @ part.transpose(1, 2, 0) for part in parts)
    return sum(others, first)


def _columns_of_views(
    term: Term, pattern: Pattern, T: Array, views: slice, weighting: Weighting, rings: Sequence[float]
) -> Array:
    """Return all columns of v views as weighted rows (6 + E + 1, v, d L); the last are the residuals."""
    scale, huber = weighting.scales[term.kind], weighting.huber
    if isinstance(term, CornerTerm):
        bent = len(COLUMNS_OF_BENT_PATTERN)
        rows, places = term.rows(T, views, scale, huber, len(COLUMNS_OF_SHUTTER) + bent)
        _fill_shutter(rows[-1 - bent - len(COLUMNS_OF_SHUTTER) : -1 - bent], rows[:3], term, T, views)
        _fill_bent(rows[-1 - bent : -1], rows[:3], places, pattern)
    elif isinstance(term, PoseTerm):
        rows, _ = term.rows(T, views, scale, huber, len(COLUMNS_OF_MEASURED_POSES))
        _fill_measured(rows[POSE_COLUMNS], rows[:3], T, pattern)
    elif isinstance(term, RangeTerm | BorderTerm):
        spare = len(COLUMNS_OF_RANGES) + len(rings) + len(COLUMNS_OF_PATTERN)
        rows, places = term.rows(T, views, scale, huber, spare)
        ranging, of_rings = np.split(rows[POSE_COLUMNS : -1 - len(COLUMNS_OF_PATTERN)], [len(COLUMNS_OF_RANGES)])
        _fill_ranging(ranging, rows[:3], T, places)
        _fill_rings(of_rings, ranging[COLUMNS_OF_RANGES.index("elevation")], term.rays[views], rings)
        _fill_bent(rows[-1 - len(COLUMNS_OF_PATTERN) : -2], rows[:3], places, pattern)
        _fill_border(rows[-2], rows[:2], term, places)
    else:
        raise AssertionError(f"labels of {term.kind} have no columns")
    return rows.reshape(*rows.shape[:2], -1)


def _fill_ranging(out: Array, pull: Array, T: Array, places: Array) -> None:
    """Fill the columns of `COLUMNS_OF_RANGES` (6, v, 1, L).

    They are computed at the expected ends of the rays, not at the measured ones: with noise in the column of the
    scale, it would explain the noise itself.
    """
    ends = np.swapaxes(T[:, :3, :3] @ places + T[:, :3, 3:], 0, 1)
    pull = np.swapaxes(T[:, :3, :3] @ np.swapaxes(pull[:, :, 0], 0, 1), 0, 1)  # along the sensor's axes
    x, y, z = ends
    flat = np.maximum(np.hypot(x, y), 1e-9)
    lower = np.stack([x * z / flat, y * z / flat, -flat])
    along = (pull * ends).sum(0)
    np.divide(along, np.maximum(np.linalg.norm(ends, axis=0), 1e-9), out=out[0, :, 0])
    out[1, :, 0] = along
    out[2, :, 0] = (pull * lower).sum(0)
    np.multiply(pull, np.arctan2(y, x) / (-2 * np.pi), out=out[3:, :, 0])


def _fill_shutter(out: Array, pull: Array, term: CornerTerm, T: Array, views: slice) -> None:
    """Fill `COLUMNS_OF_SHUTTER` (3, v, 2, L): the pattern moves along the camera's axes from the first row to the last.

    The image counts as it is in its middle row.
    """
    row = np.nan_to_num(term.pixels[views, 1]) / term.camera.height - 0.5
    np.einsum("vij,jvdl,vl->ivdl", T[:, :3, :3], pull, row, out=out)


def _fill_rings(out: Array, elevation: Array, rays: Array, rings: Sequence[float]) -> None:
    """Fill the columns (R, v, 1, L) of rings: that of the elevation (v, 1, L), of the rays (v, 3, L) on each."""
    angles = elevations(rays)[:, None]
    for column, ring in zip(out, rings, strict=True):
        np.multiply(elevation, np.abs(angles - ring) < RING_GAP, out=column)


def _fill_measured(out: Array, pull: Array, T: Array, pattern: Pattern) -> None:
    """Fill the column of the scale (v, 3, 1): the pattern's frame, not its centre, is moved along its distance.

    The rows ``pull`` (3, v, 3, 1) of an orientation are zero, and so is its column.
    """
    from_sensor = np.swapaxes(T[:, :3, :3], 1, 2) @ T[:, :3, 3:] - pattern.centre[:, None]  # along the pattern's axes
    np.einsum("avdl,va->vdl", pull, from_sensor[..., 0], out=out)


def _fill_bent(out: Array, pull: Array, places: Array, pattern: Pattern) -> None:
    """Fill `COLUMNS_OF_BENT_PATTERN` (5, v, d, L), of labels at some places (v, 3, L), or (1, 3, L), on the pattern."""
    low, high = pattern.outline.min(0), pattern.outline.max(0)
    middle, half = pattern.outline.mean(0) - pattern.centre[:2], (high - low) / 2
    x, y = places[:, 0], places[:, 1]
    a, b = (x - middle[0]) / half[0], (y - middle[1]) / half[1]
    d, out, pull = out.shape[2], out.reshape(*out.shape[:2], -1), pull.reshape(*pull.shape[:2], -1)
    for k, (axis, factor) in enumerate(((0, x), (1, y), (2, a * a - 1), (2, b * b - 1), (2, a * b))):
        np.multiply(pull[axis], np.tile(factor, d), out=out[k])


def _fill_border(out: Array, pull: Array, term: Term, places: Array) -> None:
    """Fill the column of the border (v, 1, L)."""
    out[:] = 0.0
    if isinstance(term, BorderTerm):
        nearest = (np.einsum("si,vil->vls", term.normals, places[:, :2]) - term.offsets).argmax(-1)
        outward = term.normals[nearest]
        out[:, 0] = pull[0, :, 0] * outward[..., 0] + pull[1, :, 0] * outward[..., 1]
