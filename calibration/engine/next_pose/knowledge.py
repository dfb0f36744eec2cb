"""Information of a calibration on its parameters, what further views add to it, and the variances that follow.

Information is additive. Of the F calibrated parameters and the H held ones, known to ``s`` each, a calibration has the
matrix ``T`` (`covariance.linear_model`), and the views of a further pose add ``G_c``, with the pattern's own pose
eliminated. With the parts ``A`` (F, F) and ``B`` (F, H) of their sum, and a quantity ``R x`` of all parameters x::

    variance = tr(R_F A^-1 (1 + D) R_F^T) + |(R_H - R_F A^-1 B) diag(s)|^2

where D is by how much the recording's collections disagree beyond the noise of their labels: further ones are expected
to disagree as much. This is what `covariance.error_bars` states once the poses are taken.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.covariance.fixed_inputs import LAG_KIND, Cause
from calibration.engine.estimation.covariance.linear_model import information_of_each
from calibration.engine.estimation.covariance.result import Calibration, Solution
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.start.build import groups_of_views
from calibration.engine.geometry.transforms import translation

NEXT_TO_NOTHING = 1e-9
"""Information before anything is recorded, in that of all views that are looked at."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Information on F calibrated and H held parameters."""

    solution: Solution
    causes: tuple[Cause, ...]
    """Calibrated ones, then those that are held with an assumed error: their parameters follow the shared ones."""
    columns: IntArray
    """(F + H,): the parameters' columns of the linear model."""
    information: Array
    """(F + H, F + H)."""
    calibrated: int
    """F."""
    disagreement: Array
    """(F,): D, on the diagonal."""

    @cached_property
    def held_sigmas(self) -> Array:
        """(H,): standard deviations of the held parameters."""
        assumed = [sigma for cause in self.causes if not cause.free for sigma in cause.assumed]
        return np.array(assumed, float)

    def with_views(self, information: Array) -> "Knowledge":
        """Return what is known with further views, by their information (F + H, F + H)."""
        return replace(self, information=self.information + information)

    def views(self, poses: Dataset) -> Array:
        """Return the information (M, F + H, F + H) of each collection of a dataset of further views.

        Args:
            poses: the sensors and patterns of the calibrated dataset, and its transforms where nothing moves.
        """
        return information_of_further_views(self.solution, poses, self.causes)

    def variances(self, rows: Array, more: Array | None = None) -> Array:
        """Return the variances (M, r) of quantities, by their derivatives (r, F + H).

        Args:
            rows: the derivatives.
            more: information (M, F + H, F + H) that is added, each alone; None for one of nothing.
        """
        return np.asarray(self._parts(rows, more)[0])

    def held_parts(self, rows: Array, more: Array | None = None) -> Mapping[str, Array]:
        """Return by held cause its part (M, r) of the variances."""
        squares, parts, start = self._parts(rows, more)[1], {}, 0
        for cause in self.causes:
            if not cause.free:
                parts[cause.name] = squares[:, :, start : start + cause.size].sum(-1)
                start += cause.size
        return parts

    def _parts(self, rows: Array, more: Array | None) -> tuple[Array, Array]:
        """Return the variances (M, r), and the parts (M, r, H) of each held parameter in them."""
        F = self.calibrated
        T = self.information[None] if more is None else self.information + more
        own, held = rows[:, :F], rows[:, F:]
        weights = np.stack([np.ones(F), np.sqrt(self.disagreement)])[: 1 + bool(self.disagreement.any())]
        sides = (weights[:, None] * own).reshape(-1, F).T
        solved = np.linalg.solve(T[:, :F, :F], np.broadcast_to(sides, (len(T), *sides.shape)))
        by_labels = (solved * sides).sum(1).reshape(len(T), -1, len(rows)).sum(1)
        moved = held - np.swapaxes(solved[:, :, : len(rows)], 1, 2) @ T[:, :F, F:]
        squares = (moved * self.held_sigmas) ** 2
        return by_labels + squares.sum(-1), squares


def knowledge_of(calibration: Calibration) -> Knowledge:
    """Return what a calibration that has converged knows.

    Args:
        calibration: the calibration.
    """
    solution, bars = calibration.solution, calibration.error_bars
    if bars is None:
        raise AssertionError("it has converged")
    found = _of_model(solution)
    disagreement = np.zeros(found.calibrated)
    for block, at in solution.setup.problem.shared_parameters.items():
        beyond = np.trace(np.linalg.solve(bars.labels[block], bars.total[block] - bars.expected[block]))
        disagreement[at] = max(0.0, float(beyond) / len(bars.labels[block]))
    return replace(found, disagreement=disagreement)


def knowledge_before(solution: Solution) -> Knowledge:
    """Return what is known before anything is recorded: next to nothing.

    Args:
        solution: any views of the sensors that are planned, at the nominal poses.
    """
    found = _of_model(solution)
    prior = solution.model.prior[found.columns[:, None], found.columns]
    return replace(found, information=prior + np.diag(NEXT_TO_NOTHING * solution.model.alone[found.columns]))


def _of_model(solution: Solution) -> Knowledge:
    """Return what a solution's views tell; they are taken to agree."""
    model = solution.model
    placed = model.placed()
    kept = [each for each in placed if each[0].free] + [
        (cause, at) for cause, at in placed if cause.counts and not cause.free and any(cause.assumed)
    ]
    columns = np.concatenate([np.arange(model.shared), *(np.arange(at.start, at.stop) for _, at in kept)])
    calibrated = model.shared + sum(cause.size for cause, _ in kept if cause.free)
    return Knowledge(
        solution,
        tuple(cause for cause, _ in kept),
        columns,
        model.total[columns[:, None], columns],
        calibrated,
        np.zeros(calibrated),
    )


def information_of_further_views(solution: Solution, poses: Dataset, causes: tuple[Cause, ...]) -> Array:
    """Return the information (M, C, C) of each collection of further views on the shared parameters and some causes.

    What is linearised at is the optimum; of patterns and transforms that differ between collections, what the dataset
    of the views has. Frames of a robot that stands still tell nothing about a lag.
    """
    setup = solution.setup
    blocks, kinds = setup.problem.blocks, solution.weighting.scales
    groups = [
        replace(group, terms=terms)
        for group in groups_of_views(poses, blocks)
        if (terms := tuple(term for term in group.terms if term.kind in kinds))
    ]
    problem = Problem(blocks, tuple(groups), len(poses.collections))
    size = problem.sizes[0] + sum(cause.size for cause in causes)
    if not groups:
        return np.zeros((problem.collections, size, size))
    still = [replace(cause, effect=_no_effect) if cause.kind == LAG_KIND else cause for cause in causes]
    nothing = Cause("nothing", "", "1", (0.0,), _no_effect)
    weighting = Weighting(kinds, None)  # no label is an outlier yet
    found = information_of_each(problem, _values_at(solution, poses), weighting, poses, still or [nothing])
    return found[:, :size, :size]


def _no_effect(_: object) -> None:
    return None


def _values_at(solution: Solution, poses: Dataset) -> Values:
    """Return the optimum, with the poses (M, 4, 4) of what differs between collections."""
    centres = {pattern.edge: translation(pattern.centre) for pattern in poses.patterns.values()}
    values = []
    for block, value in zip(solution.setup.problem.blocks, solution.values, strict=True):
        if block.per_collection and block.edge is not None:
            value = poses.transforms[block.edge] @ centres.get(block.edge, np.eye(4))
        values.append(value)
    return tuple(values)
