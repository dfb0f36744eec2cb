"""Figures over a camera's image, and 3D scenes of lines and points.

Over an image: a map of cells, residuals as vectors, and the image with its labels. A scene is drawn from one side as
SVG, and is turned where scripts run (three.js).
"""

import itertools
import json
import math
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array
from calibration.ci.pages.charts import drawing, path, text, thinned
from calibration.ci.pages.html import Html, element, join

FIGURE_WIDTH = 560.0
"""Width of the image in a figure, px."""
SCALE_HEIGHT, NUMBERS_HEIGHT = 14.0, 22.0
"""Height of the colour scale, and of its numbers, px."""
COLOUR_STEPS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
"""px: values at which the colour becomes stronger."""


CORNER_STEPS = (1, 2, 5, 10, 20, 50, 100, 200)
"""Numbers of corners from which the colour becomes stronger."""
SCENE_WIDTH, FIGURE_HEIGHT = 900.0, 520.0
FILLED_FRACTION = 0.92
"""Initial size of the scene as a fraction of the figure."""
INITIAL_TURN, INITIAL_TILT = math.radians(-35), math.radians(28)
"""Initial direction of view."""


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


@dataclass(frozen=True)
class Kind:
    """Kind of lines or points, which readers hide and show together."""

    colour: str
    """Variable of the style sheet, without its hyphens."""
    legend: str
    dashed: bool = False
    filled: bool = False
    """Whether its lines are outlines of faces of four corners."""


@dataclass(frozen=True, eq=False)
class Line:
    """A polyline with a style."""

    points: Array
    """(N, 3), m."""
    class_: str
    """Name of its kind, and CSS class, which sets its colour."""
    label: str = ""
    """Text beside it."""
    collection: int | None = None
    """Number of the only collection in which it is there; None for all."""
    in_all: bool = True
    """Whether it is drawn too where all collections are drawn together."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points with values, of one collection."""

    points: Array
    """(N, 3), m."""
    values: Array
    """(N,): from 0, the colour of what fits, to 1, that of what does not."""
    class_: str
    collection: int


LABEL_SIDES = tuple((x, y) for x, y in itertools.product((1, 0, -1), (0, -1, 1)) if (x, y) != (0, 0))
"""Where a label may stand beside the box around its line: to the right (1) or left (-1), below (1) or above (-1)."""
LABEL_GAPS = (5.0, 16.0, 32.0)
"""px: distances of a label from that box."""
LETTER_WIDTH, LETTER_HEIGHT = 6.3, 12.0
"""px: estimated width of a label's character, and its height."""
SAMPLE_DISTANCE = 6.0
"""px: distance of the points of the drawing that a label avoids."""


def scene(
    lines: Sequence[Line],
    title: str,
    kinds: Mapping[str, Kind],
    clouds: Sequence[Cloud] = (),
    collections: Sequence[str] = (),
) -> Html:
    """Return the figure with its legend; the script of the page makes it one that is turned.

    Args:
        lines: lines in the world frame, z up.
        title: title of the figure.
        kinds: all kinds of lines and clouds.
        clouds: points, drawn where scripts run only.
        collections: names of the collections, which readers choose from.
    """
    seen = [line for line in lines if line.in_all]
    everything = np.concatenate([line.points for line in seen]) if seen else np.zeros((1, 3))
    low, high = everything.min(axis=0), everything.max(axis=0)
    centre = (low + high) / 2
    wide, tall = (
        np.abs(_project_points(everything - centre) - (SCENE_WIDTH / 2, FIGURE_HEIGHT / 2)).max(axis=0).tolist()
    )
    radius = max(tall, wide * FIGURE_HEIGHT / SCENE_WIDTH, 1e-3)
    scale = FILLED_FRACTION * FIGURE_HEIGHT / 2 / radius
    drawn = [_project_points((line.points - centre) * scale) for line in seen]
    parts = [
        element("path", d=path(flat), class_=f"scene {line.class_}") for line, flat in zip(seen, drawn, strict=True)
    ]
    for number, place in _place_labels(seen, drawn).items():
        x, y = place.corner(drawn[number])
        parts.append(element("text", seen[number].label, x=x, y=y + LETTER_HEIGHT - 3, class_="small label"))
    used = {line.class_ for line in lines} | {cloud.class_ for cloud in clouds}
    data = {
        "lines": [
            {"p": _round_values(line.points.ravel()), "c": line.class_}
            | ({"t": line.label} if line.label else {})
            | ({} if line.collection is None else {"k": line.collection, "a": line.in_all})
            for line in lines
        ],
        "clouds": [
            {
                "p": _round_values(cloud.points.ravel(), 3),
                "v": _round_values(cloud.values, 2),
                "c": cloud.class_,
                "k": cloud.collection,
                "a": True,
            }
            for cloud in clouds
        ],
        "kinds": {name: {"colour": k.colour, "dashed": k.dashed, "filled": k.filled} for name, k in kinds.items()},
        "collections": list(collections),
    }
    still = drawing(SCENE_WIDTH, FIGURE_HEIGHT, title, join(parts))
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    script = element("script", Html(text), type="application/json")
    legend = [
        element("span", element("i", style=f"border-color: var(--{kind.colour})"), kind.legend, data_kind=name)
        for name, kind in kinds.items()
        if name in used and kind.legend
    ]
    return element(
        "figure",
        element("div", still, script, class_="turning", data_title=title),
        element("figcaption", *legend, class_="legend"),
    )


@dataclass(frozen=True)
class _Place:
    """Place of a label beside the box around its line."""

    side: tuple[int, int]
    gap: float
    width: float
    """Of the label, px."""

    def corner(self, line: Array) -> tuple[float, float]:
        """Return the upper left corner of the label of a line (N, 2), px."""
        low, high, size = line.min(axis=0), line.max(axis=0), np.array((self.width, LETTER_HEIGHT))
        side = np.array(self.side)
        beside = np.where(side > 0, high + self.gap, low - self.gap - size)
        x, y = np.where(side == 0, (low + high - size) / 2, beside).tolist()
        return x, y


def _place_labels(lines: Sequence[Line], drawn: Sequence[Array]) -> dict[int, _Place]:
    """Choose the place of each label, by the number of its line: where it covers least of the drawing and of others."""
    avoided = np.concatenate([_sample_line(flat) for flat in drawn]) if drawn else np.zeros((0, 2))
    found = {}
    for number, line in enumerate(lines):
        if not line.label:
            continue
        places = [_Place(side, gap, LETTER_WIDTH * len(line.label)) for gap in LABEL_GAPS for side in LABEL_SIDES]
        chosen = places[int(np.argmin([_count_covered(place, drawn[number], avoided) for place in places]))]
        x, y = chosen.corner(drawn[number])
        box = np.array(
            [(x, y), (x + chosen.width, y), (x + chosen.width, y + LETTER_HEIGHT), (x, y + LETTER_HEIGHT), (x, y)]
        )
        avoided = np.concatenate([avoided, _sample_line(box)])
        found[number] = chosen
    return found


def _count_covered(place: _Place, line: Array, avoided: Array) -> int:
    """Return how many points (N, 2) a label covers; one that leaves the figure covers more than any other."""
    corner = np.array(place.corner(line))
    end = corner + np.array((place.width, LETTER_HEIGHT))
    if (corner < 0).any() or end[0] > SCENE_WIDTH or end[1] > FIGURE_HEIGHT:
        return len(avoided) + 1
    return int(((avoided > corner - 2) & (avoided < end + 2)).all(axis=-1).sum())


def _sample_line(line: Array) -> Array:
    """Return points (M, 2) along a polyline (N, 2) at small distances."""
    counts = np.maximum(1, np.ceil(np.linalg.norm(np.diff(line, axis=0), axis=-1) / SAMPLE_DISTANCE).astype(int))
    parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(line[:-1], line[1:], counts.tolist(), strict=True)]
    return np.concatenate([*parts, line[-1:]])


def _project_points(points: Array) -> Array:
    """Project points (N, 3) to the figure, (N, 2), px: parallel projection, from the front, right and above."""
    x = math.cos(INITIAL_TURN) * points[:, 0] - math.sin(INITIAL_TURN) * points[:, 1]
    y = math.sin(INITIAL_TURN) * points[:, 0] + math.cos(INITIAL_TURN) * points[:, 1]
    up = math.cos(INITIAL_TILT) * points[:, 2] + math.sin(INITIAL_TILT) * y
    return np.stack([SCENE_WIDTH / 2 + x, FIGURE_HEIGHT / 2 - up], axis=-1)


def _round_values(values: Array, digits: int = 4) -> list[float]:
    return [round(v, digits) + 0.0 for v in values.tolist()]
