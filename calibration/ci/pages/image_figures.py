"""Figures over a camera's image: a map of cells, residuals as vectors, and the image with its labels."""

from base64 import b64encode
from collections.abc import Sequence

import numpy as np

from calibration.base.arrays import Array
from calibration.ci.pages.charts import drawing, text, thinned
from calibration.ci.pages.html import Html, element, join

FIGURE_WIDTH = 560.0
"""Width of the image in a figure, px."""
SCALE_HEIGHT, NUMBERS_HEIGHT = 14.0, 22.0
"""Height of the colour scale, and of its numbers, px."""
COLOUR_STEPS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""px: values at which the colour becomes stronger."""


CORNER_STEPS = (1, 2, 5, 10, 20, 50, 100, 200)
"""Numbers of corners from which the colour becomes stronger."""


def image_map(
    title: str, size: tuple[int, int], values: Array, unit: str = "px", steps: Sequence[float] = COLOUR_STEPS
) -> Html:
    """Return the figure: a cell is the stronger, the larger its value, by the scale below.

    Args:
        title: title of the figure.
        size: width and height of the image, px.
        values: (R, C), of the cells; NaN where there is none.
        unit: of the values.
        steps: values at which the colour becomes stronger.
    """
    rows, columns = values.shape
    high = size[1] * FIGURE_WIDTH / size[0]
    level = np.where(np.isfinite(values), np.searchsorted(steps, values, side="right"), -1)
    scaled = f"scale({FIGURE_WIDTH / columns:.6g} {high / rows:.6g})"
    drawn = []
    for n in range(len(steps) + 1):  # one path of each colour, in units of cells, so that a map is a few kilobytes
        boxes = "".join(f"M{c} {r}h1v1h-1z" for r, c in np.argwhere(level == n))
        if boxes:
            drawn.append(element("path", d=boxes, transform=scaled, class_="heat", fill_opacity=_opacity(n, steps)))
    frame = element("rect", x=0.5, y=0.5, width=FIGURE_WIDTH - 1, height=high - 1, class_="frame")
    step, below = FIGURE_WIDTH / (len(steps) + 1), high + 8 + SCALE_HEIGHT + 14
    scale = [
        element(
            "rect",
            x=n * step,
            y=high + 8,
            width=step,
            height=SCALE_HEIGHT,
            class_="heat",
            fill_opacity=_opacity(n, steps),
        )
        for n in range(len(steps) + 1)
    ]
    texts = [f"{edge:g}" for edge in steps]
    texts[-1] += f" {unit}"
    numbers = [text((n + 1) * step, below, each, class_="small") for n, each in enumerate(texts)]
    finite = values[np.isfinite(values)]
    most = f": at most {finite.max():.2g} {unit}" if len(finite) else ""
    return drawing(
        FIGURE_WIDTH, high + 8 + SCALE_HEIGHT + NUMBERS_HEIGHT, f"{title}{most}", *drawn, frame, *scale, *numbers
    )


def _opacity(above: int, steps: Sequence[float]) -> float:
    """Return the opacity of the colour of values above this number of steps."""
    return round(0.05 + 0.95 * above / len(steps), 3)


MOST_VECTORS = 3000
VECTOR_LENGTH = 18.0
"""Length of the vector of a residual of three times the RMS, px of the figure."""


def residual_plane(name: str, size: tuple[int, int], pixels: Array, residuals: Array) -> Html:
    """Return the figure.

    Args:
        name: name of the camera.
        size: width and height of the image, px.
        pixels: (n, 2), positions of the labels.
        residuals: (n, 2), reprojection minus label, px.
    """
    scale = FIGURE_WIDTH / size[0]
    height = size[1] * scale
    rms = float(np.sqrt(np.mean(np.sum(residuals**2, axis=-1)))) if len(residuals) else 0.0
    enlarged = VECTOR_LENGTH / (3 * rms) if rms else 1.0
    chosen = thinned(len(pixels), MOST_VECTORS)
    at, to = pixels[chosen] * scale, (pixels[chosen] * scale + residuals[chosen] * enlarged)
    large = np.sum(residuals[chosen] ** 2, axis=-1) > (3 * rms) ** 2
    lines = [_draw_vectors(at[~large], to[~large], "vector"), _draw_vectors(at[large], to[large], "vector far")]
    frame = element("rect", x=0.5, y=0.5, width=FIGURE_WIDTH - 1, height=height - 1, class_="frame")
    title = f"Residuals of {name}: RMS {rms:.3g} px, vectors enlarged {enlarged / scale:.0f} times"
    return drawing(
        FIGURE_WIDTH, height, title, frame, join(lines), text(FIGURE_WIDTH - 8, height - 8, f"RMS {rms:.3g} px", "end")
    )


def _draw_vectors(at: Array, to: Array, class_: str) -> Html:
    ends = np.concatenate([at, to], axis=-1).tolist()
    d = "".join(f"M{x:.1f} {y:.1f}L{u:.1f} {v:.1f}" for x, y, u, v in ends)
    return element("path", d=d, class_=class_) if d else Html("")


OVERLAY_WIDTH = 430.0
"""Width of the figure, px."""
ARM = 3.0
"""Half the size of a cross, px of the figure."""


def overlay(title: str, jpeg: bytes | None, size: tuple[int, int], seen: Array, expected: Array) -> Html:
    """Return the figure.

    Args:
        title: title of the figure.
        jpeg: the image, of any size; None for an empty frame.
        size: width and height of the image to which the pixel coordinates refer.
        seen: (n, 2), px, drawn as crosses.
        expected: (n, 2), px, drawn as circles.
    """
    scale = OVERLAY_WIDTH / size[0]
    height = size[1] * scale
    address = "" if jpeg is None else f"data:image/jpeg;base64,{b64encode(jpeg).decode('ascii')}"
    picture = element("image", href=address, width=OVERLAY_WIDTH, height=height) if address else Html("")
    crosses = "".join(
        f"M{x - ARM:.1f} {y:.1f}h{2 * ARM:g}m-{ARM:g}-{ARM:g}v{2 * ARM:g}" for x, y in (seen * scale).tolist()
    )
    circles = "".join(
        f"M{x - ARM:.1f} {y:.1f}a{ARM:g} {ARM:g} 0 1 0 {2 * ARM:g} 0a{ARM:g} {ARM:g} 0 1 0 -{2 * ARM:g} 0"
        for x, y in (expected * scale).tolist()
    )
    return drawing(
        OVERLAY_WIDTH,
        height,
        title,
        picture,
        element("rect", x=0.5, y=0.5, width=OVERLAY_WIDTH - 1, height=height - 1, class_="frame"),
        element("path", d=circles, class_="expected"),
        element("path", d=crosses, class_="seen"),
    )
