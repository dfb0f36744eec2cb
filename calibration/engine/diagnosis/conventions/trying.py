"""Try other conventions where the labels do not fit, and name the one by which they do."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.conventions.arm_hypotheses import (
    FEWEST_POSES,
    joints,
    other_rotations,
    robot_poses,
    scales,
)
from calibration.engine.diagnosis.conventions.misfit import Hypothesis, Misfit, improved, misfit, misfit_at
from calibration.engine.diagnosis.conventions.recording import Recording
from calibration.engine.diagnosis.conventions.sensor_hypotheses import (
    exchanged,
    left_handed,
    lenses,
    shifted,
    turned_boards,
)
from calibration.engine.diagnosis.finding import Finding, FindingKind
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.ambiguous_views import trace_differences
from calibration.engine.geometry.rotations import angle

Hypotheses = Callable[[Recording], Iterator[Hypothesis]]

HYPOTHESES_BY_PRIORITY: tuple[Hypotheses, ...] = (
    robot_poses,
    shifted,
    exchanged,
    scales,
    left_handed,
    turned_boards,
    lenses,
    joints,
)
"""In the order in which equally good ones are named."""
SLOW_HYPOTHESES: tuple[Hypotheses, ...] = (other_rotations,)
"""Tried where none of the others fits."""
WORTH_TRYING = 0.15
"""Misfit below which nothing is tried, in multiples of what is noticeable (1 px, 1 cm)."""
MAX_FITTING_MISFIT = 3.0
"""Misfit above which nothing fits, likewise."""
MAX_MISFIT_RATIO, MAX_MISFIT_RATIO_OF_POSES = 0.1, 0.2
"""Misfit of a convention that is named, relative to that of the recording as it is; of measured poses, whose own errors
no view tells."""
MAX_MISFIT_RATIO_WITHOUT_RESULT = 0.25
"""The same where there is no result as it is: an arm that errs by some mm fits no convention ten times better."""
BETTER_IN_NOISE, IN_NOISE = 0.5, 1.5
"""The same for a misfit that is as small, up to this factor, as that of each view's own fit."""
MAX_RATIO_TO_BEST = 2.0
"""Misfit of other conventions that are named with it, relative to the best."""
LEFT_OUT = 0.05
"""Share of views that a calibration may have left out to be a measure of the recording."""
MAX_REFINED_CONVENTIONS = 16
"""Number of conventions that are compared after a few steps from their linear start: those with the best of these."""
KINDS_THAT_CAST_DOUBT: tuple[FindingKind, ...] = ("contradiction",)
"""Findings, red or not, on which other conventions are tried;"""
KINDS_WITHOUT_DOUBT: tuple[FindingKind, ...] = ("precision", "too-few")
"""and red ones on which they are not: all may fit."""
MIN_DIFFERENCE_OF_OTHER_IMAGES = 0.5
"""Median difference of traces of an arm's rotations and of the pattern's, above which they are of different moments."""
MAX_NAMED_CONVENTIONS = 3
"""Number of conventions that fit alike that a message names."""


def conventions(calibration: Calibration | None, description: Dataset, options: Options) -> tuple[Finding, ...]:
    """Name the convention by which the labels of a recording fit ten times better than as it was read.

    Args:
        calibration: the result; None if there is none.
        description: the dataset, without the noise of an initial guess. It is not changed.
        options: options of the calibration.
    """
    now = _as_it_is(calibration, description, options)
    if now.noticed < WORTH_TRYING:
        return ()
    recording = Recording(description)
    better = MAX_MISFIT_RATIO_OF_POSES if recording.has_measured_poses else MAX_MISFIT_RATIO
    fitting: list[tuple[Hypothesis, Misfit]] = []
    tried: list[tuple[Hypothesis, Misfit]] = []
    for table in (HYPOTHESES_BY_PRIORITY, SLOW_HYPOTHESES):
        if not fitting:
            tried += _nearest_hypotheses(recording, table, options)
            fitting = [each for each in tried if _fits(each[1], now, better)]
    if not fitting and not _has_result(calibration):
        fitting = [each for each in tried if each[1].noticed < MAX_MISFIT_RATIO_WITHOUT_RESULT * now.noticed]
    if not fitting:
        return _poses_of_other_images(recording)
    best = min(found.noticed for _, found in fitting)
    alike = [each for each in fitting if each[1].noticed <= MAX_RATIO_TO_BEST * best]
    told = [h.told_apart(found) if h.told_apart else (h.name, h.remedy) for h, found in alike]
    sensors = tuple(dict.fromkeys(name for h, _ in alike for name in h.sensors))
    names = ", or ".join(dict.fromkeys(name for name, _ in told))
    remedies = "; or ".join(dict.fromkeys(remedy for _, remedy in told))
    fit = "fit" if _fits(alike[0][1], now, better) else "fit better, though not well"
    text = f"with {names}, the labels {fit}: {alike[0][1].text} (as they are: {now.text}); {remedies}"
    return (Finding("convention", "red", text, sensors),)


def _poses_of_other_images(recording: Recording) -> tuple[Finding, ...]:
    """Report an arm that turns by other angles than the pattern that it, or its camera, moves: by no mounting."""
    arm, view = recording.arm, recording.view
    if arm is None or view is None or len(view.collections) < FEWEST_POSES:
        return ()
    turned = recording.dataset.transforms[arm][view.collections][:, :3, :3]
    off = trace_differences(turned, view.seen[:, :3, :3])
    if np.median(off) < MIN_DIFFERENCE_OF_OTHER_IMAGES:
        return ()
    pair = np.unravel_index(off.argmax(), off.shape)
    by_arm, by_pattern = (np.degrees(angle(R[pair[0]].T @ R[pair[1]])) for R in (turned, view.seen[:, :3, :3]))
    first, second = (recording.dataset.collections[view.collections[i]].key for i in sorted(pair))
    text = (
        f"poses and images do not belong together: between collections {first} and {second} the robot turns by "
        f"{by_arm:.0f} deg, '{view.pattern}' as '{view.sensor}' sees it by {by_pattern:.0f} deg, and no convention or "
        "mounting makes these angles equal; does each pose stand with its own image, of this arm and this camera?"
    )
    return (Finding("convention", "red", text, (view.sensor,), (first, second)),)


def doubts(calibration: Calibration, found: tuple[Finding, ...]) -> bool:
    """Whether a result is bad enough to try other conventions, by what was found and by the residuals."""
    bad = any(
        f.kind in KINDS_THAT_CAST_DOUBT
        or (f.kind == "wrong-views" and (f.value or 0.0) > LEFT_OUT)
        or (f.severity == "red" and f.kind not in KINDS_WITHOUT_DOUBT)
        for f in found
    )
    return bad or not calibration.converged or _misfit_of_calibration(calibration).noticed > 1


def _as_it_is(calibration: Calibration | None, description: Dataset, options: Options) -> Misfit:
    """Return the misfit of the recording as it was read; of a calibration, if that is better."""
    found = misfit(description, options)
    if calibration is None or not _has_result(calibration):
        return found
    reached = _misfit_of_calibration(calibration)
    views = sum(len(collection.labels) for collection in description.collections)
    most_are_used = len(calibration.dropped_views) <= LEFT_OUT * views
    return reached if most_are_used and reached.noticed < found.noticed else found


def _misfit_of_calibration(calibration: Calibration) -> Misfit:
    return misfit_at(calibration.solution.setup, calibration.solution.values)


def _has_result(calibration: Calibration | None) -> bool:
    """Whether a calibration is one of all that was asked for."""
    return calibration is not None and calibration.converged and not calibration.not_determined


def _nearest_hypotheses(
    recording: Recording, table: Sequence[Hypotheses], options: Options
) -> list[tuple[Hypothesis, Misfit]]:
    """Return the hypotheses of a table by which a recording fits best, in its order, after a few steps."""
    tried = [
        (each, misfit(each.dataset(), options, steps=False)) for hypotheses in table for each in hypotheses(recording)
    ]
    nearest = sorted(found.noticed for _, found in tried if found.exists)[:MAX_REFINED_CONVENTIONS]
    return [(each, improved(found)) for each, found in tried if found.exists and found.noticed <= nearest[-1]]


def _fits(found: Misfit, now: Misfit, better: float) -> bool:
    limit = BETTER_IN_NOISE if found.above_noise < IN_NOISE else better
    return found.noticed < MAX_FITTING_MISFIT and found.noticed < limit * now.noticed
