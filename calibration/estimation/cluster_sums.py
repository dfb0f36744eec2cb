"""Sums of products of columns over clusters of collections, with the local parameters of each collection eliminated."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Self

import numpy as np

from calibration.estimation.batches import Columns, index_of
from calibration.estimation.held import SeenGroup
from calibration.estimation.label_columns import POSE, products
from calibration.estimation.normal_equations import Weighting, fill_unobserved
from calibration.estimation.views import Term
from calibration.frozen import frozen
from calibration.geometry.types import Array, IntArray


@frozen(eq=False)
class ClusterSums:
    """Sums of products of B columns, the last of them the residuals, and of P local ones, filled by `add`."""

    clusters: IntArray
    """(N,): of each collection."""
    G: Array
    """(K, B, B), over clusters."""
    mixed: Array
    """(N, P, B), over collections."""
    local: Array
    """(N, P, P)."""

    @classmethod
    def zeros(cls, clusters: IntArray, columns: int, local: int) -> Self:
        """Before any view."""
        K, N = int(clusters.max()) + 1, len(clusters)
        zeros = (np.zeros(shape) for shape in ((K, columns, columns), (N, local, columns), (N, local, local)))
        return cls(clusters, *zeros)

    def add(
        self,
        seen: SeenGroup,
        terms: Sequence[Term],
        weighting: Weighting,
        A: Array,
        W: Array,
        local: Columns,
        Y: Array,
    ) -> None:
        """Add the views of a group.

        Args:
            seen: the group.
            terms: its labels.
            weighting: weights of the residuals.
            A: (V, 6, a), twists of the poses.
            W: (a + E + 1, B), the columns as combinations of these, of the labels' columns and the residuals.
            local: its local columns.
            Y: (V, 6, p), their twists of the poses.
        """
        order = _in_order(self.clusters[seen.group.collections])
        collections, T, A, Y = seen.group.collections[order], seen.T[order], A[order], Y[order]
        clusters, starts, runs = np.unique(self.clusters[collections], return_index=True, return_inverse=True)
        a, n = A.shape[-1], len(W)
        M, right = np.empty((len(T), POSE, POSE)), np.empty((len(T), POSE, n))
        G = np.zeros((len(starts), n, n))
        terms = [term.take(order) for term in terms]
        for views, found in products(terms, seen.names.camera, seen.pattern, T, weighting):
            M[views], right[views, :, a:] = found[:, :POSE, :POSE], found[:, :POSE, POSE:]
            first = np.flatnonzero(np.diff(runs[views], prepend=-1))
            G[runs[views][first], a:, a:] += np.add.reduceat(found[:, POSE:, POSE:], first)
        np.matmul(M, A, out=right[:, :, :a])
        G[:, :a] = _products(A, right, starts)
        G[:, a:, :a] = np.swapaxes(G[:, :a, a:], 1, 2)
        self.G[_as_slice(clusters)] += W.T @ G @ W
        if Y.shape[-1]:
            Yt, rows = np.swapaxes(Y, 1, 2), _as_slice(collections)
            self.local[index_of(rows, local, local)] += Yt @ M @ Y
            more = (Yt @ right).reshape(-1, n) @ W
            self.mixed[index_of(rows, local)] += more.reshape(len(Y), -1, W.shape[1])

    def eliminated(self) -> Array:
        """Return the sums over clusters (K, B, B) with the local columns eliminated."""
        if not self.local.shape[-1]:
            return self.G
        fill_unobserved(self.local)
        solved = np.linalg.inv(self.local) @ self.mixed
        order = _in_order(self.clusters)
        starts = np.unique(self.clusters[order], return_index=True)[1]
        taken = _products(self.mixed[order], solved[order], starts)
        return self.G - 0.5 * (taken + np.swapaxes(taken, 1, 2))


def _in_order(clusters: IntArray) -> IntArray | slice:
    """Return the index that sorts clusters (n,); all, as a slice, if they are sorted."""
    return slice(None) if (np.diff(clusters) >= 0).all() else clusters.argsort(kind="stable")


def _as_slice(indices: IntArray) -> Columns:
    """Return ascending indices as a slice if they are contiguous, which is faster."""
    steps = np.diff(indices)
    return slice(int(indices[0]), int(indices[-1]) + 1) if (steps == 1).all() else indices


def _products(left: Array, right: Array, starts: IntArray) -> Array:
    """Return the sums (k, a, b) of ``left^T right``, (n, p, a) and (n, p, b), over runs that begin at ``starts``."""
    if len(starts) == len(left):
        return np.swapaxes(left, 1, 2) @ right
    _, p, a = left.shape
    left, right = left.reshape(-1, a), right.reshape(-1, right.shape[-1])
    ends = [*(p * starts).tolist(), len(left)]
    return np.array([left[i:j].T @ right[i:j] for i, j in pairwise(ends)])
