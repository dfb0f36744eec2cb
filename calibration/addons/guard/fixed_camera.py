"""A fixed camera against the features that its reference keeps: rotation, focal length and translation.

Each image is matched to the reference. Its rotation is that on which most matches agree (RANSAC: M. Fischler, R.
Bolles, 1981), so that what moves, and what stands elsewhere than it did, is left out; all of it then is fitted, with
the focal length, by least squares with Tukey's weights. The images' values are a series, whose levels are found exactly
(`calibration.engine.baseline.comparison`). Of each level, the median place of each feature is compared with the
reference: one scene point in many images is one observation, and those of a cell of the image one cluster, as they may
be of one thing (K.-Y. Liang, S. Zeger, 1986, for the covariance). A level differs if Hotelling's T^2 says so.

Translation shows in parallax alone. If the camera moves along t, every feature moves along its epipolar direction,
whatever its distance; so with the right t the flow across these directions is that of a rotation (H. Longuet-Higgins,
K. Prazdny, 1980; A. Bruss, B. Horn, 1983). Its size is known only relative to the distance of the scene.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.addons.guard.features import NEAR_PX, Features, cells_of, match
from calibration.addons.guard.outcome import MAX_FALSE_ALARM, t_squared_limit
from calibration.base.arrays import Array, IntArray
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.statistics import MAD_TO_SIGMA, t_squared_tail

MIN_MATCHES = 12
"""Least number of matches that agree, to say anything."""
MIN_IMAGE_CELLS, MIN_CELLS = 5, 6
"""Least number of cells in which they are, in one image, and in all images of a level."""
MAX_FIT_STEPS = 20
MEDIAN_OF_RAYLEIGH = 1.1774
"""Median of the length of a normal vector of two elements, in their standard deviation."""
RANSAC_DRAWS = 300
MAX_INLIER_PX = 3.0
"""px: largest residual of a match that agrees with a rotation; the focal length is fitted after."""
TUKEY = 4.685
"""Residual in standard deviations from which on it has no weight: 95 % efficient (P. Huber, "Robust statistics")."""
MIN_SCATTER_PX = 0.05
SYSTEMATIC_PX = 0.03
"""px: standard deviation of what no feature tells: a lens and a mount by their temperature, light that changes."""
PARAMETERS = 4
"""Rotation vector, and relative change of the focal length."""
LOOSE_PX = 15.0
"""px: largest residual of a match that may be parallax."""
MIN_SEEN_IMAGES = 0.2
"""Least share of the images of a level in which a feature is seen."""
MIN_ALONG_TO_ACROSS = 2.5
"""Least ratio of the median sizes along and across epipolar directions: about 1 without parallax."""
MIN_PARALLAX_PX = 0.1
"""px: least standard deviation of parallax."""
MIN_PARALLAX_FEATURES = 40
MIN_TRANSLATION_PERCENT = 0.1
"""Least translation, in percent of the distance of the scene: smaller ones are not told from a rotation."""
MIN_ONE_SIGN = 0.85
"""Least share of the larger half of parallax that is of one sign: all points are in front of the camera."""
DIRECTIONS = 400
"""Directions of a translation that are tried, on half a sphere."""


class View(NamedTuple):
    """Features of the reference in one image."""

    time: float
    ids: IntArray
    pixels: Array
    """(n, 2): those within `LOOSE_PX` of the rotation on which most agree."""
    values: Array
    """(4,): rotation vector, rad, and relative change of the focal length."""


@dataclass(frozen=True, eq=False)
class Translation:
    """Translation of a camera by parallax."""

    percent: Array
    """(3,): of the median distance of the scene."""
    rotation: Array
    """(3,): rotation vector with it, rad."""
    covariance: Array
    """(3, 3) of the rotation."""


@dataclass(frozen=True, eq=False)
class Level:
    """What images from one change to the next have in common, against the reference."""

    since: float
    """Time of the first image."""
    images: int
    values: Array
    """(4,), as in `View`."""
    covariance: Array
    t_squared: float
    limit: float
    """Of T^2."""
    p: float
    translation: Translation | None

    @property
    def differs(self) -> bool:
        """Whether it differs from the reference."""
        return self.t_squared > self.limit

    @property
    def is_zoom(self) -> bool:
        """Whether a change of the focal length explains it."""
        if self.translation is not None:
            return False
        turned = self.values[:3] @ np.linalg.solve(self.covariance[:3, :3], self.values[:3])
        return bool(turned < self.limit < self.values[3] ** 2 / self.covariance[3, 3])


class FixedCamera:
    """A camera and the features of its reference."""

    def __init__(self, camera: Camera, kept: Features) -> None:
        self.camera, self.kept = camera, kept
        rays = camera.rays(kept.pixels)
        self._rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        self._centre = np.array([camera.cx, camera.cy])
        self._cells = cells_of(kept.pixels, np.array([camera.width, camera.height]))
        self.focal = math.sqrt(camera.fx * camera.fy)
        self.units = np.array([1 / self.focal] * 3 + [4 / math.hypot(camera.width, camera.height)])
        """(4,): what one pixel is of each value; of the focal length, half way to a corner."""

    @property
    def is_distinct(self) -> bool:
        """Whether the reference has features enough."""
        return len(self.kept) >= MIN_MATCHES and len(np.unique(self._cells)) >= MIN_CELLS

    def seen_in(self, seen: Features, time: float) -> View | None:
        """Return the features of the reference in those of an image; None if too few agree."""
        near = self._agreeing(*match(self.kept, seen, NEAR_PX), seen, time)
        if near is not None and len(near.ids) > len(self.kept) / 2:
            return near
        far = self._agreeing(*match(self.kept, seen), seen, time)
        return far if near is None or (far is not None and len(far.ids) > 1.3 * len(near.ids)) else near

    def _agreeing(self, ids: IntArray, others: IntArray, seen: Features, time: float) -> View | None:
        pixels = seen.pixels[others]
        now = self.camera.rays(pixels)
        usable = np.isfinite(now).all(1) & np.isfinite(self._rays[ids]).all(1)
        ids, pixels, now = ids[usable], pixels[usable], now[usable]
        if len(ids) < MIN_MATCHES:
            return None
        now /= np.linalg.norm(now, axis=1, keepdims=True)
        start = rotations.log(_common_rotation(self._rays[ids], now, MAX_INLIER_PX / self.focal))
        values, weights, r = self._fitted(ids, pixels, np.append(start, 0.0))
        if (weights > 0).sum() < MIN_MATCHES or len(np.unique(self._cells[ids[weights > 0]])) < MIN_IMAGE_CELLS:
            return None
        loose = np.linalg.norm(r, axis=1) < LOOSE_PX
        return View(time, ids[loose], pixels[loose], values)

    def _residuals(self, ids: IntArray, pixels: Array, values: Array) -> tuple[Array, Array]:
        """Return the residuals (n, 2), px, and derivatives (n, 2, 4) of the predicted places by the values."""
        points = self._rays[ids] @ rotations.exp(values[:3])  # R^T of each
        offset, zoomed = self.camera.project(points) - self._centre, 1 + values[3]
        slopes = np.moveaxis(self.camera.slopes(points.T), -1, 0)
        J = np.concatenate([zoomed * slopes @ rotations.hat(points), offset[..., None]], -1)  # exp(w)^T p = p + p x w
        return pixels - self._centre - zoomed * offset, J

    def _fitted(self, ids: IntArray, pixels: Array, start: Array) -> tuple[Array, Array, Array]:
        """Fit the values by robust least squares; return them, the weights (n,) and the residuals (n, 2)."""
        values, scale = start, MAX_INLIER_PX / TUKEY
        shared = 1 / np.sqrt(np.bincount(self._cells[ids])[self._cells[ids]])
        for turn in range(MAX_FIT_STEPS):
            r, J = self._residuals(ids, pixels, values)
            size = np.linalg.norm(r, axis=1)
            if turn > 2 and (near := size[size < TUKEY * scale]).size:
                scale = max(MIN_SCATTER_PX, min(scale, float(np.median(near)) / MEDIAN_OF_RAYLEIGH))
            weights = shared * np.clip(1 - (size / (TUKEY * scale)) ** 2, 0, None) ** 2
            if (weights > 0).sum() < PARAMETERS:
                break
            H = np.einsum("nij,n,nik->jk", J, weights, J)
            step = np.linalg.solve(H + 1e-9 * np.diag(np.diagonal(H) + 1e-12), np.einsum("nij,n,ni->j", J, weights, r))
            R = rotations.exp(values[:3]) @ rotations.exp(step[:3])
            values = np.append(rotations.log(R), values[3] + step[3])
            if turn > 4 and np.abs(step / self.units).max() < 1e-4:
                break
        return values, weights, r

    def level(self, views: Sequence[View], tests: int) -> Level | None:
        """Compare what images have in common with the reference; None if that is too little.

        Args:
            views: images that follow each other.
            tests: number of levels that are compared.
        """
        places = np.full((len(views), len(self.kept), 2), np.nan)
        for own, view in zip(places, views, strict=True):
            own[view.ids] = view.pixels
        counts = np.isfinite(places[..., 0]).sum(0)
        ids = np.flatnonzero(counts >= max(1, MIN_SEEN_IMAGES * len(views)))
        pixels = np.nanmedian(places[:, ids], axis=0)
        values, weights, r = self._fitted(ids, pixels, np.median([view.values for view in views], axis=0))
        used = weights > 0
        groups, cells = np.unique(self._cells[ids[used]], return_inverse=True)
        if used.sum() < MIN_MATCHES or len(groups) < MIN_CELLS:
            return None
        r, J = self._residuals(ids[used], pixels[used], values)
        own_covariance = _clustered_covariance(J, weights[used], r, cells)
        C = own_covariance + np.diag((SYSTEMATIC_PX * self.units) ** 2)
        # of a sum with a known part more degrees of freedom (B. Welch, 1947)
        share = float(np.trace(own_covariance / np.outer(self.units, self.units)))
        freedom = (len(groups) - 1) * (1 + PARAMETERS * SYSTEMATIC_PX**2 / share) ** 2
        t_squared = float(values @ np.linalg.solve(C, values))
        limit = t_squared_limit(PARAMETERS, freedom, MAX_FALSE_ALARM / tests)
        p = min(1.0, tests * t_squared_tail(t_squared, PARAMETERS, freedom))
        translation = self._translation(ids, pixels, values) if t_squared > limit else None
        return Level(views[0].time, len(views), values, C, t_squared, limit, p, translation)

    def _translation(self, ids: IntArray, pixels: Array, values: Array) -> Translation | None:
        """Return the translation that parallax shows; None if there is none."""
        R = rotations.exp(values[:3])
        before, now = self._rays[ids], self.camera.rays(pixels) @ R.T
        front = (before[:, 2] > 0) & (now[:, 2] > 0)
        x = before[front, :2] / before[front, 2:]
        flow = now[front, :2] / now[front, 2:] - x
        cells = np.unique(self._cells[ids[front]], return_inverse=True)[1]
        if len(x) < MIN_PARALLAX_FEATURES:
            return None
        by_rotation = _flow_by_rotation(x)
        t = min(_half_sphere(DIRECTIONS), key=lambda t: _across(x, flow, by_rotation, t)[0])
        for width in (0.1, 0.05, 0.02, 0.01, 0.005):
            around = [t] + [_as_direction(t + width * each) for each in np.vstack([np.eye(3), -np.eye(3)])]
            t = min(around, key=lambda t: _across(x, flow, by_rotation, t)[0])
        _, w, across, along, J, weights = _across(x, flow, by_rotation, t)
        size = np.linalg.norm(_epipolar(x, t), axis=1)
        used = weights > 0
        parallax = (_without_zoom(x, flow, by_rotation, weights) * _epipolar(x, t) / size[:, None]).sum(1)[used]
        size_px = MAD_TO_SIGMA * self.focal * np.median(np.abs(parallax))
        ratio = np.median(np.abs(parallax)) / np.median(np.abs(across[used]))
        large = along[used][np.abs(along[used]) >= np.median(np.abs(along[used]))]
        one_sign = max((large > 0).mean(), (large < 0).mean())
        if ratio < MIN_ALONG_TO_ACROSS or one_sign < MIN_ONE_SIGN or size_px < MIN_PARALLAX_PX:
            return None
        nearness = 100 * float(np.median(along[used] / size[used]))
        if abs(nearness) < MIN_TRANSLATION_PERCENT:
            return None
        C = _clustered_covariance(J[used, None], weights[used], across[used, None], cells[used])
        rotation = rotations.log(rotations.exp(w) @ R)
        return Translation(nearness * t, rotation, C[:3, :3] + np.eye(3) * (SYSTEMATIC_PX / self.focal) ** 2)


def _common_rotation(before: Array, now: Array, tolerance: float) -> Array:
    """Return the rotation R with ``before = R now`` on which most unit rays (n, 3) agree, by pairs of them."""
    random = np.random.default_rng(len(before))
    pairs = random.integers(0, len(before), (RANSAC_DRAWS, 2))
    R = np.concatenate(
        [np.eye(3)[None], _axes_of_pairs(before, pairs) @ np.swapaxes(_axes_of_pairs(now, pairs), -1, -2)]
    )
    apart = ((before[None] - now[None] @ np.swapaxes(R, -1, -2)) ** 2).sum(-1)
    return np.asarray(R[(apart < tolerance**2).sum(1).argmax()])


def _axes_of_pairs(rays: Array, pairs: IntArray) -> Array:
    """Return the axes (n, 3, 3) that each pair of rays spans."""
    one, other = rays[pairs[:, 0]], rays[pairs[:, 1]]
    x, z = one + other, np.cross(one, other)
    x, z = (each / np.maximum(np.linalg.norm(each, axis=1, keepdims=True), 1e-12) for each in (x, z))
    return np.stack([x, np.cross(z, x), z], -1)


def _clustered_covariance(J: Array, weights: Array, residuals: Array, cells: IntArray) -> Array:
    """Return the covariance of the values, with the residuals of a cell as one cluster."""
    bread = np.linalg.inv(np.einsum("nij,n,nik->jk", J, weights, J))
    scores = np.einsum("nij,n,ni->nj", J, weights, residuals)
    groups, k = int(cells.max()) + 1, J.shape[-1]
    sums = np.stack([np.bincount(cells, scores[:, i], groups) for i in range(k)], 1)
    return np.asarray(groups / max(groups - k, 1) * bread @ (sums.T @ sums) @ bread)


def _flow_by_rotation(x: Array) -> Array:
    """Derivatives (n, 2, 3) of the flow of normalised points (n, 2) by a rotation that brings them back."""
    u, v = x.T
    return np.stack([np.stack([u * v, -1 - u * u, v], -1), np.stack([1 + v * v, -u * v, -u], -1)], 1)


def _epipolar(x: Array, t: Array) -> Array:
    """Return the flow (n, 2) of normalised points at distance 1, if the camera moves along t."""
    return np.asarray(x * t[2] - t[:2])


def _across(x: Array, flow: Array, by_rotation: Array, t: Array) -> tuple[float, Array, Array, Array, Array, Array]:
    """Fit the rotation to the flow across epipolar directions.

    Returns:
        The cost, the rotation vector (3,), the residuals (n,) across and along, derivatives (n, 5) by the rotation and
        by two directions of t, and weights (n,).
    """
    a = _epipolar(x, t)
    length = np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-9)
    along, normal = a / length, np.stack([-a[:, 1], a[:, 0]], -1) / length
    J, y = np.einsum("ni,nij->nj", normal, by_rotation), (normal * flow).sum(1)
    weights, w = np.ones(len(x)), np.zeros(3)
    for _ in range(4):
        w = np.linalg.lstsq(J * np.sqrt(weights)[:, None], y * np.sqrt(weights), rcond=None)[0]
        r = y - J @ w
        scale = max(MAD_TO_SIGMA * float(np.median(np.abs(r))), 1e-7)
        weights = np.clip(1 - (r / (TUKEY * scale)) ** 2, 0, None) ** 2
    rest = flow - by_rotation @ w
    e = (along * rest).sum(1)
    tangent = np.linalg.svd(t[None])[2][1:]
    by_t = np.stack([(normal * _epipolar(x, each)).sum(1) * e / length[:, 0] for each in tangent], 1)
    cost = float(np.minimum(np.abs(r), TUKEY * scale).sum())
    return cost, w, r, e, np.concatenate([J, by_t], 1), weights


def _without_zoom(x: Array, flow: Array, by_rotation: Array, weights: Array) -> Array:
    """Return what of the flow (n, 2) neither a rotation nor another focal length explains."""
    J, root = np.concatenate([by_rotation, x[..., None]], -1), np.sqrt(np.repeat(weights, 2))
    values = np.linalg.lstsq(J.reshape(-1, 4) * root[:, None], flow.ravel() * root, rcond=None)[0]
    return np.asarray(flow - J @ values)


def _half_sphere(number: int) -> Array:
    """Return directions (number, 3) that cover half a sphere evenly (a spiral: R. Swinbank, R. Purser, 2006)."""
    at = (np.arange(number) + 0.5) / number
    turn = np.arange(number) * math.pi * (1 + math.sqrt(5))
    radius = np.sqrt(1 - at**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), at], 1)


def _as_direction(t: Array) -> Array:
    return np.asarray(t / np.linalg.norm(t))
