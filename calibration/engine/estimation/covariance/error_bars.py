"""Total covariance of a calibration: noise of the labels, disagreement of collections, and errors of fixed parameters.

The inverse of the information, C, is valid for independent noise of the labels alone. Two terms are added:

- If collections disagree by more than that noise explains (an arm's repeatability, a base that sways), C is scaled
  by one factor per block, ``phi = tr(C^-1 V) / k``, at least 1, with the covariance V of the collections as clusters:
  ``V = sum_c d_c d_c^T`` with ``d_c = A^-1/2 (I - A^-1/2 G_c A^-1/2)^-1/2 A^-1/2 g_c``, which is unbiased if
  there is that noise alone (CR2: R. M. Bell and D. F. McCaffrey, "Bias reduction in standard errors for linear
  regression with multi-stage samples", 2002). Where neighbouring clusters are alike, as of poses that drift, they are
  one cluster, by twos until their means are not (batch means: B. Schmeiser, "Batch size effects in the analysis of
  simulation output", 1982). With this factor the expected ``e^T (phi C)^-1 e`` is k for any shape of V. Where phi is
  large or clusters are such batches, it is told by few, and multiplied by n / (n - 2), with the effective number n of
  clusters: the mean of an inverse chi-square variable.
- Fixed parameters are known with a standard deviation s (`options.Assumptions`). Their error changes the
  result by ``W = -A^-1 B`` times it, so ``W diag(s^2) W^T`` is added (consider analysis: S. F. Schmidt, 1966).

A cause that is calibrated (the scale of poses, a lag) is one of the columns of A.

The nominal covariance is that of a good robot of this kind with the same views: labels with at most the noise that a
detector keeps, collections that agree as those of a good arm do, fixed parameters known as assumed. The recording gives
the views alone: whatever is wrong with it does not widen this covariance. It is the source of default limits.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.covariance.fixed_inputs import ARM_ACCURACY, CAMERA_INFO, LAG_KIND, LINK_KIND
from calibration.engine.estimation.covariance.linear_model import LinearModel, linear_model
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.problem.blocks import Pose
from calibration.engine.estimation.problem.problem import Problem

MIN_ALIKE = 2.0
"""Correlation of neighbouring clusters, in multiples of 1 over the root of their number, from which they are alike."""
MIN_BATCHES = 6
"""Number of batches of clusters that are alike of which the scatter is still told."""
MIN_CONTRADICTING_FACTOR = 3.0
"""Factor above which clusters contradict each other; one that is estimated from few clusters is then corrected."""
MIN_CLUSTERS = 4.0
"""Minimum of the clusters that a factor is taken to come from."""
MAX_INFORMATION_WITHOUT_DECISIVE = 1e-6
"""Information left without a cluster, relative to the total, below which that cluster alone determines a direction."""


SourceKind = Literal["labels", "collections", "lens", "board", "arm", "ranges", "held"]
"""Noise of the labels, disagreement of collections, and what is held: intrinsics, patterns, an arm, a LiDAR's ranges,
other things."""
SOURCE_KIND_OF_CAUSE: Mapping[str, SourceKind] = {
    CAMERA_INFO: "lens",
    **dict.fromkeys(("size", "stretch", "bow", "twist", "border"), "board"),
    **dict.fromkeys((LINK_KIND, "accuracy"), "arm"),
    **dict.fromkeys(("range bias", "range scale", "beam elevation"), "ranges"),
}


@dataclass(frozen=True, eq=False)
class ErrorSource:
    """Independent errors of one standard deviation each, and what they do to the parameters of a linear model."""

    kind: SourceKind
    name: str
    """Of the cause; the kind of what is none."""
    columns: Array
    """(C, n): changes of all C columns of the model, calibrated and held, by each of n errors."""


@dataclass(frozen=True, eq=False)
class ErrorBars:
    """Covariances of the shared parameters, by block."""

    labels: Mapping[int, Array]
    """(k, k): from the noise of the labels alone."""
    expected: Mapping[int, Array]
    """(k, k): from that and the errors of fixed parameters, for a robot whose collections agree."""
    total: Mapping[int, Array]
    """(k, k): total."""
    effective_collections: float
    """Number of independent collections of equal weight with the same information."""
    decisive: float
    """Largest share of one cluster of collections in the information on any direction."""
    worth: Mapping[str, float]
    """By cause, the displacement of a transform by one assumed (if 0, typical) standard deviation, m."""
    held: Mapping[str, Array]
    """(S, k): by cause, the changes of the parameters by an error of one assumed standard deviation."""
    lags: Mapping[str, float]
    """s: by sensor, total standard deviation of a calibrated lag."""
    sources: tuple[ErrorSource, ...]
    """What the total is made of. Of two blocks whose collections disagree, that part is taken to be as correlated as
    the labels' noise is. Where they disagree along one direction by more than on average, that is added: a task may ask
    for just that one."""


def error_bars(model: LinearModel, problem: Problem) -> ErrorBars:
    """Compute the covariances at the optimum.

    Args:
        model: of the calibration.
        problem: its problem.
    """
    S, T, blocks = model.shared, model.total, problem.shared_parameters
    freed = [(cause, at) for cause, at in model.placed() if cause.free]
    free = np.concatenate([np.arange(S), *(np.arange(at.start, at.stop) for _, at in freed)])
    C = np.linalg.inv(T[np.ix_(free, free)])
    C = 0.5 * (C + C.T)
    values, vectors = np.linalg.eigh(C)
    root = vectors * np.sqrt(np.maximum(values, 0.0))  # C = root root^T
    shares = root.T @ model.G[:, free[:, None], free] @ root  # (K, F, F): of each cluster in the total information
    leverages = np.einsum("kii->k", shares)
    scatter, batches = scatter_of_clusters(shares, model.g[:, free] @ root)
    clustered, average = root @ scatter @ root.T, 1.0
    moves = -C @ T[free]  # by a unit of each column
    poses = [at for block, at in blocks.items() if isinstance(problem.blocks[block].parameters, Pose)]
    squares = np.stack([(moves[at][:3] ** 2).sum(0) for at in poses] or [np.zeros(len(T))])
    worth, held, considered = {}, {}, np.zeros((len(free), len(free)))
    sources = [ErrorSource("labels", "labels", _placed_rows(root, free, len(T)))]
    for cause, at, typical in zip(model.causes, model.places, model.typical, strict=True):
        if cause.counts and not cause.free:
            usual = cause.assumed
            if any(cause.assumed):
                moved = moves[:, at] * np.array(cause.assumed)
                held[cause.name] = moved[:S]
                considered = considered + moved @ moved.T
                columns = _placed_rows(moved, free, len(T))
                columns[at] = np.diag(cause.assumed)
                sources.append(ErrorSource(SOURCE_KIND_OF_CAUSE.get(cause.kind, "held"), cause.name, columns))
            else:
                usual = typical
            worth[cause.name] = float(np.sqrt((squares[:, at] @ np.square(usual)).max()))

    disagreement = np.zeros(len(free))  # variance of each parameter by it, over that by the labels

    def bars(at: slice) -> tuple[Array, Array]:
        nonlocal average
        own = C[at, at]
        factor = max(1.0, float(np.trace(np.linalg.solve(own, clustered[at, at]))) / len(own))
        average = max(average, factor)
        if factor > MIN_CONTRADICTING_FACTOR or len(batches) < len(shares):
            factor *= _for_few_clusters(root[at] @ batches @ root[at].T, own)
        disagreement[at] = factor - 1
        return own + considered[at, at], factor * own + considered[at, at]

    labels, expected, total = {}, {}, {}
    for block, at in blocks.items():
        labels[block] = C[at, at]
        expected[block], total[block] = bars(at)
    ends = np.cumsum([S, *(cause.size for cause, _ in freed)]).tolist()
    lags = {
        cause.subject: float(np.sqrt(bars(slice(start, start + 1))[1][0, 0]))
        for (cause, _), start in zip(freed, ends, strict=False)
        if cause.kind == LAG_KIND
    }
    effective = float(leverages.sum() ** 2 / (leverages**2).sum())
    decisive = float(np.linalg.eigvalsh(shares).max())
    apart = np.concatenate([np.sqrt(disagreement)[:, None] * root, root @ beyond_average(scatter, average)], 1)
    apart = _placed_rows(apart, free, len(T))
    sources.insert(1, ErrorSource("collections", "collections", apart))
    return ErrorBars(labels, expected, total, effective, decisive, worth, held, lags, tuple(sources))


def _placed_rows(rows: Array, at: IntArray, count: int) -> Array:
    """Return rows (r, n) as those of indices (r,) among so many, the others zero."""
    out = np.zeros((count, rows.shape[1]))
    out[at] = rows
    return out


def _for_few_clusters(parts: Array, own: Array) -> float:
    """Return the factor ``n / (n - 2)`` by which a variance that n clusters tell is too small as a divisor.

    Args:
        parts: (K, k, k), of each cluster in the covariance.
        own: (k, k), their sum.
    """
    leverages = np.einsum("kii->k", np.linalg.solve(own, parts))
    count = float(leverages.sum() ** 2 / (leverages**2).sum())
    return max(count, MIN_CLUSTERS) / (max(count, MIN_CLUSTERS) - 2)


def scatter_of_clusters(shares: Array, pulls: Array) -> tuple[Array, Array]:
    """Return the covariance (F, F) of standardised parameters by the scatter of clusters, which may be alike in a row.

    Args:
        shares: (K, F, F), of each cluster in the information, which is 1 in all.
        pulls: (K, F), its gradient.

    Returns:
        The covariance, and the shares of the batches of neighbours (B, F, F) that it is from.
    """
    changes, least = _changes_by_cluster(shares, pulls), MIN_ALIKE
    while len(shares) >= 2 * MIN_BATCHES and _neighbour_correlation(changes) > least:
        starts = np.arange(len(shares) // 2) * 2
        shares, pulls = np.add.reduceat(shares, starts), np.add.reduceat(pulls, starts)
        changes, least = _changes_by_cluster(shares, pulls), 0.0
    return changes.T @ changes, shares


def beyond_average(scatter: Array, average: float) -> Array:
    """Return independent errors (F, F) of standardised parameters by what clusters disagree beyond the average.

    One factor for all directions is right for the size of a whole pose. What moved between two images, or a lens beyond
    its model, does not err alike in all of them.

    Args:
        scatter: (F, F), as of `scatter_of_clusters`.
        average: variance by it that is counted in each direction, in that of the labels' noise.
    """
    values, axes = np.linalg.eigh(scatter)
    return np.asarray(axes * np.sqrt(np.maximum(values - average, 0.0)))


def _changes_by_cluster(shares: Array, pulls: Array) -> Array:
    """Return the change (K, F) of the optimum by each cluster, without the bias by its own share in it."""
    w, U = np.linalg.eigh(np.eye(shares.shape[-1]) - shares)
    along = (pulls[:, None] @ U)[:, 0] / np.sqrt(np.maximum(w, MAX_INFORMATION_WITHOUT_DECISIVE))
    return np.asarray((U @ along[..., None])[..., 0])


def _neighbour_correlation(changes: Array) -> float:
    """Return the correlation of neighbouring changes (K, F) of sum 0, in multiples of 1 over the root of K."""
    K, total = len(changes), float((changes**2).sum())
    # what has sum 0 is correlated by -1 / K if independent
    return np.sqrt(K) * (float((changes[1:] * changes[:-1]).sum()) / total + 1 / K) if total > 0 else 0.0


if TYPE_CHECKING:
    from calibration.engine.estimation.covariance.result import Solution

MAX_NOISE: Mapping[NoiseKind, float] = {
    "pixel": 0.35,
    "range": 0.03,
    "border": 0.02,
    "depth_border": 0.02,
    "lidar2d_range": 0.03,
    "lidar2d_border": 0.02,
    "pose_translation": 0.005,
    "pose_rotation": 0.01,
}
"""Largest noise of good labels (px, m or rad): what a detector in sharp images, a LiDAR, a tracker keeps."""


def nominal_covariances(solution: "Solution") -> Mapping[int, Array]:
    """Return the covariance (k, k) of each shared block of a good robot with these views.

    Args:
        solution: the optimum.
    """
    model = _nominal_model(solution)
    S, at = model.shared, solution.setup.problem.shared_parameters
    expected = error_bars(model, solution.setup.problem).expected
    scatter = -np.linalg.inv(model.total[:S, :S]) @ arm_scatter(model)[:, :S]  # (K, S, H)
    return {
        block: C + np.einsum("kih,kjh->ij", scatter[:, at[block]], scatter[:, at[block]])
        for block, C in expected.items()
    }


def arm_scatter(model: LinearModel) -> Array:
    """Return the gradients (K, C, H) of each cluster by one standard deviation of the arm's H errors in it alone."""
    columns = [model.G[:, :, at] * cause.assumed for cause, at in model.placed(LINK_KIND)]
    if not columns:
        return np.zeros((*model.g.shape, 0))
    return np.asarray(np.concatenate(columns, -1) * (ARM_ACCURACY / np.sqrt(len(columns))))


def _nominal_weighting(weighting: Weighting) -> Weighting:
    """Return the weighting with the noise of good labels; itself where that is what they have."""
    scales = {kind: min(scale, MAX_NOISE[kind]) for kind, scale in weighting.scales.items()}
    return weighting if scales == weighting.scales else Weighting(scales, None)


def _nominal_model(solution: "Solution") -> LinearModel:
    weighting = _nominal_weighting(solution.weighting)
    if weighting is solution.weighting:
        return solution.model
    return linear_model(
        solution.setup.problem, solution.values, weighting, solution.dataset, solution.assume, solution.clusters
    )
