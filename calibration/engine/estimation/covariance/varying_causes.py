"""A fixed parameter that is another one in each collection: images that are shifted one by one, stamps that jitter.

Collections that contradict each other are explained by the cause whose deviations ``u_k ~ N(0, s^2)``, one of each
cluster k, make the residuals most likely. With the columns A of what is calibrated and B of the cause, and
``P_k = (B_k^T B_k + 1/s^2)^-1``, they are eliminated from each cluster as a local parameter with a prior is::

    G_k' = G_k - G_k[:, B] P_k G_k[B, :]        g_k' = g_k - G_k[:, B] P_k g_k[B]

and s follows from the restricted likelihood (H. D. Patterson and R. Thompson, "Recovery of inter-block information when
block sizes are unequal", 1971) by steps of EM (N. M. Laird and J. H. Ware, "Random-effects models for longitudinal
data", 1982). The optimum of these, ``x' = -(A^T A)'^-1 (A^T r)'``, weighs each collection by what it is worth then, so
that it tells how far off the given result is, better than the scatter of the collections does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.estimation.covariance.cluster_state import ClusterState
from calibration.engine.estimation.covariance.fixed_inputs import ARM_ACCURACY, PLACE_KIND, SHUTTER_KIND, Cause
from calibration.engine.estimation.covariance.linear_model import LinearModel
from calibration.engine.estimation.covariance.suspects import (
    Explanation,
    Suspect,
    columns_of_cause,
    remaining_disagreement,
    suspects_of,
)
from calibration.engine.statistics import threshold

FIRST_STEPS, MAX_STEPS = 4, 30
"""Steps of EM after which causes are compared, and those of the likeliest ones."""
LIKELIEST = 4
"""Number of causes that are compared by their best variance."""
STRIDE = 3.0
"""Power of a step of EM that is taken, as it goes a small part of the way; 1 from where that is too far."""
MAX_GROWTH = 1e6
"""Limit of a variance, in the one to start from: of a cause that nothing but it determines, none is large enough."""
TOLERANCE = 0.01
"""Gain of a step in deviance below which the variance is found."""
ALIKE = 10.0
"""Difference of twice the logarithm of two likelihoods within which the data cannot tell which."""
MAX_UNEXPLAINED = 1.0
"""Disagreement that may be left, in that which is expected of what is assumed."""
MAX_PARAMETERS = 6
"""Of a cause."""
MIN_MOVES = 2
"""Number of moves in one recording from which on something else is likelier."""


@dataclass(frozen=True, eq=False)
class VaryingCause:
    """Cause that varies from collection to collection and explains how they contradict each other."""

    causes: tuple[Cause, ...]
    """The likeliest one first, then those that explain it as well."""
    sigmas: Array
    """(k,): standard deviation of its parameters between collections."""
    change: Array
    """(S,): from the calibrated parameters to their optimum with it."""
    covariance: Array
    """(S, S): of that optimum, with the errors of what is fixed."""


def varying_cause(model: LinearModel, suspects: Sequence[Suspect]) -> VaryingCause | None:
    """Return the cause whose variation between clusters explains how they disagree; None if none does.

    Args:
        model: linear model at the optimum.
        suspects: causes that have been found, which are set free.
    """
    state = ClusterState.at_optimum(model)
    for suspect in suspects:
        state = state.with_cause(columns_of_cause(model, suspect.cause), suspect.since)
    best = _likeliest_variations(model, state)
    if not best:
        return None
    varied, S, free = best[0].eliminated(), state.shared, state.free
    held = varied.inverse @ varied.G.sum(0)[free][:, varied.held] * varied.sigmas
    return VaryingCause(
        tuple(each.cause for each in best),
        np.sqrt(best[0].variances),
        -(varied.inverse @ varied.g.sum(0)[free])[:S],
        (varied.inverse + held @ held.T)[:S, :S],
    )


def steadied(model: LinearModel, explanation: Explanation | None) -> Explanation | None:
    """Return the explanation without several moves, if something that varies and a cause without a moment explain them.

    Collections that scatter more than labels do, and not alike in all directions, look like parts of a recording with
    moves between them, and hide what is wrong in all of them.
    """
    if explanation is None or sum(each.cause.kind == PLACE_KIND for each in explanation.suspects) < MIN_MOVES:
        return explanation
    best = _likeliest_variations(model, ClusterState.at_optimum(model))
    if not best or any(each.cause.kind == PLACE_KIND for each in suspects_of(model, best[0].eliminated(), 1)[0]):
        return explanation
    found, state = suspects_of(model, best[0].eliminated(), None)[0], ClusterState.at_optimum(model)
    if not found:
        return explanation
    for suspect in found:
        state = state.with_cause(columns_of_cause(model, suspect.cause), suspect.since)
    return Explanation(found, remaining_disagreement(model, state))


def _likeliest_variations(model: LinearModel, state: ClusterState) -> "list[_Variation]":
    """Return the likeliest variation that explains the disagreement of clusters, and those as likely; or none."""
    placed = [
        (cause, at)
        for cause, at in model.placed()
        if (cause.tested or cause.kind == SHUTTER_KIND) and cause.size <= MAX_PARAMETERS
    ]
    tried = [each for cause, at in placed if (each := _Variation.first(state, cause, at))]
    tried = sorted((each.fitted(FIRST_STEPS) for each in tried), key=lambda each: each.deviance)[:LIKELIEST]
    tried = sorted((each.fitted(MAX_STEPS) for each in tried), key=lambda each: each.deviance)
    if not tried or tried[0].deviance > -(threshold(len(placed)) ** 2):
        return []
    usual = np.array(tried[0].cause.assumed) * (1.0 if tried[0].cause.kind == PLACE_KIND else ARM_ACCURACY)
    if (np.sqrt(tried[0].variances) <= usual).all():  # no more than a good robot's poses are off
        return []
    left = remaining_disagreement(model, tried[0].eliminated())
    if left.ratio > MAX_UNEXPLAINED * left.expected:
        return []
    return [each for each in tried if each.deviance < tried[0].deviance + ALIKE]


@dataclass(frozen=True, eq=False)
class _Variation:
    """Cause with the variances of its parameters between clusters."""

    state: ClusterState
    cause: Cause
    own: IntArray
    """(k,): its columns."""
    variances: Array
    """(k,); those of lengths and of angles of a pose are alike in all directions."""

    @classmethod
    def first(cls, state: ClusterState, cause: Cause, at: slice) -> "_Variation | None":
        """Return variances to start from; None of a cause of which the labels tell nothing."""
        own = np.arange(at.start, at.stop)
        information = np.einsum("kii->ki", state.G[:, own[:, None], own]).mean(0)
        if (information <= 0).any():
            return None
        pulls = (state.residual[:, own] ** 2).mean(0)
        return cls(state, cause, own, np.maximum(pulls / information, 1e-2) / information)._alike()

    def _alike(self) -> "_Variation":
        parts = self.variances.reshape(-1, 3 if len(self.own) == MAX_PARAMETERS else len(self.own))
        return replace(self, variances=np.repeat(parts.mean(1), parts.shape[1]))

    def eliminated(self) -> ClusterState:
        """Return the state with this variation in it."""
        return self.state.with_variation(self.own, self.variances)

    @property
    def deviance(self) -> float:
        """Twice the decrease of the logarithm of the restricted likelihood, of no variation; negative if it gains.

        Infinite where a shared parameter is not determined with it.
        """
        return self._evaluated()[0]

    def fitted(self, steps: int) -> "_Variation":
        """Return the variation after steps of EM, the likeliest on the way."""
        best, now, stride = self, self, STRIDE
        least, expected = np.inf, self.variances
        for _ in range(steps):
            deviance, reached = now._evaluated()
            if deviance < least - TOLERANCE:
                best, least, expected = now, deviance, reached
            elif stride > 1:
                stride = 1.0
            else:
                break
            variances = best.variances * (expected / best.variances) ** stride
            now = replace(self, variances=np.minimum(variances, MAX_GROWTH * self.variances))._alike()
        return best

    def _evaluated(self) -> tuple[float, Array]:
        """Return the deviance, and the expected squares (k,) of the deviations of all clusters by these variances."""
        own, free, G = self.own, self.state.free, self.state.G
        squares, mixed, pulls = G[:, own[:, None], own], G[:, own][:, :, free], self.state.residual[:, own]
        P = np.linalg.inv(squares + np.diag(1 / self.variances))
        taken, before = P @ mixed, G.sum(0)[free[:, None], free]
        after = before - np.einsum("kbi,kbj->ij", mixed, taken)
        try:
            root = np.linalg.cholesky(after)
        except np.linalg.LinAlgError:  # it leaves nothing that tells a shared parameter
            return np.inf, self.variances
        gradient, inverse = -np.einsum("kbi,kb->i", taken, pulls), np.linalg.inv(after)
        change = -inverse @ gradient
        logs = (
            np.linalg.slogdet(np.eye(len(own)) + squares * self.variances)[1].sum()
            + 2 * np.log(np.diagonal(root)).sum()
            - np.linalg.slogdet(before)[1]
        )
        gain = np.einsum("ki,kij,kj->", pulls, P, pulls) - gradient @ change
        means = np.einsum("kij,kj->ki", P, pulls + mixed @ change)
        spread = np.einsum("kii->ki", P + taken @ inverse @ np.swapaxes(taken, 1, 2))
        return float(logs - gain), np.asarray((means**2 + spread).mean(0))
