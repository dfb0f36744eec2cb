"""The calibration of a robot on which something has moved within the recording: by the views since then."""

from collections.abc import Iterator, Sequence

import numpy as np

from calibration.base import UndeterminedError
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import TWIST_UNITS, Limits, allowed, sizes, stated
from calibration.engine.diagnosis.precision import RECOMMENDED_COLLECTIONS, too_few
from calibration.engine.diagnosis.what_does_not_fit import distance_text, keys_since, what_does_not_fit
from calibration.engine.estimation.calibrate import Prepared, prepare_without
from calibration.engine.estimation.covariance.fixed_inputs import PLACE_KIND
from calibration.engine.estimation.covariance.result import Calibration, DroppedView
from calibration.engine.estimation.covariance.suspects import MIN_CLUSTERS_ON_A_SIDE, Suspect
from calibration.engine.geometry.transforms import distance


def after_move(
    calibration: Calibration,
    findings: Sequence[Finding],
    prepared: Prepared,
    limits: Limits,
) -> tuple[Calibration, tuple[Finding, ...]]:
    """Return the calibration of the robot as it stands now, and a warning that says so; the given one if none moved.

    Of what has moved only the views since then are kept, of the others all. If these tell less than all views do, the
    given calibration is returned, with a warning of that.

    Args:
        calibration: the calibration of all views.
        findings: those on it.
        prepared: what it was solved from.
        limits: those that the user has set.
    """
    if not any(each.kind == "suspect" and each.severity == "red" and each.collections for each in findings):
        return calibration, ()
    moves = _last_moves(calibration)
    if not moves:
        return calibration, ()
    since = {name: keys_since(calibration, at) for name, (at, _) in moves.items()}
    firsts = dict.fromkeys(keys[0] for keys in since.values())
    names = {first: " and ".join(name for name, keys in since.items() if keys[0] == first) for first in firsts}
    when = " and ".join(f"{names[first]} since collection {first}" for first in firsts)
    sensors = tuple(name for name in moves if name in calibration.dataset.sensors)
    before = tuple(_views_before(calibration, moves))
    try:
        after = prepare_without(prepared, (*calibration.dropped_views, *before)).optimum
        why = after.reason or _why_not_determined(calibration, after, since, limits)
    except UndeterminedError as error:
        after, why = calibration, str(error).removeprefix(f"{calibration.dataset.path}: ")
    if why:
        text = (
            f"the result is not that of the robot as it stands now, of {when}, but lies between before and after: "
            f"{why}; record {RECOMMENDED_COLLECTIONS}, of the robot as it is now"
        )
        return calibration, (Finding("after-move", "warning", text, sensors),)
    text = (
        f"the result is that of the robot as it stands now, of {when}: {len(before)} views from before are left out, "
        f"and its error bars are of the others"
    )
    return after, (Finding("after-move", "warning", text, sensors),)


def _last_moves(calibration: Calibration) -> dict[str, tuple[int, Suspect]]:
    """Return the cluster of collections from which on each moved sensor or pattern is where it is now, and the suspect.

    Where the data cannot tell which of several has moved, all of them: before it they do not belong together.
    """
    explanation = calibration.solution.explanation
    moves: dict[str, tuple[int, Suspect]] = {}
    for suspect in explanation.suspects if explanation else ():
        for cause in (suspect.cause, *(rival.cause for rival in suspect.rivals)):
            if suspect.since and cause.kind == PLACE_KIND and suspect.since > moves.get(cause.subject, (0,))[0]:
                moves[cause.subject] = (suspect.since, suspect)
    return moves


def _views_before(calibration: Calibration, moves: dict[str, tuple[int, Suspect]]) -> Iterator[DroppedView]:
    """Yield the views of what has moved before it did, with how far that was."""
    solution = calibration.solution
    for collection, cluster in zip(solution.dataset.collections, solution.model.clusters.tolist(), strict=True):
        for pattern, sensor in collection.labels:
            later = [moves[name] for name in (sensor, pattern) if name in moves and cluster < moves[name][0]]
            if later:
                yield DroppedView(sensor, pattern, collection.key, *sizes(later[0][1].value, TWIST_UNITS))


def _why_not_determined(
    mixed: Calibration, after: Calibration, since: dict[str, tuple[str, ...]], limits: Limits
) -> str:
    """Return why the views since a move tell less of the robot as it is now than all views; empty if they tell more.

    The result of all views is off by its own error, and by what lies between before and after.
    """
    for name, keys in since.items():
        if len(keys) < MIN_CLUSTERS_ON_A_SIDE:
            return f"{len(keys)} collections since then are too few to know where {name} is"
    moved_again = [each for each in what_does_not_fit(after, limits) if each.severity == "red" and each.collections]
    if faults := (*moved_again, *too_few(after)):
        return f"since then {faults[0].text}"
    now = stated(after)
    of_all = {name: np.hypot(sigmas, _distance_of_sensor(mixed, after, name)) for name, sigmas in stated(mixed).items()}
    shares = {name: allowed(after, limits, name).share(*sigmas) for name, sigmas in now.items()}
    worst = max(shares, key=lambda name: shares[name])
    if shares[worst] > max(allowed(after, limits, name).share(*each.tolist()) for name, each in of_all.items()):
        return f"by the views since then {worst} is known to {distance_text(*now[worst])} only"
    return ""


def _distance_of_sensor(one: Calibration, other: Calibration, name: str) -> tuple[float, float]:
    """Return how far apart two calibrations have a sensor, mm and degrees; zeros for a joint."""
    sensor = one.dataset.sensors.get(name)
    if sensor is None:
        return 0.0, 0.0
    metres, radians = distance(one.transforms[sensor.edge], other.transforms[sensor.edge])
    return 1e3 * float(metres), float(np.degrees(radians))
