"""Quality of a calibration against that of the accepted one: noise, RMS, error bars and rejected labels.

On the same data a result is deterministic: what is worse by more than allowed is a failure. On other data it is a
warning, because light, focus and distance change it and the robot stays what it is; whether the result is still good
enough is decided by its error bars and the limits. There the chance of both recordings counts, family-wise over all
measures, with views as the independent units, since the labels of a view err and fail together:

- noise and RMS are standard deviations: the ratio of their squares is F-distributed, with 2 degrees of freedom a view;
  what light, focus and distance usually change counts as allowed: up to twice the baseline's, and any noise that a good
  detector keeps;
- rejected labels are a proportion: ``2 asin(sqrt(p))`` has the variance ``1 / n`` whatever p is (F. J. Anscombe, "The
  transformation of Poisson, binomial and negative-binomial data", 1948);
- an error bar falls with the root of the number of independent collections, and is compared at the same number.

What is allowed says the section ``baseline`` of calibration.yml, `BaselineSettings`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from calibration.base import InputError, number_text, shorten
from calibration.base.records import Converted, Place, at_least, field, length, record
from calibration.base.tables.rules import Allowance, parse_allowance
from calibration.base.verdict import Check, at_most
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import BaselineComparison
from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.estimation.covariance.error_bars import MAX_NOISE
from calibration.engine.statistics import score_of_f, threshold

BASELINE_FILE = "calibration-baseline.json"
Least = Annotated[float, at_least(0)]


def _parse_allowance_at(text: str, place: Place) -> Allowance:
    try:
        return parse_allowance(text)
    except InputError as error:
        raise place.fault(str(error)) from None


Increase = Annotated[Allowance, Converted(Annotated[str, length(1, 30)], _parse_allowance_at)]


@record
class SameData:
    """Tolerances of a result on the same data, where it is deterministic."""

    sigmas: Least = field("Standard deviations by the labels' noise, and never less than the rest.", default=0.1)
    translation_mm: Least = field("Of a translation.", default=0.001, unit="mm")
    rotation_deg: Least = field("Of a rotation.", default=0.00006, unit="degrees")
    error_bars: Least = field("Noise of the labels and standard deviations, in percent.", default=1.0)


@record
class MaxIncrease:
    """Limits of the increase of quality measures over the baseline: 10%, or 0.1 in its unit."""

    rms: Increase = field("Root mean square of the table (5%).", default=Allowance(5, True))
    noise: Increase = field("Noise of each kind of label (5%).", default=Allowance(5, True))
    sigma: Increase = field(
        "The largest standard deviation of a translation, and the error of each task (25%).",
        default=Allowance(25, True),
    )
    rejected: Increase = field("Share of the labels that do not fit, in percent (1).", default=Allowance(1, False))


@record
class BaselineSettings:
    """The accepted calibration that every cell is compared with."""

    file: Annotated[Path, Converted(Annotated[str, length(1)], lambda text, place: place.folder / text)] = field(
        f"The reviewed file, relative to this one ({BASELINE_FILE}).", default=Path(BASELINE_FILE)
    )
    required: bool = field("Whether a system without an accepted calibration fails (false).", default=False)
    translation_mm: Least = field("Allowed displacement of a sensor on other data (0).", default=0.0, unit="mm")
    rotation_deg: Least = field("Allowed rotation of a sensor on other data (0).", default=0.0, unit="degrees")
    same_data: SameData = field("Allowed differences of a result on the same data.", default_factory=SameData)
    max_increase: MaxIncrease = field(
        "Allowed increase of the errors over the baseline; on other data, the effect of chance is added.",
        default_factory=MaxIncrease,
    )


HOW_TO_ACCEPT = "accept it: calibration accept"
USUAL_RATIO = 2.0
"""Ratio of noise and RMS to those of the baseline up to which other light, another focus or distance explains them,"""
MAX_USUAL_RMS = 1.0
"""px: RMS up to which they do, whatever that of the baseline; and noise does up to that of a good detector."""
MAX_RATIO_OF_EXTENTS = 1.25
"""Noise and RMS in px are compared if the pattern is as large in the images but for this factor. A board at twice the
distance has half the pixels along each edge, and its corners scatter more."""


@dataclass(frozen=True)
class _Measure:
    """A measure of quality of both calibrations."""

    what: str
    before: float | None
    now: float | None
    most: float
    """Allowed now."""
    unit: str
    significant: bool
    """Whether the difference, beyond what is allowed, is more than chance; always on the same data."""


def quality(comparison: BaselineComparison, settings: BaselineSettings) -> Iterator[Finding]:
    """Yield findings on measures of quality that are worse than the baseline's by more than allowed."""
    severity: Severity = "red" if comparison.same_data else "warning"
    if comparison.same_data:
        yield from _error_bars_on_same_data(comparison, settings)
    for each in _compared_measures(comparison, settings):
        if each.before is None or not each.significant:
            continue
        check = at_most(each.what, each.now, each.most, each.unit)
        if not check.passed:
            advice = (
                "" if comparison.same_data else "; the limits decide whether it matters: look at light, focus, distance"
            )
            text = f"{worse_than_baseline(check, each.before)}{advice}"
            yield Finding("baseline-quality", severity, text, value=each.now)


def worse_than_baseline(check: Check, before: float) -> str:
    """Describe a value that exceeds what the baseline allows."""
    return f"worse than the baseline: {shorten(str(check), 200)} (baseline {number_text(round(before, 6))})"


def largest_standard_deviations(before: CalibrationDocument, now: CalibrationDocument) -> tuple[float, float]:
    """Return the largest standard deviation of a translation, mm, of each calibration, over the poses of both."""
    common = {each.edge for each in before.poses} & {each.edge for each in now.poses}
    first, second = (
        max((each.norm_mm for each in one.poses if each.edge in common), default=0.0) for one in (before, now)
    )
    return first, second


def _compared_measures(comparison: BaselineComparison, settings: BaselineSettings) -> list[_Measure]:
    before, now, most = comparison.before, comparison.now, settings.max_increase
    levels = now.noise.given()
    pairs = [("RMS", before.rms_px, now.rms_px, most.rms, MAX_USUAL_RMS, "px")]
    pairs += [
        (f"noise of the labels ({kind})", level, levels.get(kind), most.noise, MAX_NOISE[kind], "")
        for kind, level in before.noise.given().items()
    ]
    same = comparison.same_data
    score = 0.0 if same else threshold(len(pairs) + 1)
    comparable = same or _are_as_large_in_the_images(before, now)
    measures = []
    for what, old, new, allowance, usual, unit in pairs:
        allowed = allowance.above(old or 0.0)
        allowed = allowed if same else max(allowed, USUAL_RATIO * (old or 0.0), usual)
        significant = same or (comparable and _score_of_deviations(allowed, new, before, now) > score)
        measures.append(_Measure(what, old, new, allowed, unit, significant))
    sigma, new_sigma = largest_standard_deviations(before, now)
    fewer = 1.0 if same else _more_by_fewer_collections(before, now)
    sigmas = [("largest standard deviation", sigma, new_sigma, "mm")]
    sigmas += [
        (f"error of task '{name}'", task.most, again.most, task.unit)
        for name, task in before.tasks.items()
        if (again := now.tasks.get(name)) is not None and again.unit == task.unit
    ]
    for what, wide, wide_now, unit in sigmas:
        measures.append(_Measure(what, wide * fewer, wide_now, most.sigma.above(wide * fewer), unit, True))
    rejected = [100 * each.rejected_labels / max(1, each.labels) for each in (before, now)]
    worse = same or _score_of_proportions(before, now, most.rejected) > score
    measures.append(_Measure("rejected labels", rejected[0], rejected[1], most.rejected.above(rejected[0]), "%", worse))
    return measures


def _are_as_large_in_the_images(before: CalibrationDocument, now: CalibrationDocument) -> bool:
    """Whether the patterns are about as large in the images of both recordings, and as far from LiDARs."""
    ratios = [now.extents[name] / before.extents[name] for name in before.extents.keys() & now.extents.keys()]
    return all(1 / MAX_RATIO_OF_EXTENTS <= each <= MAX_RATIO_OF_EXTENTS for each in ratios)


def _more_by_fewer_collections(before: CalibrationDocument, now: CalibrationDocument) -> float:
    """Return the factor by which a standard deviation is larger because there are fewer independent collections."""
    counts = [each.effective_collections or each.collections for each in (before, now)]
    return math.sqrt(max(1.0, counts[0] / max(counts[1], 1e-9)))


def _score_of_deviations(
    allowed: float, new: float | None, before: CalibrationDocument, now: CalibrationDocument
) -> float:
    """Return the standard score of a larger standard deviation than the allowed one; infinite if one is unknown."""
    if new is None or allowed <= 0:
        return math.inf
    first, second = (2 * _views_in_all(each) for each in (before, now))
    return float(score_of_f((new / allowed) ** 2, second, first))


def _score_of_proportions(before: CalibrationDocument, now: CalibrationDocument, allowance: Allowance) -> float:
    """Return the standard score of a larger share of rejected labels than the allowed one."""
    shares = [each.rejected_labels / max(1, each.labels) for each in (before, now)]
    allowed = min(1.0, allowance.above(100 * shares[0]) / 100)
    difference = 2 * (math.asin(math.sqrt(shares[1])) - math.asin(math.sqrt(allowed)))
    return difference / math.sqrt(sum(1 / _views_in_all(each) for each in (before, now)))


def _views_in_all(snapshot: CalibrationDocument) -> int:
    return max(1, sum(snapshot.views.values()))


def _error_bars_on_same_data(comparison: BaselineComparison, settings: BaselineSettings) -> Iterator[Finding]:
    """Yield findings on differing noise and standard deviations, which are deterministic too."""
    before, now, share = comparison.before, comparison.now, settings.same_data.error_bars / 100
    levels, new = before.noise.given(), now.noise.given()
    rows = [(f"noise of the labels ({kind})", levels[kind], new[kind]) for kind in levels if kind in new]
    poses = {each.edge: each for each in now.poses}
    rows += [
        (f"standard deviation of {each.name}", each.norm_mm, poses[each.edge].norm_mm)
        for each in before.poses
        if each.edge in poses
    ]
    for what, old, value in rows:
        if abs(value - old) > share * max(old, value):
            text = (
                f"{what} differs on the same data: {value:.4g}, accepted was {old:.4g}: {HOW_TO_ACCEPT}, if it is meant"
            )
            yield Finding("baseline-quality", "red", text, value=value)


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
            why = "better than that"
            if reached > promised:
                why = "were they the poses that were advised, and are light and focus the same?"
            text = (
                f"{name} has {reached:.2g} {unit}, and {promise.poses} further poses were expected to bring it to "
                f"{promised:.2g} {unit} ({since}): {why}"
            )
            severity: Severity = "warning" if reached > promised else "note"
            yield Finding("baseline-quality", severity, text, (name,), value=reached, unit=unit)


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
