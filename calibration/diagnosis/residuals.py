"""How residuals are distributed: notes on what noise alone would not do, for results that nothing else explains.

Noise is independent from label to label, equal all over the image and the range, and as small as a detector's. The
tests have views as clusters, so that what differs from view to view (an arm, a sway) is no pattern.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from calibration.diagnosis.finding import Finding
from calibration.estimation.label_errors import LabelErrors, label_errors
from calibration.estimation.median import median
from calibration.estimation.result import Calibration
from calibration.estimation.significance import score_of_f, threshold
from calibration.geometry.types import Array

DETECTOR = 0.35
"""px: no good detector of corners in sharp images scatters by more."""
CELLS = (4, 3)
"""An image is divided into so many columns and rows."""
RANGES = 6
"""A LiDAR's points are divided into so many equal parts by their range."""
LEAST_VIEWS = 8
"""Fewer views of a part tell nothing about it."""
SMALL = {"pixel": 0.1, "range": 0.005}
"""Smaller errors (px, m) are no pattern worth a line,"""
OF_NOISE = 0.5
"""nor are smaller ones than this part of the noise."""
ALIKE = 0.5
"""Neighbouring corners whose errors correlate by more than this err alike."""
NOISIER = 1.5
"""A sensor whose labels scatter so many times as much as those of all others of its kind is noisier."""


def residuals(calibration: Calibration) -> tuple[Finding, ...]:
    """Notes on errors that are alike in a part of the image or of the range, alike in neighbours, or large.

    Args:
        calibration: a calibration that has converged.
    """
    labels = [each for each in label_errors(calibration.solution) if each.kind in SMALL]
    parts = sum(RANGES if each.kind == "range" else CELLS[0] * CELLS[1] for each in labels)
    return (
        *(note for each in labels for note in _pattern(calibration, each, threshold(parts))),
        *(note for each in labels for note in _neighbours(calibration, each)),
        *_scatter(calibration, labels),
    )


def _pattern(calibration: Calibration, labels: LabelErrors, limit: float) -> list[Finding]:
    """Errors that are alike in all views, in a part of the image or of the range: the largest."""
    part, names = _parts(calibration, labels)
    least = max(SMALL[labels.kind], OF_NOISE * _level(labels))
    worst: tuple[float, str] = (least, "")
    for i, name in enumerate(names):
        of = (part == i) & labels.seen
        sums, counts = np.where(of[:, None], labels.errors, 0.0).sum(-1), of.sum(-1)
        sums = sums[counts > 0]
        V, d = sums.shape
        if max(LEAST_VIEWS, d + 2) > V:
            continue
        mean = sums.mean(0)
        covariance = np.cov(sums.T).reshape(d, d) / V
        T2 = float(mean @ np.linalg.lstsq(covariance, mean, rcond=None)[0])  # Hotelling, views as clusters
        size = float(np.linalg.norm(sums.sum(0)) / counts.sum())
        if size > worst[0] and score_of_f(T2 * (V - d) / (d * (V - 1)), d, V - d) > limit:
            worst = size, name
    if not worst[1]:
        return []
    size, where = worst
    what, unit, factor, why = (
        ("corners", "px", 1.0, "the lens has more than its model, or the detector errs there: calibrate the intrinsics")
        if labels.kind == "pixel"
        else ("points", "mm", 1e3, "the sensor's ranges have an error of their own")
    )
    text = (
        f"the {what} of '{labels.sensor}' {where} are off by {factor * size:.2g} {unit} in all views alike, which "
        f"nothing that is tested explains: {why}"
    )
    return [Finding("residual-pattern", "note", text, (labels.sensor,), value=size, unit=_unit(labels))]


def _parts(calibration: Calibration, labels: LabelErrors) -> tuple[Array, list[str]]:
    """The part (V, L) of the image or the range that each label is in, and what the parts are called."""
    sensor = calibration.dataset.sensors[labels.sensor]
    if labels.kind == "pixel" and sensor.camera:
        columns, rows = CELLS
        u, v = np.moveaxis(sensor.camera.project(np.moveaxis(labels.points, 1, -1)), -1, 0)
        with np.errstate(invalid="ignore"):
            column = np.clip(np.nan_to_num(u / sensor.camera.width * columns), 0, columns - 1).astype(int)
            row = np.clip(np.nan_to_num(v / sensor.camera.height * rows), 0, rows - 1).astype(int)
        x, y = (np.linspace(0, 100, n + 1) for n in CELLS)
        names = [
            f"at {x[i]:.0f} to {x[i + 1]:.0f} % of the image's width and {y[j]:.0f} to {y[j + 1]:.0f} % of its height"
            for j in range(rows)
            for i in range(columns)
        ]
        return row * columns + column, names
    far = np.linalg.norm(labels.points, axis=1)
    edges = np.quantile(far[labels.seen], np.linspace(0, 1, RANGES + 1))
    names = [f"from {a:.2f} to {b:.2f} m away" for a, b in pairwise(edges)]
    return np.clip(np.searchsorted(edges, far) - 1, 0, RANGES - 1), names


def _neighbours(calibration: Calibration, labels: LabelErrors) -> list[Finding]:
    """Corners of one view that err as their neighbours do."""
    corners = calibration.dataset.patterns[labels.pattern].corners
    if labels.kind != "pixel" or len(corners) != labels.errors.shape[-1]:
        return []
    apart = np.linalg.norm(corners[:, None] - corners, axis=-1)
    i, j = np.nonzero(np.triu(apart < 1.05 * apart[apart > 0].min(), 1))
    both = labels.seen[:, i] & labels.seen[:, j]
    products = np.where(both, (labels.errors[..., i] * labels.errors[..., j]).sum(1), 0.0).sum(-1)
    squares = np.where(both, 0.5 * (labels.errors[..., i] ** 2 + labels.errors[..., j] ** 2).sum(1), 0.0).sum(-1)
    if len(products) < LEAST_VIEWS or not squares.sum():
        return []
    alike = float(products.sum() / squares.sum())
    if alike < ALIKE:
        return []
    text = (
        f"neighbouring corners of '{labels.sensor}' err alike (correlation {alike:.2f}), so that its labels tell less "
        f"than their number: a lens or a board that is not as it is described, or smoothed images"
    )
    return [Finding("residual-correlation", "note", text, (labels.sensor,), value=alike, unit="1")]


def _scatter(calibration: Calibration, labels: Sequence[LabelErrors]) -> list[Finding]:
    """Sensors that scatter by more than a detector should, or than others of their kind."""
    levels = {(each.sensor, each.pattern, each.kind): _level(each) for each in labels if each.seen.any()}
    notes = []
    for (sensor, pattern, kind), level in levels.items():
        others = [one for (name, _, each), one in levels.items() if each == kind and name != sensor]
        if others and level > NOISIER * max(others):
            text = (
                f"the labels of '{sensor}' on '{pattern}' scatter {level / max(others):.1f} times as much as those of "
                f"the others of its kind, which count as much: look at its focus, its light and its exposure"
            )
            notes.append(Finding("noisy-sensor", "note", text, (sensor,), value=level / max(others), unit="1"))
        elif kind == "pixel" and (noise := calibration.noise_levels.pixel or 0.0) > DETECTOR and level > DETECTOR / 2:
            text = (
                f"the corners of '{sensor}' scatter by {noise:.2g} px, a detector errs by {DETECTOR:g} px at most: "
                f"look at its focus, its light and its exposure, and whether all stood still"
            )
            notes.append(Finding("noisy-sensor", "note", text, (sensor,), value=noise, unit="px"))
    return notes


def _level(labels: LabelErrors) -> float:
    """The root of the median squared error of each axis, px or m: a few wrong labels do not count."""
    return float(np.sqrt(median((labels.errors**2).mean(1)[labels.seen])))


def _unit(labels: LabelErrors) -> str:
    return "px" if labels.kind == "pixel" else "m"
