"""Report of rejected views that contradict the majority: image and pose from different moments."""

from collections import Counter, defaultdict

from calibration.diagnosis.finding import Finding, Severity
from calibration.estimation.result import Calibration, DroppedView

RED = 0.05
"""Share of a sensor's views that is a failure: the majority is no longer reliable."""
NAMED = 20
"""Number of collections that a message names."""


def wrong_views(calibration: Calibration) -> tuple[Finding, ...]:
    """Report the rejected views, by the sensors that contradict each other.

    If two sensors contradict each other and no third one decides, both views are rejected and both are named.
    """
    views = Counter(sensor for c in calibration.dataset.collections for _, sensor in c.labels)
    by_collection: dict[str, list[DroppedView]] = defaultdict(list)
    for view in calibration.dropped_views:
        by_collection[view.collection].append(view)
    alike: dict[tuple[str, ...], list[DroppedView]] = defaultdict(list)
    for dropped in by_collection.values():
        alike[tuple(sorted({view.sensor for view in dropped}))] += dropped
    return tuple(_finding(sensors, dropped, views) for sensors, dropped in alike.items())


def _finding(sensors: tuple[str, ...], dropped: list[DroppedView], views: Counter[str]) -> Finding:
    collections = tuple(dict.fromkeys(view.collection for view in dropped))
    share = max(len({v.collection for v in dropped if v.sensor == sensor}) / views[sensor] for sensor in sensors)
    mm, degrees = (max(getattr(view, unit) for view in dropped) for unit in ("mm", "degrees"))
    several = len(collections) > 1
    more = f" and {len(collections) - NAMED} more" if collections[NAMED:] else ""
    where = f"collection{'s' * several} {', '.join(collections[:NAMED])}{more}"
    if len(sensors) > 1:
        what = f"{', '.join(sensors[:-1])} and {sensors[-1]} contradict each other in {where}"
    else:
        what = (
            f"{sensors[0]}: {'views' if several else 'the view'} of {where} contradict{'s' * (not several)} the others"
        )
    text = (
        f"{what}, by up to {mm:.4g} mm and {degrees:.3g} deg, left out: image and pose of different moments? "
        f"Record these collections again, at standstill"
    )
    severity: Severity = "red" if share > RED else "warning"
    return Finding("wrong-views", severity, text, sensors, collections, share, unit="1")
