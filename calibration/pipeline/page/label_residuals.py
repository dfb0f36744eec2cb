"""Part of the page: residuals over the image, their distribution against the reported noise, RMS by collection."""

from collections.abc import Iterator

import numpy as np

from calibration.base.arrays import Array
from calibration.ci.pages.heat_map import heat_map
from calibration.ci.pages.histogram import histogram
from calibration.ci.pages.html import Html, element
from calibration.ci.pages.page import figure
from calibration.ci.pages.residual_plane import residual_plane
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.estimation.solve.noise_levels import NoiseLevels
from calibration.engine.evaluation.residuals import Residuals, residuals
from calibration.pipeline.page.worst_views import worst_views

_PLANE = (
    "from where its corners were seen to where they come out, enlarged. Red ones are longer than three times the RMS. "
    "Where the image is empty, the lens is not known."
)


def label_residuals(dataset: Dataset, levels: NoiseLevels | None, given: Dataset | None = None) -> Iterator[Html]:
    """Yield the figures of each sensor that has labels, then the views' RMS.

    Args:
        dataset: calibrated.
        levels: the calibration's estimate of the labels' standard deviations.
        given: the given dataset, with its images, if available.
    """
    found = {name: residuals(dataset, sensor) for name, sensor in dataset.sensors.items()}
    found = {name: each for name, each in found.items() if len(each.collections)}
    if found:
        yield element("h3", "Residuals")
    for name, each in found.items():
        yield element("div", *_figures(dataset.sensors[name], each, levels), class_="figures")
    pixels: dict[str, Array] = {}
    for unit, factor, widths in (("px", 1.0, (2,)), ("mm", 1e3, (1, 3))):
        rows = [name for name, each in found.items() if each.values.shape[-1] in widths]
        if rows:
            by_view = {name: factor * _by_collection(found[name], len(dataset.collections)) for name in rows}
            drawn = heat_map("RMS of each view", rows, dataset.keys, np.array(list(by_view.values())), unit)
            yield figure(drawn, f"RMS of each view, {unit}: the stronger, the larger; empty where nothing was seen.")
            if unit == "px":
                pixels = by_view
    yield from worst_views(dataset, found, pixels, given)


def _figures(sensor: Sensor, found: Residuals, levels: NoiseLevels | None) -> Iterator[Html]:
    stated = "beside the normal distribution of the noise that the calibration states."
    if sensor.camera is not None and found.values.shape[-1] == 2:
        size = sensor.camera.width, sensor.camera.height
        yield figure(residual_plane(sensor.name, size, found.where, found.values), f"{sensor.name}: {_PLANE}")
        sigma = levels.pixel if levels else None
        drawn = histogram(f"{sensor.name}, x and y", found.values.ravel(), sigma or 0.0, "px")
        yield figure(drawn, f"{sensor.name}: residuals in x and y {stated}")
    elif sensor.modality.has_poses:
        sigma = levels.pose_translation if levels else None
        drawn = histogram(f"{sensor.name}, x, y and z", 1e3 * found.values.ravel(), 1e3 * (sigma or 0.0), "mm")
        yield figure(drawn, f"{sensor.name}: from where patterns were measured to where they come out {stated}")
    else:
        sigma = levels.range if levels else None
        drawn = histogram(sensor.name, 1e3 * found.values.ravel(), 1e3 * (sigma or 0.0), "mm")
        yield figure(drawn, f"{sensor.name}: distances from the pattern {stated}")


def _by_collection(found: Residuals, count: int) -> Array:
    """RMS (count,) of each view; NaN if there is none."""
    sums = np.bincount(found.collections, found.sizes**2, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms: Array = np.sqrt(sums / np.bincount(found.collections, minlength=count))
    return rms
