"""Pose of a planar pattern in a camera's frame, from one view by a linear method; all views at once.

Rays are undistorted normalised image coordinates in structure-of-arrays form, (V, 2, K): V views, x
and y, K corners (`calibration.geometry.cameras.Camera.normalise` gives them). The values of
view has not seen a corner does not matter, NaN included. A view whose seen corners cannot give a
pose gets NaN.
"""

import numpy as np

from calibration.estimation.median import median
from calibration.geometry import rotations
from calibration.geometry.transforms import apply, transform
from calibration.geometry.types import Array, ArrayLike, BoolArray

_CHUNK = 128  # views at a time, so that the temporaries of a pass stay in the cache
_FLAT = 1e-7  # ratio of the eigenvalues of a 2x2 moment matrix below which it counts as singular


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
    T = np.empty((len(rays), 4, 4))
    for start in range(0, len(rays), _CHUNK):
        views = slice(start, start + _CHUNK)
        T[views] = _planar_poses(rays[views], corners[:, :2], None if seen is None else seen[views])
    return T


def _planar_poses(rays: Array, corners: Array, seen: BoolArray | None) -> Array:
    """`planar_poses` for a chunk of views; the corners are (K, 2).

    All sums over corners are sums of 1, x, y and x^2 + y^2 of the rays times the monomials (1, a, b, a^2, ab, b^2) of
    the corners, which are the same in all views: one product of matrices.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        origin, size = corners.mean(0), np.sqrt(corners.var(0).sum()) or 1.0
        a, b = ((corners - origin) / size).T
        monomials = np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], -1)  # (K, 6)
        weights = np.ones((1, len(corners))) if seen is None else seen.astype(float)
        rays = rays if seen is None else np.where(seen[:, None], rays, 0.0)
        count = weights.sum(-1)
        middle = rays.sum(-1) / count[:, None]
        offset = rays - middle[..., None] if seen is None else (rays - middle[..., None]) * weights[:, None]

        of_corners = _second_moments(weights @ monomials)
        centre = of_corners[:, 0, 1:] / count[:, None]
        moments = of_corners[:, 1:, 1:] / count[:, None, None] - centre[:, :, None] * centre[:, None]
        W = _inverse_sqrt(moments)
        to_basis = np.zeros((len(W), 3, 3))  # from (1, a, b) to (1, q1, q2), each of norm sqrt(count)
        to_basis[:, 0, 0] = 1.0
        to_basis[:, 1:, 1:] = W
        to_basis[:, 1:, 0] = -(W @ centre[..., None])[..., 0]

        sums = np.concatenate([offset, (offset * offset).sum(1, keepdims=True)], 1) @ monomials
        in_basis = to_basis[:, None] @ _second_moments(sums) @ to_basis.swapaxes(-1, -2)[:, None]
        fits = in_basis[:, :2].swapaxes(1, 2) / count[:, None, None, None]  # (V, 3, 2, 3)
        flat = fits.reshape(len(fits), 3, 6)
        G = in_basis[:, 2] - count[:, None, None] * (flat @ flat.swapaxes(-1, -2))
        h3 = np.ones((len(rays), 3))
        h3[:, 1:] = -_solve2(G[:, 1:, 1:], G[:, 1:, 0])
        h12 = np.einsum("vi,vijk->vjk", h3, fits) + middle[..., None] * h3[:, None]
        H = np.concatenate([h12, h3[:, None]], 1)  # columns for 1, q1, q2

        B = H[..., 1:] @ (W / size)  # columns in metres
        S = B.swapaxes(-1, -2) @ B
        root = _inverse_sqrt(S)
        R = np.empty((len(rays), 3, 3))
        R[..., :2] = B @ root
        R[..., 2] = np.cross(R[..., 0], R[..., 1])
        scale = 0.5 * (root * S).sum((-1, -2))  # the mean singular value of B
        t = H[..., 0] / scale[:, None] - (R[..., :2] @ (origin + size * centre)[..., None])[..., 0]

        spread = sums[:, 2, 0] / count
        usable = (count >= 4) & _regular(moments) & _in_two_directions(to_basis, monomials, weights)
        usable = usable & (spread > 1e-16 * (1 + (middle * middle).sum(-1))) & _regular(S)
    return np.where(usable[:, None, None], transform(R, t), np.nan)


def _second_moments(sums: Array) -> Array:
    """Sums (..., 6) of the monomials (1, a, b, a^2, ab, b^2) as the matrices (..., 3, 3) of (1, a, b)(1, a, b)^T."""
    matrices: Array = sums[..., [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    return matrices


def _in_two_directions(to_basis: Array, monomials: Array, weights: Array) -> BoolArray:
    """Return a mask (V,) of the views with more than one corner off a line: otherwise the homography is ambiguous."""
    basis = (to_basis @ monomials[:, :3].T) * weights[:, None]  # (V, 3, K)
    q = basis[:, 1:]
    products = basis[:, :, None] * q[:, None]  # (V, 3, 2, K)
    count = weights.sum(-1)[:, None, None]
    flat = products.reshape(len(q), 3, -1)
    fits = (products.reshape(len(q), 6, -1) @ basis.swapaxes(-1, -2) / count).reshape(len(q), 3, 6)
    G = flat @ flat.swapaxes(-1, -2) - count * (fits @ fits.swapaxes(-1, -2))
    return _regular(G[:, 1:, 1:])


def _inverse_sqrt(S: Array) -> Array:
    """Compute ``S^(-1/2)`` of symmetric positive definite 2x2 matrices, in closed form."""
    a, b, c = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    s = np.sqrt(np.maximum(a * c - b * b, 0.0))
    t = np.sqrt(a + c + 2 * s)
    out = np.empty_like(S)
    out[..., 0, 0], out[..., 1, 1] = c + s, a + s
    out[..., 0, 1] = out[..., 1, 0] = -b
    root: Array = out / (s * t)[..., None, None]
    return root


def _solve2(S: Array, r: Array) -> Array:
    """Solve symmetric 2x2 systems (..., 2, 2), (..., 2)."""
    a, b, c = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    adjugate = np.stack([c * r[..., 0] - b * r[..., 1], a * r[..., 1] - b * r[..., 0]], -1)
    solution: Array = adjugate / (a * c - b * b)[..., None]
    return solution


def _regular(S: Array) -> BoolArray:
    """Return a mask of the symmetric 2x2 matrices that are finite and not nearly singular."""
    a, b, c = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    regular: BoolArray = a * c - b * b > _FLAT * (a + c) ** 2
    return regular


def mirrored_poses(T: Array, centre: Array) -> Array:
    """Return the mirrored pose in which each planar pattern looks nearly the same.

    Far away, a plane and its reflection in the image plane through its centre have one image: the
    normal turns half a revolution about the line of sight to the centre. Least squares from there
    reaches the second local minimum (G. Schweighofer and A. Pinz, "Robust pose estimation from a
    planar target", 2006; T. Collins and A. Bartoli, "Infinitesimal plane-based pose estimation", 2014).

    Args:
        T: (V, 4, 4), ``T_camera_pattern``.
        centre: (3,), the fixed point of the mirroring, in the pattern's frame.
    """
    p = apply(T, centre[None])[:, 0]
    v = p / np.linalg.norm(p, axis=-1, keepdims=True)
    mirror = np.eye(3) - 2 * v[:, :, None] * v[:, None]
    R = mirror @ T[:, :3, :3] * np.array([1.0, 1.0, -1.0])  # the plane is mirrored, the frame stays right-handed
    return transform(R, p - (R @ centre[:, None])[..., 0])


def mean_pose(T: Array, weights: ArrayLike | None = None) -> Array:
    """Return a robust mean of poses (n, 4, 4).

    The rotation minimises the sum of chordal distances (not squared; iteratively reweighted from
    the least-squares mean: R. Hartley et al., "L1 rotation averaging using the Weiszfeld algorithm",
    2011), the translation is the median of each coordinate.

    Raises:
        ValueError: there is no pose.
    """
    if not len(T):
        raise ValueError("the mean of no poses")
    w = np.ones(len(T)) if weights is None else np.asarray(weights, float)
    R = rotations.nearest(np.einsum("n,nij->ij", w, T[:, :3, :3]))
    for _ in range(20):
        distance = np.linalg.norm(T[:, :3, :3] - R, axis=(1, 2))
        nearness = w / np.maximum(distance, 0.05 * median(distance) + 1e-12)
        previous, R = R, rotations.nearest(np.einsum("n,nij->ij", nearness, T[:, :3, :3]))
        if np.linalg.norm(R - previous) < 1e-6:
            break
    return transform(R, _median(T[:, :3, 3], w))


def _median(values: Array, weights: Array) -> Array:
    """Weighted median of each column of (n, d); the mean of two values if they tie."""
    order = values.argsort(0, kind="stable")
    ranked, share = np.take_along_axis(values, order, 0), weights[order].cumsum(0) / weights.sum()
    low = (share > 0.5 - 1e-12).argmax(0)
    high = (share > 0.5 + 1e-12).argmax(0)  # another one where `low` has exactly one half
    median: Array = 0.5 * (np.take_along_axis(ranked, low[None], 0) + np.take_along_axis(ranked, high[None], 0))[0]
    return median
