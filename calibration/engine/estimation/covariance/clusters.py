"""Clusters of collections: those that repeat others, and sums over clusters with the local parameters eliminated."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.covariance.fixed_inputs import SeenGroup
from calibration.engine.estimation.least_squares.label_columns import POSE_COLUMNS, products
from calibration.engine.estimation.least_squares.normal_equations import Weighting, fill_unobserved
from calibration.engine.estimation.problem.problem import Columns, index_of
from calibration.engine.estimation.residuals.views import Term, sum_of_products
from calibration.engine.geometry.transforms import apply, distance

MAX_SIGMAS_IF_STILL = 2.0
"""Distance, in standard deviations of the labels, within which a pattern has not moved,"""
NEAR_PIXELS, NEAR_METRES = 0.3, 0.005
"""and distance in a camera's view (px), and for other sensors (m)."""
MAX_MOTION_IF_STILL = 1e-3
"""m, rad: tolerance of a transform of a robot that has not moved."""


def repeated_collections(dataset: Dataset, pixel: float | None) -> IntArray:
    """Return the cluster (N,) of each collection: the index of the first one that it repeats, or its own.

    A collection repeats an earlier one if every sensor that saw a pattern in both has it at the same pose, and the
    transforms between the sensors and fixed patterns are the same. Its labels have new noise but hardly any new
    information, so a cluster counts as one independent collection.

    Args:
        dataset: calibrated, so that patterns have their poses.
        pixel: the standard deviation of the corners, px; None without any.
    """
    clusters = np.arange(len(dataset.collections))
    near = _near_pairs(_border_corners(dataset, MAX_SIGMAS_IF_STILL * (pixel or 0.0)))
    moving = _moving_transforms(dataset) if near else []
    for k, first in near:
        if (
            clusters[k] == k
            and clusters[first] == first
            and all(np.max(distance(T[first], T[k])) < MAX_MOTION_IF_STILL for T in moving)
        ):
            clusters[k] = first
    return clusters


def _near_pairs(views: Sequence[Array]) -> list[tuple[int, int]]:
    """Pairs (i, j), j < i, ascending, of rows that are near in each of the views (N, F) which has both, and in one."""
    N = len(views[0]) if views else 0
    numbers = [np.zeros(0, int)]
    for view in views:
        i, j = _candidate_pairs(view)
        near = ~_rows_differ(view, i, j)
        numbers.append(i[near] * N + j[near])
    together = np.concatenate(numbers)
    if not len(together):
        return []
    i, j = np.divmod(np.unique(together), N)
    near = np.ones(len(i), bool)
    for view in views:
        near &= ~_rows_differ(view, i, j)
    return list(zip(i[near].tolist(), j[near].tolist(), strict=True))


def _rows_differ(view: Array, i: IntArray, j: IntArray) -> BoolArray:
    """Whether rows of a view (N, F) differ; NaN, not seen in both, is ignored."""
    return np.asarray(((view[i] - view[j]) ** 2).mean(-1) > 1.0)


def _candidate_pairs(view: Array) -> tuple[IntArray, IntArray]:
    """Pairs of rows i, j, j < i, of a view (N, F) whose first two coordinates allow that they are near."""
    order = view[:, 0].argsort(kind="stable")[: np.isfinite(view[:, 0]).sum()]
    ranked = view[order, 0]
    counts = np.searchsorted(ranked, ranked + np.sqrt(view.shape[-1]), side="right") - np.arange(len(order)) - 1
    first = np.repeat(np.arange(len(order)), counts)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    a, b = order[first], order[second]
    close = np.abs(view[a, 1] - view[b, 1]) <= np.sqrt(view.shape[-1])
    a, b = a[close], b[close]
    return np.maximum(a, b), np.minimum(a, b)


def _border_corners(dataset: Dataset, pixels: float) -> list[Array]:
    """Return the border's corners of each pattern in each sensor (N, 8 or 12), in tolerances; NaN if unseen."""
    found = []
    for name, pattern in dataset.patterns.items():
        corners = np.column_stack([pattern.outline, np.zeros(len(pattern.outline))])
        for sensor in dataset.sensors.values():
            at = _collections_seen(dataset, name, sensor.name)
            if not len(at):
                continue
            points = apply(dataset.transform(sensor.frame, pattern.link, at), corners)
            if sensor.camera and sensor.modality.has_corners:
                z = np.maximum(points[..., 2:], 1e-3)  # the border may be behind the camera
                focal = np.array([sensor.camera.fx, sensor.camera.fy])
                near = focal * points[..., :2] / z / max(pixels, NEAR_PIXELS)
            else:
                near = points / NEAR_METRES
            view = np.full((len(dataset.collections), near[0].size), np.nan)
            view[at] = near.reshape(len(at), -1)
            found.append(view)
    return found


def _collections_seen(dataset: Dataset, pattern: str, sensor: str) -> IntArray:
    """Return the collections (V,) in which a sensor saw a pattern that has a pose there."""
    board = dataset.patterns[pattern]
    seen = np.array([i for i, c in enumerate(dataset.collections) if (pattern, sensor) in c.labels], int)
    pose = dataset.transforms.get(board.edge)
    return seen if pose is None else seen[np.isfinite(pose[seen, 0, 0])]


def _moving_transforms(dataset: Dataset) -> list[Array]:
    """Return the transforms (N, 4, 4) between sensors and fixed patterns that differ between collections."""
    edges = {
        (step.parent, step.child)
        for pattern in dataset.patterns.values()
        if pattern.fixed
        for sensor in dataset.sensors.values()
        for step in dataset.tree.path(sensor.frame, pattern.parent_link)
    }
    T = [dataset.transforms[edge] for edge in sorted(edges - dataset.moving_transforms)]
    return [each for each in T if np.ptp(each, axis=0).max() > MAX_MOTION_IF_STILL]


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
