"""Residuals of views, with their Jacobians reduced to a 6x6 matrix and a 6-vector: what all kinds of labels share.

Every label of a view depends on one rigid pose ``T_sensor_pattern``. So its residuals are differentiated by a twist of
that pose in the *pattern's* frame, about the centre of its corners, once, and only the Hessian ``J^T J`` (6x6), the
gradient ``J^T r`` (6) and the cost leave the modules `corner_residuals`, `ray_residuals` and `pose_residuals`, whatever
the chain behind the pose. Free intrinsics of a camera are further columns of the same rows.
Points are stored as structure of arrays, and processed in chunks of views that fit into the processor's cache.
"""

from collections.abc import Iterator

import numpy as np

from calibration.base.arrays import Array

LABELS_PER_CHUNK = 19200
"""Labels per chunk: enough to be worth the calls on them, while their numbers fit into a cache; and BLAS starts no
threads for their product with the (4, 3) numbers of a pose (`calibration.engine.estimation.residuals.one_thread`)."""
MAX_VIEWS_PER_CHUNK = 384
"""Most views per chunk, so that BLAS starts no threads for their rotations (v, 9) times (9, 54) numbers either."""

Linearised = tuple[Array, Array, Array]


# glibc maps fresh pages for every array above a threshold, and mapping them costs more than filling them. The threshold
# rises to the size of an array that is freed, at most 32 MB, and twice as much freed memory is kept for later arrays
# (M_MMAP_THRESHOLD and M_TRIM_THRESHOLD in mallopt(3)): they now reuse pages, in one calibration after another too.
np.empty(31 << 20, np.uint8)


def robust(squared: Array, huber: float | None) -> tuple[Array, Array | None]:
    """Return the cost (v,) of squared, normalised residuals (v, L), and the square root of their weights.

    Huber's loss: squared up to the threshold k, ``2 k e - k^2`` beyond it; its weight there is k / e.
    """
    if huber is None:
        return squared.sum(-1), None
    outside = np.flatnonzero(squared > huber * huber)
    if not len(outside):
        return squared.sum(-1), None
    e = np.sqrt(squared.take(outside))
    loss, weight = squared.copy(), np.ones(squared.shape)
    loss.put(outside, 2 * huber * e - huber * huber)
    weight.put(outside, np.sqrt(huber / e))
    return loss.sum(-1), weight


def total_loss(squared: Array, scale: float, huber: float | None) -> float:
    """Return the cost that `robust` gives to squared residuals of any shape, not normalised; NaN without a label."""
    flat = squared.ravel()
    limit = np.inf if huber is None else (huber * scale) ** 2
    cost = float(flat.compress(flat <= limit).sum()) / scale**2
    if huber is None:
        return cost
    e = np.sqrt(flat.compress(flat > limit)) / scale
    return cost + 2 * huber * float(e.sum()) - huber * huber * len(e)


def spread(rows: Array, out: Array) -> Array:
    """Fill the first six and the last of more rows (r, v, L) with rows (v, 7, L)."""
    out[:6], out[-1] = np.swapaxes(rows[:, :6], 0, 1), rows[:, 6]
    return out


def squeezed(rows: Array) -> tuple[Array, Array]:
    """Return Hessian (v, p, p) and gradient (v, p) of weighted rows (v, p + 1, n): the Jacobian's, and the residual."""
    G = rows @ rows.transpose(0, 2, 1)
    return G[:, :-1, :-1], G[:, :-1, -1]


def chunks(views: int, labels: int) -> Iterator[slice]:
    """Yield parts of the views with about `LABELS_PER_CHUNK` labels each, of 1 to `MAX_VIEWS_PER_CHUNK` views."""
    step = max(1, min(MAX_VIEWS_PER_CHUNK, LABELS_PER_CHUNK // max(1, labels)))
    for start in range(0, views, step):
        yield slice(start, min(start + step, views))
