"""Residuals on a camera's image plane, as enlarged vectors; empty areas have no labels."""

import numpy as np

from calibration.base.arrays import Array
from calibration.ci.pages.html import Html, element, join
from calibration.ci.pages.svg import drawing, text, thinned

MOST_VECTORS = 3000
FIGURE_WIDTH = 560.0
"""Width of the figure, px."""
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
