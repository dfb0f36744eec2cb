"""Linear model with the causes that have been set free so far: each cluster's information, and what is left of it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.estimation.covariance.error_bars import arm_scatter
from calibration.engine.estimation.covariance.linear_model import LinearModel

MIN_INFORMATION_LEFT = 1e-7
"""Part of the information on a cause that the other parameters must leave for it to be determined."""


@dataclass(frozen=True, eq=False)
class ClusterState:
    """Linear model with the causes that have been set free among the free parameters."""

    G: Array
    """(K, C, C)."""
    g: Array
    """(K, C): gradient of each cluster before the last causes were set free."""
    free: IntArray
    """(F,): columns that are free."""
    shared: int
    """Number of calibrated parameters among the free ones."""
    held: IntArray
    """(H,): columns of fixed parameters that add to the covariance, without those that have been set free."""
    sigmas: Array
    """(H,): their assumed standard deviations."""
    alone: Array
    """(C,): information on each column if all others were known, see `LinearModel`."""
    arm: Array
    """(K, C, H): gradients by errors of an arm that differ from cluster to cluster."""

    @cached_property
    def inverse(self) -> Array:
        """(F, F): inverse of the information of the free columns."""
        return _pseudo_inverse(self.G.sum(0)[np.ix_(self.free, self.free)], self.alone[self.free])

    @cached_property
    def residual(self) -> Array:
        """(K, C): gradient of each cluster with the free ones at their optimum."""
        return np.asarray(self.g - self.G[:, :, self.free] @ (self.inverse @ self.g.sum(0)[self.free]))

    @cached_property
    def whitening(self) -> Array:
        """(K, S, S): of the calibrated parameters by each cluster."""
        return whitening_matrices(self.G[:, : self.shared, : self.shared], self.alone[: self.shared])

    @cached_property
    def disagreement(self) -> float:
        """Decrease of the clusters' costs if each had its own parameters."""
        return float((np.einsum("kji,kj->ki", self.whitening, self.residual[:, : self.shared]) ** 2).sum())

    @property
    def freedom(self) -> float:
        """Its degrees of freedom."""
        return float(np.any(self.whitening, 1).sum()) - len(self.free)

    @classmethod
    def at_optimum(cls, model: LinearModel) -> "ClusterState":
        """Return the state of a calibration, with no cause free but those that are calibrated."""
        G, g = model.G.copy(), model.g.copy()
        G[0] += model.prior
        g[0, : model.shared] -= g[:, : model.shared].sum(0)  # rounding error, or the gradient of a prior
        # those that add to the result's covariance
        counting = [(cause, at) for cause, at in model.placed() if cause.counts]
        held = np.concatenate([np.arange(0), *(np.arange(at.start, at.stop) for _, at in counting)])
        sigmas = np.concatenate([np.zeros(0), *(np.array(cause.assumed) for cause, _ in counting)])
        state = cls(G, g, np.arange(model.shared), model.shared, held, sigmas, model.alone, arm_scatter(model))
        for cause, at in model.placed():
            state = state.with_cause(np.arange(at.start, at.stop), None) if cause.free else state
        return state

    def with_cause(self, own: IntArray, since: int | None) -> "ClusterState":
        """Return the state with one more cause free, by its columns."""
        mask = (np.arange(len(self.G)) >= (since or 0)).astype(float)[:, None, None]
        C = self.G.shape[-1]
        k = len(own)
        G = np.zeros((len(self.G), C + k, C + k))
        G[:, :C, :C] = self.G
        G[:, :C, C:] = mask * self.G[:, :, own]
        G[:, C:, :C] = np.swapaxes(G[:, :C, C:], 1, 2)
        G[:, C:, C:] = mask * self.G[:, own[:, None], own]
        g = np.concatenate([self.residual, mask[..., 0] * self.residual[:, own]], -1)
        alone = np.append(self.alone, self.alone[own])
        arm = np.concatenate([self.arm, mask * self.arm[:, own]], 1)
        kept = ~np.isin(self.held, own)
        free = np.append(self.free, np.arange(C, C + k))
        return ClusterState(G, g, free, self.shared, self.held[kept], self.sigmas[kept], alone, arm)

    def with_variation(self, own: IntArray, variances: Array) -> "ClusterState":
        """Return the state with a cause that varies from cluster to cluster eliminated, see `varying_causes`.

        Args:
            own: (k,), its columns.
            variances: (k,), of its parameters between clusters.
        """
        taken = self.G[:, :, own] @ np.linalg.inv(self.G[:, own[:, None], own] + np.diag(1 / variances))
        return replace(
            self,
            G=self.G - taken @ self.G[:, own],
            g=self.residual - np.einsum("kib,kb->ki", taken, self.residual[:, own]),
            arm=self.arm - taken @ self.arm[:, own],
        )


def _pseudo_inverse(information: Array, alone: Array) -> Array:
    """Pseudo-inverse (n, n) of an information (n, n); zero in directions without any, as a free cause may have.

    Args:
        information: the information.
        alone: (n,), the reference of full information on each column.
    """
    scale = 1 / np.sqrt(np.maximum(alone, 1e-300))
    return scale[:, None] * np.linalg.pinv(scale[:, None] * information * scale, 1e-13, True) * scale


def whitening_matrices(G: Array, alone: Array) -> Array:
    """Return matrices w (K, n, n) with ``w w^T = G^+``; columns of zeros for directions without information.

    Args:
        G: (K, n, n).
        alone: (n,), the reference of full information on each column.
    """
    return _whitening_and_axes(G, alone)[0]


def inverse_roots(G: Array, alone: Array) -> Array:
    """Return such matrices of which two are alike where their G are: axes of the columns are turned back."""
    whitening, axes = _whitening_and_axes(G, alone)
    return whitening @ np.swapaxes(axes, 1, 2)


def _whitening_and_axes(G: Array, alone: Array) -> tuple[Array, Array]:
    scale = 1 / np.sqrt(np.maximum(alone, 1e-300))
    values, vectors = np.linalg.eigh(scale[:, None] * G * scale)
    kept = values > MIN_INFORMATION_LEFT / len(G)
    root = np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
    return np.asarray(scale[:, None] * vectors * root[:, None]), vectors
