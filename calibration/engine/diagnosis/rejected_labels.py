"""Check of the labels that do not fit the result: a few are errors of the detector, many have another cause."""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.diagnosis.limits import Limits, limit_in_labels
from calibration.engine.estimation.covariance.result import Calibration

MIN_WARNING_SHARE, MIN_RED_SHARE = 0.01, 0.05
"""Shares of all labels."""
MIN_SHARE_OF_VIEW = 0.2
"""Share of the labels of one view."""
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


def rejected_labels(calibration: Calibration, limits: Limits) -> tuple[Finding, ...]:
    """Report the labels that do not fit, in total and in single views.

    A label is rejected if Huber's loss gives it less than half its weight, beyond five standard deviations: for
    normal noise, 4e-6 of the corners. It is counted if its residual also exceeds `GROSS_PIXELS` or `GROSS_METRES`.
    The robust loss may have followed a minority, so more than half of them rejected, gross or not, is a failure too.
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
        text = (
            f"{len(gross)} of {total} labels do not fit the result ({100 * share:.1f} %, expected "
            f"{100 * MIN_WARNING_SHARE:g} % "
            f"at most), most of '{worst}', in collections {_list_collections(collections)}; look at their images, "
            "or leave them "
            f"out"
        )
        severity: Severity = "red" if share > MIN_RED_SHARE else "warning"
        return (Finding("rejected-labels", severity, text, (worst,), collections, share, unit="1"),)
    keys = Counter(label.collection for label in rejected)
    collections = tuple(key for key, _ in keys.most_common())
    text = f"{len(rejected)} of {total} labels rejected as outliers, in collections {_list_collections(collections)}"
    note = Finding("rejected-labels", "note", text, (), collections, len(rejected) / total, unit="1")
    views = _find_bad_views(calibration, Counter((g.collection, g.sensor, g.pattern, g.kind) for g in gross))
    return (*_at_the_ends(calibration, limits), *views, note)


def _at_the_ends(calibration: Calibration, limits: Limits) -> tuple[Finding, ...]:
    """Return a failure for each sensor whose first or last view does not fit as a whole: it may have moved."""
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


def _list_collections(keys: tuple[str, ...]) -> str:
    return ", ".join(keys[:MAX_NAMED_COLLECTIONS]) + (
        f" and {len(keys) - MAX_NAMED_COLLECTIONS} more" if keys[MAX_NAMED_COLLECTIONS:] else ""
    )
