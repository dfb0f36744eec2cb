"""What was promised of further poses with an accepted calibration, against what a later recording has reached."""

from collections.abc import Iterator

import numpy as np

from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.diagnosis.finding import Finding, Severity

MAX_OFF = 1.5
"""Factor between what was promised and what is reached, from which on it is stated."""


def promise_not_kept(before: CalibrationDocument, now: CalibrationDocument, since: str) -> Iterator[Finding]:
    """Yield what a recording with the advised poses, or as many, has reached otherwise than promised.

    Args:
        before: the accepted calibration.
        now: a later one.
        since: the file and its commit, for messages.
    """
    promise = before.promise
    if promise is None or now.collections < before.collections + promise.poses or now.data == before.data:
        return
    for name, sizes in promise.sizes.items():
        for unit, promised in sizes.items():
            reached = _reached(now, name).get(unit)
            if reached is None or max(reached, promised) <= MAX_OFF * min(reached, promised):
                continue
            text = (
                f"{name} has {reached:.2g} {unit}, and {promise.poses} further poses were expected to bring it to "
                f"{promised:.2g} {unit} ({since}): {_why(reached > promised)}"
            )
            severity: Severity = "warning" if reached > promised else "note"
            yield Finding("baseline-quality", severity, text, (name,), value=reached, unit=unit)


def _why(worse: bool) -> str:
    return "were they the poses that were advised, and are light and focus the same?" if worse else "better than that"


def _reached(now: CalibrationDocument, name: str) -> dict[str, float]:
    """Return the sizes of a sensor's, joint's or task's error, by unit."""
    if (task := now.tasks.get(name)) is not None:
        return {task.unit: task.most}
    found: dict[str, float] = {}
    for pose in now.poses:
        if pose.sensor == name and pose.sigma_mm is not None and pose.sigma_deg is not None:
            found = {"mm": pose.norm_mm, "deg": float(np.linalg.norm(pose.sigma_deg))}
    for unit, own, scale in (("mm", "m", 1e3), ("deg", "rad", 180 / np.pi)):
        sigmas = [each.sigma for each in now.parameters if each.of == name and each.unit == own]
        if sigmas and unit not in found:
            found[unit] = scale * float(np.linalg.norm(sigmas))
    return found
