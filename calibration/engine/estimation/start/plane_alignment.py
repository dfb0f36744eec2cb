"""Extrinsics from planes at known poses, for LiDARs and depth cameras.

Each view of the pattern gives a plane ``n . x = d`` in the sensor's frame. Rotation and translation are
solved separately, the rotation from the normals and the translation from the distances (R. Unnikrishnan and M. Hebert,
"Fast extrinsic calibration of a laser rangefinder to a camera", 2005).
"""

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.estimation.residuals.median import median
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import inverse, transform

MIN_SINGULAR_VALUE_RATIO = 1e-3
"""Singular value of the normals relative to the largest, below which they do not determine a direction."""


def fit_planes(points: Array, present: BoolArray) -> tuple[Array, Array]:
    """Fit least-squares planes to views of points.

    Args:
        points: (V, 3, L), in the sensor's frame, m.
        present: (V, L), mask of valid ones.

    Returns:
        Unit normals (V, 3), pointing away from the sensor, and distances (V,) from its origin, m.
    """
    weight = present / present.sum(-1, keepdims=True)
    centre = (points * weight[:, None]).sum(-1)
    spread = (points - centre[..., None]) * np.sqrt(weight)[:, None]
    _, vectors = np.linalg.eigh(spread @ np.swapaxes(spread, 1, 2))
    normals = vectors[..., 0]
    offsets = (normals * centre).sum(-1)
    sign = np.where(offsets < 0, -1.0, 1.0)
    return normals * sign[:, None], offsets * sign


def align_planes(normals: Array, offsets: Array, before: Array, after: Array, guess: Array) -> tuple[Array, bool]:
    """Solve for the transform X that maps the pattern's planes, through ``before @ X @ after``, to the measured ones.

    With the pattern's normal m and centre p in X's child frame, and a measured plane (n, d) in its parent frame::

        R m = n               orthogonal Procrustes for R
        n . (R p + t) = d     linear least squares for t

    Both are iteratively reweighted, so that single views with a flipped pattern have no effect. A LiDAR mostly sees the
    same side of the pattern as the cameras; if the guess implies the other side and fits better, that is used.
    Directions of t that the planes do not determine are taken from the guess.

    Args:
        normals: (V, 3), measured, in the sensor's frame, pointing away from it.
        offsets: (V,), measured distances, m.
        before: (V, 4, 4), sensor to X's parent.
        after: (V, 4, 4), X's child to the pattern.
        guess: (4, 4), initial guess of X.

    Returns:
        X (4, 4), and whether it depends on the guess.
    """
    back = inverse(before)
    n = np.einsum("vij,vj->vi", back[:, :3, :3], normals)  # the planes in X's parent frame
    d = offsets + (n * back[:, :3, 3]).sum(-1)
    m, p = after[:, :3, 2], after[:, :3, 3]  # the pattern's normal and centre in X's child frame
    by_guess = np.sign((n * (m @ guess[:3, :3].T)).sum(-1))
    signs = [np.ones(len(n))] if (by_guess > 0).all() else [np.ones(len(n)), by_guess]
    candidates = [_align_signed(n * sign[:, None], d * sign, m, p, guess) for sign in signs]
    best = min(range(len(signs)), key=lambda k: candidates[k][1])
    X, _, is_open = candidates[best]
    return X, is_open or best > 0


def _align_signed(n: Array, d: Array, m: Array, p: Array, guess: Array) -> tuple[Array, float, bool]:
    """Solve for X with ``R m = n`` and ``n . (R p + t) = d``.

    Returns:
        X, the median misfit of the planes (m), and whether a direction of t is the guess's.
    """
    weight, is_open = np.ones(len(n)), False
    for _ in range(5):
        R = rotations.nearest(np.einsum("v,vi,vj->ij", weight, n, m))
        distance = d - (n * (p @ R.T)).sum(-1)
        t, is_left_open = _solve_translation(n, distance, np.sqrt(weight), guess[:3, 3])
        is_open |= is_left_open
        tilt = np.linalg.norm(n - m @ R.T, axis=-1)
        miss = np.abs(distance - n @ t) + tilt * median(np.abs(d))
        weight = 1.0 / np.maximum(miss, 0.5 * median(miss) + 1e-9)
    return transform(R, t), median(miss), is_open


def _solve_translation(n: Array, distance: Array, root: Array, guess: Array) -> tuple[Array, bool]:
    """Solve ``n . t = distance`` with the roots of weights (V,); what the planes do not determine is the guess's (3,).

    Returns:
        t, and whether they leave a direction to the guess, which has no effect otherwise, not even on the last bit.
    """
    weighted = n * root[:, None]
    t, _, rank, _ = np.linalg.lstsq(weighted, distance * root, rcond=MIN_SINGULAR_VALUE_RATIO)
    if rank < 3:
        t = guess + np.linalg.lstsq(weighted, (distance - n @ guess) * root, rcond=MIN_SINGULAR_VALUE_RATIO)[0]
    return np.asarray(t, float), bool(rank < 3)
