"""Linear model of a calibration at its optimum, of calibrated and fixed parameters.

The normal equations are extended by columns of fixed parameters (`covariance.fixed_inputs`), and summed over
clusters of collections (`covariance.cluster_sums`), with the local parameters of each collection eliminated
by the Schur complement, as in `solve.normal_equations`. The result is one small matrix and vector for
each cluster k of collections c::

    G_k = sum_c (Z_c^T Z_c - Z_c^T Y_c (Y_c^T Y_c)^-1 Y_c^T Z_c)        g_k likewise of Z_c^T r

with the columns Z of the S calibrated shared parameters and of the causes, Y of the local ones. All questions on fixed
parameters are answered from these, without another pass over the labels.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.covariance.clusters import ClusterSums, GroupColumns
from calibration.engine.estimation.covariance.fixed_inputs import (
    ARM_ACCURACY,
    CAMERA_INFO,
    LINK_KIND,
    Cause,
    Combination,
    SeenGroup,
    causes,
    lag,
    moved_pattern,
    moved_sensor,
    seen_groups,
)
from calibration.engine.estimation.covariance.lens_errors import lens_errors
from calibration.engine.estimation.least_squares.normal_equations import Weighting, diagonal_of
from calibration.engine.estimation.options import Assumptions
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem, batches, table_of

DAMPING_OF_EACH = 1e-10
"""Relative damping of a collection's own parameters, which its views alone may not determine."""
MAX_CLUSTERS = 100
"""Limit of the number of clusters; more give no better estimate of the collections' disagreement."""


@dataclass(frozen=True, eq=False)
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
    """(C, C): information of the priors on the shared parameters, and between them and the causes."""
    clusters: IntArray
    """(N,): cluster of each collection."""
    alone: Array
    """(C,): information on each column if all others were known, the reference for rounding errors in what is left of
    it beside the others."""

    def placed(self, kind: str | None = None) -> list[tuple[Cause, slice]]:
        """Return the causes, of one kind or of all, with their columns."""
        return [each for each in zip(self.causes, self.places, strict=True) if kind in (None, each[0].kind)]

    @cached_property
    def total(self) -> Array:
        """(C, C): sum over the clusters, and the prior."""
        total: Array = self.G.sum(0)
        total += self.prior
        return total

    def beside_shared(self, own: list[int]) -> tuple[Array, Array]:
        """Return information (k, k) and gradient (k,) of some columns, with the shared parameters at their optimum."""
        S, total, g = self.shared, self.total, self.g.sum(0)
        moves = np.linalg.solve(total[:S, :S], np.concatenate([total[:S, own], g[:S, None]], -1))
        return total[np.ix_(own, own)] - total[own, :S] @ moves[:, :-1], g[own] - total[own, :S] @ moves[:, -1]


def linear_model(
    problem: Problem,
    values: Values,
    weighting: Weighting,
    dataset: Dataset,
    assume: Assumptions,
    clusters: IntArray | None = None,
    free_scale: bool = False,
    free_lags: Collection[str] = (),
) -> LinearModel:
    """Linearise at the optimum.

    Args:
        problem: the problem.
        values: the optimum.
        weighting: its weights.
        dataset: the collections that count, with the transforms of the optimum.
        assume: assumed standard deviations of fixed parameters.
        clusters: (N,), cluster of each collection, from 0; equal for dependent ones. Each is its own if None.
        free_scale: whether the scale of measured poses is calibrated.
        free_lags: sensors whose lag is calibrated.
    """
    groups = seen_groups(dataset, problem.groups, [problem.poses(group, values) for group in problem.groups])
    found = _all_causes(problem, dataset, groups, assume, free_scale, free_lags)
    usual = (
        found
        if assume == Assumptions()
        else _all_causes(problem, dataset, groups, Assumptions(), free_scale, free_lags)
    )
    S, _ = problem.sizes
    if S == 0:
        raise AssertionError("nothing is calibrated")
    ends = np.cumsum([S, *(cause.size for cause in found)]).tolist()
    places = [slice(*ends[i : i + 2]) for i in range(len(found))]
    clusters = _at_most(np.arange(problem.collections) if clusters is None else clusters, MAX_CLUSTERS)
    sums = _sums_over_clusters(problem, values, weighting, groups, found, places, clusters)
    alone = np.einsum("kii->i", sums.G)
    G = sums.eliminated()
    kept = [i for i, at in enumerate(places) if alone[at].any()]
    columns = np.concatenate([np.arange(S), *(np.arange(places[i].start, places[i].stop) for i in kept)])
    ends = np.cumsum([S, *(found[i].size for i in kept)]).tolist()
    return LinearModel(
        S,
        tuple(found[i] for i in kept),
        tuple(slice(*ends[k : k + 2]) for k in range(len(kept))),
        tuple(usual[i].assumed for i in kept),
        G[:, columns[:, None], columns],
        G[:, columns, -1],
        _information_of_priors(problem, values, [found[i] for i in kept], ends),
        clusters,
        alone[columns],
    )


def information_of_each(
    problem: Problem, values: Values, weighting: Weighting, dataset: Dataset, known: Sequence[Cause]
) -> Array:
    """Return the information (N, C, C) of each collection on the shared parameters and some causes, as `LinearModel.G`.

    Args:
        problem: the problem.
        values: where it is linearised.
        weighting: standard deviations of the labels.
        dataset: the collections, with the transforms of the values.
        known: the causes, one or more.
    """
    groups = seen_groups(dataset, problem.groups, [problem.poses(group, values) for group in problem.groups])
    ends = np.cumsum([problem.sizes[0], *(cause.size for cause in known)]).tolist()
    places = [slice(*each) for each in pairwise(ends)]
    clusters = np.arange(problem.collections)
    sums = _sums_over_clusters(problem, values, weighting, groups, known, places, clusters)
    diagonal_of(sums.local)[:] *= 1 + DAMPING_OF_EACH
    return sums.eliminated()[:, : ends[-1], : ends[-1]]


def _sums_over_clusters(
    problem: Problem,
    values: Values,
    weighting: Weighting,
    groups: Sequence[SeenGroup],
    found: Sequence[Cause],
    places: Sequence[slice],
    clusters: IntArray,
) -> ClusterSums:
    """Return the sums of the columns of all views, and of their residuals, which come last."""
    sums = ClusterSums.zeros(clusters, places[-1].stop + 1, problem.sizes[1])
    table = table_of(problem.blocks, values)
    for seen in groups:
        own = _group_columns(problem, seen, found, places, table, values)
        sums.add(seen, problem.terms(seen.group, values), weighting, own)
    return sums


def _group_columns(
    problem: Problem, seen: SeenGroup, found: Sequence[Cause], places: Sequence[slice], table: Array, values: Values
) -> GroupColumns:
    """Return the columns of a group's views."""
    shared, local = problem.shared_parameters, problem.local_parameters
    pieces = batches(problem.blocks, [seen.group], problem.collections, shared, local)
    (part,) = pieces[0].parts
    J = np.concatenate([batch.linearise(table, values)[1] for batch in pieces])
    columns, twists = [np.arange(problem.sizes[0])[part.shared_at]], [J[:, :, part.shared]]
    for cause, at in zip(found, places, strict=True):
        moved = cause.effect(seen) if callable(cause.effect) else None
        if moved is not None:
            columns.append(np.arange(at.start, at.stop))
            twists.append(moved)
    combined, W = _combine_columns(problem, seen, found, places)
    columns.append(combined)
    return GroupColumns(np.concatenate(columns), np.concatenate(twists, -1), W, part.local_at, J[:, :, part.local])


def _combine_columns(
    problem: Problem, seen: SeenGroup, found: Sequence[Cause], places: Sequence[slice]
) -> tuple[IntArray, Array]:
    """Return the model's columns (c,) that a group's E columns of labels and its residuals determine.

    And their weights (E + 1, c). The last of the columns are the residuals.
    """
    rows = {column: i for i, column in enumerate(seen.label_columns)}
    combined = [
        (column, {rows[label]: weight for label, weight in combination.items() if label in rows})
        for column, combination in _combinations_of_group(problem, seen, found, places)
    ]
    combined = [each for each in combined if each[1]] + [(places[-1].stop, {len(rows): 1.0})]
    W = np.zeros((len(rows) + 1, len(combined)))
    for k, (_, weights) in enumerate(combined):
        W[list(weights), k] = list(weights.values())
    return np.array([column for column, _ in combined]), W


def _combinations_of_group(
    problem: Problem, seen: SeenGroup, found: Sequence[Cause], places: Sequence[slice]
) -> Iterator[tuple[int, Combination]]:
    """Yield the columns of the model that are combinations of a group's columns of labels, with these."""
    block = seen.group.intrinsics
    intrinsics = None if block is None or problem.blocks[block].held else problem.blocks[block].intrinsics
    if block is not None and intrinsics is not None:
        for column, name in enumerate(intrinsics.free, problem.shared_parameters[block].start):
            yield column, {(intrinsics.sensor, name): 1.0}
    for cause, at in zip(found, places, strict=True):
        if not callable(cause.effect):
            yield from enumerate(cause.effect, at.start)


def _all_causes(
    problem: Problem,
    dataset: Dataset,
    groups: Sequence[SeenGroup],
    assume: Assumptions,
    free_scale: bool,
    free_lags: Collection[str],
) -> list[Cause]:
    """Return the causes of fixed parameters; and of each sensor and fixed pattern a displacement and a time offset."""
    intrinsics = [(block.intrinsics, block.held) for block in problem.blocks if block.intrinsics]
    free = {each.sensor: each.free for each, held in intrinsics if not held}
    priors = {each.sensor: each.prior for each, _ in intrinsics}
    seen = dict.fromkeys(group.group.sensor for group in groups)
    patterns = dict.fromkeys(group.pattern.name for group in groups if group.pattern.fixed)
    cameras = {each.sensor.name: camera for each in groups if (camera := each.names.camera) is not None}
    given = {name: priors.get(name) or dataset.sensors[name].uncertainty for name in cameras}
    lenses = {name: lens_errors(camera, assume, given[name]) for name, camera in cameras.items()}
    found = causes(dataset, groups, assume, free, lenses, free_scale)
    arm = ARM_ACCURACY * any(cause.kind == LINK_KIND for cause in found)
    steady = (arm * assume.arm_translation,) * 3 + (arm * assume.arm_rotation,) * 3
    return [
        *found,
        *(
            cause
            for name in seen
            for cause in (
                lag(dataset, dataset.sensors[name], name in free_lags),
                moved_sensor(dataset.sensors[name], steady),
            )
        ),
        *(moved_pattern(dataset.patterns[name], steady) for name in patterns),
    ]


def _at_most(clusters: IntArray, most: int) -> IntArray:
    """Merge neighbouring clusters until there are at most ``most``."""
    _, clusters = np.unique(clusters, return_inverse=True)
    count = int(clusters.max()) + 1
    return clusters * most // count if count > most else clusters


def _information_of_priors(problem: Problem, values: Values, found: Sequence[Cause], ends: Sequence[int]) -> Array:
    """Return the information (C, C) of the priors, on the shared parameters, and between them and fixed ones.

    Args:
        problem: the problem.
        values: the optimum.
        found: the causes.
        ends: the first column of each cause, and the number of all.
    """
    prior = np.zeros((ends[-1], ends[-1]))
    for block, at in problem.shared_parameters.items():
        intrinsics = problem.blocks[block].intrinsics
        if intrinsics and intrinsics.prior:
            prior[at, at] = intrinsics.pull(values[block])[2]
            for cause, start in zip(found, ends, strict=False):
                if cause.kind == CAMERA_INFO and cause.subject == intrinsics.sensor and not callable(cause.effect):
                    own = slice(start, start + cause.size)
                    labels = [(intrinsics.sensor, name) for name in intrinsics.camera.parameters]
                    errors = np.array([[weights.get(label, 0.0) for weights in cause.effect] for label in labels])
                    prior[at, own] = intrinsics.information[intrinsics.at] @ errors
                    prior[own, at] = prior[at, own].T
    return prior
