"""Residuals of a pattern's corners in a camera's images.

All corners of a view lie in the plane of its pattern, at (X, Y, 0) from the pattern's centre. Let b (3) be the
derivative of one of a corner's two residuals r by a translation of the pattern along the pattern's own axes. A twist
(dt, dw) of the pose in the pattern's frame moves the corner by ``dt + dw x (X, Y, 0)``, so a row of the Jacobian is::

    (b_x, b_y, b_z, Y b_z, -X b_z, X b_y - Y b_x)

Every element is a component of b times 1, X or Y. So the Hessian and the gradient of a view are linear in the moments
of its corners: the sums of ``b b^T`` times the monomials (1, X, Y, X^2, XY, Y^2), and of ``r b`` times (1, X, Y). With
the derivative a (3) by a translation along the camera's axes, ``b = R^T a``, and the monomials are the same in all
views: one product of matrices gives the moments of a, the views' rotations turn them to those of b, and another product
gives Hessians and gradients. That takes half the time of rows and their products, as each number of a row would be
computed for each corner.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from calibration.dataset.modalities import NoiseKind
from calibration.estimation.planar_pose import planar_poses
from calibration.estimation.residuals import Linearised, chunks, robust, squeezed
from calibration.frozen import frozen
from calibration.geometry.cameras import Camera
from calibration.geometry.distortion import LAST_STEP
from calibration.geometry.types import Array, BoolArray, IntArray

ROUGH_STEP = 1e-3
"""Termination of `calibration.geometry.distortion.Distortion.undistort` for an initial guess: accurate to 1e-6."""


@frozen(eq=False)
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
        rays = np.empty_like(self.pixels)
        for views in chunks(*self.pixels.shape[::2]):
            rays[views] = self._rays(views, ROUGH_STEP)
        seen = self.seen
        if np.isnan(rays).any():  # a label where the distortion has no inverse must not cost its whole view
            usable: BoolArray = np.asarray(np.isfinite(rays).all(1))
            seen = usable if seen is None else seen & usable
        return planar_poses(rays, self.corners, seen)

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
        for part in chunks(len(T), self.length):
            into = None if squares is None else squares[part]
            found = self._projected(T[part], part, scale, huber, into)
            cost[part] = found.cost
            if self.free:
                rows = np.empty((len(found.cost), size + 1, 2, self.length))
                self._fill(rows, T[part], found, scale)
                H[part], g[part] = squeezed(rows.reshape(len(rows), size + 1, -1))
            else:
                H[part], g[part] = _hessian_and_gradient(T[part, :3, :3], found, self._monomials_of(part))
        return cost, H, g

    def rows(self, T: Array, scale: float, huber: float | None, spare: int = 0) -> Array:
        """See `calibration.estimation.views.Term`."""
        out = np.empty((len(T), 7 + len(self.free) + spare, 2, self.length))
        for part in chunks(len(T), self.length):
            self._fill(out[part], T[part], self._projected(T[part], part, scale, huber), scale)
        return out

    def places(self, T: Array) -> Array:
        """See `calibration.estimation.views.Term`."""
        return np.broadcast_to(np.swapaxes(self.corners, -1, -2), (len(T), 3, self.length))

    def magnitudes(self, T: Array) -> Array:
        """(V, K): distance from each label to the projected corner (px); NaN if not seen or behind."""
        out = np.empty((len(T), self.length))
        for part in chunks(len(T), self.length):
            (x, y), _, front = self._normalised(T[part], part)
            xd, yd = self.camera.distortion.distort(x, y)
            u = self.camera.fx * xd - self._from_centre[0, part]
            v = self.camera.fy * yd - self._from_centre[1, part]
            out[part] = np.sqrt(u * u + v * v)
            if not front.all():
                out[part][~front] = np.nan
        return out if self.seen is None else np.where(self.seen, out, np.nan)

    @cached_property
    def _focal(self) -> Array:
        """(2, 1, 1), or (2, V, 1): focal lengths, px."""
        return np.array([self.camera.fx, self.camera.fy]).reshape(2, -1, 1)

    @cached_property
    def _from_centre(self) -> Array:
        """(2, V, K): labels relative to the principal point, px."""
        u, v = np.swapaxes(self.pixels, 0, 1)
        return np.stack([u - self.camera.cx, v - self.camera.cy])

    @cached_property
    def _monomials(self) -> Array:
        """(..., K, 6): 1, X, Y, X^2, XY and Y^2 of the corners."""
        X, Y = self.corners[..., 0], self.corners[..., 1]
        return np.stack([np.ones_like(X), X, Y, X * X, X * Y, Y * Y], -1)

    def _monomials_of(self, part: slice) -> Array:
        """Return the same of a part of the views."""
        return self._monomials if self.corners.ndim == 2 else self._monomials[part]

    @cached_property
    def _in_plane(self) -> Array:
        """(..., 3, K): 1, X and Y of the corners."""
        return np.ascontiguousarray(np.swapaxes(self._monomials[..., :3], -1, -2))

    def _normalised(self, T: Array, part: slice) -> tuple[Array, Array, BoolArray]:
        """Return normalised coordinates (2, v, K), inverse depth (v, K), and a mask of points in front of the camera.

        Points that are not in front have the depth 1, so that their numbers are finite.
        """
        axes = T[:, :3, [3, 0, 1]]  # of the pattern, after its centre: (v, 3, 3)
        if self.corners.ndim == 2:  # the camera's axes first: everything after is contiguous
            points = np.swapaxes(axes, 0, 1).reshape(-1, 3) @ self._in_plane
            points = points.reshape(3, len(T), -1)
        else:
            points = np.ascontiguousarray(np.swapaxes(axes @ self._in_plane[part], 0, 1))
        front = points[2] > 1e-6
        if not front.all():
            points[2][~front] = 1.0
        inverse_depth = np.divide(1.0, points[2], out=points[2])
        points[:2] *= inverse_depth
        return points[:2], inverse_depth, front

    def _projected(
        self, T: Array, part: slice, scale: float, huber: float | None, squares: Array | None = None
    ) -> "_Projected":
        """Project the corners of a part of the views; the arguments are those of `linearise`."""
        camera, seen = self.camera, None if self.seen is None else self.seen[part]
        normalised, inverse_depth, front = self._normalised(T, part)
        distorted, jacobian = camera.distortion.distort_with_jacobian(normalised)
        residuals = distorted * self._focal
        residuals -= self._from_centre[:, part]
        residuals *= 1 / scale
        if seen is not None:
            residuals = np.where(seen, residuals, 0.0)
        squared = (residuals * residuals).sum(0)
        cost, weight = robust(squared, huber)
        if squares is not None:
            np.multiply(squared, scale * scale, out=squares)
            if seen is not None or not front.all():
                squares[~front if seen is None else ~(seen & front)] = np.nan
        if not front.all():
            behind = ~front if seen is None else seen & ~front
            cost = np.where(behind.any(-1), np.inf, cost)
        if seen is not None:
            weight = seen.astype(float) if weight is None else weight * seen
        if weight is not None:
            residuals *= weight
        over_depth = inverse_depth if weight is None else weight * inverse_depth
        along = over_depth * (self._focal / scale)
        slopes = np.empty((2, *normalised.shape))
        np.multiply(jacobian[:2], along[0], out=slopes[0])
        np.multiply(jacobian[1:], along[1], out=slopes[1])
        return _Projected(cost, normalised, distorted, residuals, slopes, weight)

    def _fill(self, rows: Array, T: Array, found: "_Projected", scale: float) -> None:
        """Fill the first 6 + m and the last of weighted rows (v, r, 2, K)."""
        X, Y = self.corners[..., 0], self.corners[..., 1]  # rows are asked for of one pattern only
        along = np.moveaxis(rows, 2, 0)  # (2, v, r, K)
        bx, by, bz = found.by_translation(T[:, :3, :3])
        along[:, :, 0], along[:, :, 1], along[:, :, 2] = bx, by, bz
        np.multiply(bz, Y, out=along[:, :, 3])
        np.multiply(bz, -X, out=along[:, :, 4])
        np.subtract(X * by, Y * bx, out=along[:, :, 5])
        along[:, :, -1] = found.residuals
        if self.free:
            own = rows[:, 6 : 6 + len(self.free)]
            self._fill_intrinsics(own, found, scale)
            if found.weight is not None:
                own *= found.weight[:, None, None]

    def _fill_intrinsics(self, rows: Array, found: "_Projected", scale: float) -> None:
        """Fill (v, m, 2, K) rows: the derivative of both image axes by each of the free intrinsics."""
        fx, fy = self.camera.fx / scale, self.camera.fy / scale
        coefficients = self.camera.distortion.derivatives(*found.normalised) if max(self.free) > 3 else []
        for k, parameter in enumerate(self.free):
            if parameter > 3:
                dx, dy = coefficients[parameter - 4]
                np.multiply(dx, fx, out=rows[:, k, 0])
                np.multiply(dy, fy, out=rows[:, k, 1])
            else:
                axis = parameter % 2
                rows[:, k, 1 - axis] = 0.0
                if parameter < 2:
                    np.divide(found.distorted[axis], scale, out=rows[:, k, axis])
                else:
                    rows[:, k, axis] = 1 / scale


@frozen(eq=False)
class _Projected:
    """Corners of v views, projected, with derivatives; K corners, 2 axes of the image."""

    cost: Array
    """(v,)."""
    normalised: Array
    """(2, v, K): coordinates of an ideal camera."""
    distorted: Array
    """(2, v, K): those of this camera's lens."""
    residuals: Array
    """(2, v, K): weighted, in standard deviations."""
    slopes: Array
    """(2, 2, v, K): of both residuals, the derivatives by x and y of the normalised coordinates, over the depth."""
    weight: Array | None
    """(v, K): by which residuals and slopes are multiplied; None for 1."""

    def by_translation(self, R: Array) -> Array:
        """Return b (3, 2, v, K): the derivatives of both residuals by a translation along each axis of the pattern.

        Args:
            R: (v, 3, 3), rotations of ``T_camera_pattern``.
        """
        right, down, (x, y) = self.slopes[:, 0], self.slopes[:, 1], self.normalised
        a = (right, down, -(right * x + down * y))
        turned = [R[:, i].T[:, None, :, None] * a[i] for i in range(3)]
        return turned[0] + turned[1] + turned[2]


def _hessian_and_gradient(R: Array, found: _Projected, monomials: Array) -> tuple[Array, Array]:
    """Return Hessian (v, 6, 6) and gradient (v, 6) for a twist in the pattern's frame.

    Args:
        R: (v, 3, 3), rotations of ``T_camera_pattern``.
        found: the corners.
        monomials: (K, 6), or (v, K, 6), of the corners' places.
    """
    moments = _moments(found, monomials)
    to_pattern = np.swapaxes(R, 1, 2) * (1.0, 1.0, -1.0)
    turned = to_pattern @ np.swapaxes(moments[_PAIRS], 0, 1).reshape(-1, 3, 24)
    with_residual = turned[:, :, 18:].reshape(-1, 18)
    turned = to_pattern @ np.swapaxes(turned[:, :, :18].reshape(-1, 3, 3, 6), 1, 2).reshape(-1, 3, 18)
    H: Array = turned.reshape(-1, 54) @ _TO_HESSIAN
    g: Array = with_residual @ _TO_GRADIENT
    return H.reshape(-1, 6, 6), g


_PAIRS = np.array([0, 1, 3, 5, 1, 2, 4, 6, 3, 4, 7, 8])
"""Product of the components i and k of a, and of i and the residual, among `_moments`: (3, 4) in all."""


def _moments(found: _Projected, monomials: Array) -> Array:
    """Return the moments (9, v, 6) of the products of ``a = (x, y, -z)`` with itself and with the residual r.

    The products are xx, xy, yy, xz, yz, x r, y r, zz and z r. A translation along the camera's axes changes the
    normalised coordinates by ``(dx - x dz, dy - y dz)`` over the depth: with the slopes s of a residual,
    ``a = (s_x, s_y, -(x s_x + y s_y))``.
    """
    coordinates, slopes = found.normalised, found.slopes
    _, v, K = coordinates.shape
    products = np.empty((9, v, K))
    squares = slopes * slopes
    np.add(squares[0], squares[1], out=products[:3:2])
    np.multiply(slopes[:, 0], slopes[:, 1], out=squares[0])
    np.add(squares[0, 0], squares[0, 1], out=products[1])
    np.multiply(products[:2], coordinates[0], out=products[3:5])
    products[3:5] += products[1:3] * coordinates[1]
    np.multiply(slopes, found.residuals[:, None], out=squares)
    np.add(squares[0], squares[1], out=products[5:7])
    by_depth = products[3:7].reshape(2, 2, v, K) * coordinates
    np.add(by_depth[:, 0], by_depth[:, 1], out=products[7:])
    if monomials.ndim > 2:
        return np.swapaxes(np.swapaxes(products, 0, 1) @ monomials, 0, 1)
    moments = np.empty((9, v, 6))
    for rows in (slice(0, 5), slice(5, 9)):  # so that BLAS starts no threads
        np.matmul(products[rows].reshape(-1, K), monomials, out=moments[rows].reshape(-1, 6))
    return moments


def _from_moments() -> tuple[Array, Array]:
    """Return the matrices (54, 36) and (18, 6) from the moments of b of a view to its Hessian and its gradient.

    The moments are those of the components i and k of b and of six monomials (3, 3, 6), and of the component i, the
    residual and the monomials (3, 6).
    """
    monomials = {powers: m for m, powers in enumerate([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)])}
    # each element of a row of the Jacobian: components of b, their factors, and the powers of X and Y
    row = [[(i, 1.0, (0, 0))] for i in range(3)]
    row += [[(2, 1.0, (0, 1))], [(2, -1.0, (1, 0))], [(1, 1.0, (1, 0)), (0, -1.0, (0, 1))]]
    hessian, gradient = np.zeros((3, 3, 6, 6, 6)), np.zeros((3, 6, 6))
    for at, element in enumerate(row):
        for i, factor, (p, q) in element:
            gradient[i, monomials[p, q], at] = factor
            for other, its in enumerate(row):
                for k, its_factor, (r, s) in its:
                    hessian[i, k, monomials[p + r, q + s], at, other] = factor * its_factor
    return hessian.reshape(54, 36), gradient.reshape(18, 6)


_TO_HESSIAN, _TO_GRADIENT = _from_moments()


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
