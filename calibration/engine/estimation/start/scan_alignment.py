"""2D LiDAR extrinsics from line scans of planes at known poses.

One view determines no plane, so the points of all views are solved together.
"""

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.estimation.residuals.median import median
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import apply, inverse, transform

MAX_FLAT_SPREAD_RATIO = 1e-6
"""Points are coplanar if their spread across a plane is less than this times that along it."""
MIN_SINGULAR_VALUE_RATIO = 1e-7
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
    if singular[-1] <= MIN_SINGULAR_VALUE_RATIO * singular[0]:
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
    weight: Array = 1.0 / np.maximum(size, 0.5 * median(size) + 1e-9)
    return weight
