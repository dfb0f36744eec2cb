"""Noise of measured positions along the line of sight, relative to that across it, as their residuals tell."""

from dataclasses import replace
from typing import TypeGuard

import numpy as np

from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.pose_residuals import PoseTerm
from calibration.engine.estimation.residuals.views import Term
from calibration.engine.estimation.solve.noise_levels import MIN_SIGMA_OF_KIND, standard_deviation

ISOTROPIC_VIEWS = 10
"""Views with the same noise in all directions as which it is expected to be so: few views cannot tell."""
MIN_DIFFERENCE = 2.5
"""Difference of the logarithms of both variances, in its standard deviations, from which they differ."""


def with_noise_along_sight(problem: Problem, values: Values, robust: bool) -> Problem:
    """Return the problem with the noise of measured positions along the line of sight as their residuals tell.

    Args:
        problem: the problem; it is returned as it is if it has no measured poses, or both seem to be the same.
        values: at or near its optimum.
        robust: whether outliers are rejected.
    """
    squares = [
        term.along_and_across(problem.poses(group, values))
        for group in problem.groups
        for term in group.terms
        if _is_position(term)
    ]
    if not squares:
        return problem
    along, across = (np.concatenate(each) for each in zip(*squares, strict=True))
    one, two = (standard_deviation(each, size, 0.0, robust) ** 2 for each, size in ((along, 1), (across, 2)))
    count, least = len(along), MIN_SIGMA_OF_KIND["pose_translation"] ** 2
    one, two = max(one, least), max(two, least)
    if abs(np.log(one / two)) < MIN_DIFFERENCE * np.sqrt(3 / count):  # 2 / n of the one, 2 / 2n of the other
        return problem
    expected = ISOTROPIC_VIEWS * (one + 2 * two) / 3
    ratio = float(np.sqrt((count * one + expected) / (count * two + expected)))
    groups = [
        replace(group, terms=tuple(replace(t, along=ratio) if _is_position(t) else t for t in group.terms))
        for group in problem.groups
    ]
    return replace(problem, groups=tuple(groups))


def _is_position(term: Term) -> TypeGuard[PoseTerm]:
    return isinstance(term, PoseTerm) and term.kind == "pose_translation"
