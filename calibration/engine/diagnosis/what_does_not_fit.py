"""Suspects as findings: the parameter that does not fit, its deviation, its effect on the sensors, and advice."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calibration.base import rounded, with_error_bar
from calibration.base.arrays import Array
from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.diagnosis.limits import SENSOR_UNITS, TWIST_UNITS, Limits, allowed, block_of, sizes, stated
from calibration.engine.diagnosis.precision import MIN_FAILURE_PROBABILITY, false_accept
from calibration.engine.diagnosis.projection import projection_limit, shifts
from calibration.engine.diagnosis.residuals import neighbours_err_alike
from calibration.engine.diagnosis.robot_tasks import breaks_by_disagreement, worst_at_tasks
from calibration.engine.estimation.covariance.fixed_inputs import (
    ECCENTRICITY_KIND,
    ENCODER_KIND,
    LAG_KIND,
    PLACE_KIND,
    PROJECTION_KIND,
    RADIAL_KIND,
    RING_KIND,
    SAG_KIND,
    SHUTTER_KIND,
    Cause,
)
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.covariance.suspects import (
    DEGREES_IF_NOT_ESTIMATED,
    LENS_KIND,
    MIN_CLUSTERS_ON_A_SIDE,
    MIN_CONTRADICTING_FACTOR,
    Disagreement,
    Suspect,
    columns_of_cause,
)
from calibration.engine.estimation.covariance.varying_causes import VaryingCause
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS
from calibration.engine.geometry.transforms import adjoint
from calibration.engine.statistics import median_of_norm, probability_beyond, score_of_f, size_without_error, threshold
from calibration.engine.tasks.task_errors import TaskError

GROSS_DEVIATIONS: Mapping[str, tuple[float, str]] = {
    "focal length": (0.025, "camera"),
    "image scale": (0.025, "camera"),
    "principal point": (15.0, "camera"),
    RADIAL_KIND: (0.01, "camera"),
    PROJECTION_KIND: (0.01, "camera"),
    "size": (0.01, "board"),
    "scale of poses": (0.01, "board"),
    "lengths": (0.01, "arm"),
    "encoder gain": (0.02, "arm"),
}
"""Deviation (relative, px; of distortion, of the distance from the image's centre) that is a failure regardless of its
effect: more than a good one of this kind errs, so that it belongs to another one."""
ADVICE_ON_CAUSE: Mapping[str, str] = {
    "focal length": "calibrate the intrinsics, or take the camera_info that belongs to this lens and resolution",
    LENS_KIND: "calibrate the intrinsics (add it to 'intrinsics'), or take the camera_info that belongs to this lens",
    "aspect": "calibrate the intrinsics; were the images scaled?",
    "principal point": "calibrate the intrinsics; were the images cropped?",
    "pixel convention": "pixel (0, 0) is the centre of the first pixel here; shift cx and cy by half a pixel",
    "image scale": "the labels are of another resolution than camera_info",
    "skew": "calibrate the intrinsics",
    RADIAL_KIND: "calibrate the intrinsics with this lens model, or a richer one",
    PROJECTION_KIND: "calibrate the intrinsics with this lens model, or take the camera_info that belongs to this lens",
    "tangential distortion": "calibrate the intrinsics with this lens model, or a richer one",
    "lens model": f"calibrate the intrinsics with another lens model ({', '.join(MODELS)})",
    "range bias": "correct the sensor's ranges, or hold it to a surveyed distance",
    "range scale": "correct the sensor's ranges, or measure the pattern again",
    "beam elevation": "look at the sensor's own calibration of its beams",
    RING_KIND: "give the driver the elevations of this LiDAR's own rings, as its maker has measured them",
    "motion during a sweep": "stop the robot for each collection, or compensate the motion in the sweeps",
    "size": "measure the printed squares over many of them, and correct the pattern's size",
    "stretch": "measure the squares along both sides: printers stretch one of them",
    "stretch along x": "measure the squares along both sides: printers stretch one of them",
    "stretch along y": "measure the squares along both sides: printers stretch one of them",
    "bow": "put the pattern on a flat plate",
    "twist": "put the pattern on a flat plate",
    "border": "measure the board's border, and correct border_size",
    "link": "look at the origin of the joint that follows it in the robot's description",
    "lengths": "look at the units and the lengths of the robot's description",
    ENCODER_KIND: "look at this joint's zero, or calibrate its position_bias",
    "encoder gain": "look at this joint's unit and gear ratio",
    ECCENTRICITY_KIND: "look at this joint's gear and encoder: an error that comes again with each turn",
    SAG_KIND: "the arm bends under its weight the farther it reaches: give its poses with the bending, or record "
    "poses that reach equally far",
    "backlash": "approach every pose from the same side",
    "scale of poses": "measure the pattern by which the camera measured them, and calibrate the camera's intrinsics; "
    "or let the arm tell the scale: scale: free",
    LAG_KIND: "look at time stamps; stop the robot for each collection, or calibrate it: lag: free",
    PLACE_KIND: "something was knocked; collect anew, or calibrate the collections before and after apart",
}
ADVICE_ON_CHANGE: Mapping[str, str] = {
    "size": "leave out what another board was used in, or import the collections before and after apart",
    "focal length": "fix zoom and focus, calibrate the intrinsics as they are now, and collect anew",
    ENCODER_KIND: "reference this joint anew, as after a power cycle or a slip, and collect anew",
}
"""Advice on what has changed between two collections."""
AT_STANDSTILL = "take all images of a collection at one moment, board and robot standing still"
ADVICE_ON_VARIATION: Mapping[str, str] = {
    "principal point": "something shifts the images one by one: switch a stabiliser or a moving crop off",
    **dict.fromkeys(("focal length", "image scale"), "fix zoom and focus, and switch autofocus off"),
    SHUTTER_KIND: "a rolling shutter: stand still for each image, or take a camera with a global one",
    PLACE_KIND: f"look at time stamps, and at what moved or gave way; {AT_STANDSTILL}",
}
"""Advice on what varies from collection to collection."""
MIN_MOVES_OF_UNSTEADY = 2
"""Number of moves within a recording from which on it is rather something that does not stand still."""
MAX_NAMED_COLLECTIONS = 4
"""Number of contradicting collections that are named, each at least half as bad as the worst one."""
_UNIT_FOR_USER = {"1": (100.0, "%"), "m": (1e3, "mm"), "rad": (180 / np.pi, "deg"), "px": (1.0, "px")}


def what_does_not_fit(calibration: Calibration, limits: Limits, tasks: Sequence[TaskError] = ()) -> tuple[Finding, ...]:
    """Report suspects: a failure if one displaces a sensor, or what a task works on, by more than allowed, else a note.

    Args:
        calibration: a calibration that has converged.
        limits: allowed errors of the sensors.
        tasks: errors of the robot's tasks, of which some have limits.
    """
    explanation = calibration.solution.explanation
    if explanation is None:
        count = len(calibration.solution.model.G)
        text = f"{count} collections are too few to test fixed parameters (intrinsics, pattern, arm): take 8 or more"
        return (Finding("untested", "note", text),)
    suspects = [_worst_alternative(calibration, limits, suspect) for suspect in explanation.suspects]
    found = [(_finding_on_suspect(calibration, limits, suspect, tasks), suspect) for suspect in suspects]
    found.sort(key=lambda each: _limits_moved(calibration, limits, *each), reverse=True)
    findings = [finding for finding, _ in found]
    findings = [*_find_failure_together(calibration, limits, suspects, findings, tasks), *findings]
    contradictions = _find_contradictions(calibration, limits, explanation.disagreement, tasks)
    moves = sum(each.cause.kind == PLACE_KIND for each in suspects)
    findings = [*findings, *contradictions] if moves < MIN_MOVES_OF_UNSTEADY else [*contradictions, *findings]
    return tuple(findings) or (_note_without_suspects(calibration),)


def _limits_moved(calibration: Calibration, limits: Limits, finding: Finding, suspect: Suspect) -> float:
    """Return by how many of its limits a failure certainly moves a sensor; 0 of all else, which stays in its order."""
    if finding.severity != "red" or finding.moves_mm is None or finding.moves_deg is None:
        return 0.0
    unsure = _unsure_of_few_views(calibration, suspect, limits)
    certain = {
        name: (max(0.0, finding.moves_mm - unsure[name][0]), max(0.0, finding.moves_deg - unsure[name][1]))
        for name in finding.sensors
    }
    return max((allowed(calibration, limits, name).share(*each) for name, each in certain.items()), default=0.0)


def _worst_alternative(calibration: Calibration, limits: Limits, suspect: Suspect) -> Suspect:
    """Return, of what may have moved and the data cannot tell apart, what does most harm, with the others as rivals."""
    every = (suspect, *suspect.rivals)
    if suspect.cause.kind != PLACE_KIND or calibration.of_cameras_alone:
        return suspect

    def harm(each: Suspect) -> float:
        moves = _largest_moves(calibration, each.moves), _largest_moves(calibration, _moves_after(calibration, each))
        return max(
            (allowed(calibration, limits, name).share(*size) for moved in moves for name, size in moved.items()),
            default=0.0,
        )

    worst = max((each for each in every if each.cause.kind == PLACE_KIND), key=harm)
    return replace(worst, rivals=tuple(each for each in every if each is not worst))


def _finding_on_suspect(
    calibration: Calibration, limits: Limits, suspect: Suspect, tasks: Sequence[TaskError]
) -> Finding:
    if calibration.of_cameras_alone:
        return _finding_on_cameras(calibration, limits, suspect, tasks)
    cause = suspect.cause
    before, after = (
        _largest_moves(calibration, suspect.moves),
        _largest_moves(calibration, _moves_after(calibration, suspect)),
    )
    moved = {name: _larger_of_each(before[name], after[name]) for name in before}
    unsure, sure = _unsure_of_few_views(calibration, suspect, limits), _sure_moves(calibration, suspect)
    for name, turn in _turns_by_zoom(calibration, suspect).items():
        if name in moved:  # else it is the sensor that is held
            moved[name], sure[name] = (_larger_of_each(of[name], (0.0, turn)) for of in (moved, sure))
    limit_of = {name: allowed(calibration, limits, name) for name in moved}
    certain = moved if cause.kind == PLACE_KIND else sure
    over = [name for name in moved if limit_of[name].exceeded(*certain[name])]
    is_red = bool(over)
    if not over:  # the estimate, or where few views tell its guard band, may reach over the limit
        over = [
            name
            for name, (mm, degrees) in moved.items()
            if limit_of[name].exceeded(mm + unsure[name][0], degrees + unsure[name][1])
        ]
    sensor = max(over or moved, key=lambda name: moved[name][0], default="")
    mm, degrees = moved.get(sensor, (0.0, 0.0))
    names = " or ".join(dict.fromkeys(_name_cause(each.cause) for each in (suspect, *suspect.rivals)))
    since = ""
    collections: tuple[str, ...] = ()
    if suspect.since is not None:
        keys = keys_since(calibration, suspect.since)
        since, collections = f" from collection {keys[0]} on", keys
    changed = suspect.is_change
    verb = "has moved" if cause.kind == PLACE_KIND else "has changed" if changed else "does not fit"
    advice = (ADVICE_ON_CHANGE if changed else ADVICE_ON_CAUSE)[cause.kind]
    either = ", the data cannot tell which" if suspect.rivals else ""
    gross = _is_gross(calibration, suspect) and not (changed and cause.kind == "size")  # another board is as good
    harm = f"it moves {sensor} by {distance_text(mm, degrees)}" if sensor else "it moves no sensor"
    if cause.kind == PLACE_KIND and sensor:
        was, now = distance_text(*before[sensor]), distance_text(*after[sensor])
        harm = f"one pose for all of them is {was} from where {sensor} was before, {now} from where it is now"
        if any(unsure[sensor]):
            harm += (
                f", known to {distance_text(*unsure[sensor])} as few views tell how far; that it has moved is certain, "
                "so that the estimate counts"
            )
    text = f"{names} {verb}{since}{either}: {_describe_size(cause, suspect.value, suspect.sigma)}"
    at_task = worst_at_tasks(tasks, _changes_by(calibration, [suspect]), _errors_of_changes(calibration, suspect))
    if over:
        text += f"; {harm} (limit {limit_of[sensor]}): {advice}"
    elif at_task.broken or at_task.undecided:
        text += f"; {at_task}: {advice}"
    elif gross:
        text += f", more than any {GROSS_DEVIATIONS[cause.kind][1]} errs: {advice}"
    elif not sensor or limits.any_set:
        text += f"; harmless: {at_task or harm}"
    else:
        text += f"; {harm} (limit {limit_of[sensor]})"
    text += f": {advice}" if changed and not text.endswith(advice) else ""
    severity: Severity = "warning" if changed else "note"
    if over or at_task.undecided:
        severity = "red" if is_red else "undecided"
    one = cause.size == 1
    return Finding(
        "suspect",
        "red" if gross or at_task.broken else severity,
        text,
        sensors=tuple(over) if over else tuple(filter(None, [sensor])),
        collections=collections,
        value=float(suspect.value[0]) if one else None,
        sigma=float(suspect.sigma[0]) if one else None,
        unit=cause.unit if one else None,
        moves_mm=round(mm, 4),
        moves_deg=round(degrees, 5),
        tasks=at_task.broken or at_task.undecided,
    )


def _finding_on_cameras(
    calibration: Calibration, limits: Limits, suspect: Suspect, tasks: Sequence[TaskError]
) -> Finding:
    """Report what a cause does to the projection of cameras alone, and to tasks."""
    moved = shifts(calibration, suspect.moves)
    camera = max(moved, key=lambda name: moved[name])
    model = calibration.dataset.sensors[camera].camera
    limit = projection_limit(model, limits) if model else 0.0
    at_task = worst_at_tasks(tasks, _changes_by(calibration, [suspect]))
    red = moved[camera] > limit or bool(at_task.broken)
    names = " or ".join(dict.fromkeys(_name_cause(each.cause) for each in (suspect, *suspect.rivals)))
    text = (
        f"{names} does not fit: {_describe_size(suspect.cause, suspect.value, suspect.sigma)}; it shifts the "
        f"projection of {camera} by {moved[camera]:.2g} px (limit {limit:.3g} px)"
    )
    text += f"; {at_task}" if at_task.broken else ""
    text += f": {ADVICE_ON_CAUSE.get(suspect.cause.kind, 'look at it')}" if red else ""
    return Finding(
        "suspect",
        "red" if red else "note",
        text,
        (camera,),
        value=round(moved[camera], 4),
        unit="px",
        tasks=at_task.broken,
    )


def distance_text(mm: float, degrees: float) -> str:
    """Return a displacement and a rotation in words."""
    return f"{mm:.3g} mm and {degrees:.2g} deg"


def _unsure_of_few_views(calibration: Calibration, suspect: Suspect, limits: Limits) -> dict[str, tuple[float, float]]:
    """Return the guard band of each sensor's displacement of which few views tell, mm and degrees; zeros of others.

    That something has moved is certain then, and how far is not.
    """
    K = len(calibration.solution.model.G)
    few = suspect.since is not None and min(suspect.since, K - suspect.since) < MIN_CLUSTERS_ON_A_SIDE
    guard = limits.guard * few
    return {name: (guard * mm, guard * deg) for name, (mm, deg) in _sigmas_of_moves(calibration, suspect).items()}


def _sigmas_of_moves(calibration: Calibration, suspect: Suspect) -> dict[str, tuple[float, float]]:
    """Return the standard deviations of what a suspect moves each sensor or joint by, mm and degrees."""
    before, after = (
        _largest_moves(calibration, np.linalg.norm(by @ suspect.errors, axis=1))
        for by in (suspect.moved_by, _moved_after(calibration, suspect))
    )
    return {name: _larger_of_each(before[name], after[name]) for name in before}


def _turns_by_zoom(calibration: Calibration, suspect: Suspect) -> dict[str, float]:
    """Return by how many degrees the rays at the image's corners are other ones since a camera's lens was changed."""
    if not suspect.is_change or suspect.cause.kind != "focal length":
        return {}
    sensors = [calibration.dataset.sensors[name] for name in suspect.cause.subject.split(" and ")]
    slopes = {each.name: np.hypot(c.width / c.fx, c.height / c.fy) / 2 for each in sensors if (c := each.camera)}
    return {name: float(np.degrees(abs(suspect.value[0]) * slope / (1 + slope**2))) for name, slope in slopes.items()}


def _sure_moves(calibration: Calibration, suspect: Suspect) -> dict[str, tuple[float, float]]:
    """Return what a suspect moves each sensor or joint by, mm and degrees, without what its error makes it longer."""
    setup = calibration.solution.setup
    at = setup.problem.shared_parameters

    def sure(by: Array, name: str) -> tuple[float, float]:
        block, units = block_of(calibration, name)
        lengths = np.array(units) == SENSOR_UNITS[0]
        mm, rad = (
            size_without_error(by[at[block]][own] @ suspect.value, by[at[block]][own] @ suspect.errors)
            for own in (lengths, ~lengths)
        )
        return 1e3 * mm, float(np.degrees(rad))

    ways = suspect.moved_by, _moved_after(calibration, suspect)
    names = _largest_moves(calibration, suspect.moves)
    return {name: _larger_of_each(sure(ways[0], name), sure(ways[1], name)) for name in names}


def _larger_of_each(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    return max(one[0], other[0]), max(one[1], other[1])


def _is_gross(calibration: Calibration, suspect: Suspect) -> bool:
    """Whether a cause is off by more than any camera, board or arm errs."""
    kind, value = suspect.cause.kind, suspect.value
    if kind not in GROSS_DEVIATIONS:
        return False
    if kind in (RADIAL_KIND, PROJECTION_KIND):
        camera = calibration.dataset.sensors[suspect.cause.subject.split(" and ")[0]].camera
        if camera is None:
            return False
        value = _radial_stretch(camera, value)
    return float(np.abs(value).max()) > GROSS_DEVIATIONS[kind][0]


def _radial_stretch(camera: Camera, changes: Array) -> Array:
    """Return by what part of itself the distance from the image's centre changes with the radial coefficients.

    From the centre to the image's nearer border; NaN where the lens has no ray.
    """
    lens = camera.distortion
    r = np.linspace(0, min(camera.width / camera.fx, camera.height / camera.fy) / 2, 20)[1:]
    x, none = lens.undistort(r, np.zeros_like(r))
    derivatives = dict(zip(lens.names(), lens.derivatives(x, none), strict=True))
    part = sum(k * derivatives[name][0] for name, k in zip(lens.radial, changes.tolist(), strict=False)) / r
    return np.asarray(np.nan_to_num(part))


def _moves_after(calibration: Calibration, suspect: Suspect) -> Array:
    """Return the changes (S,) of the calibrated parameters to where the sensors are at the end of the recording.

    Those of a suspect are to where they were before it moved.
    """
    moves: Array = _moved_after(calibration, suspect) @ suspect.value
    return moves


def _moved_after(calibration: Calibration, suspect: Suspect) -> Array:
    """Return the changes (S, k) by a deviation likewise; of a sensor that is held all others move the other way."""
    dataset, setup, moved_by = calibration.dataset, calibration.solution.setup, suspect.moved_by.copy()
    moved = dataset.sensors.get(suspect.cause.subject)
    if suspect.cause.kind != PLACE_KIND or moved is None:
        return moved_by
    at = setup.problem.shared_parameters
    if (block := setup.block(moved.edge)) in at:
        moved_by[at[block]] += np.eye(6)
        return moved_by
    for sensor in dataset.sensors.values():
        if (block := setup.block(sensor.edge)) in at:
            T_sensor_moved = dataset.transform(sensor.frame, moved.frame)[-1]
            moved_by[at[block]] -= adjoint(T_sensor_moved)
    return moved_by


def _changes_by(calibration: Calibration, suspects: Sequence[Suspect]) -> list[Array]:
    """Return the changes (C,) of all columns of the model by suspects together: to before, and to after a move.

    Where few views are before it, to after it alone: these are of the past.
    """
    model = calibration.solution.model
    both = np.zeros((2, model.total.shape[0]))
    for each in suspects:
        both[:, : model.shared] += each.moves, _moves_after(calibration, each)
        both[:, columns_of_cause(model, each.cause)] += each.value
    return list(both[int(any(map(_is_of_the_past, suspects))) :])


def _is_of_the_past(suspect: Suspect) -> bool:
    return suspect.since is not None and suspect.since < MIN_CLUSTERS_ON_A_SIDE


def _errors_of_changes(calibration: Calibration, suspect: Suspect) -> list[Array]:
    """Return the errors (C, r) of the changes of all columns by a suspect likewise."""
    model = calibration.solution.model
    both = np.zeros((2, model.total.shape[0], suspect.errors.shape[1]))
    both[:, : model.shared] = suspect.moved_by @ suspect.errors, _moved_after(calibration, suspect) @ suspect.errors
    both[:, columns_of_cause(model, suspect.cause)] += suspect.errors
    return list(both[int(_is_of_the_past(suspect)) :])


def _find_failure_together(
    calibration: Calibration,
    limits: Limits,
    suspects: Sequence[Suspect],
    findings: Sequence[Finding],
    tasks: Sequence[TaskError],
) -> list[Finding]:
    """Report a failure if no suspect exceeds the limits by itself, but all of them together do.

    Each was tested with the previous ones free, so that their effects add up.
    """
    if len(suspects) < 2 or any(each.severity == "red" for each in findings):
        return []
    causes = ", ".join(_name_cause(each.cause) for each in suspects)
    if (at_task := worst_at_tasks(tasks, _changes_by(calibration, suspects)[-1:])).broken:
        text = f"{causes} do not fit: together {at_task}: {ADVICE_ON_CAUSE[suspects[0].cause.kind]}"
        return [Finding("suspect", "red", text, tasks=at_task.broken)]
    moved = _largest_moves(calibration, np.sum([each.moves for each in suspects], axis=0))
    for name, (mm, degrees) in moved.items():
        limit = allowed(calibration, limits, name)
        if limit.exceeded(mm, degrees):
            text = (
                f"{causes} do not fit: together they move {name} by {mm:.3g} mm and {degrees:.2g} deg (limit {limit}): "
            )
            text += ADVICE_ON_CAUSE[suspects[0].cause.kind]
            return [Finding("suspect", "red", text, (name,), moves_mm=round(mm, 4), moves_deg=round(degrees, 5))]
    return []


def _name_cause(cause: Cause) -> str:
    return cause.subject if cause.kind in (PLACE_KIND, RING_KIND) else f"{cause.subject}'s {cause.kind}"


def _describe_size(cause: Cause, value: Array, sigma: Array) -> str:
    """Describe the deviation of a cause, with its standard deviation, in the user's units."""
    if cause.size == 6:  # a twist: translation and rotation
        mm, deg = (
            [factor * float(np.linalg.norm(each[part])) for each in (value, sigma)]
            for factor, part in ((1e3, slice(3)), (float(np.degrees(1)), slice(3, 6)))
        )
        return f"{with_error_bar(*mm)} mm, {with_error_bar(*deg)} deg"
    if cause.unit == "collections":
        return f"{value[0]:+.3g} ± {rounded(sigma[0], 1)} of the way to the next collection"
    if cause.kind == LENS_KIND:
        return "off in several parameters at once"
    if cause.kind == SAG_KIND:
        (low, tilt), (of_low, of_tilt) = value, sigma
        return (
            f"its end hangs lower by {with_error_bar(1e3 * low, 1e3 * of_low)} mm and is tilted by "
            f"{with_error_bar(np.degrees(tilt), np.degrees(of_tilt))} deg where it reaches 1 m"
        )
    if cause.kind == ECCENTRICITY_KIND:
        turn, of_turn = (np.degrees(np.linalg.norm(each[:2])) for each in (value, sigma))
        return f"off by {with_error_bar(turn, of_turn)} deg to either side in a turn"
    factor, unit = _UNIT_FOR_USER.get(cause.unit, (1.0, cause.unit))
    if cause.unit == "1":  # a relative change of d is extrapolated with an error of its square
        sigma = np.hypot(sigma, value**2 / 2)
    if "distortion" in cause.kind or cause.kind in ("lens model", PROJECTION_KIND):
        factor, unit = 1.0, ""
    numbers = ", ".join(f"{factor * v:+.3g} ± {rounded(factor * s, 1)}" for v, s in zip(value, sigma, strict=True))
    return f"off by {numbers} {unit}".rstrip()


def _largest_moves(calibration: Calibration, moves: Array) -> dict[str, tuple[float, float]]:
    """Return the displacements of each calibrated sensor and joint, mm and degrees."""
    setup = calibration.solution.setup
    at = setup.problem.shared_parameters
    sensors = {sensor.name: setup.block(sensor.edge) for sensor in setup.dataset.sensors.values()}
    moved = {name: sizes(moves[at[block]], TWIST_UNITS) for name, block in sensors.items() if block in at}
    for name, joint in calibration.joints.items():
        moved[name] = sizes(moves[at[setup.block(setup.dataset.joints[name].edge)]], joint.units)
    return moved


def keys_since(calibration: Calibration, since: int) -> tuple[str, ...]:
    """Return the collections of the clusters from an index on."""
    solution = calibration.solution
    return tuple(
        key for key, at in zip(solution.dataset.keys, solution.model.clusters.tolist(), strict=True) if at >= since
    )


def _find_contradictions(
    calibration: Calibration, limits: Limits, found: Disagreement, tasks: Sequence[TaskError]
) -> list[Finding]:
    """Report sensors whose views contradict each other by more than noise and all that is assumed explain.

    Each is tested by itself, so that good ones do not hide a bad one: red if it is more likely than not off by more
    than its limit. Where only the guard band reaches over it, `calibration.engine.diagnosis.precision` says so.
    """
    if calibration.of_cameras_alone:
        return _contradiction_of_cameras(calibration, found)
    setup = calibration.solution.setup
    at = setup.problem.shared_parameters
    edges = {sensor.name: sensor.edge for sensor in calibration.dataset.sensors.values()}
    places = {name: at[block] for name, edge in edges.items() if (block := setup.block(edge)) in at}
    beyond = {name: found.beyond(own) for name, own in places.items()}
    significant = [
        name
        for name, ratio in beyond.items()
        if ratio > MIN_CONTRADICTING_FACTOR
        and score_of_f(ratio, found.freedom(places[name]), DEGREES_IF_NOT_ESTIMATED) > threshold(len(beyond))
    ]
    limit_of = {name: allowed(calibration, limits, name) for name in places}
    sigmas = {name: each for name, each in stated(calibration).items() if name in places}
    unsure = any(limit_of[name].exceeded(limits.guard * mm, limits.guard * deg) for name, (mm, deg) in sigmas.items())
    varying = calibration.solution.varying if significant or unsure or neighbours_err_alike(calibration) else None
    findings = []
    for name in sorted(beyond, key=lambda each: -beyond[each]):
        limit, (mm, degrees) = limit_of[name], sigmas[name]
        off = _off_by_variation(varying, places[name], name not in significant) if varying else (mm, degrees)
        within = off[0] < limits.guard * mm and off[1] < limits.guard * degrees  # what its error bar says already
        if name not in significant and (varying is None or within or not limit.exceeded(*off)):
            continue
        subject, keys = _worst_subject(calibration, found, (name, *calibration.dataset.patterns))
        broken = tuple(each.task.name for each in tasks if _is_broken(each, places[name]))
        worst = max(false_accept(mm, limit.translation_mm), false_accept(degrees, limit.rotation_deg))
        harmful = bool(broken) or (varying is not None and limit.exceeded(*off))
        if name in significant and (varying is None or varying.causes[0].kind == PLACE_KIND):  # it does not stand still
            harmful = harmful or worst > MIN_FAILURE_PROBABILITY
        where, advice = f"most {subject} in {_list_collections(keys)}", AT_STANDSTILL
        if varying:
            advice = ADVICE_ON_VARIATION.get(varying.causes[0].kind, AT_STANDSTILL)
            text = f"{where}, as {_describe_variation(varying)}; by that it is off by "
            text += f"{distance_text(*off)} (limit {limit})"
        else:
            text = (
                f"they scatter {beyond[name] ** 0.5:.2g} times as far as noise and all that is assumed explain, "
                f"{where}, and leave it uncertain by {distance_text(mm, degrees)} (limit {limit}); no fixed parameter "
                "explains it: time stamps, or something that moved or gave way"
            )
        text = f"the views of {name} contradict each other: {text}{f': {advice}' if harmful else ''}"
        severity: Severity = "red" if harmful else "note"
        findings.append(Finding("contradiction", severity, text, (name,), keys, value=beyond[name], tasks=broken))
    return findings


def _off_by_variation(varying: VaryingCause, own: slice, surely: bool) -> tuple[float, float]:
    """Return by how much a sensor is as likely off by more as by less, mm and degrees, if a cause varies.

    Args:
        varying: the cause.
        own: the sensor's parameters.
        surely: only what its error bar does not explain, of a sensor whose views need not contradict each other.
    """
    change, C = varying.change[own], varying.covariance[own, own]
    m, rad = (
        size_without_error(change[part], np.asarray(np.linalg.cholesky(C[part, part])))
        if surely
        else median_of_norm(change[part], C[part, part])
        for part in (slice(3), slice(3, 6))
    )
    return 1e3 * m, float(np.degrees(rad))


def _describe_variation(varying: VaryingCause) -> str:
    cause, sigmas = varying.causes[0], varying.sigmas
    names = " or ".join(dict.fromkeys(_name_cause(each) for each in varying.causes))
    if cause.size == 6:
        size = distance_text(1e3 * sigmas[0], float(np.degrees(sigmas[3])))
    else:
        factor, unit = _UNIT_FOR_USER.get(cause.unit, (1.0, cause.unit))
        size = f"{factor * sigmas.max():.2g} {unit}"
    which = ", the data cannot tell which," if varying.causes[1:] else ""
    return f"{names}{which} {'moves' if cause.kind == PLACE_KIND else 'varies'} from collection to collection by {size}"


def _is_broken(task: TaskError, own: slice) -> bool:
    """Whether a task that depends on parameters whose views contradict each other is broken by that.

    It is more likely than not beyond its limit at its worst point; or would hold but for their disagreement.
    """
    limit, worst = task.task.limit, [task.worst]
    if limit is None or not np.abs(task.jacobian[:, :, own]).any():
        return False
    probable = probability_beyond(task.covariance[worst], limit)[0] > MIN_FAILURE_PROBABILITY
    return bool(probable) or breaks_by_disagreement(task)


def _worst_subject(calibration: Calibration, found: Disagreement, names: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """Return the sensor or pattern that disagrees most, and its worst collections (`MAX_NAMED_COLLECTIONS`)."""
    of = {name: found.sizes[name] for name in names if name in found.sizes}
    subject = max(of, key=lambda name: of[name].max())
    sizes = of[subject]
    worst = [i for i in np.argsort(-sizes)[:MAX_NAMED_COLLECTIONS].tolist() if sizes[i] >= sizes.max() / 2]
    return subject, tuple(keys_since(calibration, i)[0] for i in worst)


def _list_collections(keys: Sequence[str]) -> str:
    return f"collection{'s' * (len(keys) > 1)} {', '.join(keys)}"


def _contradiction_of_cameras(calibration: Calibration, found: Disagreement) -> list[Finding]:
    """Report views of cameras alone that contradict each other, as a note: what it does is in their error bars."""
    level = calibration.noise_levels.pixel
    if not found.contradicts or not level:
        return []
    subject, keys = _worst_subject(calibration, found, tuple(found.sizes))
    text = (
        f"the views contradict each other by {found.excess * level:.2g} px where {level:.2g} px is the noise, most "
        f"{subject} in {_list_collections(keys)}, and no fixed parameter explains it: a board that bends, motion in "
        "the images, or a lens with more than its model"
    )
    return [Finding("contradiction", "note", text, (subject,), keys, value=found.ratio)]


def _note_without_suspects(calibration: Calibration) -> Finding:
    """Return the note for a calibration without suspects: the contributions to its standard deviations."""
    text = "nothing suspicious"
    bars = calibration.error_bars
    worth = bars.worth if bars else {}
    most = max(worth, key=lambda name: worth[name], default="")
    if most and worth[most] > 0:
        text += (
            f"; the result hangs most on the {most}: the usual uncertainty of it is worth {1e3 * worth[most]:.2g} mm"
        )
    return Finding("nothing-suspicious", "note", text)
