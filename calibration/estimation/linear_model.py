"""The calibration near its optimum as a linear model of everything, calibrated or held.

The normal equations are widened by columns of what is held (`calibration.estimation.held`), and the parameters that
each collection has its own of are eliminated collection by collection, as in `calibration.estimation.normal_equations`.
What is left is, of each cluster of collections, one small matrix and vector::

    G_k = sum_c (Z_c^T Z_c - Z_c^T Y_c (Y_c^T Y_c)^-1 Y_c^T Z_c)        g_k likewise of Z_c^T r

with the columns Z of the S calibrated parameters that all collections share and of the causes, Y of the local ones.
Every question about what is held is a question to these: no label is looked at again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.dataset.model import Dataset
from calibration.estimation.assumptions import Assumptions
from calibration.estimation.batches import batches, table_of
from calibration.estimation.blocks import Values
from calibration.estimation.held import (
    Cause,
    SeenGroup,
    causes,
    lag,
    moved_pattern,
    moved_sensor,
    seen_groups,
    velocities,
)
from calibration.estimation.label_columns import POSE, squeeze
from calibration.estimation.normal_equations import Weighting
from calibration.estimation.problem import Problem
from calibration.geometry.types import Array, IntArray

MOST_CLUSTERS = 100
"""Clusters of collections; more tell nothing new about how far collections disagree."""
VIEWS_AT_A_TIME = 256


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Information and gradient of the shared parameters and of causes, cluster by cluster."""

    shared: int
    """S: so many columns come first."""
    causes: tuple[Cause, ...]
    places: tuple[slice, ...]
    """Where the columns of each cause stand."""
    typical: tuple[tuple[float, ...], ...]
    """Of each cause what its parameters are usually known with, where nothing else is assumed."""
    G: Array
    """(K, C, C), in standard deviations."""
    g: Array
    """(K, C)."""
    prior: Array
    """(S, S): information that is known beforehand."""
    clusters: IntArray
    """(N,): the cluster of each collection."""
    alone: Array
    """(C,): the information on each column if all else were known: what is left of it beside others is to be compared
    with this, as rounding leaves some of nothing."""

    @cached_property
    def total(self) -> Array:
        """(C, C): the sum over the clusters, and the prior."""
        total: Array = self.G.sum(0)
        total[: self.shared, : self.shared] += self.prior
        return total

    @cached_property
    def gradient(self) -> Array:
        """(C,): that of the causes; of the shared parameters it is zero at the optimum, but for rounding."""
        gradient: Array = self.g.sum(0)
        gradient[: self.shared] = 0.0
        return gradient

    def columns_of(self, cause: Cause) -> slice:
        """Where the columns of a cause stand."""
        return next(at for each, at in zip(self.causes, self.places, strict=True) if each is cause)


def linear_model(
    problem: Problem,
    values: Values,
    weighting: Weighting,
    dataset: Dataset,
    assume: Assumptions,
    clusters: IntArray | None = None,
) -> LinearModel:
    """Linearise at the optimum.

    Args:
        problem: the problem.
        values: the optimum.
        weighting: its weights.
        dataset: the collections that count, with the transforms of the optimum.
        assume: how well what is held is known.
        clusters: (N,), which collections are not independent of each other, numbers from 0 on; each its own if None.
    """
    groups = seen_groups(dataset, problem.groups, [problem.poses(group, values) for group in problem.groups])
    found = _causes(problem, dataset, groups, assume)
    typical = [cause.assumed for cause in _causes(problem, dataset, groups, Assumptions())]
    S, P = problem.sizes
    N = problem.collections
    ends = np.cumsum([S, *(cause.size for cause in found)]).tolist()
    places = [slice(*ends[i : i + 2]) for i in range(len(found))]
    C = ends[-1]
    clusters = _at_most(np.arange(N) if clusters is None else clusters, MOST_CLUSTERS)
    K = int(clusters.max()) + 1
    G, g = np.zeros((K, C, C)), np.zeros((K, C))
    mixed, H_local, g_local = np.zeros((N, C, P)), np.zeros((N, P, P)), np.zeros((N, P))
    table = table_of(problem.blocks, values)
    for seen in groups:
        start = 0
        for batch in batches(problem.blocks, [seen.group], N, problem.shared_parameters, problem.local_parameters):
            _, A = batch.linearise(table, values)
            spread = batch.spread(A, (S, P), slice(0, 0))
            count = len(A)
            span = slice(start, start + count)
            start += count
            active, Z = _design(problem, seen, found, places, spread[0], span)
            _add(
                problem, seen, weighting, values, span, active, Z, spread[1], clusters, (G, g, mixed, H_local, g_local)
            )
    alone = np.einsum("kii->i", G)
    if P:
        _eliminate(G, g, mixed, H_local, g_local, clusters)
    prior = _priors(problem, values)
    kept = [i for i, at in enumerate(places) if G[:, at, at].any()]
    columns = np.concatenate([np.arange(S), *(np.arange(places[i].start, places[i].stop) for i in kept)]).astype(int)
    ends = np.cumsum([S, *(found[i].size for i in kept)]).tolist()
    return LinearModel(
        S,
        tuple(found[i] for i in kept),
        tuple(slice(*ends[k : k + 2]) for k in range(len(kept))),
        tuple(typical[i] for i in kept),
        G[:, columns[:, None], columns],
        g[:, columns],
        prior,
        clusters,
        alone[columns],
    )


def _causes(problem: Problem, dataset: Dataset, groups: Sequence[SeenGroup], assume: Assumptions) -> list[Cause]:
    """What is held; and of each sensor and fixed pattern its place, and its lag, which are no error of what is held."""
    intrinsics = [(block.intrinsics, block.held) for block in problem.blocks if block.intrinsics]
    free = {each.sensor: each.free for each, held in intrinsics if not held}
    known = [each.sensor for each, held in intrinsics if held and each.prior]
    seen = dict.fromkeys(group.group.sensor for group in groups)
    speeds = {(group.sensor.name, group.pattern.name): velocities(group) for group in groups}
    patterns = dict.fromkeys(group.pattern.name for group in groups if group.pattern.fixed)
    return [
        *causes(dataset, groups, assume, free, known),
        *(lag(dataset.sensors[name], speeds) for name in seen),
        *(moved_sensor(dataset.sensors[name]) for name in seen),
        *(moved_pattern(dataset.patterns[name]) for name in patterns),
    ]


def _at_most(clusters: IntArray, most: int) -> IntArray:
    """Clusters, neighbours put together until there are no more than ``most``."""
    _, clusters = np.unique(clusters, return_inverse=True)
    count = int(clusters.max()) + 1
    return clusters * most // count if count > most else clusters


def _design(
    problem: Problem, seen: SeenGroup, found: Sequence[Cause], places: Sequence[slice], J: Array, span: slice
) -> tuple[IntArray, Array]:
    """Which columns (C,) the views of a span depend on, and how on them: (v, 6 + E, active)."""
    S = J.shape[-1]
    used = np.flatnonzero(np.abs(J).max((0, 1)) > 0)
    active, parts = [used], [seen.widened(J[:, :POSE, used])]
    if seen.group.intrinsics is not None and not problem.blocks[seen.group.intrinsics].held:
        intrinsics = problem.blocks[seen.group.intrinsics].intrinsics
        if intrinsics is None:
            raise AssertionError("a group's block of intrinsics has none")
        at = problem.shared_parameters[seen.group.intrinsics]
        own = np.concatenate([seen.names.selection({name: 1.0}) for name in intrinsics.free], -1)
        active.append(np.arange(at.start, at.stop))
        parts.append(np.broadcast_to(own, (len(J), *own.shape)))
    for cause, at in zip(found, places, strict=True):
        columns = cause.columns(seen)
        if columns is not None:
            active.append(np.arange(at.start, at.stop))
            parts.append(columns[span] if columns.ndim == 3 else np.broadcast_to(columns, (len(J), *columns.shape)))
    if S == 0:
        raise AssertionError("nothing is calibrated")
    return np.concatenate(active), np.concatenate([part for part in parts if part is not None], -1)


def _add(
    problem: Problem,
    seen: SeenGroup,
    weighting: Weighting,
    values: Values,
    span: slice,
    active: IntArray,
    Z: Array,
    J_local: Array,
    clusters: IntArray,
    sums: tuple[Array, Array, Array, Array, Array],
) -> None:
    """Add the views of a span to the sums over clusters and collections."""
    G, g, mixed, H_local, g_local = sums
    group = seen.group.take(span)
    terms = problem.terms(group, values)
    for first in range(0, len(Z), VIEWS_AT_A_TIME):
        part = slice(first, first + VIEWS_AT_A_TIME)
        M, m = squeeze(
            [term.take(part) for term in terms], seen.names.camera, seen.pattern, seen.T[span][part], weighting
        )
        collections = group.collections[part]
        MZ = M @ Z[part]
        for k in np.unique(clusters[collections]):
            of = clusters[collections] == k
            left = Z[part][of].reshape(-1, len(active))
            G[k][np.ix_(active, active)] += left.T @ MZ[of].reshape(-1, len(active))
            g[k][active] += left.T @ m[of].ravel()
        Y = J_local[part, :POSE]
        if Y.shape[-1]:
            Yt = np.swapaxes(Y, 1, 2)
            H_local[collections] += Yt @ M[:, :POSE, :POSE] @ Y
            g_local[collections] += (Yt @ m[:, :POSE, None])[..., 0]
            mixed[collections[:, None], active] += np.swapaxes(MZ[:, :POSE], 1, 2) @ Y


def _eliminate(G: Array, g: Array, mixed: Array, H_local: Array, g_local: Array, clusters: IntArray) -> None:
    """Take the local parameters out of the sums of each cluster."""
    index = np.arange(H_local.shape[-1])
    diagonal = H_local[:, index, index]
    H_local[:, index, index] = np.where(diagonal == 0.0, 1.0, diagonal)
    right = np.concatenate([np.swapaxes(mixed, 1, 2), g_local[..., None]], -1)
    solved = np.linalg.solve(H_local, right)
    for k in range(len(G)):
        of = clusters == k
        left = np.swapaxes(mixed[of], 0, 1).reshape(mixed.shape[1], -1)
        taken = left @ solved[of].reshape(-1, solved.shape[-1])
        G[k] -= taken[:, :-1]
        g[k] -= taken[:, -1]
        G[k] = 0.5 * (G[k] + G[k].T)


def _priors(problem: Problem, values: Values) -> Array:
    """(S, S): what is known beforehand of the shared parameters."""
    S, _ = problem.sizes
    prior = np.zeros((S, S))
    for block, at in problem.shared_parameters.items():
        intrinsics = problem.blocks[block].intrinsics
        if intrinsics and intrinsics.prior:
            prior[at, at] = intrinsics.pull(values[block])[2]
    return prior
