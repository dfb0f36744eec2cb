"""Sums of products of columns over clusters of collections, with the local parameters of each collection eliminated."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.estimation.covariance.fixed_inputs import SeenGroup
from calibration.engine.estimation.problem.batches import Columns, index_of
from calibration.engine.estimation.residuals.one_thread import sum_of_products
from calibration.engine.estimation.residuals.views import Term
from calibration.engine.estimation.solve.label_columns import POSE_COLUMNS, products
from calibration.engine.estimation.solve.normal_equations import Weighting, fill_unobserved


@dataclass(frozen=True, eq=False)
class GroupColumns:
    """Columns of the V views of a group: a that move the poses, then combinations of the E columns of labels."""

    columns: IntArray
    """(n,): their indices among all B columns; the last are the residuals."""
    twists: Array
    """(V, 6, a): twists of the poses by the first a columns."""
    weights: Array
    """(E + 1, n - a): the others, as combinations of the labels' columns and the residuals."""
    local: Columns
    """Indices of the p local columns among all P."""
    local_twists: Array
    """(V, 6, p): twists of the poses by the local columns."""


@dataclass(frozen=True, eq=False)
class ClusterSums:
    """Sums of products of B columns, of which the last are the residuals, and of P local ones; `add` adds to them."""

    clusters: IntArray
    """(N,): of each collection."""
    G: Array
    """(K, B, B): products of the columns, summed over each cluster."""
    mixed: Array
    """(N, P, B): products of the local ones and the columns, summed over each collection."""
    local: Array
    """(N, P, P): products of the local ones, likewise."""

    @classmethod
    def zeros(cls, clusters: IntArray, columns: int, local: int) -> Self:
        """Return sums of no views, of so many columns, and local columns; clusters (N,) are numbered from 0."""
        K, N = int(clusters.max()) + 1, len(clusters)
        zeros = (np.zeros(shape) for shape in ((K, columns, columns), (N, local, columns), (N, local, local)))
        return cls(clusters, *zeros)

    def add(self, seen: SeenGroup, terms: Sequence[Term], weighting: Weighting, own: GroupColumns) -> None:
        """Add the views of a group.

        Args:
            seen: the group.
            terms: its labels, with the intrinsics at the optimum.
            weighting: standard deviations and loss of the residuals.
            own: its columns.
        """
        order = _in_order(self.clusters[seen.group.collections])
        collections, T = seen.group.collections[order], seen.T[order]
        A, Y, W = own.twists[order], own.local_twists[order], own.weights
        clusters = self.clusters[collections]
        starts = _starts_of_runs(clusters)
        a, n = A.shape[-1], len(own.columns)
        M, right = np.empty((len(T), POSE_COLUMNS, POSE_COLUMNS)), np.empty((len(T), POSE_COLUMNS, n))
        L = np.zeros((len(starts), len(W), len(W)))
        terms = [term.take(order) for term in terms]
        for views, found in products(terms, seen.names.camera, seen.pattern, T, weighting, seen.names.rings):
            M[views] = found[:, :POSE_COLUMNS, :POSE_COLUMNS]
            np.matmul(found[:, :POSE_COLUMNS, POSE_COLUMNS:], W, out=right[views, :, a:])
            begins = _starts_of_runs(clusters[views])
            at = np.searchsorted(clusters[starts], clusters[views][begins])
            L[at] += np.add.reduceat(found[:, POSE_COLUMNS:, POSE_COLUMNS:], begins)
        np.matmul(M, A, out=right[:, :, :a])
        G = np.empty((len(starts), n, n))
        G[:, :a] = _sums_of_products(A, right, starts)
        G[:, a:, :a] = np.swapaxes(G[:, :a, a:], 1, 2)
        G[:, a:, a:] = W.T @ L @ W
        Yt, where, rows = np.swapaxes(Y, 1, 2), _as_slice(clusters[starts]), _as_slice(collections)
        self.local[index_of(rows, own.local, own.local)] += Yt @ M @ Y
        mixed, spans = Yt @ right, _runs_of_columns(own.columns)
        for i, to_i in spans:
            self.mixed[index_of(rows, own.local, to_i)] += mixed[:, :, i]
            for j, to_j in spans:
                self.G[index_of(where, to_i, to_j)] += G[:, i, j]

    def eliminated(self) -> Array:
        """Return the sums over clusters (K, B, B) with the local columns eliminated."""
        if not self.local.shape[-1]:
            return self.G
        fill_unobserved(self.local)
        solved = np.linalg.inv(self.local) @ self.mixed
        order = _in_order(self.clusters)
        taken = _sums_of_products(self.mixed[order], solved[order], _starts_of_runs(self.clusters[order]))
        return self.G - 0.5 * (taken + np.swapaxes(taken, 1, 2))


def _in_order(clusters: IntArray) -> IntArray | slice:
    """Return the index that sorts clusters (n,); all, as a slice, if they are sorted."""
    return slice(None) if (np.diff(clusters) >= 0).all() else clusters.argsort(kind="stable")


def _starts_of_runs(clusters: IntArray) -> IntArray:
    """Return the indices at which runs of equal clusters begin, in sorted clusters (n,)."""
    return np.flatnonzero(np.diff(clusters, prepend=-1))


def _as_slice(indices: IntArray) -> Columns:
    """Return ascending indices as a slice if they are contiguous, which is faster."""
    steps = np.diff(indices)
    return slice(int(indices[0]), int(indices[-1]) + 1) if (steps == 1).all() else indices


def _runs_of_columns(columns: IntArray) -> list[tuple[slice, slice]]:
    """Return runs of consecutive columns (n,), as slices of the n and slices of all columns."""
    ends = [0, *(np.flatnonzero(np.diff(columns) != 1) + 1).tolist(), len(columns)]
    return [(slice(i, j), slice(int(columns[i]), int(columns[i]) + j - i)) for i, j in pairwise(ends)]


def _sums_of_products(left: Array, right: Array, starts: IntArray) -> Array:
    """Return the sums (k, a, b) of ``left^T right``, (n, p, a) and (n, p, b), over runs that begin at ``starts``."""
    if len(starts) == len(left):
        return np.swapaxes(left, 1, 2) @ right
    out = np.empty((len(starts), left.shape[-1], right.shape[-1]))
    for k, (i, j) in enumerate(pairwise([*starts.tolist(), len(left)])):
        tall = (each[i:j].reshape(-1, each.shape[-1]) for each in (left, right))
        out[k] = sum_of_products(*tall)
    return out
