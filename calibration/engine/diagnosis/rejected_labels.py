"""Labels that do not fit the result, and views that contradict the majority: few are usual, many have a cause."""

from collections import Counter, defaultdict
from collections.abc import Mapping
from math import comb, sqrt

import numpy as np

from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.diagnosis.finding import Finding, Severity, first_names
from calibration.engine.diagnosis.limits import Limits, allowed, limit_in_labels, of_the_labels, stated
from calibration.engine.estimation.covariance.result import Calibration, DroppedView
from calibration.engine.estimation.covariance.suspects import Suspect
from calibration.engine.estimation.least_squares.minimisation import HUBER_THRESHOLD
from calibration.engine.estimation.start.wrong_views import ARM_ERRORS

MIN_WARNING_SHARE, MIN_RED_SHARE = 0.01, 0.05
"""Shares of all labels."""
MIN_SHARE_OF_VIEW = 0.2
"""Share of the labels of one view."""
KINDS_OF_BENDING = ("bow", "twist")
"""Kinds of causes by which a part of every view does not fit, and which say themselves what harm they do."""
VIEW_AT_AN_END = 0.5
"""The same of the first or the last view of a sensor: it may have moved since, or before,"""
SEEN_OF_A_MOVE = 0.25
"""if the labels are off by this part of the limit: along a camera's axis they tell less of a move."""
MIN_REJECTED_LABELS = 3
"""Minimum of rejected labels in a suspicious view: one of four corners is not significant."""
GROSS_PIXELS, GROSS_METRES = 2.5, 0.1
"""px, m: labels with smaller residuals are not counted: the noise of real images and LiDARs has tails beyond five
standard deviations, which the robust loss handles.
"""
MAX_NAMED_COLLECTIONS = 5
"""Number of collections that a message names."""
MIN_RED_SHARE_OF_WRONG_VIEWS = 0.25
"""Share of a sensor's views that is a failure: so many are no accidents, whatever the rest says."""
MAX_RATIO_OF_ONE_MOVE = (1 + 2 / ARM_ERRORS) / (1 - 2 / ARM_ERRORS)
"""Ratio of the distances or turns by which two views of one move are wrong: each is off by `ARM_ERRORS` times an arm's
own errors or more, and known to two of them."""
MIN_CHANCE_OF_ACCIDENTS = 0.05
"""Chance that so many of a sensor's wrong views lie at an end of the recording, from which on all may be accidents."""
USUAL_CAUSE = "image and pose of different moments?"
"""Most frequent cause of a view that contradicts the others."""
MAX_NAMED_VIEWS = 20
"""Number of collections that a message names."""


def rejected_labels(calibration: Calibration, limits: Limits) -> tuple[Finding, ...]:
    """Report the labels that do not fit, in total and in single views.

    A label is rejected if Huber's loss gives it less than half its weight, beyond five standard deviations: for
    normal noise, 4e-6 of the corners. It is counted if its residual also exceeds `GROSS_PIXELS` or `GROSS_METRES`.
    Many of them are a failure where they may have moved the result by more than a limit, and no bent board, and no
    other board or lens explains them. The robust loss may have
    followed a minority, so more than half of them rejected, gross or not, is a failure too.
    """
    total = sum(int(np.isfinite(view.magnitudes).sum()) for view in calibration.residuals)
    rejected = calibration.rejected
    if not rejected:
        return ()
    if len(rejected) > total / 2:
        text = (
            f"{len(rejected)} of {total} labels do not fit the result, expected less than half; look at the "
            f"intrinsics, the pattern's dimensions and the joints' positions"
        )
        return (Finding("rejected-labels", "red", text, value=len(rejected) / total, unit="1"),)
    gross = [label for label in rejected if label.residual > (GROSS_PIXELS if label.kind == "pixel" else GROSS_METRES)]
    if (share := len(gross) / total) > MIN_WARNING_SHARE:
        sensors, keys = (Counter(each) for each in zip(*((g.sensor, g.collection) for g in gross), strict=True))
        worst, collections = sensors.most_common(1)[0][0], tuple(key for key, _ in keys.most_common())
        where = first_names(collections, MAX_NAMED_COLLECTIONS)
        text = (
            f"{len(gross)} of {total} labels do not fit the result ({100 * share:.1f} %, expected "
            f"{100 * MIN_WARNING_SHARE:g} % at most), most of '{worst}', in collections {where}; "
            f"look at their images, or leave them out"
        )
        severity: Severity = "warning"
        explained = any(each.is_change or each.cause.kind in KINDS_OF_BENDING for each in _suspects(calibration))
        if share > MIN_RED_SHARE and not explained:
            severity = "red" if _may_exceed_a_limit(calibration, limits, len(rejected)) else "warning"
        found = Finding("rejected-labels", severity, text, (worst,), collections, share, unit="1")
        return (*_at_the_ends(calibration, limits), found)
    collections = tuple(key for key, _ in Counter(label.collection for label in rejected).most_common())
    where = first_names(collections, MAX_NAMED_COLLECTIONS)
    text = f"{len(rejected)} of {total} labels rejected as outliers, in collections {where}"
    note = Finding("rejected-labels", "note", text, (), collections, len(rejected) / total, unit="1")
    views = _find_bad_views(calibration, Counter((g.collection, g.sensor, g.pattern, g.kind) for g in gross))
    return (*_at_the_ends(calibration, limits), *views, note)


def _may_exceed_a_limit(calibration: Calibration, limits: Limits, count: int) -> bool:
    """Whether so many labels that do not fit may move a sensor or joint by more than its limit.

    Huber's loss lets each pull by `HUBER_THRESHOLD` standard deviations of the labels at most. All of them together
    move a parameter by at most that times the root of their number, in its standard deviations by the labels alone
    (inequality of Cauchy and Schwarz).
    """
    if calibration.of_cameras_alone:
        return True
    pull = HUBER_THRESHOLD * sqrt(count)
    return any(
        allowed(calibration, limits, name).exceeded(*(pull * sigma for sigma in of_the_labels(calibration, name)))
        for name in stated(calibration)
    )


def _suspects(calibration: Calibration) -> tuple[Suspect, ...]:
    explanation = calibration.solution.explanation
    return explanation.suspects if explanation else ()


def _at_the_ends(calibration: Calibration, limits: Limits) -> tuple[Finding, ...]:
    """Return a failure for each sensor whose first or last view does not fit as a whole: it may have moved.

    Nothing where a suspect says from which collection on what has moved or changed.
    """
    if any(each.since is not None for each in _suspects(calibration)):
        return ()
    rejected = Counter((each.collection, each.sensor, each.pattern, each.kind) for each in calibration.rejected)
    found: dict[str, tuple[str, float]] = {}
    for view in calibration.residuals:
        least = SEEN_OF_A_MOVE * limit_in_labels(calibration, limits, view.sensor)
        counts = np.isfinite(view.magnitudes).sum(-1)
        for i in (0, -1):
            key = view.collections[i]
            out = rejected.get((key, view.sensor, view.pattern, view.kind), 0)
            if (
                out >= MIN_REJECTED_LABELS
                and out > VIEW_AT_AN_END * counts[i]
                and np.nanmedian(view.magnitudes[i]) > least
            ):
                found[view.sensor] = key, out / counts[i]
    return tuple(
        Finding(
            "rejected-view",
            "red",
            f"{100 * share:.0f} % of what '{sensor}' sees in collection {key}, at an end of the recording, does not "
            f"fit the result: something has moved between this view and the others, or image and pose are of "
            f"different moments; record it again",
            (sensor,),
            (key,),
            float(share),
            unit="1",
        )
        for sensor, (key, share) in found.items()
    )


def _find_bad_views(
    calibration: Calibration, gross: Mapping[tuple[str, str, str, NoiseKind], int]
) -> tuple[Finding, ...]:
    """Return a warning on views with too large a share of labels that do not fit."""
    bad: list[tuple[float, str, str]] = []
    for view in calibration.residuals:
        counts = np.isfinite(view.magnitudes).sum(-1)
        for key, count in zip(view.collections, counts.tolist(), strict=True):
            out = gross.get((key, view.sensor, view.pattern, view.kind), 0)
            if out >= MIN_REJECTED_LABELS and out > MIN_SHARE_OF_VIEW * count:
                bad.append((out / count, view.sensor, key))
    if not bad:
        return ()
    bad.sort(reverse=True)
    share, sensor, key = bad[0]
    more = "" if len(bad) == 1 else f" (and more than {100 * MIN_SHARE_OF_VIEW:g} % in {len(bad) - 1} other views)"
    text = (
        f"{100 * share:.0f} % of what '{sensor}' sees in collection {key} does not fit the result{more}; look at its "
        f"image, or leave the collection out"
    )
    sensors, keys = dict.fromkeys(s for _, s, _ in bad), dict.fromkeys(k for _, _, k in bad)
    return (Finding("rejected-view", "warning", text, tuple(sensors), tuple(keys), share, unit="1"),)


def wrong_views(calibration: Calibration, limits: Limits) -> tuple[Finding, ...]:
    """Report the rejected views, by the sensors that contradict each other.

    If two sensors contradict each other and no third one decides, both views are rejected and both are named. At an end
    of the recording a few views that contradict the others may as well be those of a sensor that has moved, so that
    they are a failure if they are off by more than it may.

    Args:
        calibration: the result.
        limits: those that the user has set.
    """
    views = Counter(sensor for c in calibration.dataset.collections for _, sensor in c.labels)
    by_collection: dict[str, list[DroppedView]] = defaultdict(list)
    for view in calibration.dropped_views:
        by_collection[view.collection].append(view)
    alike: dict[tuple[str, ...], list[DroppedView]] = defaultdict(list)
    for dropped in by_collection.values():
        alike[tuple(sorted({view.sensor for view in dropped}))] += dropped
    return tuple(
        _finding_on_views(sensors, dropped, views, _at_an_end(calibration, limits, dropped))
        for sensors, dropped in alike.items()
    )


def _at_an_end(calibration: Calibration, limits: Limits, dropped: list[DroppedView]) -> str:
    """Return where a sensor may have moved, if its first or last view is wrong by more than it may be off; else ""."""
    if not calibration.converged:
        return ""
    left_out = {(view.sensor, view.collection) for view in dropped}
    for view in dropped:
        if not allowed(calibration, limits, view.sensor).exceeded(view.mm, view.degrees):
            continue
        seen = [c.key for c in calibration.dataset.collections if view.sensor in {s for _, s in c.labels}]
        kept = [key for key in seen if (view.sensor, key) not in left_out]
        wrong = [each for each in calibration.dropped_views if each.sensor == view.sensor]
        if _may_be_an_accident(view, wrong, seen):
            continue
        if kept and view.collection == seen[-1]:
            return f"{view.sensor} has moved after collection {kept[-1]}, and the result is that of before"
        if kept and view.collection == seen[0]:
            return f"{view.sensor} has moved before collection {kept[0]}"
    return ""


def _may_be_an_accident(view: DroppedView, wrong: list[DroppedView], seen: list[str]) -> bool:
    """Whether views that no move of this one explains show accidents, of which as many may lie at an end by chance.

    If w of n views are wrong anywhere, the e at one of both ends are among them with ``2 C(n - e, w - e) / C(n, w)``.
    """
    alike = {each.collection for each in wrong if _are_of_one_move(each, view)}
    inwards = seen if view.collection == seen[0] else seen[::-1]
    at_end = next((i for i, key in enumerate(inwards) if key not in alike), len(seen))
    n, w = len(seen), len({each.collection for each in wrong})
    return w > at_end and 2 * comb(n - at_end, w - at_end) / comb(n, w) > MIN_CHANCE_OF_ACCIDENTS


def _are_of_one_move(one: DroppedView, other: DroppedView) -> bool:
    """Whether two views are wrong by as great a distance or as great a turn."""
    pairs = (one.mm, other.mm), (one.degrees, other.degrees)
    return any(max(pair) <= MAX_RATIO_OF_ONE_MOVE * min(pair) for pair in pairs)


def _finding_on_views(sensors: tuple[str, ...], dropped: list[DroppedView], views: Counter[str], moved: str) -> Finding:
    collections = tuple(dict.fromkeys(view.collection for view in dropped))
    share = max(len({v.collection for v in dropped if v.sensor == sensor}) / views[sensor] for sensor in sensors)
    mm, degrees = (max(getattr(view, unit) for view in dropped) for unit in ("mm", "degrees"))
    several = len(collections) > 1
    where = f"collection{'s' * several} {first_names(collections, MAX_NAMED_VIEWS)}"
    if len(sensors) > 1:
        what = f"{', '.join(sensors[:-1])} and {sensors[-1]} contradict each other in {where}"
    else:
        what = (
            f"{sensors[0]}: {'views' if several else 'the view'} of {where} contradict{'s' * (not several)} the others"
        )
    either = f"either image and pose are of different moments, or {moved}." if moved else USUAL_CAUSE
    text = (
        f"{what}, by up to {mm:.4g} mm and {degrees:.3g} deg, left out: {either} "
        f"Record these collections again, at standstill"
    )
    severity: Severity = "red" if share > MIN_RED_SHARE_OF_WRONG_VIEWS or moved else "warning"
    return Finding("wrong-views", severity, text, sensors, collections, share, unit="1")
