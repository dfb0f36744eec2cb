"""Products with tall matrices, in pieces so small that BLAS starts no threads.

On a busy machine threads wait for each other, for longer than such products take.
"""

import numpy as np

from calibration.base.arrays import Array

MAX_MULTIPLICATIONS = 1 << 18
"""Most multiplications in a product of matrices for which OpenBLAS starts no threads."""


def product(A: Array, B: Array) -> Array:
    """Return ``A @ B`` (n, m) of a tall A (n, k) and a small B (k, m)."""
    out = np.empty((len(A), B.shape[1]))
    rows = _rows_per_piece(B.size)
    for start in range(0, len(A), rows):
        np.matmul(A[start : start + rows], B, out=out[start : start + rows])
    return out


def sum_of_products(A: Array, B: Array) -> Array:
    """Return ``A^T B`` (k, m) of two tall matrices (n, k) and (n, m)."""
    rows = _rows_per_piece(A.shape[1] * B.shape[1])
    total: Array = A[:rows].T @ B[:rows]
    for start in range(rows, len(A), rows):
        total += A[start : start + rows].T @ B[start : start + rows]
    return total


def _rows_per_piece(multiplications: int) -> int:
    """Return the number of rows in a piece, where each row takes so many multiplications."""
    return max(1, MAX_MULTIPLICATIONS // max(1, multiplications))
