"""Report of rejected views that contradict the majority: image and pose from different moments."""

from collections import Counter, defaultdict

from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.diagnosis.limits import Limits, allowed
from calibration.engine.estimation.covariance.result import Calibration, DroppedView

MIN_RED_SHARE = 0.05
"""Share of a sensor's views that is a failure: the majority is no longer reliable."""
USUAL_CAUSE = "image and pose of different moments?"
"""Most frequent cause of a view that contradicts the others."""
MAX_NAMED_COLLECTIONS = 20
"""Number of collections that a message names."""


def wrong_views(calibration: Calibration, limits: Limits | None = None) -> tuple[Finding, ...]:
    """Report the rejected views, by the sensors that contradict each other.

    If two sensors contradict each other and no third one decides, both views are rejected and both are named. At an end
    of the recording a few views that contradict the others may as well be those of a sensor that has moved, so that
    they are a failure if they are off by more than it may.

    Args:
        calibration: the result.
        limits: those that the user has set; None where there is no result that they are compared with.
    """
    views = Counter(sensor for c in calibration.dataset.collections for _, sensor in c.labels)
    by_collection: dict[str, list[DroppedView]] = defaultdict(list)
    for view in calibration.dropped_views:
        by_collection[view.collection].append(view)
    alike: dict[tuple[str, ...], list[DroppedView]] = defaultdict(list)
    for dropped in by_collection.values():
        alike[tuple(sorted({view.sensor for view in dropped}))] += dropped
    return tuple(
        _finding_on_views(sensors, dropped, views, _at_an_end(calibration, limits, dropped) if limits else "")
        for sensors, dropped in alike.items()
    )


def _at_an_end(calibration: Calibration, limits: Limits, dropped: list[DroppedView]) -> str:
    """Return where a sensor may have moved, if its first or last view is wrong by more than it may be off; else ""."""
    left_out = {(view.sensor, view.collection) for view in dropped}
    for view in dropped:
        if not allowed(calibration, limits, view.sensor).exceeded(view.mm, view.degrees):
            continue
        seen = [c.key for c in calibration.dataset.collections if view.sensor in {s for _, s in c.labels}]
        kept = [key for key in seen if (view.sensor, key) not in left_out]
        if kept and view.collection == seen[-1]:
            return f"{view.sensor} has moved after collection {kept[-1]}, and the result is that of before"
        if kept and view.collection == seen[0]:
            return f"{view.sensor} has moved before collection {kept[0]}"
    return ""


def _finding_on_views(sensors: tuple[str, ...], dropped: list[DroppedView], views: Counter[str], moved: str) -> Finding:
    collections = tuple(dict.fromkeys(view.collection for view in dropped))
    share = max(len({v.collection for v in dropped if v.sensor == sensor}) / views[sensor] for sensor in sensors)
    mm, degrees = (max(getattr(view, unit) for view in dropped) for unit in ("mm", "degrees"))
    several = len(collections) > 1
    more = f" and {len(collections) - MAX_NAMED_COLLECTIONS} more" if collections[MAX_NAMED_COLLECTIONS:] else ""
    where = f"collection{'s' * several} {', '.join(collections[:MAX_NAMED_COLLECTIONS])}{more}"
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
    severity: Severity = "red" if share > MIN_RED_SHARE or moved else "warning"
    return Finding("wrong-views", severity, text, sensors, collections, share, unit="1")
