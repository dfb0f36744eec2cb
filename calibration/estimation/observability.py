"""What the data say about the unknowns: their covariance, and the directions that they leave open."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration.estimation.normal_equations import NormalEquations, Weighting
from calibration.estimation.problem import NoiseKind, Problem, Values
from calibration.geometry.types import Array, IntArray

SINGULAR = 1e-12
"""Information in one direction relative to the best one, below which rounding has made it."""
HOPELESS = 0.25
"""A direction with a greater standard deviation than this (in sizes of the pattern, and in rad) is not determined."""
WEAK = 0.005
"""A direction with a greater standard deviation (m or rad) is reported as weak."""


@dataclass(frozen=True, eq=False)
class WeakDirection:
    """A common motion of the shared blocks that the data hardly determine."""

    block: int
    """The block that moves most."""
    kind: str
    """"translation" or "rotation"."""
    axis: Array
    """(3,): the unit axis, in the block's child frame."""
    sigma: float
    """The standard deviation of that motion, m or rad; infinite where nothing determines it."""
    others: tuple[int, ...]
    """Blocks that move along."""

    def describe(self, names: list[str]) -> str:
        """One phrase that names transform and axis."""
        x, y, z = np.round(self.axis, 2) + 0.0
        what = "moving along" if self.kind == "translation" else "turning about"
        unit = "mm" if self.kind == "translation" else "mrad"
        along = f" together with '{names[self.others[0]]}'" if self.others else ""
        size = f"{1e3 * self.sigma:.3g} {unit}" if np.isfinite(self.sigma) else "without bound"
        return f"'{names[self.block]}' {what} ({x:g}, {y:g}, {z:g}) of its frame{along}: {size}"


def open_directions(
    problem: Problem, equations: NormalEquations, size: float
) -> tuple[list[WeakDirection], list[WeakDirection]]:
    """The directions that are not determined, and those that are weak.

    The information on the shared blocks (the Schur complement) is taken apart into its principal
    directions, translations measured in sizes of the pattern so that they compare with radians.

    Args:
        problem: the problem.
        equations: the normal equations at the optimum, in standard deviations.
        size: the pattern's (see `calibration.dataset.pattern.Pattern.size`), m.
    """
    S = equations.schur
    unit = np.tile(np.repeat([size, 1.0], 3), len(problem.shared))
    information, directions = np.linalg.eigh(unit[:, None] * S * unit)
    undetermined, weak = [], []
    for value, direction in zip(information, directions.T, strict=True):
        singular = value <= SINGULAR * information[-1]
        sigma = np.inf if singular else 1 / np.sqrt(value)
        named = _named(problem, direction, unit, sigma)
        if singular or sigma > HOPELESS:
            undetermined.append(named)
        elif named.sigma > WEAK:
            weak.append(named)
    return undetermined, weak


def _named(problem: Problem, direction: Array, unit: Array, sigma: float) -> WeakDirection:
    """Name one direction (6S,), scaled by ``unit``, by the block and the axis that move most."""
    parts = direction.reshape(-1, 2, 3)  # shared block, translation or rotation, axis
    length = np.linalg.norm(parts, axis=-1)
    k, i = np.unravel_index(int(length.argmax()), length.shape)
    axis = parts[k, i] / length[k, i]
    axis = axis * np.sign(axis[np.abs(axis).argmax()])
    moving = np.flatnonzero(length.max(-1) > 0.3 * length.max())
    return WeakDirection(
        block=problem.shared[int(k)],
        kind="translation" if i == 0 else "rotation",
        axis=axis,
        sigma=float(sigma * length[k, i] * unit.reshape(-1, 2, 3)[k, i, 0]),
        others=tuple(problem.shared[int(m)] for m in moving if m != k),
    )


def covariances(problem: Problem, equations: NormalEquations) -> dict[int, Array]:
    """The covariance (6, 6) of each shared block: of its twist (translation, rotation), m and rad.

    The inverse of the Schur complement; held blocks have none. By Cramer and Rao no unbiased
    estimate can be better than this.
    """
    inverse = np.linalg.inv(equations.schur)
    blocks = {}
    for k, block in enumerate(problem.shared):
        part = slice(6 * k, 6 * k + 6)
        blocks[block] = 0.5 * (inverse[part, part] + inverse[part, part].T)
    return blocks


def determined_parameters(
    problem: Problem, values: Values, equations: NormalEquations, weighting: Weighting
) -> Mapping[NoiseKind, float]:
    """How many of the parameters the labels of each kind have determined; they sum to all parameters.

    A kind's share is ``trace(M C)`` over its views, with M the information of its labels on the view's
    pose and C that pose's covariance (W. Foerstner's redundancy numbers, 1979).
    """
    kinds = {term.kind for group in problem.groups for term in group.terms}
    if len(kinds) == 1:
        observed = sum(np.count_nonzero(np.bincount(_collections_of(problem, block))) for block in problem.local)
        return {kinds.pop(): 6.0 * (len(problem.shared) + observed)}
    shares = dict.fromkeys(kinds, 0.0)
    pose_covariance = _PoseCovariance(problem, equations)
    for group in problem.groups:
        T, jacobians = group.chain.jacobians(values, slice(None), group.collections, problem.held)
        C = pose_covariance.of(group.collections, jacobians)
        for term in group.terms:
            _, M, _ = term.linearise(T, slice(None), weighting.scales[term.kind], weighting.huber)
            shares[term.kind] += float(np.einsum("vij,vji->", M, C))
    return shares


class _PoseCovariance:
    """The covariance of views' poses from that of the blocks on their chain."""

    def __init__(self, problem: Problem, equations: NormalEquations) -> None:
        self._shared = {block: slice(6 * k, 6 * k + 6) for k, block in enumerate(problem.shared)}
        self._local = {block: slice(6 * k, 6 * k + 6) for k, block in enumerate(problem.local)}
        self._schur_inverse = np.linalg.inv(equations.schur)
        self._gain = np.linalg.solve(equations.H_local, np.swapaxes(equations.H_mixed, 1, 2))  # (N, 6P, 6S)
        self._local_inverse = np.linalg.inv(equations.H_local)

    def of(self, collections: IntArray, jacobians: list[tuple[int, Array]]) -> Array:
        """(v, 6, 6), for a twist in the sensor's frame; jacobians as `Chain.jacobians` gives them."""
        v, S6, P6 = len(collections), len(self._schur_inverse), self._local_inverse.shape[-1]
        J_shared, J_local = np.zeros((v, 6, S6)), np.zeros((v, 6, P6))
        for block, J in jacobians:
            if block in self._local:
                J_local[:, :, self._local[block]] = J
            else:
                J_shared[:, :, self._shared[block]] = J
        J = J_shared - J_local @ self._gain[collections]
        shared: Array = J @ self._schur_inverse @ np.swapaxes(J, 1, 2)
        local: Array = J_local @ self._local_inverse[collections] @ np.swapaxes(J_local, 1, 2)
        return shared + local


def _collections_of(problem: Problem, block: int) -> IntArray:
    """The collections of the views that depend on a block, one after the other."""
    groups = [g for g in problem.groups if any(link.block == block for link in g.chain.links)]
    return np.concatenate([group.collections for group in groups])
