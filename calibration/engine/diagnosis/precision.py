"""Check that the standard deviations of a result are small enough for its limits."""

import math
from collections.abc import Sequence

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.diagnosis.finding import CONTRADICTION, SUSPECT, Finding, Severity
from calibration.engine.diagnosis.limits import (
    DEFAULT_LIMIT_SIGMAS,
    TWIST_UNITS,
    Limits,
    allowed,
    limits_of,
    of_a_good_robot,
    sizes,
    stated,
)
from calibration.engine.estimation.covariance.fixed_inputs import CAMERA_INFO
from calibration.engine.estimation.covariance.result import Calibration

MIN_DISAGREEMENT = 1.4
"""Collections disagree if that widens the standard deviation by this factor: it is more than half of the variance."""
FINDING_KIND = "precision"
MIN_FAILURE_PROBABILITY = 0.5
"""Probability that a limit is broken, by the standard deviation alone, above which that is a failure."""
UNIT_NAMES = ("mm", "deg")
ADVICE_TO_ADD = "add collections with other rotations of the pattern or the robot"
ADVICE_TO_MEND = "mend first what does not fit"
ADVICE_ON_CONTRADICTIONS = (
    "its collections contradict each other more than those of any good robot: look at time stamps, labels, lens and "
    "arm, and at what moved or gave way"
)
COLLECTIONS_MARGIN = 1.1
"""Number of collections that is advised, over the one that their noise asks for."""
MAX_ADVISED_COLLECTIONS = 200
"""Number of collections above which better ones are advised instead."""
MIN_NAMED_SHARE = 0.03
"""Part of the variance of all that is assumed, from which on a fixed parameter is named."""
ENOUGH_ROOM = 0.75
"""Part of the wanted variance that one contribution may take if narrowing the other alone is to help."""


def precision(calibration: Calibration, limits: Limits, suspected: Sequence[Finding] = ()) -> tuple[Finding, ...]:
    """Report limits that do not hold with the guard band of the reported standard deviation.

    They are undecided; a failure where no limit is set and the error is more likely than not beyond that of any good
    robot with these views. Nothing is said where a failure is reported already.

    Args:
        calibration: a calibration that has converged.
        limits: those that the user has set; without any, the default ones.
        suspected: causes and contradictions that were found.
    """
    if any(each.severity == "red" for each in suspected):
        return ()
    wrong = any(each.kind in (SUSPECT, CONTRADICTION) for each in suspected)
    findings = []
    for name, sigmas in stated(calibration).items():
        limit = allowed(calibration, limits, name)
        most = (limit.translation_mm, limit.rotation_deg)
        unit = max((0, 1), key=lambda i: sigmas[i] / most[i])
        wanted = most[unit] / limits.guard if limits.guard else np.inf
        if sigmas[unit] <= wanted:
            continue
        of_no_good_robot = max(most[unit], DEFAULT_LIMIT_SIGMAS * of_a_good_robot(calibration, name)[unit])
        bad = not limit.set and false_accept(sigmas[unit], of_no_good_robot) > MIN_FAILURE_PROBABILITY
        remedy = (
            ADVICE_TO_MEND
            if wrong
            else ADVICE_ON_CONTRADICTIONS
            if bad
            else _advise_remedy(calibration, name, unit, wanted)
        )
        text = (
            f"'{name}' is not determined well enough: {sigmas[unit]:.2g} {UNIT_NAMES[unit]} (standard deviation, "
            "in all), "
            f"limit {most[unit]:.3g} {UNIT_NAMES[unit]}{'' if limit.set else ', as none is set,'} with a guard band of "
            f"{limits.guard:g} standard deviations, so that it can show {limits.guard * sigmas[unit]:.2g} "
            f"{UNIT_NAMES[unit]}; {remedy}"
        )
        severity: Severity = "red" if bad else "undecided"
        findings.append(Finding(FINDING_KIND, severity, text, (name,), value=sigmas[unit], unit=UNIT_NAMES[unit]))
    return tuple(findings)


def _advise_remedy(calibration: Calibration, name: str, unit: int, wanted: float) -> str:
    """Return what would narrow the standard deviation of a sensor or a joint to a wanted one.

    Args:
        calibration: the calibration.
        name: the sensor or the joint.
        unit: 0 for lengths, 1 for angles.
        wanted: mm or degrees.
    """
    joint, setup, bars = calibration.joints.get(name), calibration.solution.setup, calibration.error_bars
    edge = calibration.dataset.joints[name].edge if joint else calibration.dataset.sensors[name].edge
    block = setup.block(edge)
    if bars is None or block not in bars.labels:
        return ADVICE_TO_ADD
    units, at = joint.units if joint else TWIST_UNITS, setup.problem.shared_parameters[block]
    worth = {cause: sizes(np.linalg.norm(moved[at], axis=1), units)[unit] ** 2 for cause, moved in bars.held.items()}
    assumed, wanted = sum(worth.values()), wanted**2
    scatter = max(0.0, sizes(np.sqrt(np.diagonal(bars.total[block])), units)[unit] ** 2 - assumed)
    count = len(calibration.solution.model.G)
    if assumed <= ENOUGH_ROOM * wanted:
        return _more_collections(count, scatter / (wanted - assumed))
    room = wanted - scatter if scatter <= ENOUGH_ROOM * wanted else wanted / 2
    named = sorted((each for each in worth if worth[each] > MIN_NAMED_SHARE * assumed), key=lambda each: -worth[each])
    known = sum(worth[each] for each in named)
    better = (known / max(room - (assumed - known), 0.1 * room)) ** 0.5
    how = "state it under 'assume', or calibrate it"
    if named[0].startswith(CAMERA_INFO):
        how = "calibrate it with more views, and hand its intrinsics-covariance on"
    know = (
        f"most of it is what is assumed of the {_list_names(named)}: it has to be known {_rounded_up(better):g} "
        "times as "
        f"well ({how})"
    )
    if scatter <= ENOUGH_ROOM * wanted:
        return f"{know}; more collections would not help"
    return f"{know}, and {_more_collections(count, 2 * scatter / wanted)}"


def _more_collections(count: int, factor: float) -> str:
    """Return the advice to take so many times the collections."""
    if count * factor > MAX_ADVISED_COLLECTIONS:
        return f"{ADVICE_TO_ADD}, from nearer"
    needed = int(np.ceil(count * factor * COLLECTIONS_MARGIN))
    return f"take about {needed} collections like these {count}, or some with other rotations"


def _list_names(names: Sequence[str]) -> str:
    return ", the ".join(names[:-1]) + f" and the {names[-1]}" if names[1:] else names[0]


def _rounded_up(number: float) -> float:
    return float(np.ceil(10 * number) / 10)


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
