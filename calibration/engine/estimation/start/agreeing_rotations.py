"""Rotations of which each has several readings: those by which all agree with measured ones."""

import numpy as np

from calibration.base.arrays import Array

COLLECTIONS_TAKEN_AS_KNOWN = 3
"""Number of collections whose rotation is taken for known when branches are chosen."""
MAX_COLLECTIONS_COMPARED = 60
"""Limit of the number of collections that each is compared with, spread over all of them."""
MAX_ROUNDS = 4
"""Number of rounds in which the branches are chosen again."""


def rotations_that_agree(branches: Array, measured: Array) -> tuple[Array, float]:
    """Choose the branch of each rotation with which all agree best with measured ones.

    If ``A_i = X B_i Y``, then ``trace(A_i A_j^T) = trace(B_i B_j^T)`` for all i and j, whatever X and Y are.

    Args:
        branches: B (N, b, 3, 3); NaN where there are fewer.
        measured: A (N, 3, 3).

    Returns:
        The chosen rotations (N, 3, 3), and the median difference of those traces: of right ones, twice their error
        in rad at most.
    """
    N, b = branches.shape[:2]
    there = np.isfinite(branches[..., 0, 0])
    flat = np.nan_to_num(branches).reshape(N * b, 9)
    wanted = measured.reshape(N, 9) @ measured.reshape(N, 9).T
    first = [each for each in range(min(COLLECTIONS_TAKEN_AS_KNOWN, N) * b) if there.flat[each]]
    known = np.abs((flat @ flat[first].T).reshape(N, b, -1) - wanted[:, None, [each // b for each in first]])
    chosen = np.where(there[..., None], known, np.inf).argmin(1)  # (N, starts)
    some = np.unique(np.linspace(0, N - 1, min(N, MAX_COLLECTIONS_COMPARED)).round().astype(int))
    every = some[:, None]
    for _ in range(MAX_ROUNDS if b > 1 else 0):
        now = flat.reshape(N, b, 9)[every, chosen[some]]  # (some, starts, 9)
        off = (flat @ now.reshape(-1, 9).T).reshape(N, b, len(some), -1).swapaxes(2, 3)
        off = np.abs(off - wanted[:, None, None, some])
        chosen = np.where(there[..., None], off.mean(-1), np.inf).argmin(1)
    now = flat.reshape(N, b, 9)[every, chosen[some]]
    pairs = np.triu_indices(len(some), 1)
    apart = np.median(np.abs(now.swapaxes(0, 1) @ now.transpose(1, 2, 0) - wanted[np.ix_(some, some)])[:, *pairs], -1)
    best = int(apart.argmin())
    return branches[np.arange(N), chosen[:, best]], float(apart[best])


def disagreement_of_each(R: Array, measured: Array) -> Array:
    """Return the median difference (N,) of each rotation's traces from those of measured ones, both (N, 3, 3)."""
    flat, known = R.reshape(-1, 9), measured.reshape(-1, 9)
    return np.asarray(np.median(np.abs(flat @ flat.T - known @ known.T), -1))
