"""Residuals of points on a pattern's plane and at its border, of a LiDAR or a depth camera.

A ray of the sensor has the direction u and the origin o in the pattern's frame, and a measured range l. It meets the
pattern's plane, z = 0, at ``x = o + (l - f) u``::

    c = u_z,  h = l c + o_z          cosine of incidence, height of the measured point over the plane
    f = h c s^2                      s^2 = 1 / (c^2 + GRAZING^2), so that f is nearly h / c; see `_Meeting`

A twist (dt, dw) of the pose in the pattern's frame changes, with the measured point ``q = x + f u``::

    dh = -dt_z - (dw x q)_z
    dc = -(dw x u)_z
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.residuals.views import Linearised, chunks, robust, spread, squeezed
from calibration.engine.geometry.cameras import Camera

RING_GAP = 5e-4
"""rad: points whose polar angles differ by more are on different rings."""
PIXELS_ON_EITHER_SIDE = 6
"""Number of pixels before and after a limit pixel that determine the border's direction."""
MIN_COSINE_IF_STRAIGHT = np.cos(np.radians(20))
"""If the directions before and after a pixel differ by more, it is at a corner of the pattern, or at a gap. On a
straight border they differ by at most a pixel's step in `PIXELS_ON_EITHER_SIDE` each, 19 degrees.
"""


def scan_border_rays(points: Array, limits: IntArray, views: IntArray | None = None) -> Array:
    """Return points on the rays to the border, one for each limit point, as accurately as the scan allows.

    A limit point is the last one of its ring *on* the pattern: the border is somewhere between it
    and the next ray, on average half a step of the scan farther out. So each limit point is rotated by
    half its ring's step in azimuth, away from the ring's other points; the range is unchanged. Without this
    a pattern would look smaller by one step of the scan, 6 mm at 2 m for a step of 0.2 degrees.

    Args:
        points: (N, 3), the points on the pattern in the sensor's frame, m.
        limits: (L,), indices of those on the border.
        views: (N,), the view of each point, from 0; None if all are of one.

    Returns:
        (L, 3); NaN for limit points alone on their ring, because the side of the pattern is unknown.
    """
    x, y, z = np.ascontiguousarray(points.T)
    views = np.zeros(len(points), int) if views is None else views
    ring, azimuth = _ring_numbers(np.arctan2(np.sqrt(x * x + y * y), z), views), _relative_azimuths(x, y, views)
    order = _sorted_within(ring, azimuth)
    turns = np.empty(len(points))
    turns[order] = _turns_by_half_a_step(azimuth[order], ring[order])
    cos, sin = np.cos(turns[limits]), np.sin(turns[limits])
    x, y, z = points[limits].T
    return np.stack([cos * x - sin * y, sin * x + cos * y, np.where(np.isnan(cos), np.nan, z)], -1)


def _relative_azimuths(x: Array, y: Array, views: IntArray) -> Array:
    """Return azimuths (N,) relative to the direction of their view's mean, contiguous for one across +-180 degrees."""
    u, v = (np.bincount(views, each)[views] for each in (x, y))
    return np.arctan2(u * y - v * x, u * x + v * y)


def _ring_numbers(polar: Array, views: IntArray) -> IntArray:
    """Return the number of the ring (N,) of each point: equal view and polar angle."""
    order = _sorted_within(views, polar)
    rings = np.zeros(len(polar), int)
    rings[order[1:]] = np.cumsum((np.diff(polar[order]) > RING_GAP) | (np.diff(views[order]) != 0))
    return rings


def _sorted_within(groups: IntArray, angles: Array) -> IntArray:
    """Return the order (N,) by groups, and in a group by angles, rad; as `numpy.lexsort`, at half the cost."""
    return np.argsort(angles + 8.0 * groups, kind="stable")


def _turns_by_half_a_step(azimuth: Array, rings: IntArray) -> Array:
    """Return the turns (N,) of points by half their ring's median step: of the ends of rings, outwards; 0 of others.

    Args:
        azimuth: (N,), ascending in each ring.
        rings: (N,), numbers of the rings, ascending.
    """
    turns = np.zeros(len(azimuth))
    first = np.flatnonzero(np.diff(rings, prepend=-1))
    last = np.append(first[1:], len(rings))[: len(first)] - 1
    inside = np.diff(rings) == 0
    steps, of = np.diff(azimuth)[inside], rings[1:][inside]
    ranked = steps[_sorted_within(of, steps)]
    several = last > first
    turns[first[~several]] = np.nan
    before = (first - np.arange(len(first)))[several]  # number of steps of the rings before it
    count = (last - first)[several]
    half_step = 0.25 * (ranked[before + (count - 1) // 2] + ranked[before + count // 2])
    turns[first[several]], turns[last[several]] = -half_step, half_step
    return turns


def depth_border_rays(points: Array, limits: IntArray, camera: Camera) -> Array:
    """Return points on the rays to the border, one for each limit point, as accurately as the pixels allow.

    A limit pixel is the last one *on* the pattern of its row or column, whichever crosses the border
    more steeply: the border runs somewhere between it and the next pixel of that row or column, on
    average half a pixel farther out. So each is moved by half a pixel along that axis, away from the
    pattern; the depth is kept.

    Where a border runs along the rows or columns so well that no step from one to the next is near,
    all its pixels have the same error, of up to half a pixel, which does not average out: they are
    rejected. The errors of those around a step average to zero.

    Args:
        points: (N, 3), the points on the pattern in the optical frame, m.
        limits: (L,), indices of those on the border.
        camera: the intrinsics.

    Returns:
        (L, 3); NaN if the limit pixels around one do not locate the border: no step, a corner, a gap.
    """
    pixels = np.rint(camera.project(points[limits]))
    step = _outward_steps(pixels, camera.project(points).mean(axis=0))
    x, y = camera.normalise(pixels + 0.5 * step).T
    z = np.where(np.isnan(x), np.nan, points[limits, 2])
    return np.stack([x * z, y * z, z], -1)


def _outward_steps(pixels: Array, centre: Array) -> Array:
    """Return the unit step (L, 2) along rows or columns out of a convex region at its border pixels; else NaN."""
    if len(pixels) < 2 * PIXELS_ON_EITHER_SIDE + 1:
        return np.full_like(pixels, np.nan)
    order = np.argsort(np.arctan2(*(pixels - centre).T[::-1]), kind="stable")
    around = pixels[order]
    after, before = (
        np.roll(around, -PIXELS_ON_EITHER_SIDE, axis=0) - around,
        around - np.roll(around, PIXELS_ON_EITHER_SIDE, axis=0),
    )
    along = after + before
    normal = np.stack([along[:, 1], -along[:, 0]], -1)  # outward: with y down, angles grow clockwise
    straight = (after * before).sum(-1) > MIN_COSINE_IF_STRAIGHT * np.linalg.norm(after, axis=-1) * np.linalg.norm(
        before, axis=-1
    )
    rows = np.abs(normal[:, 0]) > np.abs(normal[:, 1])
    step = np.where(np.stack([rows, ~rows], -1), np.sign(normal), 0.0)
    out = np.empty_like(pixels)
    stepped = (along != 0).all(-1)
    out[order] = np.where((straight & stepped)[:, None], step, np.nan)
    return out


MIN_COSINE_OF_INCIDENCE = 0.05
"""Cosine of incidence below which the intersection of a ray and a plane is unreliable (3 degrees)."""


@dataclass(frozen=True, eq=False)
class _Rays:
    """Rays to points on a pattern, one residual each."""

    rays: Array
    """(V, 3, L): unit directions in the sensor's frame; arbitrary without a point."""
    ranges: Array
    """(V, L): measured ranges, m."""
    present: BoolArray
    """(V, L)."""

    dimension: ClassVar[int] = 1

    @cached_property
    def counts(self) -> IntArray:
        """(V,): number of points in each view."""
        return np.asarray(np.count_nonzero(self.present, axis=-1))

    @property
    def length(self) -> int:
        """L."""
        return int(self.rays.shape[-1])

    @cached_property
    def _end_of_points(self) -> IntArray:
        """(V,): the place after each view's last point; at least 1."""
        last = self.present.shape[-1] - self.present[:, ::-1].argmax(-1)
        return np.where(self.present.any(-1), last, 1)

    @cached_property
    def _order_by_end(self) -> IntArray:
        """(V,): the views by the place after their last point, so that in a chunk few places are empty."""
        return np.argsort(self._end_of_points, kind="stable")

    @cached_property
    def _in_order_of_ends(self) -> Self:
        """The term of the views in this order."""
        return self.take(self._order_by_end)

    @property
    def points(self) -> Array:
        """(V, 3, L): in the sensor's frame, m; arbitrary without a point."""
        return self.rays * self.ranges[:, None]

    def take(self, views: IntArray | slice) -> Self:
        """Return the term of only some of the views."""
        return replace(self, rays=self.rays[views], ranges=self.ranges[views], present=self.present[views])

    def seen_with(self, camera: Camera, free: Sequence[int]) -> Self:
        """See `views.Term`; a depth camera's data are points, independent of intrinsics."""
        return self


@dataclass(frozen=True, eq=False)
class RangeTerm(_Rays):
    """Points of a LiDAR or a depth camera on a pattern's plane: measured range minus that of the ray's intersection.

    The difference is along the ray, the direction of these sensors' noise, so that one standard deviation holds at
    every angle of incidence; for a grazing ray it is bounded (see `_Meeting`).

    The residual is ``h s`` over the standard deviation, which the twist changes by ``s (dh - f dc)``. With dh and dc as
    above that is ``-s (dt_z + y dw_x - x dw_y)``: the other three elements of the twist move the plane in itself.
    """

    kind: NoiseKind = "range"

    def linearise(self, T: Array, scale: float, huber: float | None, squares: Array | None = None) -> Linearised:
        """See `calibration.engine.estimation.residuals.views.Term`."""
        cost, H, g = np.empty(len(T)), np.zeros((len(T), 6, 6)), np.zeros((len(T), 6))
        threshold, variance, ordered = None if huber is None else huber * scale, scale * scale, self._in_order_of_ends
        for part in chunks(len(T), self.length):
            views, there = self._order_by_end[part], slice(0, int(ordered._end_of_points[part].max()))
            meeting = _Meeting(T[views], ordered.rays[part, :, there], ordered.ranges[part, there])
            present = ordered.present[part, there]
            cost[views], rows, squared = self._rows_of_distances(meeting, present, threshold)
            H[views, 2:5, 2:5], g[views, 2:5] = squeezed(rows)
            if squares is not None:
                squares[views, there] = np.where(present, squared, np.nan)
                squares[views, there.stop :] = np.nan
        return cost / variance, H / variance, g / variance

    def rows(self, T: Array, views: slice, scale: float, huber: float | None, spare: int = 0) -> tuple[Array, Array]:
        """See `calibration.engine.estimation.residuals.views.Term`."""
        meeting = _Meeting(T, self.rays[views], self.ranges[views])
        rows = (
            self._rows_of_distances(meeting, self.present[views], None if huber is None else huber * scale)[1] / scale
        )
        out = np.empty((7 + spare, len(T), 1, self.length))
        out[:2] = out[5] = 0.0
        out[2:5, :, 0], out[-1, :, 0] = np.swapaxes(rows[:, :3], 0, 1), rows[:, 3]
        return out, meeting.hits

    def magnitudes(self, T: Array) -> Array:
        """(V, L): absolute range error in m; NaN without a point."""
        meeting = _Meeting(T, self.rays, self.ranges)
        return np.where(self.present, np.abs(meeting.height * meeting.slope), np.nan)

    @staticmethod
    def _rows_of_distances(
        meeting: "_Meeting", present: BoolArray, threshold: float | None
    ) -> tuple[Array, Array, Array]:
        """Return cost (v,), weighted rows (v, 4, L) and squared residuals (v, L), all of residuals in m.

        The rows are those by dt_z, dw_x and dw_y, and the residuals.

        Args:
            meeting: of the rays with the plane.
            present: (v, L).
            threshold: of Huber's loss, m.
        """
        residuals = np.where(present, meeting.height * meeting.slope, 0.0)
        squared = residuals * residuals
        cost, of_loss = robust(squared, threshold)
        weight = present.astype(float) if of_loss is None else present * of_loss
        rows = np.empty((len(residuals), 4, residuals.shape[-1]))
        x, y = meeting.in_plane
        slope = meeting.slope * weight
        np.negative(slope, out=rows[:, 0])
        np.multiply(rows[:, 0], y, out=rows[:, 1])
        np.multiply(slope, x, out=rows[:, 2])
        np.multiply(residuals, weight, out=rows[:, 3])
        return cost, rows, squared


@dataclass(frozen=True, eq=False)
class BorderTerm(_Rays):
    """Rays to a pattern's border: distance of their intersections with the plane from the nearest border line.

    The intersection depends on the ray's direction alone, so the range noise has no effect. The
    rays point to the *expected* position of the border: half a step of a LiDAR's scan, or half a pixel of a
    depth camera, beyond the last point on the pattern (`border_rays`). The uncertainty is within the step, an angle:
    so the in-plane distance is divided by the range, and one standard deviation holds at every range.
    """

    normals: Array
    """(4, 2): outward unit normals of the border's lines, in the pattern's plane."""
    offsets: Array
    """(4,): the lines are ``normal . (x, y) = offset``, relative to the pattern's centre, m."""
    kind: NoiseKind = "border"

    def linearise(self, T: Array, scale: float, huber: float | None, squares: Array | None = None) -> Linearised:
        """See `calibration.engine.estimation.residuals.views.Term`.

        The nearest border line has the outward unit normal m in the plane and the distance o from the centre; the
        residual is the distance ``m . x - o``, over l and the standard deviation. The twist changes it by::

            df = c s^2 dh + h s^2 (1 - 2 c^2 s^2) dc
            dx = -dt - dw x x - u df
        """
        cost, rows, _ = self._weighted_rows(T, scale, huber, squares)
        return cost, *squeezed(rows)

    def rows(self, T: Array, views: slice, scale: float, huber: float | None, spare: int = 0) -> tuple[Array, Array]:
        """See `calibration.engine.estimation.residuals.views.Term`; on the nearest border line."""
        _, rows, places = self.take(views)._weighted_rows(T, scale, huber)
        return spread(rows, np.empty((7 + spare, len(T), rows.shape[-1])))[:, :, None], places

    def _weighted_rows(
        self, T: Array, scale: float, huber: float | None, squares: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return cost (V,) and rows (V, 7, L), as derived in `linearise`; places on the border (V, 3, L)."""
        meeting = _Meeting(T, self.rays, self.ranges)
        u, q, x = meeting.directions, meeting.points, meeting.hits
        signed, mx, my = self._distances_to_border(x)
        along = mx * u[:, 0] + my * u[:, 1]
        square = meeting.slope**2
        by_height = along * meeting.cosine * square  # -m . dx by dh and by dc
        by_cosine = along * meeting.height * square * (1 - 2 * meeting.cosine**2 * square)
        J = np.empty((len(T), 7, signed.shape[-1]))
        J[:, 0], J[:, 1], J[:, 2] = -mx, -my, by_height
        J[:, 3] = by_height * q[:, 1] + by_cosine * u[:, 1] + my * x[:, 2]
        J[:, 4] = -by_height * q[:, 0] - by_cosine * u[:, 0] - mx * x[:, 2]
        J[:, 5] = mx * x[:, 1] - my * x[:, 0]
        J[:, 6] = signed
        J /= (scale * self.ranges)[:, None]
        if squares is not None:
            squares[:] = np.where(self.present, (signed / self.ranges) ** 2, np.nan)
        J[:, 6] = np.where(self.present, J[:, 6], 0.0)
        cost, weight = robust(J[:, 6] ** 2, huber)
        J *= (self.present if weight is None else self.present * weight)[:, None]
        x[:, 0] -= signed * mx
        x[:, 1] -= signed * my
        return cost, J, x

    def magnitudes(self, T: Array) -> Array:
        """(V, L): distance to the nearest border line over the range, rad; NaN without a ray."""
        signed, _, _ = self._distances_to_border(_Meeting(T, self.rays, self.ranges).hits)
        return np.where(self.present, np.abs(signed) / self.ranges, np.nan)

    def _distances_to_border(self, places: Array) -> tuple[Array, Array, Array]:
        """Return the signed distance (V, L) of places (V, 3, L) to the nearest border line, positive outside.

        And x and y (V, L) of that line's outward normal.
        """
        x, y = places[:, 0], places[:, 1]
        all_lines = self.normals @ places[:, :2] - self.offsets[:, None]  # (V, 4, L)
        side = np.abs(all_lines).argmin(1)
        mx, my = self.normals[:, 0].take(side), self.normals[:, 1].take(side)
        return mx * x + my * y - self.offsets.take(side), mx, my


class _Meeting:
    """Intersections of rays with the patterns' planes, in the patterns' frames.

    Exactly, a ray at the height h over the plane, at its measured range, has ``h / cosine`` left to go.
    That is unbounded for a ray along the plane, as with a bad initial guess; so 1 / cosine
    is replaced by ``cosine / (cosine^2 + GRAZING^2)``, and where only its magnitude matters by the root of
    ``1 / (cosine^2 + GRAZING^2)``: nearly equal for all other rays, and smooth and finite for every pose.
    """

    def __init__(self, T: Array, rays: Array, ranges: Array) -> None:
        to_pattern = np.swapaxes(T[:, :3, :3], 1, 2)
        self._origin = -(to_pattern @ T[:, :3, 3:])
        self._ranges = ranges
        self.directions = to_pattern @ rays
        """(v, 3, L): of the rays."""
        self.cosine = self.directions[:, 2]
        """(v, L)."""
        self.height = ranges * self.cosine + self._origin[:, 2]
        """(v, L): height of the measured point over the plane, m; with the cosine's sign for points behind it."""
        self.slope = 1.0 / np.sqrt(self.cosine * self.cosine + MIN_COSINE_OF_INCIDENCE**2)
        """(v, L): slightly less than 1 / |cosine|."""

    @cached_property
    def _length_to_plane(self) -> Array:
        """(v, L): length of the rays to the plane, m."""
        return np.asarray(self._ranges - self.height * self.cosine * (self.slope * self.slope))

    @property
    def in_plane(self) -> tuple[Array, Array]:
        """The intersections of the rays with the plane: their x and y (v, L)."""
        x, y = (self._origin[:, i] + self._length_to_plane * self.directions[:, i] for i in range(2))
        return x, y

    @cached_property
    def hits(self) -> Array:
        """(v, 3, L): the intersections."""
        return self._origin + self._length_to_plane[:, None] * self.directions

    @property
    def points(self) -> Array:
        """(v, 3, L): the measured points."""
        return self._origin + self._ranges[:, None] * self.directions


def elevations(rays: Array) -> Array:
    """Return the angles (..., L) of rays (..., 3, L) over the sensor's xy plane, rad."""
    x, y, z = np.moveaxis(rays, -2, 0)
    return np.asarray(np.arctan2(z, np.hypot(x, y)))
