"""Check that the standard deviations of a result are small enough for its limits."""

import math

import numpy as np

from calibration.diagnosis.finding import Finding
from calibration.diagnosis.limits import Limits, limits_of, stated
from calibration.estimation.held import CAMERA_INFO
from calibration.estimation.result import Calibration
from calibration.geometry.types import Array

DISAGREEING = 1.4
"""Collections disagree if that widens the standard deviation by this factor: it is more than half of the variance."""


def precision(calibration: Calibration, limits: Limits) -> tuple[Finding, ...]:
    """Report a failure if a limit does not hold with the guard band of the reported standard deviation.

    Args:
        calibration: a calibration that has converged.
        limits: those that the user has set; without any, nothing is checked.
    """
    findings = []
    for name, sigmas in stated(calibration).items():
        for sigma, limit, unit in zip(sigmas, limits_of(calibration, limits, name), ("mm", "deg"), strict=True):
            if limit is not None and limits.guard * sigma > limit:
                text = (
                    f"'{name}' is not determined well enough: {sigma:.2g} {unit} (standard deviation, in all), "
                    f"limit {limit:g} {unit} with a guard band of {limits.guard:g} standard deviations; "
                    f"{_remedy(calibration, name)}"
                )
                findings.append(Finding("precision", "undecided", text, (name,), value=sigma, unit=unit))
                break
    return tuple(findings)


def _remedy(calibration: Calibration, name: str) -> str:
    """Return advice on the largest contribution to the standard deviation."""
    dataset = calibration.dataset
    edge = (dataset.sensors.get(name) or dataset.joints[name]).edge
    block, bars = calibration.solution.setup.block(edge), calibration.error_bars
    if bars is None or block not in bars.labels:
        return "add collections with other rotations of the pattern or the robot"
    if wider(bars.total[block], bars.expected[block]) > DISAGREEING:
        return "the collections disagree by more than their labels' noise: look at the arm, the mounts and time stamps"
    if wider(bars.expected[block], bars.labels[block]) > DISAGREEING:
        most = max(bars.worth, key=lambda name: bars.worth[name])
        if most.startswith(CAMERA_INFO):
            return f"most of it is the {most}: calibrate it with more views, and hand its intrinsics-covariance on"
        return f"most of it is the {most}: state under 'assume' how well you know it, or calibrate it"
    return "add collections with other rotations of the pattern or the robot"


def wider(C: Array, D: Array) -> float:
    """Return the ratio of the standard deviations of covariances C and D, independent of units."""
    return float(np.sqrt(np.trace(np.linalg.solve(D, C)) / len(C)))


def worst_false_accept(calibration: Calibration, limits: Limits) -> float | None:
    """Return the probability that the least precise sensor or joint exceeds its limits; None without limits."""
    found = [
        false_accept(sigma, limit)
        for name, sigmas in stated(calibration).items()
        for sigma, limit in zip(sigmas, limits_of(calibration, limits, name), strict=True)
        if limit is not None
    ]
    return round(max(found), 6) if found else None


def false_accept(sigma: float, limit: float) -> float:
    """Return the probability that a three-dimensional error exceeds a limit.

    Args:
        sigma: norm of the standard deviations of the three axes.
        limit: of the norm of the error, in the same unit.

    By Maxwell's distribution with the same mean square: ``P(|e| > l) = erfc(x) + 2 x exp(-x^2) / sqrt(pi)`` with
    ``x = l / (sqrt(2) s)``, s the standard deviation of one axis.
    """
    if sigma <= 0:
        return 0.0
    x = limit / (math.sqrt(2 / 3) * sigma)
    if x > 20:
        return 0.0
    return math.erfc(x) + 2 * x * math.exp(-x * x) / math.sqrt(math.pi)
