"""Observability of the unknowns: their covariance, and the directions that the data do not determine.

Also the choice of the collections that determine a calibration best: poses of a motion, or moments of a recording, by
greedy A-optimal design. The next one minimises the sum of the calibrated parameters' variances, the trace of their
covariance (F. Pukelsheim, "Optimal design of experiments", 1993).
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.least_squares.normal_equations import NormalEquations, Weighting, linearise
from calibration.engine.estimation.problem.blocks import PARAMETERS_IN_PIXELS, Motion, Values, root_mean_square
from calibration.engine.estimation.problem.problem import Problem, table_of
from calibration.engine.geometry.lenses import Distortion

MIN_RELATIVE_INFORMATION = 1e-12
"""Information in one direction relative to the largest, below which it is rounding error."""
MIN_UNDETERMINED_SIGMA = 0.25
"""Standard deviation (in sizes of the pattern, and in rad) above which a direction is not determined."""
MIN_NAMED_MOTION = 0.3
"""Blocks and parameters of joints that move by more than this fraction of the largest motion are named too,"""
MIN_NAMED_MOTION_IF_UNDETERMINED = 0.02
"""and by more than this in a direction that is not determined: a joint rotates little if a distant pattern moves."""
MIN_WEAK_SIGMA = 0.005
"""Standard deviation (m or rad) above which a direction is reported as weak."""


@dataclass(frozen=True, eq=False)
class WeakDirection:
    """Common motion of the shared blocks that the data hardly determine."""

    block: int
    """Block with the largest motion."""
    kind: str
    """"translation", "rotation", or "ray" of a camera's intrinsics."""
    axis: Array
    """(3,): unit axis, in the block's child frame."""
    sigma: float
    """Standard deviation of that motion, m or rad; infinite if nothing determines it. Of intrinsics the rotation of
    rays: those of the labels if it is not determined, those all over the image if it is weak."""
    others: tuple[int, ...]
    """Other blocks that move, largest motion first."""
    parameters: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    """Of each joint or camera among the blocks, the parameters that change; largest change first."""

    def describe(self, names: Sequence[str]) -> str:
        """Describe transform and axis, or joint or intrinsics and parameters, in one phrase."""
        unit = {"translation": "mm", "rotation": "mrad", "ray": "mrad of a ray"}[self.kind]
        size = f"{1e3 * self.sigma:.3g} {unit}" if np.isfinite(self.sigma) else "without bound"
        along = (
            f" together with {_list_names([self._name_of_block(other, names) for other in self.others])}"
            if self.others
            else ""
        )
        if self.block in self.parameters:
            return f"{self._name_of_block(self.block, names)}{along}: {size}"
        x, y, z = np.round(self.axis, 2) + 0.0
        what = "moving along" if self.kind == "translation" else "turning about"
        return f"'{names[self.block]}' {what} ({x:g}, {y:g}, {z:g}) of its frame{along}: {size}"

    def to_hold(self, names: Sequence[str]) -> str:
        """Return the name of the joint's or camera's parameter that changes least, to be fixed; empty without one."""
        return next((f"{names[block]}-{each[-1]}" for block, each in self.parameters.items() if each), "")

    def coefficients_to_hold(self, lens: Distortion) -> tuple[str, ...]:
        """Distortion coefficients that can be fixed to determine the direction; empty if it does not depend on them.

        Args:
            lens: the camera's, if the block with the largest motion is one.
        """
        moving = self.parameters.get(self.block, ())
        if not moving or self.kind != "ray" or moving[0] in PARAMETERS_IN_PIXELS:
            return ()
        groups = (tuple(name for name in group if name in moving) for group in lens.held_first)
        return next(filter(None, groups), ())

    def _name_of_block(self, block: int, names: Sequence[str]) -> str:
        parameters = self.parameters.get(block)
        return f"'{names[block]}' ({', '.join(parameters)})" if parameters else f"'{names[block]}'"


def open_directions(
    problem: Problem, equations: NormalEquations, size: float
) -> tuple[list[WeakDirection], list[WeakDirection]]:
    """Find the directions that are not determined, and those that are weak.

    They are eigenvectors of the information on the shared blocks (the Schur complement), with
    translations in sizes of the pattern and intrinsics by the rotation of the labels' rays, so
    that they are comparable to radians.

    Args:
        problem: the problem.
        equations: the normal equations at the optimum, in standard deviations.
        size: the pattern's (see `calibration.engine.dataset.pattern.Pattern.size`), m.
    """
    S = equations.schur
    parts = [(i, motion) for i in problem.shared for motion in problem.blocks[i].parameters.motions(size)]
    largest = max(motion.extent for _, motion in parts)
    unit = problem.units(size)
    information, directions = np.linalg.eigh(unit[:, None] * S * unit)
    undetermined, weak = [], []
    for value, direction in zip(information, directions.T, strict=True):
        singular = value <= MIN_RELATIVE_INFORMATION * information[-1]
        sigma = np.inf if singular else 1 / np.sqrt(value)
        hopeless = singular or sigma > MIN_UNDETERMINED_SIGMA
        if not hopeless and sigma * largest <= MIN_WEAK_SIGMA:
            continue
        named = _name_direction(
            parts, direction, sigma, MIN_NAMED_MOTION_IF_UNDETERMINED if hopeless else MIN_NAMED_MOTION
        )
        if hopeless:
            undetermined.append(named)
        elif named.sigma > MIN_WEAK_SIGMA and named.kind != "ray":
            weak.append(named)
    return undetermined, weak if undetermined else weak + _weak_intrinsics(problem, equations)


def _weak_intrinsics(problem: Problem, equations: NormalEquations) -> list[WeakDirection]:
    """Find the cameras whose intrinsics do not determine rays somewhere in the image, with the main parameters.

    At the labels, parameters may be degenerate with each other; where the image has no labels they are not.
    """
    weak = []
    if not any(problem.blocks[block].intrinsics for block in problem.shared):
        return []
    covariance = covariances(problem, equations)
    for block in problem.shared:
        if (intrinsics := problem.blocks[block].intrinsics) is not None:
            bends, C = intrinsics.bends, covariance[block]
            sigma = float(np.sqrt(np.einsum("ian,ij,jan->", bends, C, bends) / bends.shape[-1]))
            own = root_mean_square(bends) * np.sqrt(np.diagonal(C))
            most = [
                intrinsics.free[k] for k in np.argsort(-own, kind="stable") if own[k] > MIN_NAMED_MOTION * own.max()
            ]
            if sigma > MIN_WEAK_SIGMA:
                weak.append(WeakDirection(block, "ray", np.zeros(3), sigma, (), {block: tuple(most)}))
    return weak


def _name_direction(
    parts: list[tuple[int, Motion]], direction: Array, sigma: float, moving_from: float
) -> WeakDirection:
    """Name one direction (S,), in units of the motions of blocks, by the block and the axis with the largest motion.

    Others are named from ``moving_from`` times that motion.
    """
    pieces = np.split(direction, np.cumsum([motion.length for _, motion in parts])[:-1])
    length = np.array([np.linalg.norm(piece) for piece in pieces])
    block, most = parts[k := int(length.argmax())]
    axis = np.zeros(3)
    axis[: most.length] = pieces[k] / length[k]
    axis = axis * np.sign(axis[np.abs(axis).argmax()])
    moving = [parts[m] for m in np.argsort(-length, kind="stable") if length[m] > moving_from * length[k]]
    blocks = dict.fromkeys(b for b, _ in moving)
    parameters = {b: tuple(motion.parameter for own, motion in moving if own == b) for b in blocks}
    return WeakDirection(
        block=block,
        kind=most.kind,
        axis=axis,
        sigma=float(sigma * length[k] * most.extent),
        others=tuple(other for other in blocks if other != block),
        parameters={b: each for b, each in parameters.items() if each[0]},
    )


def _list_names(names: Sequence[str]) -> str:
    """Format the first three names, and the number of others."""
    more = [f"{len(names) - 3} more"] if len(names) > 3 else []
    return " and ".join([*names[:3], *more])


def covariances(problem: Problem, equations: NormalEquations) -> dict[int, Array]:
    """Return the covariance of each shared block.

    (6, 6) of its twist (translation, rotation), m and rad, or (k, k) of the free parameters of a joint or a
    camera. The inverse of the Schur complement; fixed blocks have none. By Cramer and Rao no unbiased
    estimate can be better than this.

    Args:
        problem: the problem.
        equations: the normal equations at the optimum, in standard deviations.
    """
    inverse = np.linalg.inv(equations.schur)
    blocks = {}
    for block, part in problem.shared_parameters.items():
        blocks[block] = 0.5 * (inverse[part, part] + inverse[part, part].T)
    return blocks


def determined_parameters(
    problem: Problem, values: Values, equations: NormalEquations, weighting: Weighting
) -> Mapping[NoiseKind, float]:
    """Return the number of parameters that the labels of each kind have determined; they sum to all parameters.

    A kind's share is ``trace(M C)`` over its views, with M the information of its labels on the view's
    pose and C that pose's covariance (W. Foerstner's redundancy numbers, 1979). The kind with most labels has what the
    others leave.
    """
    labels: Counter[NoiseKind] = Counter()
    for group in problem.groups:
        for term in group.terms:
            labels[term.kind] += int(term.counts.sum())
    most, *others = (kind for kind, _ in labels.most_common())
    observed = sum(np.count_nonzero(problem.collections_with(block)) for block in problem.local)
    total = problem.sizes[0] + 6.0 * observed - _known_beforehand(problem, values, equations)
    shares = _parameters_by_kind(problem, values, equations, weighting, others) if others else {}
    return {most: total - sum(shares.values()), **shares}


def _parameters_by_kind(
    problem: Problem,
    values: Values,
    equations: NormalEquations,
    weighting: Weighting,
    kinds: Sequence[NoiseKind],
) -> dict[NoiseKind, float]:
    """Return the number of parameters that some kinds of labels have determined."""
    shares = dict.fromkeys(kinds, 0.0)
    schur_inverse, local_inverse = np.linalg.inv(equations.schur), np.linalg.inv(equations.H_local)
    gain = np.linalg.solve(equations.H_local, np.swapaxes(equations.H_mixed, 1, 2))  # (N, P, S)
    table = table_of(problem.blocks, values)
    for batch in problem.batches:
        terms = [term for term in problem.terms(batch, values) if term.kind in shares]
        if not terms:
            continue
        T, A = batch.linearise(table, values)
        J_shared, J_local = batch.spread(A, problem.sizes, problem.intrinsics_at(batch))
        J = J_shared - J_local @ gain[batch.collections]
        C = J @ schur_inverse @ np.swapaxes(J, 1, 2)
        C += J_local @ local_inverse[batch.collections] @ np.swapaxes(J_local, 1, 2)
        for term in terms:
            _, M, _ = term.linearise(T, weighting.scales[term.kind], weighting.huber)
            shares[term.kind] += float((M * C).sum())  # both are symmetric
    return shares


def _known_beforehand(problem: Problem, values: Values, equations: NormalEquations) -> float:
    """Return the number of shared parameters determined by the priors: the trace of their share of the information."""
    if not problem.has_priors:
        return 0.0
    covariance = np.linalg.inv(equations.schur)
    known = 0.0
    for block, at in problem.shared_parameters.items():
        if (intrinsics := problem.blocks[block].intrinsics) is not None:
            _, _, information = intrinsics.pull(values[block])
            known += float(np.einsum("ij,ji->", information, covariance[at, at]))
    return known


PRIOR_SIGMA = 0.1
"""Prior standard deviation before the first pose, so that there is a covariance from the start;
in rad and in the unit of length.
"""
_DIGITS_OF_SCORE = 6  # of a score: smaller differences are rounding errors, and the first of equal ones is taken


def choose(
    information: Array, parameters: int, partial: Array, share: float, cells: BoolArray, count: int
) -> list[int]:
    """Return the indices of the best poses, in order of choice, at most ``count``.

    The next pose is the best among those with partial views or those without, as the share of partial
    views so far requires; and among those that show the pattern in new places, while there are any.

    Args:
        information: (N, D, D), information of each pose on D parameters, in comparable units.
        parameters: number of the D that are calibrated; the others, after them, are marginalised.
        partial: (N,), the share of each pose's views that are partial.
        share: the required share of all.
        cells: (N, C), mask of the places in which each pose shows the pattern.
        count: number of poses.
    """
    chosen: list[int] = []
    in_part = partial > 0
    left = np.ones(len(information), bool)
    shown = np.zeros(cells.shape[1], bool)
    known = np.eye(information.shape[-1]) / PRIOR_SIGMA**2
    while len(chosen) < count and left.any():
        wanted_in_part = bool(partial[chosen].sum() < share * len(chosen))
        pool = _narrow_pool(left, in_part == wanted_in_part)
        pool = _narrow_pool(pool, np.any(cells & ~shown, axis=-1))
        index = np.flatnonzero(pool)
        best = int(index[_sum_of_variances(known + information[index], parameters).argmin()])
        chosen.append(best)
        left[best] = False
        shown |= cells[best]
        known = known + information[best]
    return chosen


def _narrow_pool(pool: BoolArray, wish: BoolArray) -> BoolArray:
    """Restrict a pool (N,) to those that fulfil a wish (N,); unchanged if none does."""
    some: BoolArray = pool & wish
    return some if some.any() else pool


def _sum_of_variances(information: Array, parameters: int) -> Array:
    """Return the sum of the variances (N,) of the first parameters, rounded so that machines agree."""
    variance = np.linalg.inv(information).diagonal(axis1=1, axis2=2)[:, :parameters].sum(-1)
    unit = 10.0 ** (np.floor(np.log10(variance)) + 1 - _DIGITS_OF_SCORE)
    return np.asarray(np.round(variance / unit) * unit)


def informations(problem: Problem, values: Values, weighting: Weighting) -> Array:
    """Return the information (N, S, S) of each collection on the S shared parameters, with its local ones eliminated.

    Their sum is `calibration.engine.estimation.least_squares.normal_equations.NormalEquations.schur`.
    """
    S, P = problem.sizes
    H = np.zeros((problem.collections, S + P, S + P))
    table = table_of(problem.blocks, values)
    for batch in problem.batches:
        T, A = batch.linearise(table, values)
        _, M, _ = linearise(batch.terms, T, weighting)
        J = np.concatenate(batch.spread(A, problem.sizes, problem.intrinsics_at(batch)), -1)
        np.add.at(H, batch.collections, np.swapaxes(J, 1, 2) @ M @ J)
    H_local, H_mixed = H[:, S:, S:], H[:, :S, S:]
    index = np.arange(H_local.shape[-1])
    H_local[:, index, index] += H_local[:, index, index] == 0  # no view depends on it, so it has no effect
    reduced: Array = H[:, :S, :S] - H_mixed @ np.linalg.solve(H_local, np.swapaxes(H_mixed, 1, 2))
    return 0.5 * (reduced + np.swapaxes(reduced, 1, 2))
