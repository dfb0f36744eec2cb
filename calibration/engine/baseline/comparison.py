"""Comparison of two calibrations of the same robot, with a significance test.

The difference d of two poses is a twist in the child frame of the first. For independent recordings its covariance is
``C = C_1 + C_2 - sum (m_1 m_2^T + m_2 m_1^T)``, where m are the effects of fixed parameters that both have in common:
their error is the same in both and moves both results alike. If nothing has moved, ``d^T C^-1 d`` is Hotelling's T^2,
as the C are estimated from collections: with k = 6 parameters and n degrees of freedom, those of the effective
collections of both, ``T^2 (n - k + 1) / (k n)`` is F-distributed (H. Hotelling, "The generalization of Student's
ratio", 1931). On the same data the result is deterministic, so every difference counts.

In a series of measurements, levels that change and a slow drift are found. The levels are the segmentation with the
least ``sum |x_i - mean of its segment|^2 / s^2 + penalty * changes``, found exactly by optimal partitioning (B. Jackson
et al., "An algorithm for optimal partitioning of data on an interval", 2005). The penalty is a quantile of chi-squared,
so that the false alarm rate of a constant series is 0.001.
"""

import math
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.base.records import field, result
from calibration.engine.baseline.calibration_document import (
    POSITIONS_INPUT,
    CalibratedParameter,
    CalibratedPose,
    CalibrationDocument,
)
from calibration.engine.estimation.residuals.statistics import FAMILY_WISE, score_of_f
from calibration.engine.geometry.transforms import local

Kind = Literal["pose", "parameter", "lens", "added", "removed"]
MOST_FREEDOM = 1e6
"""Upper limit of the degrees of freedom; beyond it the distribution is practically chi-squared."""
MIN_VARIANCE_RATIO = 1e-9
"""Relative to the largest: a smaller variance is rounding error."""


@result(kw_only=True)
class BaselineChange:
    """Difference of one calibrated transform or parameter from an earlier one."""

    name: str = field("The sensor, the transform or the parameter.")
    kind: Kind = field(
        "pose, parameter, lens (all parameters of a camera together); added and removed where only one of the two "
        "calibrations has it."
    )
    translation_mm: tuple[float, ...] = field("Translation, in the earlier child frame.", unit="mm", default=())
    rotation_deg: tuple[float, ...] = field("Rotation vector, in that frame.", unit="degrees", default=())
    value: float | None = field("Difference of a parameter.", default=None)
    unit: str | None = field("Of a parameter.", default=None)
    mm: float = field("Norm of the translation.", unit="mm", default=0.0)
    deg: float = field("Angle of the rotation.", unit="degrees", default=0.0)
    sigma_mm: float = field("Standard deviation of the translation, the norm of three axes.", unit="mm", default=0.0)
    sigma_deg: float = field("Standard deviation of the rotation, the norm of three axes.", unit="degrees", default=0.0)
    sigma: float | None = field("Standard deviation of the difference of a parameter.", default=None)
    sigmas: float = field("The difference in standard deviations: the root of T^2.", default=0.0)
    p: float = field("Probability of so large a difference if nothing has moved.", default=1.0)
    unseen_mm: float = field(
        "Largest displacement that would not be significant, in the worst direction.",
        unit="mm",
        default=0.0,
    )


@dataclass(frozen=True)
class BaselineComparison:
    """Comparison of two calibrations of one system."""

    before: CalibrationDocument
    now: CalibrationDocument
    changes: tuple[BaselineChange, ...]

    @property
    def same_data(self) -> bool:
        """Whether both are calibrated from the same labels."""
        return self.before.data == self.now.data

    @property
    def other_inputs(self) -> tuple[str, ...]:
        """Inputs other than the labels that differ."""
        before, now = self.before.inputs, self.now.inputs
        changed = [name for name in now if before.get(name, now[name]) != now[name]]
        if not self.same_data:
            changed = [name for name in changed if name != POSITIONS_INPUT]
        engines = [f"the engine ({self.before.engine} to {self.now.engine})"]
        return (*changed, *(engines if self.before.engine != self.now.engine else []))

    @property
    def significance(self) -> float:
        """Significance level of each single difference: family-wise over all of them (Bonferroni)."""
        return FAMILY_WISE / max(1, sum(each.kind in ("pose", "parameter", "lens") for each in self.changes))


def compare(before: CalibrationDocument, now: CalibrationDocument) -> BaselineComparison:
    """Compare an accepted calibration with another."""
    same = before.data == now.data
    earlier = {each.edge: each for each in before.poses}
    later = {each.edge: each for each in now.poses}
    values = {each.name: each for each in before.parameters}
    new_values = {each.name: each for each in now.parameters}
    lenses = [] if same else sorted(before.lens_correlations.keys() & now.lens_correlations.keys())
    count = len(earlier.keys() & later.keys()) + len(values.keys() & new_values.keys()) + len(lenses)
    freedom = _degrees_of_freedom(before, now)
    threshold = t_squared_quantile(FAMILY_WISE / max(1, count), freedom)
    changes = [_pose_change(earlier[edge], later[edge], same, threshold, freedom) for edge in earlier if edge in later]
    changes += [
        _parameter_change(values[name], new_values[name], same, freedom) for name in values if name in new_values
    ]
    changes += [each for name in lenses if (each := _lens_change(before, now, name, freedom))]
    changes += _unmatched_changes({each.name for each in earlier.values()}, {each.name for each in later.values()})
    changes += _unmatched_changes(values.keys(), new_values.keys())
    return BaselineComparison(before, now, tuple(changes))


def _degrees_of_freedom(before: CalibrationDocument, now: CalibrationDocument) -> float:
    """Degrees of freedom of the covariance of a difference; infinite if unknown."""
    known = [each.effective_collections for each in (before, now)]
    return sum(each - 1 if each is not None else math.inf for each in known)


def _unmatched_changes(before: Set[str], now: Set[str]) -> Iterator[BaselineChange]:
    for name in sorted(before - now):
        yield BaselineChange(name=name, kind="removed")
    for name in sorted(now - before):
        yield BaselineChange(name=name, kind="added")


def _pose_change(
    before: CalibratedPose, now: CalibratedPose, same: bool, threshold: float, freedom: float
) -> BaselineChange:
    d = local(before.matrix, now.matrix)
    C = _label_covariance(before) if same else covariance_of_difference(before, now)
    chi_squared, worst = (0.0, 0.0) if C is None else _chi_squared(d, C)
    sizes = (0.0, 0.0) if C is None else _twist_norms(np.sqrt(np.diagonal(C)))
    if C is None and np.abs(d).max() > 0:
        chi_squared = math.inf  # fixed in both: no standard deviation, and no noise
    mm, deg = _twist_norms(d)
    return BaselineChange(
        name=now.name,
        kind="pose",
        translation_mm=_round_values(1e3 * d[:3]),
        rotation_deg=_round_values(np.degrees(d[3:])),
        mm=round(mm, 6),
        deg=round(deg, 8),
        sigma_mm=round(sizes[0], 6),
        sigma_deg=round(sizes[1], 8),
        sigmas=_finite_number(math.sqrt(chi_squared)),
        p=t_squared_tail(chi_squared, 6, freedom),
        unseen_mm=round(min(1e3 * math.sqrt(threshold) * worst, 1e9), 4),
    )


def _parameter_change(
    before: CalibratedParameter, now: CalibratedParameter, same: bool, freedom: float
) -> BaselineChange:
    difference = now.value - before.value
    variances = [each.sigma**2 for each in (before, now)]
    if same:
        variances = [(before.label_sigma if before.label_sigma is not None else before.sigma) ** 2]
    sigma = math.sqrt(sum(variances))
    sigmas = abs(difference) / sigma if sigma > 0 else (math.inf if difference else 0.0)
    return BaselineChange(
        name=now.name,
        kind="parameter",
        value=difference,
        unit=now.unit,
        mm=1e3 * abs(difference) if now.unit == "m" else 0.0,
        deg=math.degrees(abs(difference)) if now.unit == "rad" else 0.0,
        sigma=sigma,
        sigma_mm=1e3 * sigma if now.unit == "m" else 0.0,
        sigma_deg=math.degrees(sigma) if now.unit == "rad" else 0.0,
        sigmas=_finite_number(sigmas),
        p=t_squared_tail(sigmas**2, 1, freedom),
    )


def _lens_change(
    before: CalibrationDocument, now: CalibrationDocument, camera: str, freedom: float
) -> BaselineChange | None:
    """Compare all parameters of a camera together, which make up for each other; None for another lens model.

    Of its covariance only a factor is estimated from the collections, by all k parameters of each, so that the squared
    distance over k is F-distributed with k and k n degrees of freedom.
    """
    earlier, later = before.lens(camera), now.lens(camera)
    if earlier is None or later is None or earlier[0] != later[0]:
        return None
    chi_squared, k = squared_mahalanobis(later[1] - earlier[1], earlier[2] + later[2]), len(earlier[0])
    score = float(score_of_f(chi_squared / k, k, k * min(max(freedom, 1.0), MOST_FREEDOM)))
    return BaselineChange(
        name=f"{camera}'s lens",
        kind="lens",
        sigmas=_finite_number(math.sqrt(chi_squared)),
        p=0.5 * math.erfc(score / math.sqrt(2)),
    )


def _label_covariance(pose: CalibratedPose) -> Array | None:
    """Covariance (6, 6) from the labels' noise alone, without that of fixed parameters; None for a fixed pose."""
    C = pose.covariance
    if C is None or pose.label_sigma_mm is None or pose.label_sigma_deg is None:
        return C
    scale = np.repeat([pose.label_sigma_mm, pose.label_sigma_deg], 3)
    scale = scale / np.repeat(np.maximum(_twist_norms(np.sqrt(np.diagonal(C))), 1e-300), 3)
    return C * np.outer(scale, scale)


def covariance_of_difference(before: CalibratedPose, now: CalibratedPose) -> Array | None:
    """Covariance (6, 6) of the difference of two poses from independent recordings; None if both are fixed."""
    parts = [each for each in (before.covariance, now.covariance) if each is not None]
    if not parts:
        return None
    alike = [before.moves(name).T @ now.moves(name) for name in before.held.keys() & now.held.keys()]
    return np.asarray(np.sum([*parts, *(-each - each.T for each in alike)], axis=0))


def _chi_squared(d: Array, C: Array) -> tuple[float, float]:
    """Return ``d^T C^-1 d``, and the largest standard deviation of a translation in any direction, m."""
    return squared_mahalanobis(d, C), float(np.sqrt(np.linalg.eigvalsh(C[:3, :3])[-1]))


def squared_mahalanobis(d: Array, C: Array) -> float:
    """Return ``d^T C^-1 d``."""
    scale = np.sqrt(np.maximum(np.diagonal(C), 1e-300))
    values, vectors = np.linalg.eigh(C / np.outer(scale, scale))
    values = np.maximum(values, MIN_VARIANCE_RATIO * values[-1])
    white = vectors.T @ (d / scale) / np.sqrt(values)
    return float(white @ white)


def _twist_norms(d: Array) -> tuple[float, float]:
    """Return the norms of a twist (6,) in m and rad, as mm and degrees."""
    return 1e3 * float(np.linalg.norm(d[:3])), float(np.degrees(np.linalg.norm(d[3:])))


def _round_values(values: Array) -> tuple[float, ...]:
    return tuple(round(float(v), 8) + 0.0 for v in values)


def _finite_number(value: float) -> float:
    return round(min(value, 1e9), 4)


def t_squared_tail(x: float, k: int, freedom: float) -> float:
    """Probability that Hotelling's T^2 of k parameters exceeds x under the null hypothesis.

    1 if there are too few degrees of freedom.
    """
    n = min(freedom, MOST_FREEDOM)
    if n - k + 1 < 1 or x <= 0:
        return 1.0
    if math.isinf(x):
        return 0.0
    score = float(score_of_f(x * (n - k + 1) / (k * n), k, n - k + 1))
    return 0.5 * math.erfc(score / math.sqrt(2))


def t_squared_quantile(p: float, freedom: float) -> float:
    """Value that Hotelling's T^2 of 6 parameters exceeds with probability p; infinite if ``freedom`` is too small."""
    return _solve_tail(lambda x: t_squared_tail(x, 6, freedom), p)


def chi_squared_quantile(p: float) -> float:
    """Quantile that chi-squared with 6 degrees of freedom exceeds with probability p."""
    return _solve_tail(chi_squared_tail, p)


def chi_squared_tail(x: float) -> float:
    """Probability that chi-squared with 6 degrees of freedom exceeds x.

    ``exp(-x/2) (1 + x/2 + x^2/8)`` (M. Abramowitz, I. Stegun, "Handbook of mathematical functions", 26.4.21).
    """
    return math.exp(-x / 2) * (1 + x / 2 + x * x / 8) if x < 1400 else 0.0


def _solve_tail(tail: Callable[[float], float], p: float) -> float:
    """Solve ``tail(x) = p`` for a decreasing function; infinite if there is no solution below the search limit."""
    low, high = 0.0, 1e6
    if tail(high) > p:
        return math.inf
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if tail(middle) > p else (low, middle)
    return high


MAD_TO_SIGMA = 1.4826
"""Ratio of standard deviation to median absolute deviation of a normal distribution."""
MIN_VALUES = 4
"""Minimum number of values for a trend."""
MIN_VALUES_FOR_NOISE = 12
"""Least number of values for which the noise is estimated from their differences."""
MIN_NOISE_SHARE = 0.02
"""Lower limit of the noise, as a fraction of the stated one."""


def noise_of(values: Array, stated: Array) -> Array:
    """Estimate the standard deviation of each column of a series from its differences; short series: the stated one.

    It is the larger of the two halves' estimates, so that increasing noise is not detected as changes of the level.

    Args:
        values: (n, d).
        stated: (d,), positive.
    """
    if len(values) < MIN_VALUES_FOR_NOISE:
        return stated
    steps = np.diff(values, axis=0)
    halves = np.array_split(steps, 2)
    deviations = [np.median(np.abs(half - np.median(half, axis=0)), axis=0) for half in halves]
    return np.asarray(np.maximum(MAD_TO_SIGMA * np.max(deviations, axis=0) / math.sqrt(2), MIN_NOISE_SHARE * stated))


def change_points(values: Array, noise: Array) -> list[int]:
    """Return the indices at which the level of a series changes.

    Args:
        values: (n, d), with d at most 6.
        noise: (d,), the standard deviation of each column.
    """
    n = len(values)
    if n < 2:
        return []
    white = (values - values[0]) / noise
    sums = np.concatenate([np.zeros((1, white.shape[1])), np.cumsum(white, axis=0)])
    squares = np.concatenate([[0.0], np.cumsum((white**2).sum(axis=1))])
    penalty = chi_squared_quantile(FAMILY_WISE / n)
    best = np.zeros(n + 1)
    best[0] = -penalty
    last: IntArray = np.zeros(n + 1, int)
    for end in range(1, n + 1):
        starts = np.arange(end)
        cost = squares[end] - squares[:end] - ((sums[end] - sums[:end]) ** 2).sum(axis=1) / (end - starts)
        total = best[:end] + cost + penalty
        last[end] = int(total.argmin())
        best[end] = total[last[end]]
    found: list[int] = []
    at = n
    while (at := int(last[at])) > 0:
        found.insert(0, at)
    return found


def creeps(values: Array, noise: Array, changes: Sequence[int]) -> bool:
    """Whether a straight line explains a series better than levels, with a penalty for each parameter.

    Args:
        values: (n, d).
        noise: (d,), the standard deviation of each column.
        changes: the indices from `change_points`.
    """
    n = len(values)
    if n < MIN_VALUES:
        return False
    white = values / noise
    penalty = chi_squared_quantile(FAMILY_WISE / n)
    levels = sum(float(((part - part.mean(axis=0)) ** 2).sum()) for part in np.split(white, list(changes)))
    at = np.arange(n) - (n - 1) / 2
    centred = white - white.mean(axis=0)
    slope = at @ centred / (at @ at)
    line = float(((centred - np.outer(at, slope)) ** 2).sum())
    return line + penalty < min(levels + penalty * len(changes), float((centred**2).sum()))
