"""Verdict on the differences from the accepted calibration: failure, note, or nothing."""

import math
from dataclasses import dataclass

import numpy as np

from calibration.base import rounded
from calibration.base.verdict import at_most
from calibration.engine.baseline.calibration_document import CalibrationDocument, SoftwareStart
from calibration.engine.baseline.comparison import BaselineChange, BaselineComparison, compare
from calibration.engine.baseline.quality import (
    HOW_TO_ACCEPT,
    BaselineSettings,
    SameData,
    largest_standard_deviations,
    promise_not_kept,
    quality,
    worse_than_baseline,
)
from calibration.engine.diagnosis.finding import Finding

MIN_AXIS_COMPONENT = 0.9
"""A direction with at least this component along an axis is named by the axis."""
LEAST_P = 1e-9
MAX_NEGLIGIBLE_SIGMAS = 0.1
"""Tolerance for the distance of other software from the optimum, as a fraction of the standard deviation."""


@dataclass(frozen=True)
class Accepted:
    """Accepted calibration that a system's cells are compared with."""

    settings: BaselineSettings
    snapshot: CalibrationDocument | None
    """The accepted calibration; None if none of the system has been accepted."""
    since: str = ""
    """The file and its last commit, for messages: "calibration-baseline.json of 2026-11-02 (1a2b3c4)"."""


def against_baseline(
    accepted: Accepted, now: CalibrationDocument
) -> tuple[BaselineComparison | None, tuple[Finding, ...]]:
    """Compare a calibration with the accepted one.

    Returns:
        The comparison, None if nothing has been accepted; and the findings.
    """
    if accepted.snapshot is None:
        return None, nothing_accepted(accepted)
    comparison = compare(accepted.snapshot, now)
    since, settings = accepted.since, accepted.settings
    found = [each for change in comparison.changes if (each := _finding_of_change(change, comparison, settings, since))]
    found += quality(comparison, settings)
    found += promise_not_kept(accepted.snapshot, now, since)
    if not any(each.kind == "baseline" and each.severity == "red" for each in found) and not comparison.same_data:
        found += _nothing_moved(comparison, since)
    return comparison, tuple(found)


def nothing_accepted(accepted: Accepted) -> tuple[Finding, ...]:
    """Return a failure if an accepted calibration is required; else nothing: the report lists all such systems."""
    if not accepted.settings.required:
        return ()
    text = f"no calibration of it has been accepted in {accepted.since}: calibration accept"
    return (Finding("no-baseline", "red", text),)


def _finding_of_change(
    change: BaselineChange, comparison: BaselineComparison, settings: BaselineSettings, since: str
) -> Finding | None:
    if change.kind == "added":
        return Finding("baseline", "note", f"{change.name} is calibrated, and not in {since}: {HOW_TO_ACCEPT}")
    if change.kind == "removed":
        text = f"{change.name} is in {since}, and calibrated no more: was it renamed, or left out? Else {HOW_TO_ACCEPT}"
        return Finding("baseline", "red", text)
    if comparison.same_data:
        return _on_the_same_data(change, comparison, settings, since)
    return _on_other_data(change, comparison, settings, since)


def _on_the_same_data(
    change: BaselineChange, comparison: BaselineComparison, settings: BaselineSettings, since: str
) -> Finding | None:
    if not exceeds(change, settings.same_data):
        return None
    text = (
        f"{change.name} differs from {since} on the same data: {size_of_change(change)}, "
        f"{_sigmas_text(change.sigmas)}; "
        f"{_possible_causes(comparison)}, or {HOW_TO_ACCEPT}"
    )
    return _moved_finding("red", change, text)


def exceeds(change: BaselineChange, least: SameData) -> bool:
    """Whether the difference of a pose or a parameter is larger than the tolerances of a result on the same data."""
    over_mm = change.mm > max(least.translation_mm, least.sigmas * change.sigma_mm)
    over_deg = change.deg > max(least.rotation_deg, least.sigmas * change.sigma_deg)
    plain = change.kind == "parameter" and change.unit not in ("m", "rad") and change.sigmas > least.sigmas
    return over_mm or over_deg or plain


def _on_other_data(
    change: BaselineChange, comparison: BaselineComparison, settings: BaselineSettings, since: str
) -> Finding | None:
    if change.p >= comparison.significance:
        return None
    moved = "has moved" if change.kind == "pose" else "has changed"
    p = f"< {LEAST_P:.0e}" if change.p < LEAST_P else f"= {change.p:.1g}"
    chance = f"p {p} that this is chance"
    text = f"{change.name} {moved} since {since}: {size_of_change(change)}; {chance}"
    harmless = change.kind == "pose" and change.mm <= settings.translation_mm and change.deg <= settings.rotation_deg
    if harmless:
        allowed = f"{settings.translation_mm:g} mm, {settings.rotation_deg:g} deg"
        return _moved_finding("note", change, f"{text}; allowed {allowed}")
    others = f", and at {', '.join(comparison.other_inputs)}, which changed too" if comparison.other_inputs else ""
    return _moved_finding("red", change, f"{text}: look at {_suspected_part(change)}{others}, or {HOW_TO_ACCEPT}")


def _suspected_part(change: BaselineChange) -> str:
    """Return what is likely to have changed on the robot."""
    if change.kind == "pose":
        return "its mount"
    if change.kind == "lens":
        return "its focus and zoom"
    return "the joint" if change.unit in ("m", "rad") else "the lens"


def _possible_causes(comparison: BaselineComparison) -> str:
    """Return possible causes of a different result on the same data."""
    if comparison.other_inputs:
        return f"what changed beside: {', '.join(comparison.other_inputs)}: look there"
    if comparison.before.inputs:
        return "nothing that goes in has changed, but the program has: look at it"
    return "look at what this change does to the description, the options or the engine"


def _moved_finding(severity: str, change: BaselineChange, text: str) -> Finding:
    return Finding(
        "baseline",
        "red" if severity == "red" else "note",
        text,
        sensors=(change.name,),
        moves_mm=round(change.mm, 4),
        moves_deg=round(change.deg, 5),
    )


def _nothing_moved(comparison: BaselineComparison, since: str) -> list[Finding]:
    """Return the note that no pose has moved, with the largest move that would not be detected."""
    poses = [each for each in comparison.changes if each.kind == "pose"]
    if not poses:
        return []
    worst = max(poses, key=lambda each: each.unseen_mm)
    text = f"nothing has moved since {since}; a move of {worst.name} by up to {worst.unseen_mm:.2g} mm would go unseen"
    return [Finding("baseline-unmoved", "note", text, (worst.name,))]


def size_of_change(change: BaselineChange) -> str:
    """Describe a change's size and direction: "4.9 ± 0.3 mm along its x, 0.5 ± 0.02 deg about its z"."""
    if change.kind == "lens":
        return f"its parameters together by {_sigmas_text(change.sigmas)}"
    if change.kind == "parameter":
        sigma = "" if change.sigma is None else f" ± {change.sigma:.2g}"
        unit = "" if change.unit in (None, "1") else f" {change.unit}"
        return f"by {change.value:+.3g}{sigma}{unit}"
    parts = [
        f"{size:.3g} ± {sigma:.2g} {unit}{_direction_text(vector, word) if size > sigma else ''}"
        for size, sigma, unit, vector, word in (
            (change.mm, change.sigma_mm, "mm", change.translation_mm, "along"),
            (change.deg, change.sigma_deg, "deg", change.rotation_deg, "about"),
        )
        if size > sigma / 100
    ]
    return ", ".join(parts) or "by less than its digits"


def _direction_text(vector: tuple[float, ...], word: str) -> str:
    norm = math.hypot(*vector)
    parts = np.array(vector) / (norm or 1.0)
    axis = int(np.abs(parts).argmax())
    if abs(parts[axis]) >= MIN_AXIS_COMPONENT:
        return f" {word} its {'-' if parts[axis] < 0 else ''}{'xyz'[axis]}"
    return f" {word} its ({', '.join(f'{part:.2f}' for part in parts)})"


def _sigmas_text(sigmas: float) -> str:
    if sigmas >= 1e6:
        return "with no error bar"
    return f"{rounded(sigmas, 2)} standard deviations"


def software_against_baseline(accepted: Accepted, now: SoftwareStart, data: str) -> tuple[Finding, ...]:
    """Return findings on other software that got worse from one initial guess on the same data; empty on other data.

    Args:
        accepted: the accepted calibration.
        now: the software's result from this initial guess.
        data: the hash of the labels.
    """
    before = accepted.snapshot
    if before is None or before.data != data:
        return ()
    earlier = next((each for each in before.software if each.start == now.start), None)
    if earlier is None:
        return ()
    most = accepted.settings.max_increase.rms
    rows = [
        ("RMS", earlier.rms_px, now.rms_px, 0.0, "px"),
        (
            "distance from our optimum",
            earlier.distance_mm,
            now.distance_mm,
            MAX_NEGLIGIBLE_SIGMAS * largest_standard_deviations(before, before)[0],
            "mm",
        ),
    ]
    return tuple(
        Finding("baseline-quality", "red", worse_than_baseline(check, old), value=new)
        for what, old, new, extra, unit in rows
        if old is not None and not (check := at_most(what, new, most.above(old) + extra, unit)).passed
    )
