"""The labels of a view against its pose: squeezed to a 6x6 matrix and a 6-vector.

Every label of a view depends on one rigid pose ``T_sensor_pattern``. So its residuals are
differentiated with respect to a twist of that pose in the *sensor's* frame, once, and only the
Hessian ``J^T J`` (6x6), the gradient ``J^T r`` (6) and the cost leave this module, whatever the
chain behind the pose. Points are handled as structure of arrays, and views in chunks whose
temporaries stay in the processor's cache.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.estimation.problem import NoiseKind
from calibration.geometry.cameras import Camera
from calibration.geometry.types import Array, BoolArray, IntArray

CHUNK = 128
"""Views at a time: 128 views of 50 corners keep the 7 x 100 rows of each in a second-level cache."""

Linearised = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class CornerTerm:
    """Corners of a pattern in the images of a camera: reprojection errors in pixels."""

    camera: Camera
    corners: Array
    """(K, 3): about the pattern's centre."""
    pixels: Array
    """(V, 2, K): structure of arrays; anything where a corner is not seen."""
    seen: BoolArray | None
    """(V, K); None when every view sees every corner."""

    kind: NoiseKind = "pixel"
    dimension: int = 2

    @cached_property
    def counts(self) -> IntArray:
        """(V,): corners seen in each view."""
        V, _, K = self.pixels.shape
        return np.full(V, K) if self.seen is None else np.asarray(np.count_nonzero(self.seen, axis=-1))

    def linearise(self, T: Array, views: slice, scale: float, huber: float | None) -> Linearised:
        """See `calibration.estimation.problem.Term`."""
        pixels = self.pixels[views]
        seen = None if self.seen is None else self.seen[views]
        cost, H, g = np.empty(len(T)), np.empty((len(T), 6, 6)), np.empty((len(T), 6))
        for part in _chunks(len(T)):
            cost[part], H[part], g[part] = self._linearise(
                T[part], pixels[part], None if seen is None else seen[part], scale, huber
            )
        return cost, H, g

    def magnitudes(self, T: Array) -> Array:
        """(V, K): distance from each label to the projected corner (px); NaN where not seen or behind."""
        out = np.empty((len(T), len(self.corners)))
        for part in _chunks(len(T)):
            seen = None if self.seen is None else self.seen[part]
            x, y, _, front = self._normalised(T[part], seen)
            xd, yd = self.camera.distortion.distort(x, y)
            u = self.camera.fx * xd + (self.camera.cx - self.pixels[part, 0])
            v = self.camera.fy * yd + (self.camera.cy - self.pixels[part, 1])
            out[part] = np.where(front, np.hypot(u, v), np.nan)
        return out if self.seen is None else np.where(self.seen, out, np.nan)

    def _normalised(self, T: Array, seen: BoolArray | None) -> tuple[Array, Array, Array, BoolArray]:
        """Normalised coordinates x, y and inverse depth (v, K), and which lie in front of the camera."""
        P = T[:, :3, :3] @ self.corners.T + T[:, :3, 3:]
        z = P[:, 2]
        front = z > 1e-6
        if seen is not None or not front.all():
            z = np.where(front, z, 1.0)
        inverse_z = 1.0 / z
        return P[:, 0] * inverse_z, P[:, 1] * inverse_z, inverse_z, front

    def _linearise(
        self, T: Array, pixels: Array, seen: BoolArray | None, scale: float, huber: float | None
    ) -> Linearised:
        camera = self.camera
        fx, fy = camera.fx / scale, camera.fy / scale
        x, y, inverse_z, front = self._normalised(T, seen)
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
        cost, weight = robust(ru * ru + rv * rv, huber)
        behind = ~front if seen is None else seen & ~front
        if behind.any():
            cost = np.where(behind.any(-1), np.inf, cost)
        if seen is not None:
            weight = seen.astype(float) if weight is None else weight * seen
        rows = np.empty((len(T), 7, 2, len(self.corners)))
        _corner_rows(rows[:, :, 0], ux, uy, ru, x, y, inverse_z, weight)
        _corner_rows(rows[:, :, 1], vx, vy, rv, x, y, inverse_z, weight)
        J = rows.reshape(len(T), 7, -1)
        G = J @ J.transpose(0, 2, 1)
        return cost, G[:, :6, :6], G[:, :6, 6]


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
    """Fill (v, 7, K) rows: the derivative of one image axis to the twist, and the residual.

    (jx, jy) is its derivative to the normalised coordinates. For a point p moved by dt + dw x p:
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
    rows[:, 6] = r


@dataclass(frozen=True, eq=False)
class RangeTerm:
    """Points of a LiDAR on a pattern's plane: measured range minus the range at which the ray meets it.

    The difference is taken along the ray, where a LiDAR errs, so that one standard deviation holds at
    every angle of incidence.
    """

    rays: Array
    """(V, 3, L): unit directions in the sensor's frame; anything where there is no point."""
    ranges: Array
    """(V, L): m."""
    present: BoolArray
    """(V, L)."""

    kind: NoiseKind = "range"
    dimension: int = 1

    @cached_property
    def counts(self) -> IntArray:
        """(V,): points in each view."""
        return np.asarray(np.count_nonzero(self.present, axis=-1))

    def linearise(self, T: Array, views: slice, scale: float, huber: float | None) -> Linearised:
        """See `calibration.estimation.problem.Term`."""
        rays, present = self.rays[views], self.present[views]
        distance, cosine, hit = _meet(T, rays, present)
        residual = np.where(present, (self.ranges[views] - distance) / scale, 0.0)
        slope = 1.0 / (scale * cosine)
        h = -T[:, :3, 2, None] * slope[:, None]  # d(residual) = h . (dt + dw x point)
        return _plane_rows(h, distance[:, None] * rays, residual, present, hit, huber)

    def magnitudes(self, T: Array) -> Array:
        """(V, L): absolute range error in m; NaN where there is no point."""
        distance, _, _ = _meet(T, self.rays, self.present)
        return np.where(self.present, np.abs(self.ranges - distance), np.nan)


@dataclass(frozen=True, eq=False)
class BorderTerm:
    """Rays of a LiDAR that graze a pattern's border: in-plane distance to the nearest border line.

    Where the ray meets the plane follows from its direction alone, so the range noise stays out. The
    rays point to where the border is *expected*: half a step of the scan beyond the last point on
    the pattern (see `calibration.estimation.build`).
    """

    rays: Array
    """(V, 3, L): unit directions in the sensor's frame; anything where there is no ray."""
    present: BoolArray
    """(V, L)."""
    normals: Array
    """(4, 2): outward unit normals of the border's lines, in the pattern's plane."""
    offsets: Array
    """(4,): the lines are ``normal . (x, y) = offset``, about the pattern's centre, m."""

    kind: NoiseKind = "border"
    dimension: int = 1

    @cached_property
    def counts(self) -> IntArray:
        """(V,): rays in each view."""
        return np.asarray(np.count_nonzero(self.present, axis=-1))

    def linearise(self, T: Array, views: slice, scale: float, huber: float | None) -> Linearised:
        """See `calibration.estimation.problem.Term`."""
        rays, present = self.rays[views], self.present[views]
        distance, cosine, hit = _meet(T, rays, present)
        point = distance[:, None] * rays
        signed, side = self._distances(T, point)
        residual = np.where(present, signed / scale, 0.0)
        # the border's normal m in the sensor's frame; the hit slides along the ray to stay on the plane
        m = np.einsum("vij,vlj->vil", T[:, :3, :2], self.normals[side])
        n = T[:, :3, 2, None]
        slide = (m * rays).sum(1) / cosine
        h = (slide[:, None] * n - m) / scale
        return _plane_rows(h, point, residual, present, hit, huber)

    def magnitudes(self, T: Array) -> Array:
        """(V, L): distance to the nearest border line in m; NaN where there is no ray."""
        distance, _, _ = _meet(T, self.rays, self.present)
        signed, _ = self._distances(T, distance[:, None] * self.rays)
        return np.where(self.present, np.abs(signed), np.nan)

    def _distances(self, T: Array, points: Array) -> tuple[Array, IntArray]:
        """Signed distance (V, L) of points (V, 3, L) to the nearest border line, positive outside; which."""
        local = np.swapaxes(T[:, :3, :2], 1, 2) @ (points - T[:, :3, 3:])
        signed = np.einsum("si,vil->vls", self.normals, local) - self.offsets
        side = np.abs(signed).argmin(-1)
        return np.take_along_axis(signed, side[..., None], -1)[..., 0], side


def robust(squared: Array, huber: float | None) -> tuple[Array, Array | None]:
    """Cost (v,) of squared, normalised residuals (v, L), and the square root of their weights.

    Huber's loss: squared up to the threshold k, ``2 k e - k^2`` beyond it; its weight there is k / e.
    """
    if huber is None:
        return squared.sum(-1), None
    e = np.sqrt(squared)
    outside = e > huber
    if not outside.any():
        return squared.sum(-1), None
    cost = np.where(outside, 2 * huber * e - huber * huber, squared).sum(-1)
    return cost, np.sqrt(np.where(outside, huber / np.maximum(e, huber), 1.0))


def _meet(T: Array, rays: Array, present: BoolArray) -> tuple[Array, Array, BoolArray]:
    """Where rays (v, 3, L) meet the pattern's plane: distance (v, L), cosine to its normal, whether they do."""
    n = T[:, :3, 2]
    cosine = np.einsum("vi,vil->vl", n, rays)
    height = (n * T[:, :3, 3]).sum(-1)[:, None]
    grazing = np.abs(cosine) < 1e-9
    safe = np.where(grazing, 1.0, cosine)
    distance = height / safe
    hit = ~present | (~grazing & (distance > 0))
    return np.where(present, distance, 1.0), safe, hit


def _plane_rows(
    h: Array, points: Array, residual: Array, present: BoolArray, hit: BoolArray, huber: float | None
) -> Linearised:
    """From d(residual) = h . (dt + dw x point), all (v, 3, L), to cost, Hessian and gradient."""
    cost, weight = robust(residual * residual, huber)
    cost = np.where(hit.all(-1), cost, np.inf)
    J = np.empty((len(h), 7, h.shape[-1]))
    J[:, :3] = h
    J[:, 3] = points[:, 1] * h[:, 2] - points[:, 2] * h[:, 1]
    J[:, 4] = points[:, 2] * h[:, 0] - points[:, 0] * h[:, 2]
    J[:, 5] = points[:, 0] * h[:, 1] - points[:, 1] * h[:, 0]
    J[:, 6] = residual
    J *= (present if weight is None else present * weight)[:, None]
    G = J @ J.transpose(0, 2, 1)
    return cost, G[:, :6, :6], G[:, :6, 6]


def _chunks(views: int) -> Iterator[slice]:
    for start in range(0, views, CHUNK):
        yield slice(start, min(start + CHUNK, views))
