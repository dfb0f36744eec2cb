"""Whether the data determine a result well enough for the limits that it has to hold."""

import math

import numpy as np

from calibration.dataset.model import Edge
from calibration.diagnosis.finding import Finding
from calibration.diagnosis.limits import Limits
from calibration.estimation.result import Calibration

DISAGREEING = 1.4
"""What makes an error bar this many times as wide is more than half of its variance."""


def precision(calibration: Calibration, limits: Limits) -> tuple[Finding, ...]:
    """Red where a limit does not hold with the guard band of the stated standard deviation.

    Args:
        calibration: a calibration that has converged.
        limits: those that a user has set; without one nothing is asked.
    """
    findings = []
    for sensor in calibration.dataset.sensors.values():
        if sensor.edge not in calibration.covariances:
            continue
        stated = (
            (calibration.sigma_mm(sensor.edge), limits.translation_mm, "mm"),
            (float(np.degrees(calibration.sigma_mrad(sensor.edge) / 1e3)), limits.rotation_deg, "deg"),
        )
        for sigma, limit, unit in stated:
            if limit is not None and limits.guard * sigma > limit:
                text = (
                    f"'{sensor.name}' is not determined well enough: {sigma:.2g} {unit} (standard deviation, in all), "
                    f"limit {limit:g} {unit} with a guard band of {limits.guard:g} standard deviations; "
                    f"{_remedy(calibration, sensor.edge)}"
                )
                findings.append(Finding("precision", "red", text, (sensor.name,), value=sigma, unit=unit))
                break
    return tuple(findings)


def _remedy(calibration: Calibration, edge: Edge) -> str:
    """What would narrow the error bar most."""
    bars, label = calibration.error_bars, calibration.label_sigma_mm(edge)
    C = bars.expected.get(calibration.solution.setup.block(edge)) if bars else None
    expected = 1e3 * float(np.sqrt(np.trace(C[:3, :3]))) if C is not None else label
    if bars and calibration.sigma_mm(edge) > DISAGREEING * expected:
        return "the collections disagree by more than their labels' noise: look at the arm, the mounts and time stamps"
    if bars and expected > DISAGREEING * label:
        most = max(bars.worth, key=lambda name: bars.worth[name])
        return f"most of it is the {most}: state under 'assume' how well you know it, or calibrate it"
    return "add collections with other rotations of the pattern or the robot"


def worst_false_accept(calibration: Calibration, limits: Limits) -> float | None:
    """The probability that the sensor that is known least is off by more than the limits; None without limits."""
    found = [
        false_accept(sigma, limit)
        for sensor in calibration.dataset.sensors.values()
        if sensor.edge in calibration.covariances
        for sigma, limit in (
            (calibration.sigma_mm(sensor.edge), limits.translation_mm),
            (float(np.degrees(calibration.sigma_mrad(sensor.edge) / 1e3)), limits.rotation_deg),
        )
        if limit is not None
    ]
    return round(max(found), 6) if found else None


def false_accept(sigma: float, limit: float) -> float:
    """The probability that a result is off by more than a limit, in the worst direction of three.

    Args:
        sigma: the norm of the standard deviations of the three axes.
        limit: of the norm of the error, in the same unit.

    Maxwell's distribution with the same mean square: ``P(|e| > l) = erfc(x) + 2 x exp(-x^2) / sqrt(pi)`` with
    ``x = l / (sqrt(2) s)``, s the standard deviation of one axis.
    """
    if sigma <= 0:
        return 0.0
    x = limit / (math.sqrt(2 / 3) * sigma)
    if x > 20:
        return 0.0
    return math.erfc(x) + 2 * x * math.exp(-x * x) / math.sqrt(math.pi)
