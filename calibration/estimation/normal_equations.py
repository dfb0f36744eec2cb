"""The normal equations of all views, with the blocks of each collection eliminated.

A view's Hessian M (6x6, from `calibration.estimation.residuals`) becomes the block (a, b) of the
normal equations as ``J_a^T M J_b``, where J maps a block's parameters (the six of a twist, or those
of a joint) to the view's twist: chain length costs products of 6x6 matrices per view, never work per
label. Free intrinsics of a camera are rows and columns of M of their own. Blocks that each collection
has its own of (moving patterns) are eliminated collection by collection in one batched solve, and what
remains is one small dense matrix for the shared blocks, the Schur complement. A Jacobian is never stored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from calibration.estimation.problem import NoiseKind, Problem, Term, Values, ViewGroup
from calibration.geometry.types import Array, IntArray

VIEWS_AT_A_TIME = 1024
"""Bounds the temporaries: 1024 views of 50 corners pass through in about 10 MB."""
ONE_THREAD = 1 << 18
"""Multiplications in a product of matrices up to which BLAS starts no threads, which wait for each other on a busy
machine."""


@dataclass(frozen=True)
class Weighting:
    """What residuals weigh."""

    scales: Mapping[NoiseKind, float]
    """The standard deviation of each kind, px, m or rad."""
    huber: float | None
    """The threshold in standard deviations of the robust loss; None for plain least squares."""


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """``H step = -g``: S parameters of shared blocks, P of local ones in each of N collections."""

    cost: Array
    """(N,): the cost of each collection; the sum of squared residuals in standard deviations."""
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
    """The cost of what is known beforehand."""

    @property
    def total(self) -> float:
        """The whole cost."""
        return float(self.cost.sum()) + self.prior

    def step(self, damping: float) -> tuple[Array, Array, float]:
        """The damped step: shared (S,), local (N, P), and the decrease of the cost that it predicts.

        Levenberg's damping, scaled by the diagonal (Marquardt). A singular system gives NaN.
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
        """The step of the local blocks alone, (N, P), each collection with its own damping (N,)."""
        H = _damped(self.H_local, damping[:, None])
        return -np.asarray(np.linalg.solve(H, self.g_local[..., None])[..., 0], float)

    @cached_property
    def schur(self) -> Array:
        """(S, S): the information of the data on the shared blocks, the local ones being free."""
        solved = np.linalg.solve(self.H_local, np.swapaxes(self.H_mixed, 1, 2))
        schur: Array = self.H_shared - self._mixed @ solved.reshape(self._mixed.T.shape)
        return 0.5 * (schur + schur.T)

    @property
    def _mixed(self) -> Array:
        """`H_mixed` with the collections side by side, (S, P N)."""
        N, S, P = self.H_mixed.shape
        return np.swapaxes(self.H_mixed, 0, 1).reshape(S, N * P)


def assemble(problem: Problem, values: Values, weighting: Weighting) -> NormalEquations:
    """Form the normal equations at some values."""
    N = problem.collections
    S, P = (sum(problem.blocks[i].dimension for i in blocks) for blocks in (problem.shared, problem.local))
    equations = NormalEquations(
        np.zeros(N), np.zeros((S, S)), np.zeros((N, S, P)), np.zeros((N, P, P)), np.zeros(S), np.zeros((N, P))
    )
    for group in problem.groups:
        if not _possible(problem, group, values):
            equations.cost[group.collections] = np.inf
            continue
        terms = problem.terms(group, values)
        for start in range(0, len(group.collections), VIEWS_AT_A_TIME):
            views = slice(start, min(start + VIEWS_AT_A_TIME, len(group.collections)))
            _add(equations, problem, group, terms, views, values, weighting)
    _fill_unobserved(equations.H_local)
    return _with_priors(equations, problem, values)


def _possible(problem: Problem, group: ViewGroup, values: Values) -> bool:
    """Whether there can be a camera with such intrinsics."""
    free = problem.free_intrinsics(group)
    return free is None or free[1].possible(values[free[0]])


def _with_priors(equations: NormalEquations, problem: Problem, values: Values) -> NormalEquations:
    """The equations with what is known of intrinsics beforehand."""
    cost = 0.0
    for block, at in problem.shared_parameters.items():
        intrinsics = problem.blocks[block].intrinsics
        if intrinsics and intrinsics.prior:
            more, gradient, H = intrinsics.pull(values[block])
            equations.g_shared[at] += gradient
            equations.H_shared[at, at] += H
            cost += more
    return replace(equations, prior=cost) if cost else equations


def linearise(terms: Sequence[Term], T: Array, views: slice, weighting: Weighting) -> tuple[Array, Array, Array]:
    """Cost (v,), Hessian (v, 6 + m, 6 + m) and gradient (v, 6 + m) of some views at their poses, all terms together."""

    def of(term: Term) -> tuple[Array, Array, Array]:
        return term.linearise(T, views, weighting.scales[term.kind], weighting.huber)

    cost, M, g = of(terms[0])
    for term in terms[1:]:
        more_cost, more_M, more_g = of(term)
        cost, M, g = cost + more_cost, M + more_M, g + more_g
    return cost, M, g


def _add(
    equations: NormalEquations,
    problem: Problem,
    group: ViewGroup,
    terms: Sequence[Term],
    views: slice,
    values: Values,
    weighting: Weighting,
) -> None:
    """Add some views of a group to the equations."""
    collections = group.collections[views]
    T, jacobians = group.chain.jacobians(values, views, collections, problem.held)
    cost, M, g = linearise(terms, T, views, weighting)
    equations.cost[collections] += cost
    columns = _columns(problem, jacobians)
    free = problem.free_intrinsics(group)
    if free is not None:
        _add_intrinsics(equations, problem.shared_parameters[free[0]], collections, columns, M, g)
        M, g = M[:, :6, :6], g[:, :6]
    for i, a in enumerate(columns):
        gradient = (np.swapaxes(a.J, 1, 2) @ g[..., None])[..., 0]
        if a.local:
            equations.g_local[collections, a.at] += gradient
        else:
            equations.g_shared[a.at] += gradient.sum(0)
        MJ = M @ a.J
        for b in columns[: i + 1]:
            if a.local or b.local:
                block = np.swapaxes(b.J, 1, 2) @ MJ  # (v, k_b, k_a): row b, column a
                _add_local(equations, collections, a, b, block)
            else:
                total = _sum_of_products(b.J, MJ)
                equations.H_shared[b.at, a.at] += total
                if a is not b:
                    equations.H_shared[a.at, b.at] += total.T


def _add_intrinsics(
    equations: NormalEquations, at: slice, collections: IntArray, columns: "list[_Columns]", M: Array, g: Array
) -> None:
    """Add the rows and columns of intrinsics, which stand at ``at``, from M (v, 6 + m, 6 + m) and g (v, 6 + m)."""
    equations.H_shared[at, at] += M[:, 6:, 6:].sum(0)
    equations.g_shared[at] += g[:, 6:].sum(0)
    mixed = M[:, 6:, :6]
    for a in columns:
        if a.local:
            equations.H_mixed[collections, at, a.at] += mixed @ a.J
        else:
            total = mixed.sum(0) @ a.J[0] if len(a.J) == 1 else (mixed @ a.J).sum(0)
            equations.H_shared[at, a.at] += total
            equations.H_shared[a.at, at] += total.T


class _Columns(NamedTuple):
    """Some columns of the Jacobian of views: those of a block, or of shared blocks that are neighbours."""

    J: Array
    """(v or 1, 6, k)."""
    at: slice
    """Where its parameters stand among those of all shared or all local blocks."""
    local: bool


def _columns(problem: Problem, jacobians: list[tuple[int, Array]]) -> list[_Columns]:
    """The columns of each block; where there are joints all shared ones side by side: a few products do for many."""
    shared, local = problem.shared_parameters, problem.local_parameters
    if not any(problem.blocks[block].joint for block, _ in jacobians):
        return [_Columns(J, local[i] if i in local else shared[i], i in local) for i, J in jacobians]
    columns = [_Columns(J, local[block], True) for block, J in jacobians if block in local]
    parts = [(shared[block], J) for block, J in jacobians if block in shared]
    parts.sort(key=lambda part: part[0].start)
    run: list[Array] = []
    for k, (at, J) in enumerate(parts):
        run.append(J)
        if k + 1 == len(parts) or parts[k + 1][0].start != at.stop:
            width = sum(each.shape[-1] for each in run)
            columns.append(_Columns(_side_by_side(run), slice(at.stop - width, at.stop), False))
            run = []
    return columns


def _side_by_side(matrices: list[Array]) -> Array:
    """Jacobians (v or 1, 6, k) as one."""
    if len(matrices) == 1:
        return matrices[0]
    ends = list(accumulate(J.shape[-1] for J in matrices))
    out = np.empty((max(len(J) for J in matrices), matrices[0].shape[1], ends[-1]))
    for J, end in zip(matrices, ends, strict=True):
        out[..., end - J.shape[-1] : end] = J
    return out


def _add_local(equations: NormalEquations, collections: IntArray, a: _Columns, b: _Columns, block: Array) -> None:
    """Add blocks (v, k_b, k_a) of row b and column a, at least one of them local."""
    if a.local and b.local:
        equations.H_local[collections, b.at, a.at] += block
        if a is not b:
            equations.H_local[collections, a.at, b.at] += np.swapaxes(block, 1, 2)
    elif a.local:
        equations.H_mixed[collections, b.at, a.at] += block
    else:
        equations.H_mixed[collections, a.at, b.at] += np.swapaxes(block, 1, 2)


def _sum_of_products(J: Array, MJ: Array) -> Array:
    """The sum over views of ``J^T M J``, as few products of tall matrices."""
    if len(J) == 1:
        single: Array = J[0].T @ MJ.sum(0)
        return single
    left, right = J.reshape(-1, J.shape[-1]), MJ.reshape(-1, MJ.shape[-1])
    rows = max(1, ONE_THREAD // (left.shape[1] * right.shape[1]))
    total: Array = left[:rows].T @ right[:rows]
    for start in range(rows, len(left), rows):
        total += left[start : start + rows].T @ right[start : start + rows]
    return total


def _damped(H: Array, damping: float | Array) -> Array:
    """H with its diagonal multiplied by 1 + damping."""
    out = H.copy()
    index = np.arange(H.shape[-1])
    out[..., index, index] *= 1 + damping
    return out


def _fill_unobserved(H_local: Array) -> None:
    """Give local blocks that no view of their collection depends on a unit Hessian: their step is zero."""
    index = np.arange(H_local.shape[-1])
    diagonal = H_local[:, index, index]
    H_local[:, index, index] = np.where(diagonal == 0.0, 1.0, diagonal)
