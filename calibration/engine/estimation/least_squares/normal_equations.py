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

A view's labels depend on the twist t of its pose alone (see `residuals.residuals`, which squeezes them
to ``M = sum (dr/dt)^T (dr/dt)`` (6, 6) and ``m = sum (dr/dt)^T r`` (6)), and on free intrinsics of its camera, whose
rows and columns follow those of t. With ``A = dt/d(x, y)`` (6, C) of the C parameters on the view's chain
(`problem.problem`) it adds ``A^T M A`` to H and ``A^T m`` to g: the length of a chain costs products of
6x6 matrices per view, never work per label.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Batch, Part, Problem, index_of, table_of
from calibration.engine.estimation.residuals.views import Term, sum_of_products


@dataclass(frozen=True)
class Weighting:
    """Weights of the residuals."""

    scales: Mapping[NoiseKind, float]
    """Standard deviation of each kind, px, m or rad."""
    huber: float | None
    """Threshold of Huber's loss in standard deviations; None for plain least squares."""


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations ``H step = -g``: S parameters of shared blocks, P of local ones per collection; see above."""

    cost: Array
    """(N,): cost of each collection; sum of squared residuals in standard deviations."""
    H_shared: Array
    """(S, S)."""
    g_shared: Array
    """(S,)."""
    H_local: Array
    """(N, P, P)."""
    right: Array
    """(N, P, S + 1): `H_mixed`, transposed, and `g_local` beside it: the right sides of the solution for the local
    parameters."""
    prior: float = 0.0
    """Cost of the priors."""

    @property
    def H_mixed(self) -> Array:
        """(N, S, P)."""
        return self.right[:, :, :-1].transpose(0, 2, 1)

    @property
    def g_local(self) -> Array:
        """(N, P)."""
        return self.right[:, :, -1]

    @cached_property
    def total(self) -> float:
        """Total cost."""
        return float(self.cost.sum()) + self.prior

    def step(self, damping: float) -> tuple[Array, Array, float]:
        """Solve for the damped step by the Schur complement: shared (S,), local (N, P), and the predicted decrease.

        With Levenberg's damping, scaled by the diagonal (Marquardt), H + damping diag(H) replaces H. The decrease
        predicted by the quadratic model is ``-g^T step + damping step^T diag(H) step``. A singular system gives NaN.
        """
        N, P, C = self.right.shape
        try:
            solved = np.asarray(np.linalg.solve(_with_damping(self.H_local, damping), self.right), float).reshape(
                N * P, C
            )
            reduced = sum_of_products(self.right.reshape(N * P, C), solved)
            H_shared, g_shared = (
                _with_damping(self.H_shared, damping) - reduced[:-1, :-1],
                self.g_shared - reduced[:-1, -1],
            )
            shared = -np.asarray(np.linalg.solve(H_shared, g_shared), float)
        except np.linalg.LinAlgError:
            return np.full(C - 1, np.nan), np.full((N, P), np.nan), np.nan
        local: Array = -(solved[:, -1] + solved[:, :-1] @ shared).reshape(N, P)
        penalty = (diagonal_of(self.H_shared) * shared**2).sum() + (diagonal_of(self.H_local) * local**2).sum()
        return shared, local, float(reduced[-1, -1] - g_shared @ shared + damping * penalty)

    def local_step(self, damping: Array) -> Array:
        """Solve for the step of the local blocks alone, (N, P), each collection with its own damping (N,)."""
        H = _with_damping(self.H_local, damping[:, None])
        return -np.asarray(np.linalg.solve(H, self.g_local[..., None])[..., 0], float)

    @cached_property
    def schur(self) -> Array:
        """Schur complement (S, S): information of the data on the shared blocks, with the local ones eliminated."""
        mixed = self.right[:, :, :-1]
        solved = np.linalg.solve(self.H_local, mixed)
        S = mixed.shape[-1]
        schur: Array = self.H_shared - mixed.reshape(-1, S).T @ solved.reshape(-1, S)
        return 0.5 * (schur + schur.T)


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
        np.zeros(N), np.zeros((S, S)), np.zeros(S), np.zeros((N, P, P)), np.zeros((N, P, S + 1))
    )
    table = table_of(problem.blocks, values)
    for batch in problem.batches:
        if not _has_valid_intrinsics(problem, batch, values):
            for part in batch.parts:
                equations.cost[part.collections] = np.inf
            continue
        T, A = batch.linearise(table, values)
        cost, M, m = linearise(problem.terms(batch, values), T, weighting, squares)
        _add_batch(equations, batch, A, cost, M, m, problem.intrinsics_at(batch))
    fill_unobserved(equations.H_local)
    return _with_priors(equations, problem, values)


def _has_valid_intrinsics(problem: Problem, batch: Batch, values: Values) -> bool:
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


def _add_batch(
    equations: NormalEquations, batch: Batch, A: Array, cost: Array, M: Array, m: Array, intrinsics: slice
) -> None:
    """Add a batch of views to the equations; its free intrinsics are at ``intrinsics``."""
    for part in batch.parts:
        v = part.views
        equations.cost[part.at] += cost[v]
        by_twist, mixed = M[v, :, :6], None  # (v, 6 + m, 6), and by the shared parameters of a view
        if part.has_shared:
            J = np.ascontiguousarray(A[v, :, part.shared])
            mixed = by_twist @ J
            tall = J.reshape(6 * len(J), -1)
            equations.H_shared[part.in_shared] += sum_of_products(tall, mixed[:, :6].reshape(tall.shape))
            equations.g_shared[part.shared_at] += tall.T @ m[v, :6].ravel()
        if part.has_local:
            _add_local(equations, part, A[v, :, part.local], by_twist, mixed, m[v, :6])
        if intrinsics.stop:
            _add_intrinsics(equations, part, A[v, :, part.local], M[v], mixed, m[v, 6:], intrinsics)


def _add_intrinsics(
    equations: NormalEquations, part: Part, A: Array, M: Array, mixed: Array | None, m: Array, at: slice
) -> None:
    """Add a part of a batch to the rows and columns of its camera's intrinsics, at ``at``; see `_add_local`."""
    equations.H_shared[at, at] += M[:, 6:, 6:].sum(0)
    equations.g_shared[at] += m.sum(0)
    if mixed is not None:
        total = mixed[:, 6:].sum(0)
        equations.H_shared[at, part.shared_at] += total
        equations.H_shared[part.shared_at, at] += total.T
    if part.has_local:
        equations.H_mixed[index_of(part.at, at, part.local_at)] += M[:, 6:, :6] @ A


def _add_local(equations: NormalEquations, part: Part, A: Array, M: Array, mixed: Array | None, m: Array) -> None:
    """Add a part of a batch to the rows of its local parameters.

    Args:
        equations: added to.
        part: of p local parameters and k shared ones in each view.
        A: (v, 6, p), Jacobian by the local parameters.
        M: (v, 6 + m, 6), by the twist.
        mixed: (v, 6 + m, k), the same times the Jacobian by the shared parameters; None without any.
        m: (v, 6), gradient by the twist.
    """
    H, g, At = M[:, :6], m, A.transpose(0, 2, 1)
    if not part.is_own_twist:
        H, g = At @ H @ A, (At @ g[:, :, None])[..., 0]
    equations.H_local[part.in_local] += H
    equations.g_local[part.in_gradient] += g
    if mixed is not None:
        H_mixed = mixed[:, :6] if part.is_own_twist else At @ mixed[:, :6]
        equations.H_mixed[part.in_mixed] += H_mixed.transpose(0, 2, 1)


def diagonal_of(H: Array) -> Array:
    """Return the diagonals (..., P) of matrices (..., P, P), contiguous ones: a view, which can be written to."""
    P = H.shape[-1]
    return H.reshape(*H.shape[:-2], P * P)[..., :: P + 1]


def _with_damping(H: Array, damping: float | Array) -> Array:
    """Return H with its diagonal multiplied by 1 + damping."""
    out = H.copy()
    diagonal_of(out)[:] *= 1 + damping
    return out


def fill_unobserved(H_local: Array) -> None:
    """Set a unit Hessian for local blocks that no view of their collection depends on, so that their step is zero."""
    diagonal = diagonal_of(H_local)
    diagonal[diagonal == 0.0] = 1.0
