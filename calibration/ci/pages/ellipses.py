"""Error ellipses of a position, projected along each axis."""

import numpy as np

from calibration.base.arrays import Array
from calibration.ci.pages.html import Html, element, join
from calibration.ci.pages.svg import drawing, text

PLANE_SIDE, PLANE_GAP = 150.0, 14.0
AXES_OF_PLANE = ((0, 1), (0, 2), (1, 2))


def ellipses(name: str, covariance: Array, limit: float | None) -> Html:
    """Return the figure: ellipses of two standard deviations, and the limit as a circle.

    Args:
        name: name of the object at the position.
        covariance: (3, 3), mm^2.
        limit: mm; None for no limit.
    """
    largest = 2 * float(np.sqrt(np.linalg.eigvalsh(covariance).max()))
    span = 1.15 * max(largest, limit or 0.0, 1e-9)
    scale = (PLANE_SIDE / 2 - 4) / span
    parts = []
    for k, (i, j) in enumerate(AXES_OF_PLANE):
        x, y = PLANE_SIDE / 2 + k * (PLANE_SIDE + PLANE_GAP), PLANE_SIDE / 2
        values, vectors = np.linalg.eigh(covariance[np.ix_([i, j], [i, j])])
        a, b = (2 * float(np.sqrt(max(v, 0.0))) * scale for v in values[::-1])
        angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        turn = f"translate({x:.1f} {y:.1f}) rotate({-angle:.1f})"
        parts += [
            element(
                "path",
                d=f"M{x - PLANE_SIDE / 2:.1f} {y}h{PLANE_SIDE}M{x:.1f} {y - PLANE_SIDE / 2}v{PLANE_SIDE}",
                class_="grid",
            ),
            element("circle", cx=x, cy=y, r=limit * scale, class_="limit") if limit else Html(""),
            element("ellipse", rx=max(a, 0.75), ry=max(b, 0.75), transform=turn, class_="ellipse"),
            text(x + PLANE_SIDE / 2 - 2, y - 5, "xyz"[i], "end", "small"),
            text(x + 5, y - PLANE_SIDE / 2 + 11, "xyz"[j], "start", "small"),
        ]
    scale_text = f"at most {largest:.3g} mm" + (f"; the circle is the limit, {limit:g} mm" if limit else "")
    parts.append(text(4, PLANE_SIDE + 13, scale_text, "start", "small"))
    title = f"{name}: two standard deviations, {scale_text}"
    return drawing(3 * PLANE_SIDE + 2 * PLANE_GAP, PLANE_SIDE + 20, title, join(parts))
