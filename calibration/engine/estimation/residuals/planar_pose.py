"""Pose of a planar pattern in a camera's frame, from one view by a linear method; all views at once.

Rays are undistorted normalised image coordinates in structure-of-arrays form, (V, 2, K): V views, x
and y, K corners (`calibration.engine.geometry.cameras.Camera.normalise` gives them). The values of a corner
that a view has not seen have no effect, not even NaN. A view whose seen corners cannot give a pose gets NaN.
"""

from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import transform
from calibration.engine.statistics import median

_VIEWS_PER_CHUNK = 128  # views at a time, so that the temporaries of a pass stay in the cache
_MIN_EIGENVALUE_RATIO = 1e-7  # ratio of the eigenvalues of a 2x2 moment matrix below which it counts as singular


def planar_poses(rays: Array, corners: Array, seen: BoolArray | None = None) -> Array:
    """Estimate the poses ``T_camera_pattern`` by the linear homography of each view.

    A homography maps the pattern's (1, q1, q2) to the image by ``x h3 = h1``, ``y h3 = h2``. It is
    scaled such that the centre of the seen corners has depth 1, so it lies in front of the camera:
    ``h3 = (1, c1, c2)``. With q centred and whitened the regressors (1, q1, q2) are orthogonal, and
    the normal equations of the direct linear transform shrink to 2x2 for (c1, c2). The pose is the
    polar factor of the homography's columns (Z. Zhang, "A flexible new technique for camera
    calibration", 2000, section 3.1 and appendix C).

    Args:
        rays: (V, 2, K), normalised coordinates.
        corners: (K, 3), in the pattern's frame, z = 0, m.
        seen: (V, K), which corners each view has; None for all.

    Returns:
        (V, 4, 4); NaN for a view with fewer than four seen corners, with all of them but at most
        one on a line, or whose image is a line or a point.
    """
    parts = [slice(start, start + _VIEWS_PER_CHUNK) for start in range(0, max(1, len(rays)), _VIEWS_PER_CHUNK)]
    with np.errstate(divide="ignore", invalid="ignore"):
        if seen is None:
            basis = _orthogonal_basis(corners, np.ones((1, len(corners)), bool))
            return np.concatenate([_poses_of_chunk(rays[part], basis) for part in parts])
        known = np.where(seen[:, None], rays, 0.0)
        return np.concatenate([_poses_of_chunk(known[part], _orthogonal_basis(corners, seen[part])) for part in parts])


def determines_pose(corners: Array, seen: BoolArray) -> BoolArray:
    """Return a mask (V,) of the views whose corners determine a pose: at least four, and not all but one on a line.

    Args:
        corners: (K, 3), in the pattern's frame, z = 0, m.
        seen: (V, K), which corners each view has.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return _orthogonal_basis(corners, seen).usable


@dataclass(frozen=True, eq=False)
class _Basis:
    """Orthogonal functions 1, q1 and q2 of the seen corners, each of norm sqrt(count); V is 1 if all views see all."""

    seen: Array
    """(V, K): 1 for each seen corner, else 0."""
    count: Array
    """(V, 1): number of seen corners."""
    centre: Array
    """(V, 2): their mean, m."""
    W: Array
    """(V, 2, 2): the matrix from corners relative to it to (q1, q2), 1/m."""
    monomials: Array
    """(V, 6, K): 1, q1, q2, q1^2, q1 q2 and q2^2."""
    usable: BoolArray
    """(V,): whether a homography is determined."""


def _orthogonal_basis(corners: Array, seen: BoolArray) -> _Basis:
    """Return the basis for views (V, K) of corners (K, 3)."""
    weights = seen.astype(float)
    count = weights.sum(-1)[:, None]
    origin = corners[:, :2].mean(0)
    flat = corners[:, :2] - origin
    size = np.sqrt((flat * flat).sum(-1).mean()) or 1.0
    middle = weights @ flat / count
    q = (flat.T - middle[..., None]) / size  # (V, 2, K)
    moments = (q * weights[:, None]) @ np.swapaxes(q, -1, -2) / count[..., None]
    W = _inverse_sqrt(moments)
    monomials = np.ones((*q.shape[:1], 6, len(corners)))
    q = np.matmul(W, q, out=monomials[:, 1:3])
    np.multiply(q[:, :1], q, out=monomials[:, 3:5])
    np.multiply(q[:, 1], q[:, 1], out=monomials[:, 5])
    # with more than one corner off a line, the pattern is determined also as its own image, x = q1 and y = q2
    image = np.concatenate([q, monomials[:, 3:4] + monomials[:, 5:]], 1) * weights[:, None]
    _, G = _fit_numerators(image @ monomials.swapaxes(1, 2), count)
    usable = (count[:, 0] >= 4) & _is_regular(moments) & _is_regular(G[:, 1:, 1:])
    return _Basis(weights, count, origin + middle, W / size, monomials, usable)


def _poses_of_chunk(rays: Array, basis: _Basis) -> Array:
    """`planar_poses` for a chunk of views, whose rays (V, 2, K) are 0 where a corner is not seen.

    All sums over corners are those of x, y and x^2 + y^2 of the rays times the monomials: products of matrices, and
    only one if all views have seen all corners.
    """
    count = basis.count
    centre = rays.sum(-1) / count
    factors = np.empty((len(rays), 3, rays.shape[-1]))
    offset = np.subtract(rays, centre[..., None], out=factors[:, :2])
    if not basis.seen.all():
        offset *= basis.seen[:, None]
    np.multiply(offset[:, 0], offset[:, 0], out=factors[:, 2])
    factors[:, 2] += offset[:, 1] * offset[:, 1]
    if len(basis.monomials) == 1:
        sums = (factors.reshape(-1, rays.shape[-1]) @ basis.monomials[0].T).reshape(-1, 3, 6)
    else:
        sums = factors @ basis.monomials.swapaxes(1, 2)
    fits, G = _fit_numerators(sums, count)
    c = -_solve_2x2(G[:, 1:, 1:], G[:, 1:, 0])
    H = np.ones((len(rays), 3, 3))  # columns for 1, q1, q2
    H[:, 2, 1:] = c
    H[:, :2] = fits[:, :, 0] + c[:, :1, None] * fits[:, :, 1] + c[:, 1:, None] * fits[:, :, 2]
    H[:, :2] += centre[..., None] * H[:, 2:]

    B = H[..., 1:] @ basis.W  # columns in metres
    S = B.swapaxes(-1, -2) @ B
    root = _inverse_sqrt(S)
    axes = B @ root
    scale = 0.5 * (root * S).sum((-1, -2))  # the mean singular value of B
    T = np.zeros((len(rays), 4, 4))
    T[:, :3, :2] = axes
    T[:, :3, 2] = np.cross(axes[..., 0], axes[..., 1])
    T[:, :3, 3] = H[..., 0] / scale[:, None] - (axes @ basis.centre[..., None])[..., 0]
    T[:, 3, 3] = 1.0

    spread = sums[:, 2, 0] / count[:, 0]
    usable = basis.usable & (spread > 1e-16 * (1 + (centre * centre).sum(-1))) & _is_regular(S)
    T[~usable] = np.nan
    return T


def _fit_numerators(sums: Array, count: Array) -> tuple[Array, Array]:
    """Fit ``x h3 = h1``, ``y h3 = h2`` to the corners of each view, for any h3.

    Args:
        sums: (V, 3, 6), of x, y and x^2 + y^2 times the monomials.
        count: (V, 1), numbers of corners.

    Returns:
        (V, 2, 3, 3), the matrices from h3 to the best h1 and h2; and (V, 3, 3), the matrix of what remains of the
        squared errors, a quadratic form of h3.
    """
    products = sums[..., [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]  # times (1, q1, q2)(1, q1, q2)^T
    fits = products[:, :2] / count[..., None, None]
    rows = fits.swapaxes(1, 2).reshape(-1, 3, 6)
    return fits, products[:, 2] - count[..., None] * (rows @ rows.swapaxes(-1, -2))


def _inverse_sqrt(S: Array) -> Array:
    """Compute ``S^(-1/2)`` of symmetric positive definite 2x2 matrices, in closed form."""
    a, b, c = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    s = np.sqrt(np.maximum(a * c - b * b, 0.0))
    t = np.sqrt(a + c + 2 * s)
    out = np.empty_like(S)
    out[..., 0, 0], out[..., 1, 1] = c + s, a + s
    out[..., 0, 1] = out[..., 1, 0] = -b
    return np.asarray(out / (s * t)[..., None, None])


def _solve_2x2(S: Array, r: Array) -> Array:
    """Solve symmetric 2x2 systems (..., 2, 2), (..., 2)."""
    a, b, c = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    adjugate = np.stack([c * r[..., 0] - b * r[..., 1], a * r[..., 1] - b * r[..., 0]], -1)
    return adjugate / (a * c - b * b)[..., None]


def _is_regular(S: Array) -> BoolArray:
    """Return a mask of the symmetric 2x2 matrices that are finite and not nearly singular."""
    a, b, c = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    return a * c - b * b > _MIN_EIGENVALUE_RATIO * (a + c) ** 2


def mirrored_poses(T: Array) -> Array:
    """Return the mirrored pose in which each planar pattern looks nearly the same.

    Far away, a plane and its reflection in the image plane through its centre have one image: the
    normal turns half a revolution about the line of sight to the centre, the origin of the frame. Least squares
    from there reaches the second local minimum (G. Schweighofer and A. Pinz, "Robust pose estimation from a
    planar target", 2006; T. Collins and A. Bartoli, "Infinitesimal plane-based pose estimation", 2014).

    Args:
        T: (V, 4, 4), ``T_camera_centre``.
    """
    t = T[:, :3, 3]
    v = t / np.linalg.norm(t, axis=-1, keepdims=True)
    mirror = np.eye(3) - 2 * v[:, :, None] * v[:, None]
    R = mirror @ T[:, :3, :3] * np.array([1.0, 1.0, -1.0])  # the plane is mirrored, the frame stays right-handed
    return transform(R, t)


def mean_pose(T: Array) -> Array:
    """Return a robust mean of poses (n, 4, 4).

    The rotation is the one nearest to the geometric median of the matrices, which minimises the sum of distances (not
    squared; iteratively reweighted from their mean: E. Weiszfeld, 1937; of rotations R. Hartley et al., "L1 rotation
    averaging using the Weiszfeld algorithm", 2011). The translation is the median of each coordinate.

    Raises:
        ValueError: there is no pose.
    """
    if not len(T):
        raise ValueError("the mean of no poses")
    matrices = T[:, :3, :3].reshape(-1, 9)
    middle = matrices.mean(0)
    for _ in range(20):
        difference = matrices - middle
        distance = np.sqrt(np.einsum("ni,ni->n", difference, difference))
        nearness = 1.0 / np.maximum(distance, 0.05 * median(distance) + 1e-12)
        step = nearness @ difference / nearness.sum()
        middle = middle + step
        if np.abs(step).max() < 1e-6:
            break
    return transform(rotations.nearest(middle.reshape(3, 3)), [median(each) for each in T[:, :3, 3].T])
