"""Suspects: fixed parameters that do not fit the labels. Score (Lagrange multiplier) tests at the optimum.

For a cause with columns B beside the calibrated ones A (`covariance.linear_model`), one Newton step from
the optimum gives the value d that it would have if it were free, and the decrease of the cost::

    I = B^T B - B^T A (A^T A)^-1 A^T B,  d = -I^-1 B^T r,  gain = d^T I d

while the calibrated ones move by ``-(A^T A)^-1 A^T B d``

(C. R. Rao, "Large sample tests of statistical hypotheses", 1948). A cause is significant if each of three tests is,
family-wise over all causes:

- the gain against the remaining disagreement of collections, an F test: an arm's repeatability is not a cause;
- d against its covariance with collections as clusters (Hotelling's T^2);
- d against that and its assumed standard deviation: a deviation within what is assumed is not a suspect.

The best explanation is set free, and the others are tested again with it (forward selection). Of nearly equal ones the
simplest is taken, of several that are degenerate with each other the one that moves the result most, and the others
are named with it.

A cluster is a collection, or several that depend on each other (`clusters`): the unit whose
errors are independent of the others'.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.estimation.covariance.cluster_state import (
    MIN_INFORMATION_LEFT,
    ClusterState,
    inverse_roots,
    whitening_matrices,
)
from calibration.engine.estimation.covariance.error_bars import MAX_INFORMATION_WITHOUT_DECISIVE
from calibration.engine.estimation.covariance.fixed_inputs import (
    ECCENTRICITY_KIND,
    ENCODER_KIND,
    LINK_KIND,
    PLACE_KIND,
    PROJECTION_KIND,
    RADIAL_KIND,
    SAG_KIND,
    Cause,
)
from calibration.engine.estimation.covariance.linear_model import LinearModel
from calibration.engine.statistics import score_of_f, threshold

MIN_CLUSTERS = 6
"""Minimum of independent collections to estimate their disagreement."""
MAX_FREED_CAUSES = 4
"""Limit of the number of causes that are set free."""
MAX_RIVALS = 2
"""Number of alternatives that are reported with a cause."""
MIN_GAIN_OF_ALTERNATIVE = 0.85
"""Explanations with at least this fraction of the best one's gain are reported as alternatives."""
MIN_GAIN_OF_CHANGE = 0.95
"""Another board or lens that explains this fraction of a move's gain is taken for it: it explains a part of drifts."""
MIN_CLUSTERS_ON_A_SIDE = 4
"""Minimum of clusters before and after a displacement for their own scatter to be estimated. Fewer ones have that of
all the others, and what an arm errs by."""
DEGREES_IF_NOT_ESTIMATED = 1e6
"""Degrees of freedom of a covariance that is not estimated."""
MIN_CONTRADICTING_FACTOR = 3.0
"""Clusters contradict each other if they disagree by more than this times what is assumed."""
KINDS_THAT_CHANGE = ("size", "focal length", ENCODER_KIND)
"""Kinds that may change between two collections, by another board, a zoom or a power cycle,"""
KINDS_LIKE_A_CHANGE = (PLACE_KIND, LINK_KIND, ECCENTRICITY_KIND)
"""and those instead of which they are tested."""
KINDS_OF_STRETCH = {"stretch", "stretch along x", "stretch along y"}
"""Kinds that differ by the overall scale, which the data may not determine."""
LENS_KIND = "intrinsics"
"""Kind of all errors of a camera_info together, which is only tested instead of something that has moved."""
OF_LENS = ("focal length", "aspect", "principal point", RADIAL_KIND, PROJECTION_KIND, "tangential distortion")
"""Kinds that it consists of."""
HALF_PIXEL = (0.35, 0.65)
"""Deviation of the principal point that indicates the other convention of pixel centres."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """Cause that does not fit, with its estimate."""

    cause: Cause
    since: int | None
    """First cluster with another pose, board or lens; None for a cause that concerns all."""
    value: Array
    """(k,): estimated deviation."""
    errors: Array
    """(k, r): independent errors of that, of one standard deviation each."""
    score: float
    """Significance as a standard score; above `threshold`."""
    gain: float
    """Decrease of the cost."""
    moved_by: Array
    """(S, k): changes of the calibrated parameters by its deviation."""
    rivals: tuple["Suspect", ...] = ()
    """Other causes that explain nearly as much."""

    @property
    def is_change(self) -> bool:
        """Whether it says that another board or lens has been used since: of drifts, too, that explains a part."""
        return self.since is not None and self.cause.kind != PLACE_KIND

    @property
    def sigma(self) -> Array:
        """(k,): standard deviation of the estimate."""
        return np.asarray(np.linalg.norm(self.errors, axis=1))

    @property
    def moves(self) -> Array:
        """(S,): changes of the calibrated parameters if it were free."""
        return self.moved_by @ self.value


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Causes of the same size, tested together: n causes with k parameters each."""

    causes: list[Cause]
    since: list[int | None]
    columns: IntArray
    """(n, k): their columns."""
    masks: Array
    """(n, K): mask of the clusters that they concern."""


@dataclass(frozen=True)
class Disagreement:
    """Disagreement of collections, or of sensors in them, beyond the noise inside their views."""

    ratio: float
    """F: about 1 if there is only that noise."""
    expected: float
    """Its expected value, by the assumed errors of an arm and of all other fixed parameters."""
    excess: float
    """Unexplained part of the labels' residuals, in standard deviations of the noise."""
    sizes: Mapping[str, Array]
    """(K,): how far each cluster's views of a sensor or a pattern disagree with the others."""
    labels: Array
    """(S, S): covariance of the calibrated parameters by the noise inside the views,"""
    found: Array
    """(S, S): that by the disagreement of clusters,"""
    assumed: Array
    """(S, S): and what is expected of it, by that noise and the assumed errors."""
    held: Array
    """(K, S, H): changes of each cluster's optimum by one assumed error of each fixed parameter, common to all,"""
    shaken: Array
    """(K, S, A): and by an arm's errors, of each cluster alone."""

    @property
    def contradicts(self) -> bool:
        """Whether clusters disagree by far more than the noise and the assumed errors explain."""
        return self.ratio > MIN_CONTRADICTING_FACTOR * self.expected

    def beyond(self, at: slice) -> float:
        """Return the variance of some parameters by the disagreement of clusters, over its expected value."""
        own = np.linalg.inv(self.labels[at, at])
        return float(np.sum(own * self.found[at, at]) / np.sum(own * self.assumed[at, at]))

    def freedom(self, at: slice) -> float:
        """Return the degrees of freedom of that variance: few where few fixed parameters make most of it.

        By F. E. Satterthwaite, "An approximate distribution of estimates of variance components", 1946.
        """
        root = np.linalg.inv(np.linalg.cholesky(self.labels[at, at]))
        K, k = len(self.held), len(root)
        common = (root @ self.held[:, at]).reshape(K * k, -1)
        each = root @ self.shaken[:, at]
        common, each = common.T @ common, np.swapaxes(each, 1, 2) @ each
        expected = np.trace(common) + np.einsum("kaa->", each) + k
        return float(expected**2 / ((common**2).sum() + (each**2).sum() + k / K))


@dataclass(frozen=True, eq=False)
class Explanation:
    """Suspects, best explanation first, and the remaining disagreement."""

    suspects: tuple[Suspect, ...]
    disagreement: Disagreement


def explain(model: LinearModel, fewest_moved: int = 1) -> Explanation | None:
    """Search for suspects; None with too few collections.

    Args:
        model: linear model at the optimum.
        fewest_moved: minimum of clusters before and after a displacement.
    """
    if len(model.G) < MIN_CLUSTERS:
        return None
    found, state = suspects_of(model, ClusterState.at_optimum(model), fewest_moved)
    return Explanation(found, remaining_disagreement(model, state))


def suspects_of(
    model: LinearModel, state: ClusterState, fewest_moved: int | None
) -> tuple[tuple[Suspect, ...], ClusterState]:
    """Return the suspects, best explanation first, and the state with them free.

    Args:
        model: linear model at the optimum.
        state: what is free already.
        fewest_moved: minimum of clusters before and after a displacement; None to test none.
    """
    candidates = list(_candidates_by_size(model, fewest_moved))
    limit = threshold(sum(len(each.causes) for each in candidates))
    found: list[Suspect] = []
    while len(found) < MAX_FREED_CAUSES:
        tried = [suspect for each in candidates for suspect in _test_candidates(state, each, threshold(1))]
        tried = [
            each for each in tried if not any(each.cause is one.cause and each.since == one.since for one in found)
        ]
        plausible = [each for each in tried if _is_plausible(each)]
        significant = [each for each in plausible if each.score > limit]
        if not significant:
            break
        most = max(each.gain for each in significant)
        near = [each for each in significant if each.gain >= MIN_GAIN_OF_ALTERNATIVE * most]
        best = min(near, key=lambda each: (each.cause.size, -round(each.gain / most, 2)))
        best = max([best, *(each for each in near if _are_stretches(each.cause, best.cause))], key=_worst_displacement)
        as_good = [each for each in plausible if each.gain >= MIN_GAIN_OF_ALTERNATIVE * most]  # each by itself
        by_cause = {each.cause: each for each in sorted(as_good, key=lambda each: each.gain)}  # the best of each
        rivals = [
            each for each in by_cause.values() if each.cause is not best.cause and each.cause.size <= best.cause.size
        ]
        rivals.sort(key=lambda each: -each.gain)
        best = replace(best, rivals=tuple(rivals[:MAX_RIVALS]))
        others: list[Suspect] = []
        if best.cause.kind in KINDS_LIKE_A_CHANGE:
            others += _suspected_changes(model, state, limit, MIN_GAIN_OF_CHANGE * best.gain)
        if best.cause.kind == PLACE_KIND:
            others += _suspected_lenses(model, state, limit, MIN_GAIN_OF_ALTERNATIVE * best.gain)
        best = max(others, key=lambda each: each.gain, default=best)
        found.append(best)
        state = state.with_cause(columns_of_cause(model, best.cause), best.since)
    return tuple(found), state


def _suspected_lenses(model: LinearModel, state: ClusterState, limit: float, least: float) -> Iterator[Suspect]:
    """Yield the cameras whose intrinsics explain at least so much if all of them are free.

    Errors of a lens that no single cause covers look like something that has moved, as the places in the image change.
    """
    for subject in dict.fromkeys(cause.subject for cause in model.causes if cause.kind in OF_LENS):
        parts = [cause for cause in model.causes if cause.subject == subject and cause.kind in OF_LENS]
        effects = tuple(each for part in parts if not callable(part.effect) for each in part.effect)
        lens = Cause(LENS_KIND, subject, "1", (0.0,) * len(effects), effects, counts=False)
        columns = columns_of_cause(model, lens)[None]
        of = _Candidates([lens], [None], columns, np.ones((1, len(state.G)), bool))
        yield from (each for each in _test_candidates(state, of, limit) if each.gain >= least)


def _suspected_changes(model: LinearModel, state: ClusterState, limit: float, least: float) -> Iterator[Suspect]:
    """Yield the boards, lenses and encoders' zeros that explain at least so much as other ones from some cluster on."""
    K = len(state.G)
    since: list[int | None] = list(range(MIN_CLUSTERS_ON_A_SIDE, K - MIN_CLUSTERS_ON_A_SIDE + 1))
    masks = np.array([np.arange(K) >= (each or 0) for each in since])
    for cause in (each for each in model.causes if each.kind in KINDS_THAT_CHANGE and since):
        columns = np.tile(columns_of_cause(model, cause), (len(since), 1))
        of = _Candidates([cause] * len(since), since, columns, masks)
        yield from (each for each in _test_candidates(state, of, limit) if each.gain >= least)


def columns_of_cause(model: LinearModel, cause: Cause) -> IntArray:
    """Return the columns of a cause, or of all that a whole lens consists of."""
    own = [
        np.arange(at.start, at.stop)
        for each, at in model.placed()
        if each is cause or (cause.kind == LENS_KIND and each.subject == cause.subject and each.kind in OF_LENS)
    ]
    return np.concatenate(own)


def _are_stretches(cause: Cause, other: Cause) -> bool:
    """Whether two causes are stretches of the same print."""
    return cause.subject == other.subject and {cause.kind, other.kind} <= KINDS_OF_STRETCH


def _worst_displacement(suspect: Suspect) -> float:
    """Displacement of the result by a suspect: of equally good alternatives the worst one."""
    return float(np.abs(suspect.moves).max())


def explains_all(model: LinearModel) -> bool:
    """Whether a suspect, once it is free, leaves no contradiction between clusters.

    Few displaced views are none: they are left out as wrong ones, see `start.wrong_views`.
    """
    explanation = explain(model, MIN_CLUSTERS_ON_A_SIDE)
    return explanation is not None and bool(explanation.suspects) and not explanation.disagreement.contradicts


def disagreement(model: LinearModel) -> Disagreement:
    """Compute the disagreement of clusters without suspects; it needs fewer clusters than a search."""
    return remaining_disagreement(model, ClusterState.at_optimum(model))


def remaining_disagreement(model: LinearModel, state: ClusterState) -> Disagreement:
    """Compute the disagreement of clusters that remains after the causes that have been set free.

    The assumed errors of fixed parameters, and of an arm in each cluster, would make each cluster's own optimum scatter
    by ``P_k G_kh s^2 G_kh^T`` in the metric of its own information, with ``P_k = G_k^+``.
    """
    S = state.shared
    assumed = np.concatenate([state.G[:, :S, state.held] * state.sigmas, state.arm[:, :S]], -1)
    expected = float(((np.swapaxes(state.whitening, 1, 2) @ assumed) ** 2).sum())
    freedom = max(1.0, state.freedom)
    places = model.placed(PLACE_KIND)
    displacements = [
        (state.residual[:, None, at] @ whitening_matrices(state.G[:, at, at], state.alone[at]))[:, 0]
        for _, at in places
    ]  # (K, k) each, by its sensor or pattern
    allowed = freedom + expected
    found, held, shaken = _covariance_by_clusters(state)
    return Disagreement(
        ratio=state.disagreement / freedom,
        expected=allowed / freedom,
        excess=float(np.sqrt(max(0.0, state.disagreement - freedom) / len(model.G) / S)),
        sizes={cause.subject: (own**2).sum(-1) for (cause, _), own in zip(places, displacements, strict=True)},
        labels=state.inverse[:S, :S],
        found=found,
        assumed=state.inverse[:S, :S] + _sum_of_outer_products(held) + _sum_of_outer_products(shaken),
        held=held,
        shaken=shaken,
    )


def _covariance_by_clusters(state: ClusterState) -> tuple[Array, Array, Array]:
    """Return the covariance (S, S) of the calibrated parameters with collections as clusters, and its expected parts.

    As in `covariance.error_bars`, of the residuals that are left once causes have been set free. An error
    of a fixed parameter changes the gradient of each cluster, and the optimum of all of them.

    Args:
        state: the model.
    """
    S, free = state.shared, state.free
    values, vectors = np.linalg.eigh(state.inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    w, U = np.linalg.eigh(np.eye(len(free)) - root.T @ state.G[:, free[:, None], free] @ root)
    back = (
        root[:S] @ U / np.sqrt(np.maximum(w, MAX_INFORMATION_WITHOUT_DECISIVE))[:, None] @ np.swapaxes(U, 1, 2) @ root.T
    )  # (K, S, F)
    own = state.G[:, free][:, :, state.held] * state.sigmas
    held = own - state.G[:, free[:, None], free] @ (state.inverse @ own.sum(0))
    found = back @ state.residual[:, free, None]
    return _sum_of_outer_products(found), back @ held, back @ state.arm[:, free]


def _sum_of_outer_products(columns: Array) -> Array:
    """Return ``sum_k c_k c_k^T`` (S, S) of columns (K, S, n)."""
    flat = np.swapaxes(columns, 0, 1).reshape(columns.shape[1], -1)
    return flat @ flat.T


def _is_plausible(suspect: Suspect) -> bool:
    """Whether a suspected convention of pixel centres is off by about half a pixel, and a sagging arm hangs lower."""
    low, high = HALF_PIXEL
    if suspect.cause.kind == SAG_KIND:  # a good arm with a board 0.5 % too large would "sag" upwards
        return bool(suspect.value[0] > 0)
    return suspect.cause.kind != "pixel convention" or bool(low < abs(suspect.value[0]) < high)


def _candidates_by_size(model: LinearModel, fewest_moved: int | None) -> Iterator[_Candidates]:
    """Yield all causes by size; displacements from each collection on."""
    K = len(model.G)
    entries: dict[int, list[tuple[Cause, int | None, slice]]] = {}
    for cause, at in model.placed():
        if not cause.tested or (cause.kind == PLACE_KIND and fewest_moved is None):
            continue
        since = range(fewest_moved, K - fewest_moved + 1) if fewest_moved and cause.kind == PLACE_KIND else [None]
        entries.setdefault(cause.size, []).extend((cause, each, at) for each in since)
    for each in entries.values():
        columns = np.array([np.arange(at.start, at.stop) for _, _, at in each])
        masks = np.array([np.arange(K) >= (since or 0) for _, since, _ in each])
        yield _Candidates([cause for cause, _, _ in each], [since for _, since, _ in each], columns, masks)


@dataclass(frozen=True, eq=False)
class _Step:
    """Newton step that frees a cause."""

    own: IntArray
    """(k,): its columns."""
    mask: Array
    """(K,): 1 for the clusters that it concerns."""
    information: Array
    """(k, k): its information I, with the free parameters at their optimum."""
    W: Array
    """(F, k): negative change of the free parameters per unit of it."""
    basis: Array
    """(k, r): ``I^+ = basis basis^T``, of the r directions that the data determine."""
    white: Array
    """(r,): the whitened step; standard normal if there is only the noise of the labels."""

    @property
    def value(self) -> Array:
        """(k,): estimated deviation."""
        return self.basis @ self.white

    @property
    def gain(self) -> float:
        """Decrease of the cost."""
        return float(self.white @ self.white)

    @property
    def moves(self) -> Array:
        """(F,): changes of the free parameters."""
        return -self.W @ self.value


def _test_candidates(state: ClusterState, candidates: _Candidates, limit: float) -> Iterator[Suspect]:
    """Yield the candidates whose significance exceeds a limit."""
    for cause, since, step in zip(
        candidates.causes, candidates.since, _steps_of_candidates(state, candidates), strict=True
    ):
        r = step.basis.shape[1]
        rest = state.freedom - r
        if r == 0 or rest <= 0 or len(state.G) < r + 4:
            continue
        noise = max(1.0, (state.disagreement - step.gain) / rest)
        score = float(score_of_f(step.gain / r / noise, r, rest))
        if score <= limit:
            continue
        score, covariance = _smallest_score(state, cause, step, noise, score)
        if score > limit:
            values, vectors = np.linalg.eigh(covariance)
            errors = step.basis @ (vectors * np.sqrt(np.maximum(values, 0.0)))
            yield Suspect(cause, since, step.value, errors, score, step.gain / noise, -step.W[: state.shared])


def _steps_of_candidates(state: ClusterState, candidates: _Candidates) -> Iterator[_Step]:
    """Yield the step of each candidate; sums over clusters are computed for all of them at once."""
    if not candidates.causes:
        return
    masks, free = candidates.masks.astype(float), state.free
    first, index = np.unique(candidates.columns[:, 0], return_index=True)
    for start, i in zip(first, index, strict=True):
        own = candidates.columns[i]
        of = np.flatnonzero(candidates.columns[:, 0] == start)
        sums = masks[of] @ state.G[:, :, own].reshape(len(state.G), -1)
        mixed = sums.reshape(len(of), -1, len(own))  # (n, C, k)
        pull = masks[of] @ state.residual[:, own]
        W = state.inverse @ mixed[:, free]
        information = mixed[:, own] - np.swapaxes(mixed[:, free], 1, 2) @ W
        scale = 1 / np.sqrt(np.maximum(state.alone[own], 1e-300))
        values, vectors = np.linalg.eigh(scale[:, None] * information * scale)
        for j, mask in enumerate(masks[of]):
            kept = values[j] > MIN_INFORMATION_LEFT
            basis = scale[:, None] * vectors[j][:, kept] / np.sqrt(values[j][kept])
            yield _Step(own, mask, information[j], W[j], basis, -basis.T @ pull[j])


def _smallest_score(state: ClusterState, cause: Cause, step: _Step, noise: float, score: float) -> tuple[float, Array]:
    """Return the smallest of a cause's three standard scores, and the covariance (r, r) of its step.

    Args:
        state: the model.
        cause: the cause.
        step: its step.
        noise: remaining disagreement of the clusters.
        score: of the first test.
    """
    K, r = len(state.G), step.basis.shape[1]
    own, free, d, moves = step.own, state.free, step.value, step.moves
    mixed = step.mask[:, None, None] * state.G[:, :, own]  # (K, C, k)
    left = state.residual + state.G[:, :, free] @ moves + mixed @ d
    covariance = noise * np.eye(r)
    by_clusters, told_by_others = [score], np.zeros((r, r))
    if cause.kind == PLACE_KIND and min(step.mask.sum(), K - step.mask.sum()) < MIN_CLUSTERS_ON_A_SIDE:
        shaken = (step.mask[:, None, None] * state.arm[:, own] - step.W.T @ state.arm[:, free]).swapaxes(1, 2)
        shaken, scatter = (shaken @ step.basis).reshape(-1, r), _scatter_of_others(state, step, left, noise)
        told_by_others = scatter.T @ scatter
        covariance = covariance + shaken.T @ shaken + told_by_others
    else:
        spread = (step.mask[:, None] * left[:, own] - left[:, free] @ step.W) @ step.basis
        clustered = spread.T @ spread * (K / (K - 1))
        hotelling = _squared_mahalanobis(step.white, clustered) * (K - r) / (r * (K - 1))
        by_clusters.append(float(score_of_f(hotelling, r, K - r)))
        covariance = _larger_covariance(covariance, clustered)
    total = state.G[:, :, state.held].sum(0)
    masked = np.einsum("k,kih->ih", step.mask, state.G[:, own][:, :, state.held])
    held = (masked - step.W.T @ total[free]) * state.sigmas  # by one standard deviation
    if any(cause.assumed) and not cause.counts:
        held = np.concatenate([held, step.information * np.array(cause.assumed)], -1)
    known = step.basis.T @ held
    variance = covariance + known @ known.T
    beyond = _squared_mahalanobis(step.white, variance)
    share = 1 - beyond / _squared_mahalanobis(step.white, variance - told_by_others)  # of the variance, along the step
    others = max(step.mask.sum(), K - step.mask.sum())
    freedom = min(DEGREES_IF_NOT_ESTIMATED, others / max(share**2, 1e-9))  # F. E. Satterthwaite, 1946
    return min(*by_clusters, float(score_of_f(beyond / r, r, freedom))), covariance


def _scatter_of_others(state: ClusterState, step: _Step, left: Array, noise: float) -> Array:
    """Return errors (n, r) of a displacement that few clusters tell, by directions in which others scatter by more.

    What makes views disagree, such as images that shake, does so in some directions more than in all on average.

    Args:
        state: the model.
        step: the step of the displacement.
        left: (K, C), gradient of each cluster after it.
        noise: disagreement of the clusters on average.
    """
    own, mask = step.own, step.mask.astype(bool)
    G = state.G[:, own[:, None], own]
    others = mask if mask.sum() > len(mask) / 2 else ~mask
    pulls = left[others][:, own] @ inverse_roots(G[others].mean(0)[None], state.alone[own])[0]
    w, U = np.linalg.eigh(pulls.T @ pulls / others.sum())
    beyond = U * np.sqrt(np.maximum(w - noise, 0.0))
    effects = step.mask[:, None, None] * G - step.W.T @ state.G[:, state.free][:, :, own]
    shaken = effects @ inverse_roots(G, state.alone[own]) @ beyond
    return np.asarray((np.swapaxes(shaken, 1, 2) @ step.basis).reshape(-1, step.basis.shape[1]))


def _squared_mahalanobis(x: Array, C: Array) -> float:
    """``x^T C^-1 x``; 0 in directions without variance."""
    w, U = np.linalg.eigh(C)
    kept = w > 1e-12 * max(w[-1], 1e-300)
    return float(((U.T @ x)[kept] ** 2 / w[kept]).sum())


def _larger_covariance(A: Array, B: Array) -> Array:
    """Return a covariance that is nowhere smaller than either of two, the first a multiple of the identity."""
    w, U = np.linalg.eigh(B)
    return np.asarray((U * np.maximum(w, A[0, 0])) @ U.T)
