"""Map over a camera's image: a grid of cells, stronger colour for larger values, with its scale."""

import math
from bisect import bisect_right

import numpy as np

from calibration.base.arrays import Array
from calibration.ci.pages.html import Html, element
from calibration.ci.pages.svg import drawing, text

FIGURE_WIDTH = 560.0
"""Width of the image in the figure, px."""
SCALE_HEIGHT, NUMBERS_HEIGHT = 14.0, 22.0
"""Height of the colour scale, and of its numbers, px."""
COLOUR_STEPS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""px: values at which the colour becomes stronger."""


def image_map(title: str, size: tuple[int, int], values: Array) -> Html:
    """Return the figure.

    Args:
        title: title of the figure.
        size: width and height of the image, px.
        values: (R, C), of the cells, px; NaN where there is none.
    """
    rows, columns = values.shape
    high = size[1] * FIGURE_WIDTH / size[0]
    across, down = FIGURE_WIDTH / columns, high / rows
    cells = []
    for (r, c), value in np.ndenumerate(values):
        if math.isfinite(value):
            u, v = (c + 0.5) * size[0] / columns, (r + 0.5) * size[1] / rows
            name = element("title", f"({u:.0f}, {v:.0f}): {value:.2g} px")
            box = {"x": c * across, "y": r * down, "width": across + 0.3, "height": down + 0.3}
            steps = bisect_right(COLOUR_STEPS, float(value))
            cells.append(element("rect", name, **box, class_="heat", fill_opacity=_opacity_above(steps)))
    frame = element("rect", x=0.5, y=0.5, width=FIGURE_WIDTH - 1, height=high - 1, class_="frame")
    step = FIGURE_WIDTH / (len(COLOUR_STEPS) + 1)
    scale = [
        element(
            "rect",
            x=i * step,
            y=high + 8,
            width=step,
            height=SCALE_HEIGHT,
            class_="heat",
            fill_opacity=_opacity_above(i),
        )
        for i in range(len(COLOUR_STEPS) + 1)
    ]
    numbers = [
        text(
            (i + 1) * step,
            high + 8 + SCALE_HEIGHT + 14,
            f"{edge:g}{' px' if i == len(COLOUR_STEPS) - 1 else ''}",
            class_="small",
        )
        for i, edge in enumerate(COLOUR_STEPS)
    ]
    finite = values[np.isfinite(values)]
    most = f": at most {finite.max():.2g} px" if len(finite) else ""
    return drawing(
        FIGURE_WIDTH, high + 8 + SCALE_HEIGHT + NUMBERS_HEIGHT, f"{title}{most}", *cells, frame, *scale, *numbers
    )


def _opacity_above(steps: int) -> float:
    """Return the opacity of the colour of values above this number of steps."""
    return round(0.05 + 0.95 * steps / len(COLOUR_STEPS), 3)
