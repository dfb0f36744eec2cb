"""Residual of each label at the optimum, with its position, for checks of their distribution."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.covariance.result import Solution
from calibration.engine.estimation.residuals.residuals import chunks


@dataclass(frozen=True, eq=False)
class LabelErrors:
    """Residuals of one kind, of one sensor and one pattern."""

    sensor: str
    pattern: str
    kind: NoiseKind
    errors: Array
    """(V, d, L): px, m or rad, scaled down by the robust loss's weight; 0 without a label."""
    seen: BoolArray
    """(V, L)."""
    points: Array
    """(V, 3, L): expected positions of the labels, in the sensor's frame, m."""


def label_errors(solution: Solution) -> Iterator[LabelErrors]:
    """Yield the errors of all labels.

    Args:
        solution: at the optimum.
    """
    problem, weighting = solution.setup.problem, solution.weighting
    for group in problem.groups:
        T = problem.poses(group, solution.values)
        for term in problem.terms(group, solution.values):
            scale = weighting.scales[term.kind]
            errors, points = [], []
            for part in chunks(len(T), term.length):
                rows, places = term.rows(T[part], part, scale, weighting.huber)
                errors.append(scale * rows[-1])
                points.append(T[part, :3, :3] @ places + T[part, :3, 3:])
            yield LabelErrors(
                group.sensor,
                group.pattern,
                term.kind,
                np.concatenate(errors),
                np.isfinite(term.magnitudes(T)),
                np.concatenate(points),
            )
