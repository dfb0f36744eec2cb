"""Part of the page: how sure the projection of calibrated cameras is, over their images."""

from collections.abc import Iterator, Sequence

import numpy as np

from calibration.base.arrays import Array
from calibration.ci.pages.html import Html, element
from calibration.ci.pages.image_map import image_map
from calibration.ci.pages.page import figure
from calibration.pipeline.matrix.cell_result import ProjectionResult


def projection_figures(cameras: Sequence[ProjectionResult]) -> Iterator[Html]:
    """Yield the maps of each camera, for points at the pattern's distance and far away."""
    if cameras:
        yield element("h3", "How sure the projection is")
    for each in cameras:
        size = each.width, each.height
        near = image_map(f"Projection of {each.camera}, {each.distance_m:.2g} m away", size, _cells(each, each.near_px))
        far = image_map(f"Projection of {each.camera}, far away", size, _cells(each, each.far_px))
        what = f"{each.camera}: standard deviation of where a point is seen"
        yield element(
            "div",
            figure(
                near,
                f"{what} at the pattern's distance, {each.distance_m:.2g} m: {each.median_px:.2g} px (median), "
                f"{each.worst_px:.2g} px at most where corners were seen, in {each.seen:.0%} of the image.",
            ),
            figure(far, f"{what} far away: {each.far_median_px:.2g} px, {each.far_worst_px:.2g} px at most."),
            class_="figures",
        )


def _cells(found: ProjectionResult, values: Sequence[float]) -> Array:
    """Return the values (R, C) of the cells; NaN where the lens has no ray."""
    cells = np.array(values).reshape(-1, found.columns)
    return np.where(cells > 0, cells, np.nan)
