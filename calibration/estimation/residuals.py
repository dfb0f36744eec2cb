"""Residuals of a view's labels, with their Jacobians reduced to a 6x6 matrix and a 6-vector.

Every label of a view depends on one rigid pose ``T_sensor_pattern``. So its residuals are
differentiated by a twist of that pose in the *sensor's* frame, once, and only the
Hessian ``J^T J`` (6x6), the gradient ``J^T r`` (6) and the cost leave this module, whatever the
chain behind the pose. Free intrinsics of a camera are further columns of the same rows.
Points are stored as structure of arrays, and processed in chunks of views that fit into the processor's cache.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import ClassVar, Literal, Self

import numpy as np

from calibration.dataset.modalities import NoiseKind
from calibration.estimation.planar_pose import planar_poses
from calibration.frozen import frozen
from calibration.geometry import rotations
from calibration.geometry.cameras import Camera
from calibration.geometry.distortion import LAST_STEP
from calibration.geometry.types import Array, BoolArray, IntArray

CHUNK = 6400
"""Labels per chunk: the rows of 128 views of 50 corners fit into a second-level cache."""

ROUGH_STEP = 1e-3
"""Termination of `calibration.geometry.distortion.Distortion.undistort` for an initial guess: accurate to 1e-6."""
Linearised = tuple[Array, Array, Array]


# glibc maps fresh pages for every array above a threshold, and mapping them costs more than filling them. The threshold
# rises to the size of an array that is freed (M_MMAP_THRESHOLD in mallopt(3)): arrays up to 16 MB now reuse pages.
np.empty(16 << 20, np.uint8)


@frozen(eq=False)
class CornerTerm:
    """Corners of a pattern in a camera's images: reprojection errors in pixels."""

    camera: Camera
    """After `side_by_side`, its numbers are arrays (V, 1), one for each view."""
    corners: Array
    """(K, 3): relative to the pattern's centre; (V, K, 3) if views are of several patterns."""
    pixels: Array
    """(V, 2, K): structure of arrays; arbitrary where a corner is not seen."""
    seen: BoolArray | None
    """(V, K); None if every view sees every corner."""

    free: tuple[int, ...] = ()
    """Free intrinsics, by their indices in `Camera.intrinsics`."""
    kind: NoiseKind = "pixel"
    dimension: int = 2

    @cached_property
    def counts(self) -> IntArray:
        """(V,): number of corners seen in each view."""
        V, _, K = self.pixels.shape
        return np.full(V, K) if self.seen is None else np.asarray(np.count_nonzero(self.seen, axis=-1))

    @property
    def length(self) -> int:
        """K."""
        return int(self.pixels.shape[-1])

    @property
    def rays(self) -> Array:
        """(V, 2, K): labels as undistorted normalised coordinates."""
        return self._rays(slice(None), LAST_STEP)

    def _rays(self, views: slice, step: float) -> Array:
        camera, pixels = self.camera, self.pixels[views]
        x, y = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
        return np.stack(camera.distortion.undistort(x, y, step), 1)

    @cached_property
    def linear_poses(self) -> Array:
        """``T_camera_centre`` (V, 4, 4) of each view by its homography; NaN where its corners give none."""
        T = np.empty((len(self.pixels), 4, 4))
        for views in chunks(*self.pixels.shape[::2]):
            rays = self._rays(views, ROUGH_STEP)
            seen = None if self.seen is None else self.seen[views]
            if np.isnan(rays).any():  # a label where the distortion has no inverse must not cost its whole view
                usable: BoolArray = np.asarray(np.isfinite(rays).all(1))
                seen = usable if seen is None else seen & usable
            T[views] = planar_poses(rays, self.corners, seen)
        return T

    def take(self, views: IntArray | slice) -> "CornerTerm":
        """Return the term of only some of the views."""
        return replace(self, pixels=self.pixels[views], seen=None if self.seen is None else self.seen[views])

    def seen_with(self, camera: Camera, free: Sequence[int]) -> "CornerTerm":
        """See `calibration.estimation.views.Term`."""
        return replace(self, camera=camera, free=tuple(free))

    def linearise(self, T: Array, scale: float, huber: float | None, squares: Array | None = None) -> Linearised:
        """See `calibration.estimation.views.Term`."""
        size = 6 + len(self.free)
        cost, H, g = np.empty(len(T)), np.empty((len(T), size, size)), np.empty((len(T), size))
        K = self.pixels.shape[-1]
        for part in chunks(len(T), K):
            rows = np.empty((len(T[part]), size + 1, 2, K))
            into = None if squares is None else squares[part]
            cost[part] = self._fill(rows, T[part], part, scale, huber, into)
            H[part], g[part] = _squeezed(rows.reshape(len(rows), size + 1, -1))
        return cost, H, g

    def rows(self, T: Array, scale: float, huber: float | None, spare: int = 0) -> Array:
        """See `calibration.estimation.views.Term`."""
        out = np.empty((len(T), 7 + len(self.free) + spare, 2, self.pixels.shape[-1]))
        for part in chunks(len(T), self.pixels.shape[-1]):
            self._fill(out[part], T[part], part, scale, huber)
        return out

    def places(self, T: Array) -> Array:
        """See `calibration.estimation.views.Term`."""
        return np.broadcast_to(np.swapaxes(self.corners, -1, -2), (len(T), 3, self.pixels.shape[-1]))

    def magnitudes(self, T: Array) -> Array:
        """(V, K): distance from each label to the projected corner (px); NaN if not seen or behind."""
        out = np.empty((len(T), self.pixels.shape[-1]))
        for part in chunks(len(T), self.pixels.shape[-1]):
            seen = None if self.seen is None else self.seen[part]
            x, y, _, front = self._normalised(T[part], seen)
            xd, yd = self.camera.distortion.distort(x, y)
            u = self.camera.fx * xd + (self.camera.cx - self.pixels[part, 0])
            v = self.camera.fy * yd + (self.camera.cy - self.pixels[part, 1])
            out[part] = np.where(front, np.sqrt(u * u + v * v), np.nan)
        return out if self.seen is None else np.where(self.seen, out, np.nan)

    def _normalised(self, T: Array, seen: BoolArray | None) -> tuple[Array, Array, Array, BoolArray]:
        """Return normalised coordinates x, y and inverse depth (v, K), and a mask of points in front of the camera."""
        P = T[:, :3, :3] @ np.swapaxes(self.corners, -1, -2) + T[:, :3, 3:]
        z = P[:, 2]
        front = z > 1e-6
        if seen is not None or not front.all():
            z = np.where(front, z, 1.0)
        inverse_z = 1.0 / z
        return P[:, 0] * inverse_z, P[:, 1] * inverse_z, inverse_z, front

    def _fill(
        self, rows: Array, T: Array, part: slice, scale: float, huber: float | None, squares: Array | None = None
    ) -> Array:
        """Fill the first 6 + m and the last of weighted rows (v, r, 2, K) of a part of the views; their cost (v,)."""
        pixels, seen = self.pixels[part], None if self.seen is None else self.seen[part]
        camera = self.camera
        fx, fy = camera.fx / scale, camera.fy / scale
        x, y, inverse_z, front = self._normalised(T, seen)
        xd, yd = x, y
        if camera.distortion.is_identity:
            ru, rv = fx * x, fy * y
            ux: Array | float = fx
            uy: Array | float = 0.0
            vx: Array | float = 0.0
            vy: Array | float = fy
        else:
            (xd, yd), (xx, xy, yy) = camera.distortion.distort_with_jacobian(x, y)
            ru, rv = fx * xd, fy * yd
            ux, uy, vx, vy = fx * xx, fx * xy, fy * xy, fy * yy
        ru += (camera.cx - pixels[:, 0]) / scale
        rv += (camera.cy - pixels[:, 1]) / scale
        if seen is not None:
            ru, rv = np.where(seen, ru, 0.0), np.where(seen, rv, 0.0)
        squared = ru * ru + rv * rv
        cost, weight = robust(squared, huber)
        if squares is not None:
            np.multiply(squared, scale * scale, out=squares)
            if seen is not None or not front.all():
                squares[~front if seen is None else ~(seen & front)] = np.nan
        behind = ~front if seen is None else seen & ~front
        if behind.any():
            cost = np.where(behind.any(-1), np.inf, cost)
        if seen is not None:
            weight = seen.astype(float) if weight is None else weight * seen
        _corner_rows(rows[:, :, 0], ux, uy, ru, x, y, inverse_z, weight)
        _corner_rows(rows[:, :, 1], vx, vy, rv, x, y, inverse_z, weight)
        if self.free:
            own = rows[:, 6 : 6 + len(self.free)]
            self._intrinsics_rows(own, x, y, xd, yd, scale)
            if weight is not None:
                own *= weight[:, None, None]
        return cost

    def _intrinsics_rows(self, rows: Array, x: Array, y: Array, xd: Array, yd: Array, scale: float) -> None:
        """Fill (v, m, 2, K) rows: the derivative of both image axes by each of the free intrinsics."""
        fx, fy = self.camera.fx / scale, self.camera.fy / scale
        coefficients = self.camera.distortion.derivatives(x, y) if max(self.free) > 3 else []
        for k, parameter in enumerate(self.free):
            if parameter > 3:
                dx, dy = coefficients[parameter - 4]
                np.multiply(dx, fx, out=rows[:, k, 0])
                np.multiply(dy, fy, out=rows[:, k, 1])
            else:
                axis = parameter % 2
                rows[:, k, 1 - axis] = 0.0
                if parameter < 2:
                    np.divide(yd if axis else xd, scale, out=rows[:, k, axis])
                else:
                    rows[:, k, axis] = 1 / scale


def side_by_side(terms: Sequence[CornerTerm]) -> CornerTerm:
    """Concatenate few views of several cameras and patterns to one term, to be linearised in one pass.

    Args:
        terms: of cameras with the same model of distortion; about `CHUNK` labels together.
    """
    counts = [len(term.pixels) for term in terms]
    K = max(term.pixels.shape[-1] for term in terms)
    pixels, seen = np.zeros((sum(counts), 2, K)), np.zeros((sum(counts), K), bool)
    start = 0
    for term, count in zip(terms, counts, strict=True):
        part, own = slice(start, start + count), slice(term.pixels.shape[-1])
        pixels[part, :, own], seen[part, own] = term.pixels, True if term.seen is None else term.seen
        start += count
    first = terms[0]
    return replace(
        first,
        camera=first.camera if all(term.camera == first.camera for term in terms) else _camera_of_views(terms, counts),
        corners=_corners_of_views(terms, counts, K),
        pixels=pixels,
        seen=None if seen.all() else seen,
    )


def _camera_of_views(terms: Sequence[CornerTerm], counts: Sequence[int]) -> Camera:
    """Return several cameras as one with arrays (V, 1) as its numbers."""
    numbers = np.repeat([term.camera.intrinsics for term in terms], counts, axis=0).T[..., None]
    model = type(terms[0].camera.distortion)
    fx, fy, cx, cy = numbers[:4]
    return replace(terms[0].camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=model(*numbers[4:]))


def _corners_of_views(terms: Sequence[CornerTerm], counts: Sequence[int], K: int) -> Array:
    """Return (K, 3) if all patterns are equal, else (V, K, 3), padded with zeros."""
    if all(np.array_equal(term.corners, terms[0].corners) for term in terms):
        return terms[0].corners
    filled = [np.pad(term.corners, ((0, K - len(term.corners)), (0, 0))) for term in terms]
    return np.repeat(filled, counts, axis=0)


def _corner_rows(
    rows: Array,
    jx: Array | float,
    jy: Array | float,
    r: Array,
    x: Array,
    y: Array,
    inverse_z: Array,
    weight: Array | None,
) -> None:
    """Fill (v, 7 + m, K) rows: the first six by the derivative of an image axis by the twist, the last by the residual.

    (jx, jy) is its derivative by the normalised coordinates. For a point p moved by dt + dw x p:
    d/dp = (jx, jy, -(jx x + jy y)) / z, and d/dw = p x d/dp, in which z cancels.
    """
    if weight is not None:
        jx, jy, r = jx * weight, jy * weight, r * weight
    jz = -(jx * x + jy * y)
    rows[:, 0] = jx * inverse_z
    rows[:, 1] = jy * inverse_z
    rows[:, 2] = jz * inverse_z
    rows[:, 3] = jz * y - jy
    rows[:, 4] = jx - jz * x
    rows[:, 5] = jy * x - jx * y
    rows[:, -1] = r


@frozen(eq=False)
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
    def _ends(self) -> IntArray:
        """(V,): the place after each view's last point; at least 1."""
        last = self.present.shape[-1] - self.present[:, ::-1].argmax(-1)
        return np.where(self.present.any(-1), last, 1)

    @property
    def points(self) -> Array:
        """(V, 3, L): in the sensor's frame, m; arbitrary without a point."""
        return self.rays * self.ranges[:, None]

    def take(self, views: IntArray | slice) -> Self:
        """Return the term of only some of the views."""
        return replace(self, rays=self.rays[views], ranges=self.ranges[views], present=self.present[views])

    def seen_with(self, camera: Camera, free: Sequence[int]) -> Self:
        """See `calibration.estimation.views.Term`; a depth camera's data are points, independent of intrinsics."""
        return self


@frozen(eq=False)
class RangeTerm(_Rays):
    """Points of a LiDAR or a depth camera on a pattern's plane: measured range minus that of the ray's intersection.

    The difference is along the ray, the direction of these sensors' noise, so that one standard deviation holds at
    every angle of incidence; for a grazing ray it is bounded (see `_Meeting`).
    """

    kind: NoiseKind = "range"

    def linearise(self, T: Array, scale: float, huber: float | None, squares: Array | None = None) -> Linearised:
        """See `calibration.estimation.views.Term`."""
        cost, H, g = np.empty(len(T)), np.empty((len(T), 6, 6)), np.empty((len(T), 6))
        for part in chunks(len(T), self.rays.shape[-1]):
            there = slice(0, int(self._ends[part].max()))
            meeting = _Meeting(T[part], self.rays[part, :, there], self.ranges[part, there])
            present = self.present[part, there]
            cost[part], G = _range_products(meeting, present, scale, huber)
            H[part], g[part] = G[:, :-1, :-1], G[:, :-1, -1]
            if squares is not None:
                squares[part, there] = np.where(present, (meeting.height * meeting.slope) ** 2, np.nan)
                squares[part, there.stop :] = np.nan
        return cost, H, g

    def rows(self, T: Array, scale: float, huber: float | None, spare: int = 0) -> Array:
        """See `calibration.estimation.views.Term`."""
        out = np.empty((len(T), 7 + spare, 1, self.rays.shape[-1]))
        for part in chunks(len(T), self.rays.shape[-1]):
            meeting = _Meeting(T[part], self.rays[part], self.ranges[part])
            _spread(_range_rows(meeting, self.present[part], scale, huber)[1], out[part, :, 0])
        return out

    def places(self, T: Array) -> Array:
        """See `calibration.estimation.views.Term`."""
        return _in_pattern(T, _Meeting(T, self.rays, self.ranges).hits)

    def magnitudes(self, T: Array) -> Array:
        """(V, L): absolute range error in m; NaN without a point."""
        meeting = _Meeting(T, self.rays, self.ranges)
        return np.where(self.present, np.abs(meeting.height * meeting.slope), np.nan)


@frozen(eq=False)
class BorderTerm(_Rays):
    """Rays to a pattern's border: distance of their intersections with the plane from the nearest border line.

    The intersection depends on the ray's direction alone, so the range noise has no effect. The
    rays point to the *expected* position of the border: half a step of a LiDAR's scan, or half a pixel of a
    depth camera, beyond the last point on the pattern (see `calibration.estimation.scan` and
    `calibration.estimation.depth_border`). The uncertainty is within the step, an angle: so the in-plane
    distance is divided by the range, and one standard deviation holds at every range.
    """

    normals: Array
    """(4, 2): outward unit normals of the border's lines, in the pattern's plane."""
    offsets: Array
    """(4,): the lines are ``normal . (x, y) = offset``, relative to the pattern's centre, m."""
    kind: NoiseKind = "border"

    def linearise(self, T: Array, scale: float, huber: float | None, squares: Array | None = None) -> Linearised:
        """See `calibration.estimation.views.Term`.

        All in the sensor's frame: the plane has the unit normal n and the centre p; a ray has the unit direction u and
        the measured range l; the nearest border line has the outward unit normal m and the distance o from the centre.
        The ray meets the plane at x, and the residual is the distance d from the line to x, over l ``scale``::

            c = n . u,  h = l c - n . p      cosine of incidence, height of the measured point over the plane
            f = h c s^2,  x = (l - f) u      s^2 = 1 / (c^2 + GRAZING^2), so that f is nearly h / c; see `_Meeting`
            d = m . (x - p) - o

        A twist (dt, dw) of the pose moves p by ``dt + dw x p``, and n and m by ``dw x n`` and ``dw x m``. So::

            dc = (n x u) . dw
            dh = l dc - n . dt               as a rotation keeps n . p
            df = c s^2 dh + h s^2 (1 - 2 c^2 s^2) dc
            dd = -(m . u) df - m . dt - (x x m) . dw
               = (falls n - m) . dt + (turns (n x u) - x x m) . dw

        with ``falls = (m . u) c s^2`` and ``turns = (m . u) h s^2 (2 c^2 s^2 - 1) - falls l``.
        """
        cost, rows = self._weighted_rows(T, scale, huber, squares)
        return cost, *_squeezed(rows)

    def rows(self, T: Array, scale: float, huber: float | None, spare: int = 0) -> Array:
        """See `calibration.estimation.views.Term`."""
        rows = self._weighted_rows(T, scale, huber)[1]
        return _spread(rows, np.empty((len(T), 7 + spare, rows.shape[-1])))[:, :, None]

    def places(self, T: Array) -> Array:
        """See `calibration.estimation.views.Term`; on the nearest border line."""
        hits = _Meeting(T, self.rays, self.ranges).hits
        signed, side = self._distances(T, hits)
        local = _in_pattern(T, hits)
        local[:, :2] -= signed[:, None] * np.moveaxis(self.normals[side], -1, 1)
        return local

    def _weighted_rows(
        self, T: Array, scale: float, huber: float | None, squares: Array | None = None
    ) -> tuple[Array, Array]:
        """Return cost (V,) and rows (V, 7, L), as derived in `linearise`."""
        meeting = _Meeting(T, self.rays, self.ranges)
        signed, side = self._distances(T, meeting.hits)
        m = np.einsum("vij,vlj->vil", T[:, :3, :2], self.normals[side])
        along = (m * meeting.rays).sum(1)
        square = meeting.slope**2
        falls = along * meeting.cosine * square
        turns = along * meeting.height * square * (2 * meeting.cosine**2 * square - 1) - falls * meeting.ranges
        J = np.empty((len(T), 7, m.shape[-1]))
        J[:, :3] = falls[:, None] * meeting.n - m
        J[:, 3:6] = turns[:, None] * meeting.d_cosine - _cross(meeting.hits, m)
        J[:, 6] = signed
        J /= (scale * self.ranges)[:, None]
        if squares is not None:
            squares[:] = np.where(self.present, (signed / self.ranges) ** 2, np.nan)
        return _weighted(J, self.present, huber), J

    def magnitudes(self, T: Array) -> Array:
        """(V, L): distance to the nearest border line over the range, rad; NaN without a ray."""
        signed, _ = self._distances(T, _Meeting(T, self.rays, self.ranges).hits)
        return np.where(self.present, np.abs(signed) / self.ranges, np.nan)

    def _distances(self, T: Array, points: Array) -> tuple[Array, IntArray]:
        """Return the signed distance (V, L) of points (V, 3, L) to the nearest border line, positive outside; which."""
        local = np.swapaxes(T[:, :3, :2], 1, 2) @ (points - T[:, :3, 3:])
        signed = np.einsum("si,vil->vls", self.normals, local) - self.offsets
        side = np.abs(signed).argmin(-1)
        return np.take_along_axis(signed, side[..., None], -1)[..., 0], side


@frozen(eq=False)
class PoseTerm:
    """Measured poses of a pattern: difference of position, or of orientation, along the sensor's axes.

    The two are separate terms, since they have different noise.
    """

    measured: Array
    """(V, 4, 4): ``T_sensor_pattern``, of the pattern's centre."""
    kind: Literal["pose_translation", "pose_rotation"]
    dimension: ClassVar[int] = 3

    @cached_property
    def counts(self) -> IntArray:
        """(V,): one label in each view."""
        return np.ones(len(self.measured), int)

    @property
    def length(self) -> int:
        """One."""
        return 1

    def take(self, views: IntArray | slice) -> Self:
        """Return the term of only some of the views."""
        return replace(self, measured=self.measured[views])

    def seen_with(self, camera: Camera, free: Sequence[int]) -> Self:
        """See `calibration.estimation.views.Term`; a pose has no intrinsics."""
        return self

    def linearise(self, T: Array, scale: float, huber: float | None, squares: Array | None = None) -> Linearised:
        """See `calibration.estimation.views.Term`."""
        cost, rows = self._weighted_rows(T, scale, huber)
        if squares is not None:
            squares[:] = self.magnitudes(T) ** 2
        return cost, *_squeezed(rows)

    def rows(self, T: Array, scale: float, huber: float | None, spare: int = 0) -> Array:
        """See `calibration.estimation.views.Term`."""
        return _spread(self._weighted_rows(T, scale, huber)[1], np.empty((len(T), 7 + spare, 3)))[..., None]

    def places(self, T: Array) -> Array:
        """See `calibration.estimation.views.Term`: the pattern's centre."""
        return np.zeros((len(T), 3, 1))

    def magnitudes(self, T: Array) -> Array:
        """(V, 1): distance in m, or angle in rad."""
        norms: Array = np.linalg.norm(self._residuals(T), axis=-1, keepdims=True)
        return norms

    def _residuals(self, T: Array) -> Array:
        """(V, 3): m, or a rotation vector, in the sensor's frame."""
        if self.kind == "pose_translation":
            return np.asarray(T[:, :3, 3] - self.measured[:, :3, 3])
        return rotations.log(T[:, :3, :3] @ np.swapaxes(self.measured[:, :3, :3], 1, 2))

    def _weighted_rows(self, T: Array, scale: float, huber: float | None) -> tuple[Array, Array]:
        """Cost (V,) and rows (V, 7, 3).

        A twist (dt, dw) moves t by ``dt + dw x t``. It changes a rotation vector r by ``dw`` to first order in r, and
        along r exactly: the gradient has no error.
        """
        residuals = self._residuals(T)
        rows = np.zeros((len(T), 7, 3))
        if self.kind == "pose_translation":
            rows[:, :3] = np.eye(3)
            rows[:, 3:6] = rotations.hat(T[:, :3, 3])  # transposed: - hat(t)
        else:
            rows[:, 3:6] = np.eye(3)
        rows[:, 6] = residuals
        rows /= scale
        cost, weight = robust((rows[:, 6] ** 2).sum(-1, keepdims=True), huber)
        return cost, rows if weight is None else rows * weight[:, None]


GRAZING = 0.05
"""Cosine of incidence below which the intersection of a ray and a plane is unreliable (3 degrees)."""


class _Meeting:
    """Intersections of rays with the patterns' planes.

    Exactly, a ray at the height h over the plane, at its measured range, has ``h / cosine`` left to go.
    That is unbounded for a ray along the plane, as with a bad initial guess; so 1 / cosine
    is replaced by ``cosine / (cosine^2 + GRAZING^2)``, and where only its magnitude matters by the root of
    ``1 / (cosine^2 + GRAZING^2)``: nearly equal for all other rays, and smooth and finite for every pose.
    """

    def __init__(self, T: Array, rays: Array, ranges: Array) -> None:
        self.rays = rays
        self.ranges = ranges
        self.n = T[:, :3, 2, None]
        """(v, 3, 1): normal of the plane in the sensor's frame."""
        self.cosine = (T[:, None, :3, 2] @ rays)[:, 0]
        """(v, L)."""
        self.height = ranges * self.cosine - (T[:, :3, 2] * T[:, :3, 3]).sum(-1)[:, None]
        """(v, L): height of the measured point over the plane, m; with the cosine's sign for points behind it."""
        self.slope = 1.0 / np.sqrt(self.cosine * self.cosine + GRAZING**2)
        """(v, L): slightly less than 1 / |cosine|."""

    @cached_property
    def hits(self) -> Array:
        """(v, 3, L): intersections of the rays with the plane."""
        hits: Array = (self.ranges - self.height * self.cosine * self.slope**2)[:, None] * self.rays
        return hits

    @cached_property
    def d_cosine(self) -> Array:
        """(v, 3, L): derivative of the cosine by a rotation of the plane, ``n x ray``."""
        return _cross(self.n, self.rays)


def robust(squared: Array, huber: float | None) -> tuple[Array, Array | None]:
    """Return the cost (v,) of squared, normalised residuals (v, L), and the square root of their weights.

    Huber's loss: squared up to the threshold k, ``2 k e - k^2`` beyond it; its weight there is k / e.
    """
    if huber is None:
        return squared.sum(-1), None
    outside = squared > huber * huber
    if not outside.any():
        return squared.sum(-1), None
    e = np.sqrt(squared[outside])
    loss, weight = squared.copy(), np.ones_like(squared)
    loss[outside], weight[outside] = 2 * huber * e - huber * huber, np.sqrt(huber / e)
    return loss.sum(-1), weight


def _cross(a: Array, b: Array) -> Array:
    """Cross product of vectors (v, 3, L)."""
    (a0, a1, a2), (b0, b1, b2) = np.moveaxis(a, 1, 0), np.moveaxis(b, 1, 0)
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], 1)


def _in_pattern(T: Array, points: Array) -> Array:
    """Transform points (V, 3, L) from the sensor's frame to the pattern's, at its centre."""
    local: Array = np.swapaxes(T[:, :3, :3], 1, 2) @ (points - T[:, :3, 3:])
    return local


def _range_rows(meeting: _Meeting, present: BoolArray, scale: float, huber: float | None) -> tuple[Array, Array]:
    """Return cost (v,) and weighted rows (v, 7, L) of ranges.

    The plane's height under a point p changes by ``-n . (dt + dw x p)``, the cosine by ``(n x ray) . dw``.
    """
    rows = np.empty((len(meeting.rays), 7, meeting.rays.shape[-1]))
    slope = meeting.slope / scale
    rows[:, :3] = -meeting.n * slope[:, None]
    turns = slope * (meeting.ranges - meeting.height * meeting.cosine * meeting.slope * meeting.slope)
    rows[:, 3:6] = turns[:, None] * meeting.d_cosine
    rows[:, 6] = meeting.height * slope
    return _weighted(rows, present, huber), rows


def _range_products(meeting: _Meeting, present: BoolArray, scale: float, huber: float | None) -> tuple[Array, Array]:
    """Cost (v,) of ranges, and the products (v, 7, 7) of the rows that `_range_rows` gives, without these.

    Of a ray u they are ``(-n a, n x (b u), r)``, which is linear in the five numbers ``(a, b u, r)``: so these are
    multiplied, and of each view the matrix that makes rows of them comes before and after.
    """
    slope = meeting.slope / scale
    r = np.where(present, meeting.height * slope, 0.0)
    cost, of_loss = robust(r * r, huber)
    weight = present.astype(float) if of_loss is None else present * of_loss
    numbers = np.empty((len(r), 5, r.shape[-1]))
    np.multiply(slope, weight, out=numbers[:, 0])
    turns = numbers[:, 0] * (meeting.ranges - meeting.height * meeting.cosine * meeting.slope * meeting.slope)
    np.multiply(turns[:, None], meeting.rays, out=numbers[:, 1:4])
    np.multiply(r, weight, out=numbers[:, 4])
    n = meeting.n[..., 0]
    to_rows = np.zeros((len(r), 7, 5))
    to_rows[:, :3, 0] = -n
    to_rows[:, 3:6, 1:4] = rotations.hat(n)
    to_rows[:, 6, 4] = 1.0
    return cost, to_rows @ (numbers @ numbers.transpose(0, 2, 1)) @ to_rows.transpose(0, 2, 1)


def _weighted(rows: Array, present: BoolArray, huber: float | None) -> Array:
    """Multiply rows (v, 7, L), six of the Jacobian and the residual, by their weights, and return the cost (v,)."""
    rows[:, 6] = np.where(present, rows[:, 6], 0.0)
    cost, weight = robust(rows[:, 6] ** 2, huber)
    rows *= (present if weight is None else present * weight)[:, None]
    return cost


def _spread(rows: Array, out: Array) -> Array:
    """Rows (v, 7, L) as the first six and the last of more rows (v, r, L)."""
    out[:, :6], out[:, -1] = rows[:, :6], rows[:, 6]
    return out


def _squeezed(rows: Array) -> tuple[Array, Array]:
    """Return Hessian (v, p, p) and gradient (v, p) of weighted rows (v, p + 1, n): the Jacobian's, and the residual."""
    G = rows @ rows.transpose(0, 2, 1)
    return G[:, :-1, :-1], G[:, :-1, -1]


def chunks(views: int, labels: int) -> Iterator[slice]:
    """Yield parts of the views with about `CHUNK` labels each, at least one view."""
    step = max(1, CHUNK // max(1, labels))
    for start in range(0, views, step):
        yield slice(start, min(start + step, views))
