"""Statistical tests of the residuals, for results without another explanation: notes on deviations from pure noise.

Pure noise is independent between labels, equal over the image and the range, and as small as a detector's. The
tests treat views as clusters, so that differences between views (of an arm, or a sway) are not taken for a pattern.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.estimation.covariance.result import Calibration, LabelErrors, label_errors
from calibration.engine.statistics import median, score_of_f, threshold

MAX_DETECTOR_NOISE = 0.35
"""px: limit of a good corner detector's noise in sharp images."""
IMAGE_CELLS = (4, 3)
"""Number of columns and rows that an image is divided into."""
IMAGE_PARTS = tuple(
    f"at {100 * i / IMAGE_CELLS[0]:.0f} to {100 * (i + 1) / IMAGE_CELLS[0]:.0f} % of the image's width and "
    f"{100 * j / IMAGE_CELLS[1]:.0f} to {100 * (j + 1) / IMAGE_CELLS[1]:.0f} % of its height"
    for j in range(IMAGE_CELLS[1])
    for i in range(IMAGE_CELLS[0])
)
"""Descriptions of these parts, row by row."""
RANGE_PARTS = 6
"""Number of equal parts that a LiDAR's points are divided into by range."""
LEAST_VIEWS = 8
"""Minimum of views of a part."""
MIN_REPORTED_ERROR = {"pixel": 0.1, "range": 0.005}
"""Smaller errors (px, m) are not reported,"""
OF_NOISE = 0.5
"""nor are those smaller than this fraction of the noise."""
MIN_REPORTED_CORRELATION = 0.5
"""Correlation of neighbouring corners' errors above which it is reported."""
MIN_NOISE_RATIO = 1.5
"""Ratio of a sensor's noise to that of all others of its modality above which it is reported."""


def residuals(calibration: Calibration) -> tuple[Finding, ...]:
    """Report errors that are systematic in a part of the image or of the range, correlated in neighbours, or large.

    Args:
        calibration: a calibration that has converged.
    """
    labels = [each for each in label_errors(calibration.solution) if each.kind in MIN_REPORTED_ERROR]
    parts = sum(RANGE_PARTS if each.kind == "range" else IMAGE_CELLS[0] * IMAGE_CELLS[1] for each in labels)
    return (
        *(note for each in labels for note in _find_systematic_error(calibration, each, threshold(parts))),
        *(note for each in labels for note in _find_correlated_neighbours(calibration, each)),
        *_find_noisy_sensors(calibration, labels),
    )


def _find_systematic_error(calibration: Calibration, labels: LabelErrors, limit: float) -> list[Finding]:
    """Find the largest systematic error over all views, in a part of the image or of the range."""
    part, names = _parts_of_labels(calibration, labels)
    least = max(MIN_REPORTED_ERROR[labels.kind], OF_NOISE * _noise_level(labels))
    worst: tuple[float, str] = (least, "")
    for i, name in enumerate(names):
        of = (part == i) & labels.seen
        sums, counts = np.where(of[:, None], labels.errors, 0.0).sum(-1), of.sum(-1)
        sums = sums[counts > 0]
        V, d = sums.shape
        if max(LEAST_VIEWS, d + 2) > V:
            continue
        size = float(np.linalg.norm(sums.sum(0)) / counts.sum())
        if not size > worst[0]:  # NaN too
            continue
        mean = sums.mean(0)
        covariance = np.cov(sums.T).reshape(d, d) / V
        T2 = float(mean @ np.linalg.lstsq(covariance, mean, rcond=None)[0])  # Hotelling's T^2, with views as clusters
        if score_of_f(T2 * (V - d) / (d * (V - 1)), d, V - d) > limit:
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
    return [Finding("residual-pattern", "note", text, (labels.sensor,), value=size, unit=_unit_of_labels(labels))]


def _parts_of_labels(calibration: Calibration, labels: LabelErrors) -> tuple[Array, Sequence[str]]:
    """Return the part (V, L) of the image or the range of each label, and the descriptions of the parts."""
    sensor = calibration.dataset.sensors[labels.sensor]
    if labels.kind == "pixel" and sensor.camera:
        columns, rows = IMAGE_CELLS
        u, v = np.moveaxis(sensor.camera.project(np.moveaxis(labels.points, 1, -1)), -1, 0)
        with np.errstate(invalid="ignore"):
            column = np.clip(np.nan_to_num(u / sensor.camera.width * columns), 0, columns - 1).astype(int)
            row = np.clip(np.nan_to_num(v / sensor.camera.height * rows), 0, rows - 1).astype(int)
        return row * columns + column, IMAGE_PARTS
    far = np.linalg.norm(labels.points, axis=1)
    edges = np.quantile(far[labels.seen], np.linspace(0, 1, RANGE_PARTS + 1))
    names = [f"from {a:.2f} to {b:.2f} m away" for a, b in pairwise(edges)]
    return np.clip(np.searchsorted(edges, far) - 1, 0, RANGE_PARTS - 1), names


def neighbours_err_alike(calibration: Calibration) -> bool:
    """Whether neighbouring corners of a camera err alike: something in its views is not as it is taken to be."""
    return any(_find_correlated_neighbours(calibration, each) for each in label_errors(calibration.solution))


def _find_correlated_neighbours(calibration: Calibration, labels: LabelErrors) -> list[Finding]:
    """Find correlated errors of neighbouring corners in the same view."""
    pattern = calibration.dataset.patterns[labels.pattern]
    if labels.kind != "pixel" or len(pattern.corners) != labels.errors.shape[-1]:
        return []
    i, j = pattern.neighbours
    both = labels.seen[:, i] & labels.seen[:, j]
    products = np.where(both, (labels.errors[..., i] * labels.errors[..., j]).sum(1), 0.0).sum(-1)
    squares = np.where(both, 0.5 * (labels.errors[..., i] ** 2 + labels.errors[..., j] ** 2).sum(1), 0.0).sum(-1)
    if len(products) < LEAST_VIEWS or not squares.sum():
        return []
    alike = float(products.sum() / squares.sum())
    if alike < MIN_REPORTED_CORRELATION:
        return []
    text = (
        f"neighbouring corners of '{labels.sensor}' err alike (correlation {alike:.2f}), so that its labels tell less "
        f"than their number: a lens or a board that is not as it is described, or smoothed images"
    )
    return [Finding("residual-correlation", "note", text, (labels.sensor,), value=alike, unit="1")]


def _find_noisy_sensors(calibration: Calibration, labels: Sequence[LabelErrors]) -> list[Finding]:
    """Find sensors with more noise than a detector should have, or than others of their modality."""
    levels = {(each.sensor, each.pattern, each.kind): _noise_level(each) for each in labels if each.seen.any()}
    notes = []
    for (sensor, pattern, kind), level in levels.items():
        others = [one for (name, _, each), one in levels.items() if each == kind and name != sensor]
        if others and level > MIN_NOISE_RATIO * max(others):
            text = (
                f"the labels of '{sensor}' on '{pattern}' scatter {level / max(others):.1f} times as much as those of "
                f"the others of its kind, which count as much: look at its focus, its light and its exposure"
            )
            notes.append(Finding("noisy-sensor", "note", text, (sensor,), value=level / max(others), unit="1"))
        elif (
            kind == "pixel"
            and (noise := calibration.noise_levels.pixel or 0.0) > MAX_DETECTOR_NOISE
            and level > MAX_DETECTOR_NOISE / 2
        ):
            text = (
                f"the corners of '{sensor}' scatter by {noise:.2g} px, a detector errs by {MAX_DETECTOR_NOISE:g} px at "
                "most: look at its focus, its light and its exposure, and whether all stood still"
            )
            notes.append(Finding("noisy-sensor", "note", text, (sensor,), value=noise, unit="px"))
    return notes


def _noise_level(labels: LabelErrors) -> float:
    """Return the root of the median squared error per axis, px or m: robust to a few wrong labels."""
    return float(np.sqrt(median((labels.errors**2).mean(1)[labels.seen])))


def _unit_of_labels(labels: LabelErrors) -> str:
    return "px" if labels.kind == "pixel" else "m"
