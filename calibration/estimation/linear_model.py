"""Linear model of a calibration at its optimum, of calibrated and fixed parameters.

The normal equations are extended by columns of fixed parameters (`calibration.estimation.held`), and the local
parameters of each collection are eliminated by the Schur complement, as in `calibration.estimation.normal_equations`.
The result is one small matrix and vector for each cluster k of collections c::

    G_k = sum_c (Z_c^T Z_c - Z_c^T Y_c (Y_c^T Y_c)^-1 Y_c^T Z_c)        g_k likewise of Z_c^T r

with the columns Z of the S calibrated shared parameters and of the causes, Y of the local ones.
All questions on fixed parameters are answered from these, without another pass over the labels.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Self

import numpy as np

from calibration.dataset.model import Dataset
from calibration.estimation.assumptions import Assumptions
from calibration.estimation.batches import batches, table_of
from calibration.estimation.blocks import Values
from calibration.estimation.distinct import distinct
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
from calibration.estimation.views import Term
from calibration.frozen import frozen
from calibration.geometry.types import Array, IntArray

MOST_CLUSTERS = 100
"""Limit of the number of clusters; more give no better estimate of the collections' disagreement."""
VIEWS_AT_A_TIME = 128


@frozen(eq=False)
class LinearModel:
    """Information and gradient of the shared parameters and of causes, by cluster."""

    shared: int
    """S: number of the first columns."""
    causes: tuple[Cause, ...]
    places: tuple[slice, ...]
    """Columns of each cause."""
    typical: tuple[tuple[float, ...], ...]
    """By cause, typical standard deviations of its parameters, if no others are assumed."""
    G: Array
    """(K, C, C), in standard deviations."""
    g: Array
    """(K, C)."""
    prior: Array
    """(S, S): information of the priors."""
    clusters: IntArray
    """(N,): cluster of each collection."""
    alone: Array
    """(C,): information on each column if all others were known, the reference for rounding errors in what is left of
    it beside the others."""

    @cached_property
    def total(self) -> Array:
        """(C, C): sum over the clusters, and the prior."""
        total: Array = self.G.sum(0)
        total[: self.shared, : self.shared] += self.prior
        return total

    @cached_property
    def gradient(self) -> Array:
        """(C,): gradient of the causes; that of the shared parameters is zero at the optimum, up to rounding."""
        gradient: Array = self.g.sum(0)
        gradient[: self.shared] = 0.0
        return gradient

    def columns_of(self, cause: Cause) -> slice:
        """Return the columns of a cause."""
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
        assume: assumed standard deviations of fixed parameters.
        clusters: (N,), cluster of each collection, from 0; equal for dependent ones. Each is its own if None.
    """
    groups = seen_groups(dataset, problem.groups, [problem.poses(group, values) for group in problem.groups])
    found = _causes(problem, dataset, groups, assume)
    usual = found if assume == Assumptions() else _causes(problem, dataset, groups, Assumptions())
    typical = [cause.assumed for cause in usual]
    S, P = problem.sizes
    N = problem.collections
    ends = np.cumsum([S, *(cause.size for cause in found)]).tolist()
    places = [slice(*ends[i : i + 2]) for i in range(len(found))]
    clusters = _at_most(np.arange(N) if clusters is None else clusters, MOST_CLUSTERS)
    sums = _Sums.zeros(int(clusters.max()) + 1, N, ends[-1], P)
    table = table_of(problem.blocks, values)
    for seen in groups:
        start = 0
        for batch in batches(problem.blocks, [seen.group], N, problem.shared_parameters, problem.local_parameters):
            _, A = batch.linearise(table, values)
            J_shared, J_local = batch.spread(A, (S, P), slice(0, 0))
            span = slice(start, start := start + len(A))
            design = _design(problem, seen, found, places, J_shared, span)
            terms = problem.terms(seen.group.take(span), values)
            _add(sums, seen, span, terms, weighting, design, J_local, clusters)
    G, g = sums.G, sums.g
    alone = np.einsum("kii->i", G)
    if P:
        _eliminate(sums, clusters)
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
    """Return the causes of fixed parameters; and of each sensor and fixed pattern a displacement and a time offset."""
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
    """Merge neighbouring clusters until there are at most ``most``."""
    _, clusters = distinct(clusters)
    count = int(clusters.max()) + 1
    return clusters * most // count if count > most else clusters


@frozen(eq=False)
class _Sums:
    """Sums of the products of all columns, filled by `_add`."""

    G: Array
    """(K, C, C), over clusters."""
    g: Array
    """(K, C)."""
    mixed: Array
    """(N, C, P), over collections."""
    H_local: Array
    """(N, P, P)."""
    g_local: Array
    """(N, P)."""

    @classmethod
    def zeros(cls, K: int, N: int, C: int, P: int) -> Self:
        """Before any view."""
        return cls(np.zeros((K, C, C)), np.zeros((K, C)), np.zeros((N, C, P)), np.zeros((N, P, P)), np.zeros((N, P)))


@frozen(eq=False)
class _Design:
    """Derivatives of some views by the columns of the model: of their pose, and of the view's other columns."""

    moving: IntArray
    """(a,): columns that move the pose."""
    twists: Array
    """(V, 6, a): by these twists."""
    steady: IntArray
    """(b,): columns that are the same combination of a view's other columns in all views."""
    weights: Array
    """(E, b): that combination."""


def _design(
    problem: Problem, seen: SeenGroup, found: Sequence[Cause], places: Sequence[slice], J: Array, span: slice
) -> _Design:
    """Return the design of a span of a group's views; J (V, 6, S) is the Jacobian by the shared parameters."""
    if J.shape[-1] == 0:
        raise AssertionError("nothing is calibrated")
    used = np.flatnonzero(np.abs(J).max((0, 1)) > 0)
    moving, twists = [used], [J[:, :, used]]
    steady, weights = [np.zeros(0, int)], [np.zeros((seen.width, 0))]
    block = seen.group.intrinsics
    if block is not None and not problem.blocks[block].held:
        intrinsics = problem.blocks[block].intrinsics
        if intrinsics is None:
            raise AssertionError("a group's block of intrinsics has none")
        steady.append(np.arange(problem.sizes[0])[problem.shared_parameters[block]])
        weights += [seen.names.selection({name: 1.0}) for name in intrinsics.free]
    for cause, at in zip(found, places, strict=True):
        columns = cause.columns(seen)
        if columns is None:
            continue
        own, parts = (moving, twists) if columns.ndim == 3 else (steady, weights)
        own.append(np.arange(at.start, at.stop))
        parts.append(columns[span] if columns.ndim == 3 else columns)
    return _Design(
        np.concatenate(moving), np.concatenate(twists, -1), np.concatenate(steady), np.concatenate(weights, -1)[POSE:]
    )


def _add(
    sums: _Sums,
    seen: SeenGroup,
    span: slice,
    terms: Sequence[Term],
    weighting: Weighting,
    design: _Design,
    J_local: Array,
    clusters: IntArray,
) -> None:
    """Add a span of a group's views to the sums over clusters and collections."""
    columns, T = np.concatenate([design.moving, design.steady]), seen.T[span]
    a, W = len(design.moving), design.weights
    for first in range(0, len(T), VIEWS_AT_A_TIME):
        part = slice(first, first + VIEWS_AT_A_TIME)
        M, m = squeeze([term.take(part) for term in terms], seen.names.camera, seen.pattern, T[part], weighting)
        collections = seen.group.collections[span][part]
        A = design.twists[part]
        At, MA = np.swapaxes(A, 1, 2), M[:, :, :POSE] @ A
        which, sum_up = _by_cluster(clusters[collections])
        G = np.empty((len(which), len(columns), len(columns)))
        G[:, :a, :a] = sum_up(At @ MA[:, :POSE])
        G[:, a:, :a] = W.T @ sum_up(MA[:, POSE:])
        G[:, :a, a:] = np.swapaxes(G[:, a:, :a], 1, 2)
        G[:, a:, a:] = W.T @ sum_up(M[:, POSE:, POSE:]) @ W
        sums.G[which[:, None, None], columns[:, None], columns] += G
        sums.g[which[:, None], design.moving] += sum_up((At @ m[:, :POSE, None])[..., 0])
        sums.g[which[:, None], design.steady] += sum_up(m[:, POSE:]) @ W
        Y = J_local[part]
        if Y.shape[-1]:
            Yt = np.swapaxes(Y, 1, 2)
            sums.H_local[collections] += Yt @ M[:, :POSE, :POSE] @ Y
            sums.g_local[collections] += (Yt @ m[:, :POSE, None])[..., 0]
            sums.mixed[collections[:, None], design.moving] += np.swapaxes(MA[:, :POSE], 1, 2) @ Y
            sums.mixed[collections[:, None], design.steady] += W.T @ (M[:, POSE:, :POSE] @ Y)


def _by_cluster(clusters: IntArray) -> tuple[IntArray, Callable[[Array], Array]]:
    """Return the clusters of views (v,), ascending, and a function that sums (v, ...) over each."""
    order = clusters.argsort(kind="stable")
    ranked = clusters[order]
    starts = np.flatnonzero(np.diff(ranked, prepend=-1))
    in_order = bool((order == np.arange(len(order))).all())

    def sum_up(values: Array) -> Array:
        values = values if in_order else values[order]
        return values if len(starts) == len(values) else np.add.reduceat(values, starts)

    return ranked[starts], sum_up


def _eliminate(sums: _Sums, clusters: IntArray) -> None:
    """Eliminate the local parameters from the sums of each cluster."""
    H_local, mixed = sums.H_local, sums.mixed
    index = np.arange(H_local.shape[-1])
    diagonal = H_local[:, index, index]
    H_local[:, index, index] = np.where(diagonal == 0.0, 1.0, diagonal)
    solved = np.linalg.inv(H_local) @ np.concatenate([np.swapaxes(mixed, 1, 2), sums.g_local[..., None]], -1)
    order = clusters.argsort(kind="stable")
    starts = np.flatnonzero(np.diff(clusters[order], prepend=-1))
    taken = np.empty((len(starts), mixed.shape[1], solved.shape[-1]))
    if len(starts) == len(order):
        np.matmul(mixed[order], solved[order], out=taken)
    else:
        for k, of in enumerate(np.split(order, starts[1:])):
            left = np.swapaxes(mixed[of], 0, 1).reshape(mixed.shape[1], -1)
            np.matmul(left, solved[of].reshape(-1, solved.shape[-1]), out=taken[k])
    np.subtract(sums.G, 0.5 * (taken[..., :-1] + np.swapaxes(taken[..., :-1], 1, 2)), out=sums.G)
    np.subtract(sums.g, taken[..., -1], out=sums.g)


def _priors(problem: Problem, values: Values) -> Array:
    """Information (S, S) of the priors on the shared parameters."""
    S, _ = problem.sizes
    prior = np.zeros((S, S))
    for block, at in problem.shared_parameters.items():
        intrinsics = problem.blocks[block].intrinsics
        if intrinsics and intrinsics.prior:
            prior[at, at] = intrinsics.pull(values[block])[2]
    return prior
