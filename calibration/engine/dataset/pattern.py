"""Calibration patterns: the geometry of their corners and border, and lists of numbered points.

The pattern frame: x along a row of corners, y along a column, z into the board (away from a camera
that sees it), all corners at z = 0. Metres.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.base.records import between, field, record
from calibration.engine.dataset.document import Node, finite_numbers

CORNER_KEYS = ("id", "x", "y")


def read_corners(node: Node) -> tuple[Array, Array]:
    """Return the ids (K,), not yet checked to be integers, and coordinates (K, 2) of a list.

    Raises:
        InputError: a key is missing, or a value is not a finite number.
    """
    try:
        found = finite_numbers([corner[key] for corner in node.sequence() for key in CORNER_KEYS])
    except (KeyError, TypeError):
        found = None
    if found is None:  # one by one, to report the first invalid one
        found = np.array([element[key].number() for element in node.elements() for key in CORNER_KEYS])
    rows = found.reshape(-1, 3)
    return rows[:, 0], np.ascontiguousarray(rows[:, 1:])


MIN_SIZE, MAX_SIZE = 1e-6, 1e3
"""Limits of the side of a pattern's square (m)."""
MAX_MARKER = 10_000
"""Limit of the lowest id of a board's markers."""
PatternKind = Literal["charuco", "chessboard", "aprilgrid", "circles", "asymmetric-circles", "tags"]
CIRCLE_KINDS: tuple[PatternKind, ...] = ("circles", "asymmetric-circles")
"""Kinds of grids of circles."""
UNMARKED_KINDS: tuple[PatternKind, ...] = ("chessboard", *CIRCLE_KINDS)
"""Kinds without markers: found whole or not at all, and some look the same turned."""


@record
class PlacedTag:
    """A tag or marker of a dictionary, and where it is in the plane of its pattern."""

    id: Annotated[int, between(0, MAX_MARKER)] = field("Its id in the dictionary.")
    size: Annotated[float, between(MIN_SIZE, MAX_SIZE)] = field("Side of its black border, m.")
    x: Annotated[float, between(-MAX_SIZE, MAX_SIZE)] = field("Of its centre, to the right, m (0).", default=0.0)
    y: Annotated[float, between(-MAX_SIZE, MAX_SIZE)] = field("Of its centre, downwards, m (0).", default=0.0)
    yaw: Annotated[float, between(-7, 7)] = field(
        "Clockwise, from upright as AprilTag's own images show its tags, and OpenCV its markers, rad (0).", default=0.0
    )

    @property
    def corners(self) -> Array:
        """Corners (4, 3), clockwise from the top left."""
        across, down = (
            self.size / 2 * np.array([[np.cos(self.yaw), np.sin(self.yaw)], [-np.sin(self.yaw), np.cos(self.yaw)]])
        )
        plane = np.array([self.x, self.y]) + np.stack([-across - down, across - down, across + down, down - across])
        return np.pad(plane, ((0, 0), (0, 1)))


@dataclass(frozen=True, eq=False)
class Pattern:
    """Calibration pattern: its geometry, and its frame in the tree."""

    name: str
    kind: PatternKind
    link: str
    """Frame of the pattern."""
    parent_link: str
    """Frame that the pattern's pose is relative to."""
    fixed: bool
    """Whether it has one pose for all collections, or one for each."""
    corners: Array
    """(K, 3): inner corners, corners of an aprilgrid's tags, or centres of circles, by label id; z = 0."""
    outline: Array
    """(4, 2): the corners of the physical border: top left, top right, bottom right, bottom left."""
    known_pose: bool = False
    """Whether its pose on its parent is as exact as its print, such as that of a side of a body."""

    @property
    def edge(self) -> tuple[str, str]:
        """Edge of its pose, (parent, child)."""
        return (self.parent_link, self.link)

    @cached_property
    def centre(self) -> Array:
        """Mean of the corners (3,)."""
        return np.asarray(self.corners.mean(axis=0))

    @cached_property
    def size(self) -> float:
        """Root-mean-square distance of the corners from their centre, m: the scale of the pattern."""
        return float(np.sqrt(((self.corners - self.centre) ** 2).sum(-1).mean()))

    @cached_property
    def columns(self) -> int:
        """Number of corners in a row."""
        return int((abs(self.corners[:, 1] - self.corners[0, 1]) < 1e-9).sum())

    @cached_property
    def neighbours(self) -> tuple[IntArray, IntArray]:
        """Pairs of corners, each pair once, that are as near to each other as any two (5 % more at most): their ids."""
        apart = np.linalg.norm(self.corners[:, None] - self.corners, axis=-1)
        first, second = np.nonzero(np.triu(apart < 1.05 * apart[apart > 0].min(), 1))
        return first, second


def rectangle(left: float, top: float, right: float, bottom: float) -> Array:
    """Return the corners (4, 2) of a border: top left, top right, bottom right, bottom left."""
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def grid(columns: int, rows: int, square: float, origin: tuple[float, float]) -> Array:
    """Return the corners of a grid (K, 3): corner ``row * columns + column`` is ``origin + (column, row) * square``."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    corners = np.zeros((columns * rows, 3))
    corners[:, 0] = origin[0] + column * square
    corners[:, 1] = origin[1] + row * square
    return corners


def staggered_grid(columns: int, rows: int, spacing: float) -> Array:
    """Return the centres (K, 3) of an asymmetric grid of circles, as in OpenCV: every second row is shifted.

    Circle ``row * columns + column`` is at ``(2 column + row % 2, row) * spacing``.
    """
    centres = grid(columns, rows, spacing, (0.0, 0.0))
    centres[:, 0] = 2 * centres[:, 0] + spacing * (np.arange(len(centres)) // columns % 2)
    return centres


def tag_lines(count: int, tag: float, spacing: float) -> Array:
    """Return where the tags in a row begin and end (2 count,), from 0; ``spacing`` in sides of a tag."""
    begins = np.arange(count) * (1 + spacing) * tag
    return np.stack([begins, begins + tag], -1).ravel()


def tag_grid(columns: int, rows: int, tag: float, spacing: float) -> Array:
    """Return the corners (4 * columns * rows, 3) of an aprilgrid's tags, numbered as in Kalibr.

    Corner 0 is the bottom left of tag 0, the tag at the bottom left of the board; along the bottom of the first
    row of tags, then along its top, and so on upwards, ``2 columns`` corners a row. Corner 0 is the origin, x points to
    the right, as Kalibr's; its y points up and its z out of the board, here down and into it, as for all patterns.
    """
    y, x = np.meshgrid(-tag_lines(rows, tag, spacing), tag_lines(columns, tag, spacing), indexing="ij")
    return np.stack([x.ravel(), y.ravel() + 0.0, np.zeros(x.size)], -1)


def tag_outline(columns: int, rows: int, tag: float, spacing: float, border: tuple[float, float]) -> Array:
    """Return the outline (4, 2) of an aprilgrid: tags, the squares at their corners (one gap wide), and the border."""
    (width, height), gap = ((n * (1 + spacing) - spacing) * tag for n in (columns, rows)), spacing * tag
    left, right = -gap - border[0], width + gap + border[0]
    top, bottom = -height - gap - border[1], gap + border[1]
    return rectangle(left, top, right, bottom)


def outline(columns: int, rows: int, square: float, border: tuple[float, float], origin: tuple[float, float]) -> Array:
    """Return the outline (4, 2) of a board: the squares, one more than inner corners each way, and the border."""
    left, top = origin[0] - square - border[0], origin[1] - square - border[1]
    right, bottom = origin[0] + columns * square + border[0], origin[1] + rows * square + border[1]
    return rectangle(left, top, right, bottom)


def corner_origin(kind: PatternKind, version: str, square: float) -> tuple[float, float]:
    """Return the position of corner 0 in the pattern frame.

    A charuco board of dataset version 3 has its origin at the corner of the printed board; a
    chessboard, and a charuco board of version 2, on the first inner corner.
    """
    return (square, square) if kind == "charuco" and not version.startswith("2") else (0.0, 0.0)


BORDER_CORNERS = ("top_left", "top_right", "bottom_right", "bottom_left")
BORDER_SIDES = {"top": (0, 1), "bottom": (3, 2), "left": (0, 3), "right": (1, 2)}
"""Sides of the border, each from one of `BORDER_CORNERS` to another."""
SAMPLE_SPACING_M = 0.02
"""m: distance of ATOM's samples of the sides of the border."""
MAX_SAMPLES = 10_000
"""Limit of the number of samples of one side."""
MAX_COORDINATE = 1e6
"""m: limit of a coordinate in a pattern's frame."""


def with_explicit_geometry(pattern: Pattern, node: Node) -> Pattern:
    """Return the pattern with the corners and the border of the document; missing parts are unchanged.

    Raises:
        InputError: something in it is wrong.
    """
    corners, frame = node.get("corners"), node.get("frame")
    if corners and corners.sequence():
        pattern = replace(pattern, corners=_corners_by_id(corners))
    if frame and (border := frame.get("corners")):
        pattern = replace(
            pattern,
            outline=np.array(
                [[border[c][axis].within(-MAX_COORDINATE, MAX_COORDINATE) for axis in "xy"] for c in BORDER_CORNERS]
            ),
        )
    return pattern


def _corners_by_id(node: Node) -> Array:
    """Parse corners (K, 3) by id; the ids must be 0 to K - 1, in any order."""
    ids, places = read_corners(node)
    order = np.argsort(ids, kind="stable")
    if not np.array_equal(ids[order], np.arange(len(ids))):
        raise node.fault(f"found other ids than 0 to {len(ids) - 1}, each once, for the {len(ids)} corners")
    if (far := (abs(places) > MAX_COORDINATE).any(-1)).any():
        raise node.fault(f"found corner {int(ids[far.argmax()])} more than {MAX_COORDINATE:g} m away")
    corners = np.zeros((len(ids), 3))
    corners[:, :2] = places[order]
    return corners


def pattern_document(pattern: Pattern, transforms_initial: Mapping[str, Any]) -> dict[str, Any]:
    """Return the ``patterns[name]`` of a version 3 dataset; ``transforms_initial`` is copied unchanged."""
    ends = pattern.outline.tolist()
    return {
        "corners": [{"id": i, "x": x, "y": y} for i, (x, y, _) in enumerate(pattern.corners.tolist())],
        "frame": {
            "corners": {name: {"x": x, "y": y} for name, (x, y) in zip(BORDER_CORNERS, ends, strict=True)},
            "lines_sampled": {
                side: _sample_side(pattern.outline[start], pattern.outline[end])
                for side, (start, end) in BORDER_SIDES.items()
            },
        },
        "transitions": {"horizontal": [], "vertical": []},
        "transforms_initial": dict(transforms_initial),
    }


def _sample_side(start: Array, end: Array) -> list[dict[str, float]]:
    count = min(max(2, round(float(np.linalg.norm(end - start)) / SAMPLE_SPACING_M)), MAX_SAMPLES)
    return [{"x": x, "y": y} for x, y in np.linspace(start, end, count).tolist()]
