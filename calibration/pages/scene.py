"""3D scene of lines: drawn from one side as SVG, and rotatable where scripts run."""

import json
import math
from collections.abc import Sequence

import numpy as np

from calibration.frozen import frozen
from calibration.geometry.types import Array
from calibration.pages.html import Html, element, join
from calibration.pages.svg import drawing, path

WIDTH, HEIGHT = 900.0, 520.0
FILLED = 0.92
"""Initial size of the scene as a fraction of the figure."""
TURN, TILT = math.radians(-35), math.radians(28)
"""Initial direction of view."""


@frozen(eq=False)
class Line:
    """A polyline with a style."""

    points: Array
    """(N, 3), m."""
    class_: str
    """CSS class, which sets its colour."""
    label: str = ""
    """Text at its first point."""


def scene(lines: Sequence[Line], title: str) -> Html:
    """Return the figure; the script of the page makes it rotatable.

    Args:
        lines: lines in the world frame, z up.
        title: title of the figure.
    """
    everything = np.concatenate([line.points for line in lines]) if lines else np.zeros((1, 3))
    low, high = everything.min(axis=0), everything.max(axis=0)
    centre = (low + high) / 2
    wide, tall = np.abs(_seen(everything - centre) - (WIDTH / 2, HEIGHT / 2)).max(axis=0).tolist()
    radius = max(tall, wide * HEIGHT / WIDTH, 1e-3)
    scale = FILLED * HEIGHT / 2 / radius
    parts = []
    for line in lines:
        flat = _seen((line.points - centre) * scale)
        parts.append(element("path", d=path(flat), class_=f"scene {line.class_}"))
        if line.label:
            x, y = flat[0].tolist()
            parts.append(element("text", line.label, x=x + 4, y=y - 4, class_="small"))
    data = {
        "centre": _rounded(centre),
        "scale": round(scale, 4),
        "lines": [{"p": _rounded(line.points.ravel()), "c": line.class_, "t": line.label} for line in lines],
    }
    still = drawing(WIDTH, HEIGHT, title, join(parts))
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    return element(
        "div", still, element("script", Html(text), type="application/json"), class_="turning", data_title=title
    )


def _seen(points: Array) -> Array:
    """Project points (N, 3) to the figure, (N, 2), px: parallel projection, from the front, right and above."""
    x = math.cos(TURN) * points[:, 0] - math.sin(TURN) * points[:, 1]
    y = math.sin(TURN) * points[:, 0] + math.cos(TURN) * points[:, 1]
    up = math.cos(TILT) * points[:, 2] + math.sin(TILT) * y
    return np.stack([WIDTH / 2 + x, HEIGHT / 2 - up], axis=-1)


def _rounded(values: Array) -> list[float]:
    return [round(float(v), 4) + 0.0 for v in values]
