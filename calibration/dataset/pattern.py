"""Calibration patterns: where their corners and their border lie.

The pattern frame: x along a row of corners, y along a column, z into the board (away from a camera
that sees it), all corners at z = 0. Metres.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibration.geometry.types import Array

PatternKind = Literal["charuco", "chessboard"]


@dataclass(frozen=True, eq=False)
class Pattern:
    """One pattern, its geometry and its place in the tree of frames."""

    name: str
    kind: PatternKind
    link: str
    """The pattern's frame."""
    parent_link: str
    """The frame that the pattern's pose is relative to."""
    fixed: bool
    """One pose for all collections, or one for each."""
    corners: Array
    """(K, 3): the inner corners, by label id; z = 0."""
    outline: Array
    """(4, 2): the corners of the physical border: top left, top right, bottom right, bottom left."""

    @property
    def centre(self) -> Array:
        """(3,): the mean of the corners."""
        mean: Array = self.corners.mean(axis=0)
        return mean

    @property
    def size(self) -> float:
        """The radius of the corners about their centre (root mean square, m): the scale of the pattern."""
        return float(np.sqrt(((self.corners - self.centre) ** 2).sum(-1).mean()))


def grid(columns: int, rows: int, square: float, origin: tuple[float, float]) -> Array:
    """(K, 3): corner ``row * columns + column`` at ``origin + (column, row) * square``."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    corners = np.zeros((columns * rows, 3))
    corners[:, 0] = origin[0] + column * square
    corners[:, 1] = origin[1] + row * square
    return corners


def outline(columns: int, rows: int, square: float, border: tuple[float, float], origin: tuple[float, float]) -> Array:
    """(4, 2): the printed squares, one more than inner corners each way, and the border around them."""
    left, top = origin[0] - square - border[0], origin[1] - square - border[1]
    right, bottom = origin[0] + columns * square + border[0], origin[1] + rows * square + border[1]
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def corner_origin(kind: PatternKind, version: str, square: float) -> tuple[float, float]:
    """Where corner 0 lies in the pattern frame.

    A charuco board of dataset version 3 has its origin at the corner of the printed board; a
    chessboard, and a charuco board of version 2, on the first inner corner.
    """
    return (square, square) if kind == "charuco" and not version.startswith("2") else (0.0, 0.0)
