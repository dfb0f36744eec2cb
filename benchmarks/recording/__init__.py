"""What makes a recording good: the numbers of docs/recording.md (`make pictures` draws them)."""

from collections.abc import Iterator

import numpy as np

from benchmarks.recording import images, poses
from benchmarks.recording.curve import Curve
from benchmarks.rows import Bar, Row

MAX_SHARE_OF_WORST = Bar(high=0.75)
"""Largest error at a recommended value of a property, as a share of the largest error of its curve."""


def measure(quick: bool) -> Iterator[Row]:
    """Each point of each curve; what is recommended against what is not."""
    for curve in measured_curves(quick):
        for x, y in zip(curve.x, curve.y, strict=True):
            yield Row(f"recording/{curve.name} {x:.3g}", y, curve.unit, None, curve.property_name)
        low, high = curve.recommended
        inside = max(y for x, y in zip(curve.x, curve.y, strict=True) if low <= x <= high)
        note = f"largest within {low:g} to {high:g}, of the largest of all"
        yield Row(f"recording/{curve.name}, recommended", inside / max(curve.y), "", MAX_SHARE_OF_WORST, note)


def measured_curves(quick: bool) -> list[Curve]:
    """Measure every curve."""
    found = [*poses.curves(5 if quick else 40), *images.curves(4 if quick else 16)]
    assert all(np.isfinite(curve.y).any() for curve in found)
    return found
