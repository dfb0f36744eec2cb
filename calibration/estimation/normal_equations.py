"""The normal equations of all views, and their solution with the blocks of each collection eliminated.

The cost is ``sum r^T r`` over all residuals in standard deviations, the parameters are those x that all collections
share (S) and those y_c that each collection c has its own of (P; the pose of a moving pattern). Gauss-Newton's step
solves ``H step = -g`` with ``H = J^T J`` and ``g = J^T r``, which has the form of an arrow, as no residual depends on
two collections::

    [ H_xx   H_x1  H_x2 ... ] [ dx  ]     [ g_x ]      H_shared  H_xx (S, S)    g_shared  g_x (S)
    [ H_x1^T H_11           ] [ dy_1]     [ g_1 ]      H_mixed   H_xc (N, S, P)
    [ H_x2^T       H_22     ] [ dy_2] = - [ g_2 ]      H_local   H_cc (N, P, P) g_local   g_c (N, P)

The rows of c give ``dy_c = -H_cc^-1 (g_c + H_xc^T dx)``, one batched solve; put into the first row they leave the
Schur complement, one small dense system::

    (H_xx - sum_c H_xc H_cc^-1 H_xc^T) dx = -(g_x - sum_c H_xc H_cc^-1 g_c)

Its matrix is the information of the data on x with all y being free, its inverse the covariance of x.

A view's labels depend on the twist t of its pose alone (see `calibration.estimation.residuals`, which squeezes them
to ``M = sum (dr/dt)^T (dr/dt)`` (6, 6) and ``m = sum (dr/dt)^T r`` (6)), and on free intrinsics of its camera, whose
rows and columns follow those of t. With ``A = dt/d(x, y)`` (6, C) of the C parameters on the view's chain
(`calibration.estimation.batches`) it adds ``A^T M A`` to H and ``A^T m`` to g: the length of a chain costs products of
6x6 matrices per view, never work per label.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from calibration.dataset.modalities import NoiseKind
from calibration.estimation.batches import Batch, index_of, table_of
from calibration.estimation.blocks import Values
from calibration.estimation.problem import Problem
from calibration.estimation.views import Term
from calibration.frozen import frozen
from calibration.geometry.types import Array

ONE_THREAD = 1 << 18
"""Multiplications in a matrix product up to which BLAS starts no threads, which wait for each other on a busy
machine."""


@frozen
class Weighting:
    """Weights of the residuals."""

    scales: Mapping[NoiseKind, float]
    """Standard deviation of each kind, px, m or rad."""
    huber: float | None
    """Threshold of Huber's loss in standard deviations; None for plain least squares."""


@frozen(eq=False)
class NormalEquations:
    """Normal equations ``H step = -g``: S parameters of shared blocks, P of local ones per collection; see above."""

    cost: Array
    """(N,): cost of each collection; sum of squared residuals in standard deviations."""
    H_shared: Array
    """(S, S)."""
    H_mixed: Array
    """(N, S, P)."""
    H_local: Array
    """(N, P, P)."""
    g_shared: Array
    """(S,)."""
    g_local: Array
    """(N, P)."""
    prior: float = 0.0
    """Cost of the priors."""

    @property
    def total(self) -> float:
        """Total cost."""
        return float(self.cost.sum()) + self.prior

    def step(self, damping: float) -> tuple[Array, Array, float]:
        """Solve for the damped step by the Schur complement: shared (S,), local (N, P), and the predicted decrease.

        With Levenberg's damping, scaled by the diagonal (Marquardt), H + damping diag(H) replaces H. The decrease
        predicted by the quadratic model is ``-g^T step + damping step^T diag(H) step``. A singular system gives NaN.
        """
        N, P = self.g_local.shape
        diagonal = np.diagonal(self.H_local, axis1=1, axis2=2)
        H_local = _damped(self.H_local, damping)
        H_shared = _damped(self.H_shared, damping)
        try:
            right = np.concatenate([np.swapaxes(self.H_mixed, 1, 2), self.g_local[..., None]], -1)
            solved: Array = np.asarray(np.linalg.solve(H_local, right), float)
            reduced = self._mixed @ solved.reshape(N * P, len(self.g_shared) + 1)
            shared = -np.asarray(np.linalg.solve(H_shared - reduced[:, :-1], self.g_shared - reduced[:, -1]), float)
        except np.linalg.LinAlgError:
            return np.full_like(self.g_shared, np.nan), np.full_like(self.g_local, np.nan), np.nan
        local = -(solved[..., -1] + solved[..., :-1] @ shared)
        penalty = (np.diagonal(self.H_shared) * shared**2).sum() + (diagonal * local**2).sum()
        predicted = -(self.g_shared @ shared) - (self.g_local * local).sum() + damping * penalty
        return shared, np.asarray(local, float), float(predicted)

    def local_step(self, damping: Array) -> Array:
        """Solve for the step of the local blocks alone, (N, P), each collection with its own damping (N,)."""
        H = _damped(self.H_local, damping[:, None])
        return -np.asarray(np.linalg.solve(H, self.g_local[..., None])[..., 0], float)

    @cached_property
    def schur(self) -> Array:
        """Schur complement (S, S): information of the data on the shared blocks, with the local ones eliminated."""
        solved = np.linalg.solve(self.H_local, np.swapaxes(self.H_mixed, 1, 2))
        schur: Array = self.H_shared - self._mixed @ solved.reshape(self._mixed.T.shape)
        return 0.5 * (schur + schur.T)

    @property
    def _mixed(self) -> Array:
        """`H_mixed` with the collections side by side, (S, P N)."""
        N, S, P = self.H_mixed.shape
        return np.swapaxes(self.H_mixed, 0, 1).reshape(S, N * P)


Squares = dict[NoiseKind, list[Array]]
"""Squared magnitudes of labels by their kind, each array of any shape; NaN without a label."""


def assemble(problem: Problem, values: Values, weighting: Weighting, squares: Squares | None = None) -> NormalEquations:
    """Form the normal equations at some values.

    Args:
        problem: the problem.
        values: of all blocks.
        weighting: what residuals weigh.
        squares: filled with those of all labels, where it is given.
    """
    N, (S, P) = problem.collections, problem.sizes
    equations = NormalEquations(
        np.zeros(N), np.zeros((S, S)), np.zeros((N, S, P)), np.zeros((N, P, P)), np.zeros(S), np.zeros((N, P))
    )
    table = table_of(problem.blocks, values)
    for batch in problem.batches:
        if not _possible(problem, batch, values):
            for part in batch.parts:
                equations.cost[part.collections] = np.inf
            continue
        T, A = batch.linearise(table, values)
        cost, M, m = linearise(problem.terms(batch, values), T, weighting, squares)
        _add(equations, batch, A, cost, M, m, problem.intrinsics_at(batch))
    fill_unobserved(equations.H_local)
    return _with_priors(equations, problem, values)


def _possible(problem: Problem, batch: Batch, values: Values) -> bool:
    """Whether the camera's intrinsics are valid."""
    if batch.intrinsics is None or (intrinsics := problem.blocks[batch.intrinsics].intrinsics) is None:
        return True
    return intrinsics.possible(values[batch.intrinsics])


def _with_priors(equations: NormalEquations, problem: Problem, values: Values) -> NormalEquations:
    """Add the priors of intrinsics to the equations."""
    cost = 0.0
    for block, at in problem.shared_parameters.items():
        intrinsics = problem.blocks[block].intrinsics
        if intrinsics and intrinsics.prior:
            more, gradient, H = intrinsics.pull(values[block])
            equations.g_shared[at] += gradient
            equations.H_shared[at, at] += H
            cost += more
    return replace(equations, prior=cost) if cost else equations


def linearise(
    terms: Sequence[Term], T: Array, weighting: Weighting, squares: Squares | None = None
) -> tuple[Array, Array, Array]:
    """Return cost (V,), Hessian (V, 6 + m, 6 + m) and gradient (V, 6 + m) of views, summed over all terms."""
    each = []
    for term in terms:
        own = None if squares is None else np.empty((len(T), term.length))
        each.append(term.linearise(T, weighting.scales[term.kind], weighting.huber, own))
        if squares is not None and own is not None:
            squares.setdefault(term.kind, []).append(own)
    cost, M, m = each[0]
    for more in each[1:]:
        cost, M, m = cost + more[0], M + more[1], m + more[2]
    return cost, M, m


def _add(
    equations: NormalEquations, batch: Batch, A: Array, cost: Array, M: Array, m: Array, intrinsics: slice
) -> None:
    """Add a batch of views to the equations; its free intrinsics are at ``intrinsics``."""
    MA = M[:, :, :6] @ A  # (V, 6 + m, C)
    for part in batch.parts:
        v, collections = part.views, part.collections
        equations.cost[collections] += cost[v]
        left, right = (np.ascontiguousarray(each[v, :6, part.shared]) for each in (A, MA))
        equations.H_shared[part.in_shared] += sum_of_products(left, right)
        equations.g_shared[part.shared_at] += left.reshape(6 * len(left), -1).T @ np.ravel(m[v, :6])
        if part.has_local:
            own = np.swapaxes(A[v, :, part.local], 1, 2)
            block = own @ MA[v, :6]  # (v, local parameters of a view, C)
            equations.H_local[part.in_local] += block[:, :, part.local]
            equations.H_mixed[part.in_mixed] += np.swapaxes(block[:, :, part.shared], 1, 2)
            equations.g_local[collections, part.local_at] += (own @ m[v, :6, None])[..., 0]
        if intrinsics.stop:
            mixed = MA[v, 6:]
            total = mixed[:, :, part.shared].sum(0)
            equations.H_shared[intrinsics, intrinsics] += M[v, 6:, 6:].sum(0)
            equations.H_shared[intrinsics, part.shared_at] += total
            equations.H_shared[part.shared_at, intrinsics] += total.T
            equations.g_shared[intrinsics] += m[v, 6:].sum(0)
            if part.has_local:
                equations.H_mixed[index_of(collections, intrinsics, part.local_at)] += mixed[:, :, part.local]


def sum_of_products(A: Array, MA: Array) -> Array:
    """Sum ``A^T MA`` (v, p, k) over views, by few products of tall matrices."""
    left, right = (each.reshape(each.shape[0] * each.shape[1], -1) for each in (A, MA))
    rows = max(1, ONE_THREAD // max(1, left.shape[1] * right.shape[1]))
    total: Array = left[:rows].T @ right[:rows]
    for start in range(rows, len(left), rows):
        total += left[start : start + rows].T @ right[start : start + rows]
    return total


def _damped(H: Array, damping: float | Array) -> Array:
    """Return H with its diagonal multiplied by 1 + damping."""
    out = H.copy()
    index = np.arange(H.shape[-1])
    out[..., index, index] *= 1 + damping
    return out


def fill_unobserved(H_local: Array) -> None:
    """Set a unit Hessian for local blocks that no view of their collection depends on, so that their step is zero."""
    index = np.arange(H_local.shape[-1])
    diagonal = H_local[:, index, index]
    H_local[:, index, index] = np.where(diagonal == 0.0, 1.0, diagonal)
