"""How sure a result is: standard deviations against the limits, too few collections, how camera_info is known."""

import math
from collections.abc import Sequence

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.diagnosis.limits import (
    DEFAULT_LIMIT_SIGMAS,
    Limits,
    allowed,
    block_of,
    limits_of,
    of_a_good_robot,
    sizes,
    stated,
)
from calibration.engine.estimation.covariance.fixed_inputs import CAMERA_INFO, PLACE_KIND
from calibration.engine.estimation.covariance.lens_errors import NUMBER_OF_VIEWS, LensSource
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.covariance.suspects import MIN_CONTRADICTING_FACTOR, disagreement

MIN_DISAGREEMENT = 1.4
"""Collections disagree if that widens the standard deviation by this factor: it is more than half of the variance."""
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
MIN_INDEPENDENT_COLLECTIONS = 7
"""Minimum of independent collections for suspects and standard deviations to explain a disagreement."""
RECOMMENDED_COLLECTIONS = "8 or more, with other rotations"
"""Recommendation of a message,"""
BETTER_OF_CAMERAS = "20 to 40, near, tilted and all over the image"
"""and where only cameras are calibrated."""
MAX_SHARE_OF_ONE = 0.7
"""A direction depends on one collection if that contributes more than this fraction of its information."""
KNOWN_BY: dict[LensSource, str] = {
    "nominal": f"as from a nominal calibration of {NUMBER_OF_VIEWS} views; one of your own may leave its covariance "
    "(intrinsics-covariance)",
    "assume": "as 'assume' says",
    "covariance": "by the covariance of its own calibration",
    "standard-deviations": "by the standard deviations in its file",
}


def precision(calibration: Calibration, limits: Limits, found: Sequence[Finding] = ()) -> tuple[Finding, ...]:
    """Report limits that do not hold with the guard band of the reported standard deviation.

    They are undecided; a failure where no limit is set and the error is more likely than not beyond that of any good
    robot with these views. Nothing is said where a failure is reported already.

    Args:
        calibration: a calibration that has converged.
        limits: those that the user has set; without any, the default ones.
        found: by the checks before; causes and contradictions count.
    """
    wrong = [each for each in found if each.kind in ("suspect", "contradiction")]
    if any(each.severity == "red" for each in wrong):
        return ()
    findings, explained = [], any(each.severity == "undecided" for each in wrong)
    if any(each.kind == "contradiction" for each in wrong) and (varying := calibration.solution.varying):
        explained = explained or varying.causes[0].kind != PLACE_KIND  # what that does is told
    for name, sigmas in stated(calibration).items():
        limit = allowed(calibration, limits, name)
        most = (limit.translation_mm, limit.rotation_deg)
        unit = max((0, 1), key=lambda i: sigmas[i] / most[i])
        wanted = most[unit] / limits.guard if limits.guard else np.inf
        if sigmas[unit] <= wanted:
            continue
        of_no_good_robot = max(most[unit], DEFAULT_LIMIT_SIGMAS * of_a_good_robot(calibration, name)[unit])
        bad = not limit.set and not explained and false_accept(sigmas[unit], of_no_good_robot) > MIN_FAILURE_PROBABILITY
        remedy = (
            ADVICE_TO_MEND
            if wrong
            else ADVICE_ON_CONTRADICTIONS
            if bad
            else _advise_remedy(calibration, name, unit, wanted)
        )
        text = (
            f"'{name}' is not determined well enough: {sigmas[unit]:.2g} {UNIT_NAMES[unit]} (standard deviation, in "
            f"all), limit {most[unit]:.3g} {UNIT_NAMES[unit]}{'' if limit.set else ', as none is set,'} with a guard "
            f"band of {limits.guard:g} standard deviations, so that it can show {limits.guard * sigmas[unit]:.2g} "
            f"{UNIT_NAMES[unit]}; {remedy}"
        )
        severity: Severity = "red" if bad else "undecided"
        findings.append(Finding("precision", severity, text, (name,), value=sigmas[unit], unit=UNIT_NAMES[unit]))
    return tuple(findings)


def _advise_remedy(calibration: Calibration, name: str, unit: int, wanted: float) -> str:
    """Return what would narrow the standard deviation of a sensor or a joint to a wanted one.

    Args:
        calibration: the calibration.
        name: the sensor or the joint.
        unit: 0 for lengths, 1 for angles.
        wanted: mm or degrees.
    """
    bars, (block, units) = calibration.error_bars, block_of(calibration, name)
    if bars is None or block not in bars.labels:
        return ADVICE_TO_ADD
    at = calibration.solution.setup.problem.shared_parameters[block]
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
        f"most of it is what is assumed of the {_list_names(named)}: it has to be known {_rounded_up(better):g} times "
        f"as well ({how})"
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


def too_few(calibration: Calibration) -> tuple[Finding, ...]:
    """Report an undecided result if few views disagree by more than their noise and single ones decide it.

    The result follows such a view, so that its residual is small despite its error: no standard deviation covers that.
    """
    model, bars = calibration.solution.model, calibration.error_bars
    count = len(model.G)
    if bars is None or count >= MIN_INDEPENDENT_COLLECTIONS or bars.decisive < MAX_SHARE_OF_ONE:
        return ()
    ratio = disagreement(model).ratio
    if ratio <= MIN_CONTRADICTING_FACTOR:
        return ()
    text = (
        f"{count} collections are too few for views that disagree by {ratio**0.5:.2g} times their noise: one of them "
        f"alone decides {bars.decisive:.0%} of what is known of some direction; take "
        f"{BETTER_OF_CAMERAS if calibration.of_cameras_alone else RECOMMENDED_COLLECTIONS}"
    )
    return (Finding("too-few", "undecided", text, value=ratio, unit="1"),)


def camera_info(calibration: Calibration) -> tuple[Finding, ...]:
    """Report how well the camera_info of each camera is taken to be known; nothing where it is exact or calibrated."""
    known: dict[LensSource, list[str]] = {}
    for cause in calibration.solution.model.causes:
        if cause.kind == CAMERA_INFO and cause.known_by is not None and any(cause.assumed):
            known.setdefault(cause.known_by, []).append(cause.subject)
    return tuple(
        Finding("camera-info", "note", f"camera_info of {' and '.join(names)} is known {KNOWN_BY[source]}", (*names,))
        for source, names in known.items()
    )
