"""Suspects as findings: the parameter that does not fit, its deviation, its effect on the sensors, and advice."""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.diagnosis.finding import Finding, Severity
from calibration.diagnosis.limits import TWIST, Limits, allowed, sizes, stated
from calibration.diagnosis.projection import projection_limit, shifts
from calibration.estimation.held import PLACE, Cause
from calibration.estimation.result import Calibration
from calibration.estimation.suspects import Explanation, Suspect, explain
from calibration.geometry.types import Array

KIND = "suspect"
NOTHING = "nothing-suspicious"
UNTESTED = "untested"
GROSS: Mapping[str, float] = {"focal length": 0.025, "image scale": 0.025, "principal point": 15.0}
"""Deviation of camera_info (relative, px) that is a failure regardless of its effect: it belongs to another camera."""
ADVICE: Mapping[str, str] = {
    "focal length": "calibrate the intrinsics, or take the camera_info that belongs to this lens and resolution",
    "aspect": "calibrate the intrinsics; were the images scaled?",
    "principal point": "calibrate the intrinsics; were the images cropped?",
    "pixel convention": "pixel (0, 0) is the centre of the first pixel here; shift cx and cy by half a pixel",
    "image scale": "the labels are of another resolution than camera_info",
    "skew": "calibrate the intrinsics",
    "radial distortion": "calibrate the intrinsics with this lens model, or a richer one",
    "tangential distortion": "calibrate the intrinsics with this lens model, or a richer one",
    "lens model": "calibrate the intrinsics with a richer lens model (rational_polynomial, equidistant)",
    "range bias": "correct the sensor's ranges, or hold it to a surveyed distance",
    "range scale": "correct the sensor's ranges, or measure the pattern again",
    "beam elevation": "look at the sensor's own calibration of its beams",
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
    "encoder offset": "look at this joint's zero, or calibrate its position_bias",
    "encoder gain": "look at this joint's unit and gear ratio",
    "backlash": "approach every pose from the same side",
    "lag": "look at time stamps; stop the robot for each collection",
    PLACE: "something was knocked; collect anew, or calibrate the collections before and after apart",
}
_UNITS = {"1": (100.0, "%"), "m": (1e3, "mm"), "rad": (180 / np.pi, "deg"), "px": (1.0, "px")}


def what_does_not_fit(calibration: Calibration, limits: Limits) -> tuple[Finding, ...]:
    """Report suspects: a failure if one displaces a sensor by more than allowed, else a note.

    Args:
        calibration: a calibration that has converged.
        limits: allowed errors of the sensors.
    """
    explanation = explain(calibration.solution.model)
    if explanation is None:
        count = len(calibration.solution.model.G)
        text = f"{count} collections are too few to test fixed parameters (intrinsics, pattern, arm): take 8 or more"
        return (Finding(UNTESTED, "note", text),)
    findings = [_finding(calibration, limits, suspect) for suspect in explanation.suspects]
    findings += _together(calibration, limits, explanation.suspects, findings)
    findings += _contradiction(calibration, limits, explanation)
    return tuple(findings) or (_nothing(calibration),)


def _finding(calibration: Calibration, limits: Limits, suspect: Suspect) -> Finding:
    if calibration.of_cameras_alone:
        return _finding_on_cameras(calibration, limits, suspect)
    moved = _moved(calibration, suspect.moves)
    over = [name for name, motion in moved.items() if allowed(calibration, limits, name).exceeded(*motion)]
    sensor = max(over or moved, key=lambda name: moved[name][0], default="")
    mm, degrees = moved.get(sensor, (0.0, 0.0))
    names = " or ".join(dict.fromkeys(_name(each) for each in (suspect.cause, *suspect.rivals)))
    since = ""
    collections: tuple[str, ...] = ()
    if suspect.since is not None:
        keys = _keys(calibration, suspect.since)
        since, collections = f" from collection {keys[0]} on", keys
    size = f"{_size(suspect.cause, suspect.value, suspect.sigma)}"
    verb = "has moved" if suspect.cause.kind == PLACE else "does not fit"
    either = ", the data cannot tell which" if suspect.rivals else ""
    gross = float(np.abs(suspect.value).max()) > GROSS.get(suspect.cause.kind, np.inf)
    harm = f"moves {sensor} by {mm:.3g} mm and {degrees:.2g} deg" if sensor else "moves no sensor"
    if over:
        text = f"{names} {verb}{since}{either}: {size}; it {harm} (limit {allowed(calibration, limits, sensor)}): "
        text += ADVICE[suspect.cause.kind]
    elif gross:
        text = f"{names} {verb}{since}{either}: {size}, more than any camera errs: {ADVICE[suspect.cause.kind]}"
    else:
        text = f"{names} {verb}{since}{either}: {size}; harmless: it {harm}"
    one = suspect.cause.size == 1
    return Finding(
        KIND,
        "red" if over or gross else "note",
        text,
        sensors=tuple(over) if over else tuple(filter(None, [sensor])),
        collections=collections,
        value=float(suspect.value[0]) if one else None,
        sigma=float(suspect.sigma[0]) if one else None,
        unit=suspect.cause.unit if one else None,
        moves_mm=round(mm, 4),
        moves_deg=round(degrees, 5),
    )


def _finding_on_cameras(calibration: Calibration, limits: Limits, suspect: Suspect) -> Finding:
    """Report what a cause does to the projection of cameras alone."""
    moved = shifts(calibration, suspect.moves)
    camera = max(moved, key=lambda name: moved[name])
    model = calibration.dataset.sensors[camera].camera
    limit = projection_limit(model, limits) if model else 0.0
    red = moved[camera] > limit
    names = " or ".join(dict.fromkeys(_name(each) for each in (suspect.cause, *suspect.rivals)))
    text = (
        f"{names} does not fit: {_size(suspect.cause, suspect.value, suspect.sigma)}; it shifts the projection of "
        f"{camera} by {moved[camera]:.2g} px (limit {limit:.3g} px)"
    )
    text += f": {ADVICE.get(suspect.cause.kind, 'look at it')}" if red else ""
    return Finding(KIND, "red" if red else "note", text, (camera,), value=round(moved[camera], 4), unit="px")


def _together(
    calibration: Calibration, limits: Limits, suspects: Sequence[Suspect], findings: Sequence[Finding]
) -> list[Finding]:
    """Report a failure if no suspect exceeds the limits by itself, but all of them together do.

    Each was tested with the previous ones free, so that their effects add up.
    """
    if len(suspects) < 2 or any(each.severity == "red" for each in findings):
        return []
    moved = _moved(calibration, np.sum([each.moves for each in suspects], axis=0))
    for name, (mm, degrees) in moved.items():
        limit = allowed(calibration, limits, name)
        if limit.exceeded(mm, degrees):
            causes = ", ".join(_name(each.cause) for each in suspects)
            text = (
                f"{causes} do not fit: together they move {name} by {mm:.3g} mm and {degrees:.2g} deg (limit {limit}): "
            )
            text += ADVICE[suspects[0].cause.kind]
            return [Finding(KIND, "red", text, (name,), moves_mm=round(mm, 4), moves_deg=round(degrees, 5))]
    return []


def _name(cause: Cause) -> str:
    return cause.subject if cause.kind == PLACE else f"{cause.subject}'s {cause.kind}"


def _size(cause: Cause, value: Array, sigma: Array) -> str:
    """Describe the deviation of a cause, with its standard deviation, in the user's units."""
    if cause.size == 6:  # a twist: translation and rotation
        return (
            f"{1e3 * np.linalg.norm(value[:3]):.3g} +- {1e3 * np.linalg.norm(sigma[:3]):.1g} mm, "
            f"{np.degrees(np.linalg.norm(value[3:])):.3g} +- {np.degrees(np.linalg.norm(sigma[3:])):.1g} deg"
        )
    if cause.unit == "collections":
        return f"{value[0]:+.3g} +- {sigma[0]:.1g} of the way to the next collection"
    factor, unit = _UNITS.get(cause.unit, (1.0, cause.unit))
    if "distortion" in cause.kind or cause.kind == "lens model":
        factor, unit = 1.0, ""
    numbers = ", ".join(f"{factor * v:+.3g} +- {factor * s:.1g}" for v, s in zip(value, sigma, strict=True))
    return f"off by {numbers} {unit}".rstrip()


def _moved(calibration: Calibration, moves: Array) -> dict[str, tuple[float, float]]:
    """Return the displacements of each calibrated sensor and joint, mm and degrees."""
    setup = calibration.solution.setup
    at = setup.problem.shared_parameters
    sensors = {sensor.name: setup.block(sensor.edge) for sensor in setup.dataset.sensors.values()}
    moved = {name: sizes(moves[at[block]], TWIST) for name, block in sensors.items() if block in at}
    for name, joint in calibration.joints.items():
        moved[name] = sizes(moves[at[setup.block(setup.dataset.joints[name].edge)]], joint.units)
    return moved


def _keys(calibration: Calibration, since: int) -> tuple[str, ...]:
    """Return the collections of the clusters from an index on."""
    solution = calibration.solution
    return tuple(
        key for key, at in zip(solution.dataset.keys, solution.model.clusters.tolist(), strict=True) if at >= since
    )


def _contradiction(calibration: Calibration, limits: Limits, explanation: Explanation) -> list[Finding]:
    """Report views that contradict each other by more than the noise, an arm and fixed parameters explain."""
    found = explanation.disagreement
    if not found.contradicts:
        return []
    cluster, subject = found.worst
    key = _keys(calibration, cluster)[0]
    level = calibration.noise_levels.pixel
    noise = f"{found.excess * level:.2g} px where {level:.2g} px is the noise" if level else f"{found.excess:.2g} sigma"
    harmful = any(
        allowed(calibration, limits, name).exceeded(limits.guard * mm, limits.guard * degrees)
        for name, (mm, degrees) in stated(calibration).items()
    )
    is_set = limits.translation_mm is not None or limits.rotation_deg is not None
    severity: Severity = "note" if not harmful else "red" if is_set else "warning"
    why = "a board that bends, motion in the images, or a lens with more than its model"
    if not calibration.of_cameras_alone:
        why = "time stamps, or something that moved or gave way"
    text = (
        f"the views contradict each other by {noise}, most {subject} in collection {key}, and no fixed parameter "
        f"explains it: {why}"
    )
    return [Finding("contradiction", severity, text, (subject,), (key,), value=found.ratio)]


def _nothing(calibration: Calibration) -> Finding:
    """Return the note for a calibration without suspects: the contributions to its standard deviations."""
    text = "nothing suspicious"
    bars = calibration.error_bars
    worth = bars.worth if bars else {}
    most = max(worth, key=lambda name: worth[name], default="")
    if most and worth[most] > 0:
        text += (
            f"; the result hangs most on the {most}: the usual uncertainty of it is worth {1e3 * worth[most]:.2g} mm"
        )
    return Finding(NOTHING, "note", text)
