"""Residuals of a pattern's corners in a camera's images.

All corners of a view lie in the plane of its pattern, at (X, Y, 0) from the pattern's centre. Let b (3) be the
derivative of one of a corner's two residuals r by a translation of the pattern along the pattern's own axes. A twist
(dt, dw) of the pose in the pattern's frame moves the corner by ``dt + dw x (X, Y, 0)``, so a row of the Jacobian is::

    (b_x, b_y, b_z, Y b_z, -X b_z, X b_y - Y b_x)

Every element is a component of b times 1, X or Y: a twist moves the corners by an affine map of the plane into space,
``d = d_0 + X d_X + Y d_Y``. So the Hessian and the gradient of a view are linear in the moments of its corners. With
the derivative a (3) by a translation along the camera's axes these are the sums of ``a a^T`` times the monomials
(1, X, Y, X^2, XY, Y^2), and of ``r a`` times (1, X, Y). The monomials are the same in all views: one product of
matrices gives all moments, which are the Hessian (9, 9) and the gradient (9) of the affine map, and the map (9, 6)
of the view's twist to it gives those of the twist. That takes half the time of rows and their products, as each number
of a row would be computed for each corner.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.residuals.planar_pose import planar_poses
from calibration.engine.estimation.residuals.views import Linearised, chunks, product, robust, squeezed
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import LAST_STEP
from calibration.engine.geometry.lenses.model import IN_FRONT, Placed

ERRORS_BEYOND_LENS_MODEL = ("skew", "prism_x", "prism_y")
"""Errors of a lens that its model has no coefficients for: non-perpendicular axes, thin prism along x and y.

``u = fx (x + skew y + prism_x r^2)``, ``v = fy (y + prism_y r^2)`` with distorted (x, y)
(J. Weng et al., "Camera calibration with distortion models and accuracy evaluation", 1992).
"""
MIN_FRONT = 0.1
"""Cosine of the angle from the middle of a view beyond which its rays are left out of the homography."""
ROUGH_STEP = 1e-3
"""Termination of `Distortion.undistort` for an initial guess: accurate to 1e-6."""


@dataclass(frozen=True, eq=False)
class CornerTerm:
    """Corners of a pattern in a camera's images: reprojection errors in pixels."""

    camera: Camera
    """After `side_by_side`, its numbers are arrays (V, 1), one for each view."""
    corners: Array
    """(K, 3): relative to the pattern's centre, z = 0; (V, K, 3) if views are of several patterns."""
    pixels: Array
    """(V, 2, K): structure of arrays; arbitrary where a corner is not seen."""
    seen: BoolArray | None
    """(V, K); None if every view sees every corner."""

    free: tuple[int, ...] = ()
    """Free intrinsics, by their indices in `Camera.intrinsics`; those of `ERRORS_BEYOND_LENS_MODEL` follow."""
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
        """(V, 2, K): labels as undistorted coordinates in the lens's chart."""
        return self._rays_of_pixels(slice(None), LAST_STEP)

    def _rays_of_pixels(self, views: slice, step: float) -> Array:
        u, v = self._from_centre(views)
        return np.stack(self.camera.distortion.undistort(u / self.camera.fx, v / self.camera.fy, step), 1)

    @cached_property
    def linear_poses(self) -> Array:
        """``T_camera_centre`` (V, 4, 4) of each view by its homography; NaN where its corners give none."""
        rays = np.empty_like(self.pixels)
        for views in chunks(*self.pixels.shape[::2]):
            rays[views] = self._rays_of_pixels(views, ROUGH_STEP)
        seen = self.seen
        if np.isnan(rays).any():  # a label where the distortion has no inverse must not cost its whole view
            usable: BoolArray = np.asarray(np.isfinite(rays).all(1))
            seen = usable if seen is None else seen & usable
        if self.camera.distortion.chart is IN_FRONT:
            return planar_poses(rays, self.corners, seen)
        x, y = np.swapaxes(rays, 0, 1)
        return self._poses_of_directions(np.swapaxes(self.camera.distortion.chart.rays(x, y), 0, 1), seen)

    def _poses_of_directions(self, rays: Array, seen: BoolArray | None) -> Array:
        """Return the poses for rays (V, 3, K): each view's are turned to the front, where a homography sees them."""
        weights = np.ones(rays[:, :1].shape) if seen is None else seen[:, None].astype(float)
        turned_back = rotations.towards((np.where(weights > 0, rays, 0.0)).sum(-1))
        x, y, z = np.moveaxis(np.swapaxes(turned_back, 1, 2) @ rays, 1, 0)
        with np.errstate(invalid="ignore"):
            in_front: BoolArray = z > MIN_FRONT
        depth = np.where(in_front, z, np.nan)
        seen = in_front if seen is None else seen & in_front
        T = planar_poses(np.stack([x / depth, y / depth], 1), self.corners, None if seen.all() else seen)
        T[:, :3] = turned_back @ T[:, :3]
        return T

    def take(self, views: IntArray | slice) -> "CornerTerm":
        """Return the term of only some of the views."""
        return replace(self, pixels=self.pixels[views], seen=None if self.seen is None else self.seen[views])

    def seen_with(self, camera: Camera, free: Sequence[int]) -> "CornerTerm":
        """See `calibration.engine.estimation.residuals.views.Term`."""
        return replace(self, camera=camera, free=tuple(free))

    def linearise(self, T: Array, scale: float, huber: float | None, squares: Array | None = None) -> Linearised:
        """See `calibration.engine.estimation.residuals.views.Term`."""
        size = 6 + len(self.free)
        cost, H, g = np.empty(len(T)), np.empty((len(T), size, size)), np.empty((len(T), size))
        threshold, variance = None if huber is None else huber * scale, scale * scale
        for part in chunks(len(T), self.length):  # in pixels, as there are fewer views than corners to scale
            into = None if squares is None else squares[part]
            found = self._project_corners(T[part], part, 1.0, threshold, into)
            cost[part] = found.cost
            if self.free:
                rows = np.empty((size + 1, len(found.cost), 2, self.length))
                self._fill_pose_rows(rows, T[part], found, 1.0)
                H[part], g[part] = squeezed(np.swapaxes(rows.reshape(*rows.shape[:2], -1), 0, 1))
            else:
                H[part], g[part] = _hessian_and_gradient(T[part, :3, :3], found, self._monomials_of(part))
        return (cost, H, g) if scale == 1.0 else (cost / variance, H / variance, g / variance)

    def rows(self, T: Array, views: slice, scale: float, huber: float | None, spare: int = 0) -> tuple[Array, Array]:
        """See `calibration.engine.estimation.residuals.views.Term`."""
        out = np.empty((7 + len(self.free) + spare, len(T), 2, self.length))
        self._fill_pose_rows(out, T, self._project_corners(T, views, scale, huber), scale)
        return out, self.corners.T[None]

    def magnitudes(self, T: Array) -> Array:
        """(V, K): distance from each label to the projected corner (px); NaN if not seen or not to be seen."""
        out = np.empty((len(T), self.length))
        for part in chunks(len(T), self.length):
            placed = self._place_in_chart(T[part], part)
            (x, y), outside = placed.at, placed.outside
            xd, yd = self.camera.distortion.distort(x, y)
            seen_u, seen_v = self._from_centre(part)
            u, v = self.camera.fx * xd - seen_u, self.camera.fy * yd - seen_v
            out[part] = np.sqrt(u * u + v * v)
            if outside is not None:
                out[part][outside] = np.nan
        return out if self.seen is None else np.where(self.seen, out, np.nan)

    @cached_property
    def _focal_lengths(self) -> Array:
        """(2, 1, 1), or (2, V, 1): focal lengths, px."""
        return np.array([self.camera.fx, self.camera.fy]).reshape(2, -1, 1)

    def _from_centre(self, part: slice) -> tuple[Array, Array]:
        """Return labels, 2 x (v, K), relative to the principal point, px, as without the camera's skew.

        They are not kept: each term would hold as much again as its pixels, for 3 % of a least squares.
        """
        camera, pixels = self.camera, self.pixels[part]
        u, v = pixels[:, 0] - camera.cx, pixels[:, 1] - camera.cy
        return (u - camera.skew / camera.fy * v if np.any(camera.skew) else u), v

    @cached_property
    def _corner_monomials(self) -> Array:
        """(..., K, 6): 1, X, Y, X^2, XY and Y^2 of the corners."""
        X, Y = self.corners[..., 0], self.corners[..., 1]
        return np.stack([np.ones_like(X), X, Y, X * X, X * Y, Y * Y], -1)

    def _monomials_of(self, part: slice) -> Array:
        """Return the monomials (K, 6), or (v, K, 6), of a part of the views."""
        return self._corner_monomials if self.corners.ndim == 2 else self._corner_monomials[part]

    @cached_property
    def _in_plane(self) -> Array:
        """(..., 4, K): X, Y, 0 and 1 of the corners."""
        X, Y = self.corners[..., 0], self.corners[..., 1]
        return np.stack([X, Y, np.zeros_like(X), np.ones_like(X)], -2)

    @cached_property
    def _lever_arms(self) -> Array:
        """(2, ..., 2 K): Y and -X of the corners, twice."""
        X, Y = self.corners[..., 0], self.corners[..., 1]
        return np.stack([np.concatenate([Y, Y], -1), np.concatenate([-X, -X], -1)])

    def _place_in_chart(self, T: Array, part: slice) -> Placed:
        """Return the corners of a part of the views in the lens's chart."""
        if self.corners.ndim == 2:  # the camera's axes first: everything after is contiguous
            points = (T[:, :3].transpose(1, 0, 2).reshape(-1, 4) @ self._in_plane).reshape(3, len(T), -1)
        else:
            points = np.ascontiguousarray((T[:, :3] @ self._in_plane[part]).transpose(1, 0, 2))
        return self.camera.distortion.chart.placed(points, self.camera.distortion.sees)

    def _project_corners(
        self, T: Array, part: slice, scale: float, huber: float | None, squares: Array | None = None
    ) -> "_Projected":
        """Project the corners of a part of the views; the arguments are those of `linearise`."""
        camera, seen = self.camera, None if self.seen is None else self.seen[part]
        placed = self._place_in_chart(T, part)
        outside = placed.outside
        distorted, jacobian = camera.distortion.distort_with_jacobian(placed.at)
        residuals = distorted * self._focal_lengths
        for coordinate, seen_at in zip(residuals, self._from_centre(part), strict=True):
            coordinate -= seen_at
        if scale != 1.0:
            residuals *= 1 / scale
        if seen is not None:
            residuals = np.where(seen, residuals, 0.0)
        both = residuals * residuals
        squared = both[0] + both[1]
        cost, weight = robust(squared, huber)
        if squares is not None:
            np.multiply(squared, scale * scale, out=squares)
            if seen is not None:
                squares[~seen] = np.nan
            if outside is not None:
                squares[outside] = np.nan
        if outside is not None:
            cost = np.where((outside if seen is None else seen & outside).any(-1), np.inf, cost)
        if seen is not None:
            weight = seen.astype(float) if weight is None else weight * seen
        if weight is not None:
            residuals *= weight
        over_depth = placed.nearness if weight is None else weight * placed.nearness
        along = over_depth * (self._focal_lengths / scale)
        slopes = np.empty((2, *placed.at.shape))
        np.multiply(jacobian[0], along[0], out=slopes[0])
        np.multiply(jacobian[1], along[1], out=slopes[1])
        return _Projected(cost, placed, distorted, residuals, slopes, weight)

    def _fill_pose_rows(self, rows: Array, T: Array, found: "_Projected", scale: float) -> None:
        """Fill the first 6 + m and the last of weighted rows (r, v, 2, K)."""
        both, Y, minus_X = rows.reshape(*rows.shape[:2], -1), *self._lever_arms  # axes of the image, side by side
        np.matmul(np.swapaxes(T[:, :3, :3], 1, 2), found.by_translation(), out=np.swapaxes(both[:3], 0, 1))
        np.multiply(both[2], Y, out=both[3])
        np.multiply(both[2], minus_X, out=both[4])
        np.multiply(both[0], -Y, out=both[5])
        both[5] -= both[1] * minus_X
        rows[-1] = np.swapaxes(found.residuals, 0, 1)
        if self.free:
            own = rows[6 : 6 + len(self.free)]
            self._fill_intrinsics(own, found, scale)
            if found.weight is not None:
                own *= found.weight[:, None]

    def _fill_intrinsics(self, rows: Array, found: "_Projected", scale: float) -> None:
        """Fill (m, v, 2, K) rows: the derivative of both image axes by each of the free intrinsics."""
        fx, fy = self.camera.fx / scale, self.camera.fy / scale
        coefficients = self.camera.distortion.derivatives(*found.placed.at) if max(self.free) > 3 else []
        if max(self.free) > 3 + len(coefficients):
            x, y = found.distorted
            r2 = x * x + y * y
            coefficients += [(y, _NO_COST), (r2, _NO_COST), (_NO_COST, r2)]
        for k, parameter in enumerate(self.free):
            if parameter > 3:
                dx, dy = coefficients[parameter - 4]
                np.multiply(dx, fx, out=rows[k, :, 0])
                np.multiply(dy, fy, out=rows[k, :, 1])
            else:
                axis = parameter % 2
                rows[k, :, 1 - axis] = 0.0
                if parameter < 2:
                    np.divide(found.distorted[axis], scale, out=rows[k, :, axis])
                else:
                    rows[k, :, axis] = 1 / scale


_NO_COST = np.zeros(1)


@dataclass(frozen=True, eq=False)
class _Projected:
    """Corners of v views, projected, with derivatives; K corners, 2 axes of the image."""

    cost: Array
    """(v,)."""
    placed: Placed
    """In the chart of the lens."""
    distorted: Array
    """(2, v, K): those of this camera's lens."""
    residuals: Array
    """(2, v, K): weighted, in standard deviations."""
    slopes: Array
    """(2, 2, v, K): of both residuals, the derivatives by both coordinates of the chart, over the depth."""
    weight: Array | None
    """(v, K): by which residuals and slopes are multiplied; None for 1."""

    def by_translation(self) -> Array:
        """Return the derivatives (v, 3, 2 K) of both residuals by a translation along each axis of the camera."""
        return self.placed.by_translation(self.slopes)


def _hessian_and_gradient(R: Array, found: _Projected, monomials: Array) -> tuple[Array, Array]:
    """Return Hessian (v, 6, 6) and gradient (v, 6) for a twist in the pattern's frame.

    Args:
        R: (v, 3, 3), rotations of ``T_camera_pattern``.
        found: the corners.
        monomials: (K, 6), or (v, K, 6), of the corners' places.
    """
    # (v, 9, 10): its Hessian, and its gradient beside it
    affine = _moments_of_projected(found, monomials).take(_PLACES_OF_AFFINE, 1)
    to_affine = (R.reshape(-1, 9) @ _TO_AFFINE).reshape(-1, 9, 6)
    turned = to_affine.transpose(0, 2, 1) @ affine
    return turned[:, :, :9] @ to_affine, turned[:, :, 9]


def _moments_of_projected(found: _Projected, monomials: Array) -> Array:
    """Return the moments (v, 9 x 6) of the products of ``a = (x, y, -z)`` with itself and with the residual r.

    The products are those of `calibration.engine.geometry.lenses.model.Placed.products`.
    """
    products = found.placed.products(found.slopes, found.residuals)
    _, v, K = products.shape
    if monomials.ndim > 2:
        return (products.transpose(1, 0, 2) @ monomials).reshape(v, -1)
    moments = product(products.reshape(-1, K), monomials).reshape(9, v, 6)
    return moments.transpose(1, 0, 2).reshape(v, -1)


def _places_in_moments() -> IntArray:
    """Return where the Hessian and the gradient (9, 10) of the affine map are among `_moments_of_projected`.

    The map's elements are the camera's axes of ``d_0``, then of ``d_X`` and ``d_Y``.
    """
    monomials = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # of 1, X and Y with each other
    axes, residual = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 7]]), np.array([5, 6, 8])
    hessian = 6 * axes[:, None] + monomials[:, None, :, None]
    gradient = 6 * residual + monomials[:, 0, None]
    return np.concatenate([hessian.reshape(9, 9), gradient.reshape(9, 1)], 1)


def _to_affine() -> Array:
    """Return the matrix (9, 54) from the elements of R to the map (9, 6) from a twist to the affine map.

    The camera's z-axis is reversed there, as in `_moments_of_projected`.
    """
    out = np.zeros((3, 3, 3, 3, 6))  # of R its row and column, then d_0, d_X or d_Y, the camera's axis, and the twist
    for axis, sign in enumerate((1, 1, -1)):
        for along in range(3):
            out[axis, along, 0, axis, along] = sign
        # the twist moves (X, Y, 0) by dw x (X, Y, 0) = (-Y dw_z, X dw_z, Y dw_x - X dw_y)
        out[axis, 2, 2, axis, 3], out[axis, 2, 1, axis, 4] = sign, -sign
        out[axis, 1, 1, axis, 5], out[axis, 0, 2, axis, 5] = sign, -sign
    return out.reshape(9, 54)


_PLACES_OF_AFFINE, _TO_AFFINE = _places_in_moments(), _to_affine()


def side_by_side(terms: Sequence[CornerTerm]) -> CornerTerm:
    """Concatenate few views of several cameras and patterns to one term, to be linearised in one pass.

    Args:
        terms: of cameras with the same model of distortion; about `LABELS_PER_CHUNK` labels together.
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
    rows = [(term.camera.skew, *term.camera.intrinsics) for term in terms]
    skew, fx, fy, cx, cy, *coefficients = np.repeat(rows, counts, axis=0).T[..., None]
    lens = type(terms[0].camera.distortion)(*coefficients)
    return replace(terms[0].camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=lens, skew=skew)


def _corners_of_views(terms: Sequence[CornerTerm], counts: Sequence[int], K: int) -> Array:
    """Return (K, 3) if all patterns are equal, else (V, K, 3), padded with zeros."""
    if all(np.array_equal(term.corners, terms[0].corners) for term in terms):
        return terms[0].corners
    filled = [np.pad(term.corners, ((0, K - len(term.corners)), (0, 0))) for term in terms]
    return np.repeat(filled, counts, axis=0)
