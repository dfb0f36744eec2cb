"""Optimisation from an initial guess: noise levels that match the residuals, correction of flipped patterns."""

from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np

from calibration.dataset.modalities import NoiseKind
from calibration.estimation.blocks import Values
from calibration.estimation.least_squares import Evaluation, Optimum, choose, minimise, settle
from calibration.estimation.median import median
from calibration.estimation.noise_levels import FLOORS, NoiseLevels, estimate_scales, scales_of
from calibration.estimation.normal_equations import NormalEquations, Weighting
from calibration.estimation.observability import determined_parameters
from calibration.estimation.planar_pose import mirrored_poses
from calibration.estimation.problem import Problem
from calibration.estimation.residuals import CornerTerm
from calibration.estimation.views import ViewGroup
from calibration.frozen import frozen
from calibration.geometry.transforms import inverse
from calibration.geometry.types import Array, BoolArray

HUBER = 2.5
"""Threshold of Huber's loss in standard deviations: 4 % of good corners exceed it, which costs about
1 % of accuracy, and the influence of outliers is limited to that at the threshold."""
SETTLED = 1e-8
"""Relative change of the standard deviations below which the weights have converged."""
NEARLY_SETTLED = 1e-3
"""Relative change at which the parameters that each kind of label determines are counted."""
ROUNDS = 30
"""After so many estimates with nearly settled weights they stay as they are: they go round in circles."""
FEW = 100
"""From so many collections the first standard deviations are estimated."""


@frozen(eq=False)
class WeightedOptimum:
    """Optimum, with its weights."""

    optimum: Optimum
    weighting: Weighting
    parameters: Mapping[NoiseKind, float]
    """Number of parameters that each kind of label has determined."""


def optimise(problem: Problem, values: Values, levels: NoiseLevels, robust: bool) -> WeightedOptimum:
    """Minimise, and estimate the noise from the residuals on the way, until neither changes.

    With plain least squares, one kind of label and nothing known beforehand the weights don't matter and one round
    is enough.
    """
    huber = HUBER if robust else None
    kinds = {term.kind for group in problem.groups for term in group.terms}
    given = {kind: level for kind, level in levels.given().items() if kind in kinds}
    if len(kinds) == 1 and not robust and not problem.has_priors:
        return _plain(problem, values, {**dict.fromkeys(kinds, 1.0), **given}, estimate=not given)
    some = np.zeros(problem.collections, bool)
    some[:: max(1, problem.collections // FEW)] = True
    weighting = Weighting({**estimate_scales(problem.seen_in(some), values, {}, robust=True), **given}, huber)
    noise = _Noise(problem, given, robust) if kinds - given.keys() else None
    optimum = minimise(problem, values, weighting, reweigh=noise)
    parameters = noise.parameters if noise else None
    if not parameters:
        parameters = determined_parameters(problem, optimum.values, optimum.equations, optimum.weighting)
    return WeightedOptimum(optimum, optimum.weighting, parameters)


class _Noise:
    """Standard deviations of labels, estimated at each step of a minimisation from its residuals."""

    def __init__(self, problem: Problem, given: Mapping[NoiseKind, float], robust: bool) -> None:
        """Begin without knowing how many parameters labels determine.

        Args:
            problem: the problem.
            given: standard deviations that are not estimated.
            robust: whether outliers are to be kept out.
        """
        self._problem, self._given, self._robust = problem, given, robust
        self.parameters: Mapping[NoiseKind, float] = {}
        """Number that each kind of label determines; empty until the weights have nearly converged."""
        self._counted_at: Mapping[NoiseKind, float] = {}
        """Standard deviations at which the parameters were counted."""
        self._rounds = 0

    def __call__(self, now: Evaluation) -> Weighting:
        """Return the weighting for the residuals of an evaluation; the evaluation's own if it is unchanged."""
        scales, estimated = now.weighting.scales, self._estimated(now)
        self._rounds += _change(scales, estimated) < NEARLY_SETTLED
        if _change(scales, estimated) < NEARLY_SETTLED and _change(self._counted_at, scales) > NEARLY_SETTLED:
            self.parameters = determined_parameters(self._problem, now.values, now.equations, now.weighting)
            self._counted_at, estimated = scales, self._estimated(now)
        if self._rounds > ROUNDS or _change(scales, estimated) < SETTLED:
            return now.weighting
        return Weighting(estimated, now.weighting.huber)

    def _estimated(self, now: Evaluation) -> dict[NoiseKind, float]:
        return {**scales_of(self._problem, now.squares, self.parameters, self._robust), **self._given}


def _change(before: Mapping[NoiseKind, float], after: Mapping[NoiseKind, float]) -> float:
    """Return the largest relative change of standard deviations; infinite if there were none before."""
    return max((abs(after[kind] / before[kind] - 1) if kind in before else np.inf for kind in after), default=0.0)


def _plain(problem: Problem, values: Values, scales: dict[NoiseKind, float], estimate: bool) -> WeightedOptimum:
    """Plain least squares with one kind of label: its standard deviation scales the result afterwards."""
    weighting = Weighting(scales, None)
    optimum = minimise(problem, values, weighting)
    parameters = determined_parameters(problem, optimum.values, optimum.equations, weighting)
    if estimate and np.isfinite(optimum.cost):
        (kind,) = scales
        freedom = max(1.0, problem.residuals - parameters[kind])
        estimated = max(FLOORS[kind], scales[kind] * float(np.sqrt(optimum.cost / freedom)))
        weighting = Weighting({kind: estimated}, None)
        equations = _rescaled(optimum.equations, scales[kind] / estimated)
        optimum = replace(optimum, equations=equations, weighting=weighting)
    return WeightedOptimum(optimum, weighting, parameters)


def _rescaled(equations: NormalEquations, factor: float) -> NormalEquations:
    """Return the equations of residuals multiplied by ``factor``, without a pass over the labels."""
    numbers = (getattr(equations, each.name) for each in fields(equations))
    return NormalEquations(*(each * (factor * factor) for each in numbers))


SUSPICIOUS = 1.5
"""Collections whose cost per residual exceeds this multiple of the median are tried with the pattern flipped."""
AMBIGUOUS = 4.0
"""So are collections whose labels, for every camera, would have residuals below this on average (squared, in
standard deviations) if the pattern were mirrored for that camera: few and distant ones."""
BETTER = 0.1
"""Minimum decrease of its collection's cost by a flipped pose (and 1 %): less is rounding error."""


def unflipped(problem: Problem, values: Values, weighting: Weighting, cost: Array) -> tuple[Values, BoolArray]:
    """Correct moving patterns, or bases, that are in the mirrored pose, with the shared blocks fixed.

    A planar pattern has nearly the same image in two poses; a solver that starts near the wrong one
    stays there, and distorts the other collections. So collections that fit badly, or in which both poses
    are possible, are solved again from the mirrored pose of their pattern in each camera, by the block that
    moves in its chain.

    Args:
        problem: the problem.
        values: an optimum.
        weighting: its weights.
        cost: (N,), the cost of each collection there.

    Returns:
        The values with the better poses, and a mask (N,) of the collections that had been flipped.
    """
    expected = np.zeros(problem.collections)
    for group in problem.groups:
        for term in group.terms:
            np.add.at(expected, group.collections, term.counts * term.dimension)
    ratio = cost / np.maximum(expected, 1)
    suspicious = ratio > SUSPICIOUS * median(ratio[expected > 0])
    suspicious |= _ambiguous(problem, values, weighting)
    flipped = np.zeros(problem.collections, bool)
    if not problem.local or not suspicious.any():
        return values, flipped
    part = problem.seen_in(suspicious)
    for group in part.groups:
        if isinstance(group.terms[0], CornerTerm):
            mirrored = _mirrored(problem, group, values)
            if mirrored is not None:
                settled, settled_cost = settle(part, mirrored, weighting, suspicious)
                better = suspicious & (settled_cost < 0.99 * cost - BETTER)
                values = choose(problem, better, settled, values)
                cost = np.where(better, settled_cost, cost)
                flipped |= better
    return values, flipped


def _ambiguous(problem: Problem, values: Values, weighting: Weighting) -> BoolArray:
    """Return a mask (N,) of collections where every camera sees nearly the same if the pattern is mirrored for it."""
    worst = np.zeros(problem.collections)
    seen = np.zeros(problem.collections, bool)
    for group in problem.groups:
        term = problem.terms(group, values)[0]
        mirrored = _mirrored(problem, group, values) if isinstance(term, CornerTerm) else None
        if mirrored is not None:
            magnitudes = term.magnitudes(problem.poses(group, mirrored)) / weighting.scales[term.kind]
            cost = np.nansum(magnitudes**2, -1) / (term.counts * term.dimension)
            worst[group.collections] = np.maximum(worst[group.collections], cost)
            seen[group.collections] = True
    ambiguous: BoolArray = seen & (worst < AMBIGUOUS)
    return ambiguous


def _mirrored(problem: Problem, group: ViewGroup, values: Values) -> Values | None:
    """Set the moving block in a group's chain such that the pattern is mirrored in each of its views."""
    moving = [k for k, link in enumerate(group.chain.links) if link.block in problem.local]
    if len(moving) != 1:
        return None
    (k,) = moving
    links = group.chain.links
    mirrored = mirrored_poses(problem.poses(group, values), np.zeros(3))
    parts = (group.chain.part(-1, k), group.chain.part(k, len(links)))
    before, after = (part.poses(problem.transforms(values), group.collections) for part in parts)
    moved = inverse(before) @ mirrored @ inverse(after)
    poses = values[links[k].block].copy()
    poses[group.collections] = inverse(moved) if links[k].inverted else moved
    return tuple(poses if i == links[k].block else value for i, value in enumerate(values))
