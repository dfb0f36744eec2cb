"""Noise of the labels: the standard deviation of each kind of residual, estimated from the residuals."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeGuard, get_args

import numpy as np

from calibration.base.arrays import Array
from calibration.base.records import field, result
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.estimation.least_squares.normal_equations import Squares
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.pose_residuals import PoseTerm
from calibration.engine.estimation.residuals.views import Term
from calibration.engine.statistics import median

NOISE_KINDS: tuple[NoiseKind, ...] = get_args(NoiseKind)
MIN_SIGMA_OF_KIND: dict[NoiseKind, float] = {kind: 1e-6 if kind == "pixel" else 1e-8 for kind in NOISE_KINDS}
"""Lower limits of the standard deviations (px, m or rad); they limit the weight of exact data."""
MAX_SIGMAS_OF_INLIERS = 3.0
"""Standard deviations within which labels are used for the estimate."""
ISOTROPIC_VIEWS = 10
"""Views with the same noise in all directions as which it is expected to be so: few views cannot tell."""
MIN_SIGMAS_OF_DIFFERENCE = 2.5
"""Difference of the logarithms of both variances, in its standard deviations, from which they differ."""
# For a squared Gaussian residual of 1, 2 or 3 dimensions: its median, and its mean below MAX_SIGMAS_OF_INLIERS^2
# (d P(chi2_{d+2} < c) / P(chi2_d < c), with c = 9), both in squared standard deviations.
_MEDIAN_OF_SQUARES = {1: 0.4549364, 2: 1.3862944, 3: 2.3659739}
_TRUNCATED_MEAN = {1: 0.9733369, 2: 1.8988755, 3: 2.7534587}


@result
class NoiseLevels:
    """Standard deviations of labels; null if the dataset has none of that kind, or (as an option) to estimate it."""

    pixel: float | None = field("Of each image coordinate of a corner.", key="pixel_px", unit="px", default=None)
    range: float | None = field("Of the range of a 3D LiDAR or a depth camera.", key="range_m", unit="m", default=None)
    border: float | None = field(
        "Of the direction in which a LiDAR finds a pattern's border, across it: its step over the root of 12, where "
        "nothing else errs.",
        key="border_rad",
        unit="rad",
        default=None,
    )
    depth_border: float | None = field(
        "The same of a depth camera, whose step is the angle of a pixel.",
        key="depth_border_rad",
        unit="rad",
        default=None,
    )
    lidar2d_range: float | None = field("Of the range of a 2D LiDAR.", key="lidar2d_range_m", unit="m", default=None)
    lidar2d_border: float | None = field(
        "Of the direction in which a 2D LiDAR finds the end of its cut.",
        key="lidar2d_border_rad",
        unit="rad",
        default=None,
    )

    pose_translation: float | None = field(
        "Of each coordinate of where a pattern was measured to be.", key="pose_translation_m", unit="m", default=None
    )
    pose_rotation: float | None = field(
        "Of how it was measured to be turned, about each axis.", key="pose_rotation_rad", unit="rad", default=None
    )

    def given(self) -> dict[NoiseKind, float]:
        """The levels that are set."""
        return {kind: level for kind in NOISE_KINDS if (level := getattr(self, kind)) is not None}


def estimate_scales(
    problem: Problem, values: Values, parameters: Mapping[NoiseKind, float], robust: bool
) -> dict[NoiseKind, float]:
    """Estimate the standard deviation of each kind of label.

    Plain: root of the squared residuals over their degrees of freedom. Robust: the median first, then the
    residuals within three of its standard deviations, corrected for the truncation.

    Args:
        problem: the problem.
        values: values of all blocks.
        parameters: by kind, the number of parameters that its residuals have determined: their degrees of freedom
            are reduced by it.
        robust: whether outliers are rejected.
    """
    squares: Squares = {}
    for group in problem.groups:
        T = problem.poses(group, values)
        for term in problem.terms(group, values):
            squares.setdefault(term.kind, []).append(term.magnitudes(T) ** 2)
    return scales_of(problem, squares, parameters, robust)


def scales_of(
    problem: Problem, squares: Squares, parameters: Mapping[NoiseKind, float], robust: bool
) -> dict[NoiseKind, float]:
    """Estimate the standard deviations as `estimate_scales` does, from the squared residuals of all labels."""
    dimensions = {term.kind: term.dimension for group in problem.groups for term in group.terms}
    return {
        kind: max(
            MIN_SIGMA_OF_KIND[kind],
            standard_deviation(_finite_numbers(parts), dimensions[kind], parameters.get(kind, 0.0), robust),
        )
        for kind, parts in squares.items()
    }


def _finite_numbers(parts: Sequence[Array]) -> Array:
    """Return the finite numbers of some arrays, (n,)."""
    numbers = np.concatenate([part.ravel() for part in parts])
    finite = np.isfinite(numbers)
    return numbers if finite.all() else numbers[finite]


def standard_deviation(squared: Array, dimension: int, parameters: float, robust: bool) -> float:
    """Estimate the standard deviation per axis, from squared residuals (n,) of 1 to 3 dimensions.

    Args:
        squared: the squared residuals.
        dimension: of each residual.
        parameters: number that they have determined.
        robust: whether outliers are rejected.
    """
    if not len(squared):
        return 0.0
    freedom = max(1.0, len(squared) * dimension - parameters) / (len(squared) * dimension)
    if not robust:
        return float(np.sqrt(squared.mean() / dimension / freedom))
    variance = median(squared) / _MEDIAN_OF_SQUARES[dimension] / freedom
    for _ in range(10):
        limit = MAX_SIGMAS_OF_INLIERS**2 * variance * freedom
        inside = int(np.count_nonzero(squared <= limit))
        total = float(np.minimum(squared, limit).sum()) - (len(squared) - inside) * limit  # of those inside, uncopied
        updated = total / inside / _TRUNCATED_MEAN[dimension] / freedom if inside else variance
        if abs(updated - variance) <= 1e-6 * variance:
            break
        variance = updated
    return float(np.sqrt(variance))


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
    if abs(np.log(one / two)) < MIN_SIGMAS_OF_DIFFERENCE * np.sqrt(3 / count):  # 2 / n of the one, 2 / 2n of the other
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
