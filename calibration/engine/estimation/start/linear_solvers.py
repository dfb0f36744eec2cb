"""Unknown transforms by linear algebra: the robot-world and hand-eye problem, planes and scan lines at known poses.

The robot-world problem is ``A_i = X @ B_i @ Y`` for X and Y. With an arm that carries a pattern in front of a camera,
``A_i = T_camera_pattern`` is measured, ``B_i = T_base_flange`` is known from the joints, ``X = T_camera_base`` and
``Y = T_flange_pattern`` are unknown. The literature writes ``A Z' = X B`` with ``Z' = inverse(Y)``.

Each view of the pattern by a LiDAR or a depth camera gives a plane ``n . x = d`` in the sensor's frame. Rotation and
translation are solved separately, the rotation from the normals and the translation from the distances (R. Unnikrishnan
and M. Hebert, "Fast extrinsic calibration of a laser rangefinder to a camera", 2005). One view of a 2D LiDAR determines
no plane, so the points of all its views are solved together.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.base.arrays import Array, ArrayLike, BoolArray
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, distance, inverse, transform
from calibration.engine.statistics import median

MAX_REWEIGHTINGS = 10
"""Number of times that a robot-world problem is solved again with less weight on views that do not fit,"""
MAX_MISFIT_IF_FITTING = 0.03
"""as long as their mean misfit exceeds this (rad, and translations relative to the distance)."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Observability of a robot-world problem, from the motion and the measurements."""

    dispersion: Array
    """(3,): by how much the rotations of B tilt a fixed direction (rad), for the least tilted direction first.
    All 0: no rotation. One 0: rotations about one axis only. None 0: the motion determines X and Y."""
    axis: Array
    """(3,): the least tilted direction, a unit vector in B's child frame: the rotation axis, if there is only one."""

    def axes(self, threshold: float = 1e-3) -> int:
        """Approximate number of rotation axes: 0, 1 or (enough) 2; a tilt below `threshold` rad counts as none."""
        return max(0, int((self.dispersion > threshold).sum()) - 1)


class RobotWorld(NamedTuple):
    """Solution of ``A_i = X @ B_i @ Y``."""

    X: Array
    """(4, 4)."""
    Y: Array
    """(4, 4)."""
    spectrum: Spectrum


def solve_robot_world(A: Array, B: Array, weights: ArrayLike | None = None) -> RobotWorld:
    """Solve for X and Y by the Kronecker product: rotations first, then translations.

    ``R_X`` and ``R_Y^T`` are the nearest rotations to the leading pair of singular vectors of the sum
    of ``R_A kron R_B``; the translations follow from one linear least squares in the frame of A's
    parent (M. Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker
    product", 2013).

    A motion that does not determine them still gives finite numbers: check `Spectrum`. At least three
    poses with rotations about two axes are needed.

    Args:
        A: (n, 4, 4), finite.
        B: (n, 4, 4), finite.
        weights: (n,), not negative; None for equal weights.

    Raises:
        ValueError: there is no pose.
    """
    w = _normalised_weights(A, weights)
    RA, RB = A[:, :3, :3], B[:, :3, :3]
    # R_A = R_X R_B R_Y: maximise sum w <R_A R_Y^T, R_X R_B> = vec(R_X)^T K vec(R_Y^T)
    K = np.einsum("n,nij,nkl->ikjl", w, RA, RB).reshape(9, 9)
    U, _, Vt = np.linalg.svd(K)
    X, Yt = U[:, 0].reshape(3, 3), Vt[0].reshape(3, 3)
    sign = np.sign(np.linalg.det(X)) or 1.0  # both singular vectors may be negated together
    R_X, R_Yt = rotations.nearest(sign * X), rotations.nearest(sign * Yt)
    # t_A = R_X t_B + t_X + R_A R_Y^T t_Y
    t_X, t_Y = _solve_translations(A, B, w, R_X, RA @ R_Yt)
    return RobotWorld(transform(R_X, t_X), transform(R_Yt.T, t_Y), _spectrum_of_rotations(RB, w))


def solve_robot_world_robustly(A: Array, B: Array) -> RobotWorld:
    """Solve like `solve_robot_world`, reweighted a few times so that single wrong or flipped views have no effect."""
    solution = first = solve_robot_world(A, B)
    size = median(np.linalg.norm(A[:, :3, 3], axis=-1))
    for _ in range(MAX_REWEIGHTINGS):
        translation, rotation = distance(A, solution.X @ B @ solution.Y)
        miss = translation / size + rotation
        if miss.mean() <= MAX_MISFIT_IF_FITTING:
            break
        solution = solve_robot_world(A, B, 1 / np.maximum(miss, 0.5 * median(miss) + 1e-9) ** 2)
    return solution._replace(spectrum=first.spectrum)


def solve_li(A: Array, B: Array, weights: ArrayLike | None = None) -> RobotWorld:
    """Solve for X and Y by one linear system for rotations and translations together.

    The 24 unknowns are R_X, inverse(Y)'s rotation, and the translations of both; the two rotations
    are made orthogonal at the end (A. Li, L. Wang and D. Wu, "Simultaneous robot-world and hand-eye
    calibration using dual-quaternions and Kronecker product", 2010). Arguments, result and errors
    as `solve_robot_world`.
    """
    w = _normalised_weights(A, weights)
    n = len(A)
    root = np.sqrt(w)[:, None, None]
    RA, RB, eye = A[:, :3, :3], B[:, :3, :3], np.eye(3)
    # with Z = inverse(Y), A Z = X B: R_A R_Z - R_X R_B = 0 and R_A t_Z - R_X t_B - t_X = -t_A
    system = np.zeros((n, 12, 24))
    system[:, :9, :9] = np.einsum("nij,kl->nikjl", RA, eye).reshape(n, 9, 9)
    system[:, :9, 9:18] = -np.einsum("ij,nlk->nikjl", eye, RB).reshape(n, 9, 9)
    system[:, 9:, 9:18] = -np.einsum("ij,nl->nijl", eye, B[:, :3, 3]).reshape(n, 3, 9)
    system[:, 9:, 18:21] = RA
    system[:, 9:, 21:] = -eye
    right = np.zeros((n, 12, 1))
    right[:, 9:, 0] = -A[:, :3, 3]
    solution = np.linalg.lstsq((root * system).reshape(-1, 24), (root * right).reshape(-1), rcond=None)[0]
    R_Z, R_X = (rotations.nearest(part.reshape(3, 3)) for part in (solution[:9], solution[9:18]))
    Z = transform(R_Z, solution[18:21])
    return RobotWorld(transform(R_X, solution[21:]), inverse(Z), _spectrum_of_rotations(RB, w))


def _normalised_weights(A: Array, weights: ArrayLike | None) -> Array:
    """Return weights (n,) that sum to 1."""
    if not len(A):
        raise ValueError("a robot-world problem without poses")
    w = np.ones(len(A)) if weights is None else np.asarray(weights, float)
    return np.asarray(w / w.sum())


def _solve_translations(A: Array, B: Array, w: Array, R_X: Array, R: Array) -> tuple[Array, Array]:
    """Solve for t_X and t_Y in ``t_A = R_X t_B + t_X + R t_Y`` by least squares, R (n, 3, 3)."""
    system = np.concatenate([np.broadcast_to(np.eye(3), R.shape), R], -1)
    right = A[:, :3, 3] - B[:, :3, 3] @ R_X.T
    root = np.sqrt(w)[:, None]
    solution = np.linalg.lstsq((root[..., None] * system).reshape(-1, 6), (root * right).ravel(), rcond=None)[0]
    return solution[:3], solution[3:]


def _spectrum_of_rotations(RB: Array, w: Array) -> Spectrum:
    """Compute the spectrum from the rotations of B.

    The motion spreads a direction a of B's child frame to R_B a, whose mean has the length
    cos(dispersion); so the singular values of the mean rotation determine all three.
    """
    _, lengths, Vt = np.linalg.svd(np.einsum("n,nij->ij", w, RB))
    sines = np.sqrt(np.clip((1 - lengths) * (1 + lengths), 0.0, None))
    return Spectrum(dispersion=np.arctan2(sines, lengths), axis=Vt[0])


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


MAX_FLAT_SPREAD_RATIO = 1e-6
"""Points are coplanar if their spread across a plane is less than this times that along it."""
MIN_SINGULAR_VALUE_RATIO_OF_SCANS = 1e-7
"""Singular value of the equations relative to the largest, below which it is rounding error."""
COLUMN_LENGTH_LIMITS = (0.5, 2.0)
"""Limits of the lengths of the rotation's estimated columns; outside, the equations do not determine it."""
MAX_COSINE_OF_COLUMNS = 0.7
"""Limit of the cosines between these columns."""
MIN_SINGULAR_VALUE_RATIO_OF_MOTION = 0.01
"""If a motion of the points changes their distances to the planes by less than this times another one, the
planes do not determine it: their tilts hardly differ (rad)."""
NUMBER_OF_REWEIGHTINGS = 15
"""Number of times that the equations are solved, with less weight on outliers."""


def align_scans(points: Array, normals: Array, offsets: Array) -> Array | None:
    """Solve for the transform that puts points on known planes: ``normal . (R point + t) = offset``.

    Linear in t and in R's columns. Points of a LiDAR that is fixed in their frame all lie in one plane,
    ``o + x e1 + y e2``: then the unknowns are nine, ``R e1``, ``R e2`` and ``R o + t`` (the equations of Q. Zhang and
    R. Pless, "Extrinsic calibration of a camera and laser range finder", IROS 2004), else twelve. Two equations come
    from the line of each view, so nine unknowns need 5 planes of different tilts; 3 would do for the pose, with up to
    8 solutions (F. Vasconcelos et al., "A minimal solution for the extrinsic calibration of a camera and a
    laser-rangefinder", PAMI 2012), which are not distinguished here.

    There is no mirror ambiguity: a sensor upside down sees its ``e2`` with the other sign, so it has another
    linear solution; and of the two third columns that fit all points equally, ``R e1 x R e2`` and its negative, only
    the first makes a rotation. The side of a plane does not matter either.

    The nearest rotation is refined by Gauss-Newton on the distances to the planes. All is reweighted to the sum of
    absolute distances: up to a fifth of outliers, or of views with a wrong plane, have little effect.

    Args:
        points: (n, 3), m.
        normals: (n, 3), of the plane that each point lies on, unit vectors.
        offsets: (n,), their distances from the origin, m.

    Returns:
        (4, 4); None if the planes are too few or too similar.
    """
    if len(points) < 9:
        return None
    middle = points.mean(axis=0)
    _, spread, axes = np.linalg.svd(points - middle, full_matrices=False)
    axes[2] *= np.sign(np.linalg.det(axes))
    T_local_points = transform(axes, -axes @ middle)
    columns = 2 if spread[2] <= MAX_FLAT_SPREAD_RATIO * spread[0] else 3
    T_planes_local = _solve_linearly(apply(T_local_points, points), normals, offsets, columns)
    if T_planes_local is None:
        return None
    T = _refine_by_distances(T_planes_local, apply(T_local_points, points), normals, offsets)
    return None if T is None else T @ T_local_points


def scan_equations(points: Array, before: Array, after: Array) -> tuple[Array, Array, Array]:
    """Return the arguments of `align_scans` for the inverse of an X in ``T_sensor_pattern = before @ X @ after``.

    Args:
        points: (n, 3), in the sensor's frame.
        before: (n, 4, 4), of each point's view: sensor to X's parent.
        after: (n, 4, 4), X's child to the pattern.

    Returns:
        Points (n, 3) in X's parent frame; normals (n, 3) and offsets (n,) of the pattern's plane in X's child frame.
    """
    back, normals = inverse(before), after[:, :3, 2]
    moved = np.einsum("nij,nj->ni", back[:, :3, :3], points) + back[:, :3, 3]
    return moved, normals, (normals * after[:, :3, 3]).sum(-1)


def _solve_linearly(points: Array, normals: Array, offsets: Array, columns: int) -> Array | None:
    """Solve without the refinement, from points relative to their mean, whose last axes may be zero."""
    scale = float(np.sqrt((points**2).sum(-1).mean()))
    factors = [points[:, k, None] / scale * normals for k in range(columns)]
    A = np.concatenate([*factors, normals], -1)  # (n, 9 or 12)
    singular = np.linalg.svd(A, compute_uv=False)
    if singular[-1] <= MIN_SINGULAR_VALUE_RATIO_OF_SCANS * singular[0]:
        return None
    weight = np.ones(len(A))
    for _ in range(NUMBER_OF_REWEIGHTINGS):
        root = np.sqrt(weight)
        solution = np.linalg.lstsq(A * root[:, None], offsets * root, rcond=None)[0]
        weight = _weights_of_distances(A @ solution - offsets)
    R = solution[:-3].reshape(columns, 3).T / scale
    lengths = np.linalg.norm(R, axis=0)
    cosines = (R.T @ R) / (lengths[:, None] * lengths) - np.eye(columns)
    if not (
        lengths.min() > COLUMN_LENGTH_LIMITS[0]
        and lengths.max() < COLUMN_LENGTH_LIMITS[1]
        and np.abs(cosines).max() < MAX_COSINE_OF_COLUMNS
    ):
        return None
    if columns == 2:
        R = np.column_stack([R, np.cross(R[:, 0], R[:, 1])])
    return transform(rotations.nearest(R), solution[-3:])


def _refine_by_distances(T: Array, points: Array, normals: Array, offsets: Array) -> Array | None:
    """Refine by Gauss-Newton on the distances of the points to their planes, reweighted to their absolute values."""
    J = _jacobian_of_distances(T, points, normals)
    J[:, 3:] /= np.sqrt((points**2).sum(-1).mean())
    singular = np.linalg.svd(J, compute_uv=False)
    if singular[-1] < MIN_SINGULAR_VALUE_RATIO_OF_MOTION * singular[0]:
        return None
    for _ in range(NUMBER_OF_REWEIGHTINGS):
        miss = (normals * apply(T, points)).sum(-1) - offsets
        root = np.sqrt(_weights_of_distances(miss))
        step = np.linalg.lstsq(_jacobian_of_distances(T, points, normals) * root[:, None], -miss * root, rcond=None)[0]
        T = T @ transform(rotations.exp(step[3:]), step[:3])
    return T


def _jacobian_of_distances(T: Array, points: Array, normals: Array) -> Array:
    """Jacobian (n, 6) of the points' distances to their planes by a twist of the points' frame."""
    back = normals @ T[:3, :3]
    return np.concatenate([back, np.cross(points, back)], -1)


def _weights_of_distances(miss: Array) -> Array:
    """Return weights (n,) that make squared distances count as their absolute values, down to half their median."""
    size = np.abs(miss)
    return 1.0 / np.maximum(size, 0.5 * median(size) + 1e-9)
