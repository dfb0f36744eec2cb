"""Prints of patterns, as grey images of halving resolution (mipmaps).

A unit is the side of a square, the side of a tag of an aprilgrid, or the spacing of circles.

Both charuco layouts and their history: OpenCV 4.6 put a black square into the first corner of every
board; before, a board with an even number of rows of squares began with a white one
(``cv2.aruco.CharucoBoard.setLegacyPattern``).
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.pattern import Pattern
from calibration.robot.labelling.marked_boards import cell_ends, tag_cells
from calibration.robot.labelling.markers import printed_dictionary, turns_of

Grey = NDArray[np.uint8]

TEXELS_PER_UNIT = 256
"""Texels per unit; a power of two, so that its halves are integers."""
MAX_TEXELS = 8192
"""Limit of texels along the side of a board: one of more units has fewer texels per unit."""
INK_REFLECTANCE, PAPER_REFLECTANCE = 27, 230
"""Reflectance of ink and paper, in grey levels under a light of 1."""


@dataclass(frozen=True, eq=False)
class Texture:
    """Print of a pattern. Level k has ``texels / 2^k`` texels per unit; an image is continued by its border texels."""

    levels: tuple[Grey, ...]
    texels: int
    """Texels per unit at level 0."""
    margin: tuple[int, int]
    """Width of the border, in texels along x and along y, that every level has on each side of the print."""
    size: tuple[float, float]
    """Size of the print, along x and along y, units; an image may have more white to the right and below."""
    before: tuple[float, float]
    """Extent of the print to the left of and above corner 0, units."""

    def place(self, pattern: Pattern, size: float, level: int) -> tuple[Array, float]:
        """Return the map from the pattern frame to the texels' centres: ``texel = offset + scale * (x, y)``.

        Returns:
            The offset (2,) and the scale, texels per metre.
        """
        scale = self.texels / 2**level / size
        first = pattern.corners[0, :2] - np.array(self.before) * size
        return np.array(self.margin) - 0.5 - scale * first, scale

    def level(self, density: float) -> int:
        """Return the level with about one texel per sample, for samples of this many level 0 texels."""
        if not density > 1:
            return 0
        return min(math.floor(math.log2(density) + 0.5), len(self.levels) - 1)


@lru_cache(maxsize=16)
def texture(pattern: PatternConfiguration, legacy_layout: bool = False) -> Texture:
    """Return the print of a pattern.

    Raises:
        InputError: a charuco board without a marker size, with an unknown dictionary, or one that
            has fewer markers than the board needs.
    """
    size, before, draw = DRAWN_PATTERNS[pattern.kind](pattern, legacy_layout)
    texels = TEXELS_PER_UNIT
    while texels > 1 and texels * max(size) > MAX_TEXELS:
        texels //= 2
    image = draw(texels)
    levels = [(INK_REFLECTANCE + (PAPER_REFLECTANCE - image)) if pattern.inverted else image]
    while texels >> len(levels):  # down to one texel per unit
        height, width = levels[-1].shape
        levels.append(np.asarray(cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)))
    margin = (int(pattern.border_size[0] > 0), int(pattern.border_size[1] > 0))
    paper = INK_REFLECTANCE if pattern.inverted else PAPER_REFLECTANCE
    return Texture(tuple(_with_border(level, margin, paper) for level in levels), texels, margin, size, before)


_PAPER_TEXELS = 2
"""Width of the paper around a tag, texels, so that its edges are interpolated."""
_Sketch = tuple[tuple[float, float], tuple[float, float], Callable[[int], Grey]]
"""Size of a print, its extent before corner 0, and the function that draws it with this many texels per unit."""


def _draw_squares(pattern: PatternConfiguration, legacy_layout: bool) -> _Sketch:
    """Draw white and black squares, with or without markers."""
    columns, rows = pattern.dimension[0] + 1, pattern.dimension[1] + 1
    row, column = np.mgrid[:rows, :columns]
    black = (row + column) % 2 == int(pattern.kind == "charuco" and legacy_layout and rows % 2 == 0)
    markers = marker_modules(pattern, int((~black).sum())) if pattern.kind == "charuco" else []

    def draw(texels: int) -> Grey:
        squares = np.where(black, INK_REFLECTANCE, PAPER_REFLECTANCE).astype(np.uint8)
        image = squares.repeat(texels, 0).repeat(texels, 1)
        for (y, x), bits in zip(np.argwhere(~black) * texels if markers else (), markers, strict=True):
            share = _square_with_marker(pattern, bits, texels)
            image[y : y + texels, x : x + texels] = np.round(
                INK_REFLECTANCE + (PAPER_REFLECTANCE - INK_REFLECTANCE) * share
            )
        return image

    return (columns, rows), (1, 1), draw


def _draw_tags(pattern: PatternConfiguration, _: bool) -> _Sketch:
    """Draw an aprilgrid; the image has whole units, white beyond the print."""
    black = tag_cells(*pattern.dimension, pattern.first_marker).astype(float)
    ends = cell_ends(*pattern.dimension, pattern.spacing)
    size = tuple(float(each[-1]) for each in ends)

    def draw(texels: int) -> Grey:
        across, down = (_interval_coverage(math.ceil(each[-1]) * texels, texels * each) for each in ends)
        ink = black @ across.T
        strips = [
            np.round(PAPER_REFLECTANCE + (INK_REFLECTANCE - PAPER_REFLECTANCE) * (some @ ink))
            for some in np.split(down, len(down) // texels)
        ]
        return np.concatenate([strip.astype(np.uint8) for strip in strips])

    return (size[0], size[1]), (pattern.spacing, size[1] - pattern.spacing), draw


def _draw_circles(pattern: PatternConfiguration, _: bool) -> _Sketch:
    """Draw black circles on white."""
    (columns, rows), staggered = pattern.dimension, pattern.kind == "asymmetric-circles"
    size = ((2 * columns if staggered else columns) + 1, rows + 1)

    def draw(texels: int) -> Grey:
        image = np.full((size[1] * texels, size[0] * texels), PAPER_REFLECTANCE, np.uint8)
        radius = texels * circle_diameter(pattern) / pattern.size / 2
        y, x = np.mgrid[-texels:texels, -texels:texels] + 0.5
        ink = np.clip(radius - np.hypot(x, y) + 0.5, 0, 1)  # of a texel at the edge about its covered share
        circle = np.round(PAPER_REFLECTANCE + (INK_REFLECTANCE - PAPER_REFLECTANCE) * ink).astype(np.uint8)
        for left, top in np.round(pattern.pattern().corners[:, :2] / pattern.size).astype(int) * texels:
            part = image[top : top + 2 * texels, left : left + 2 * texels]
            np.minimum(part, circle, out=part)
        return image

    return size, (1, 1), draw


def _placed_tags(pattern: PatternConfiguration, _: bool) -> _Sketch:
    """Draw tags at their places on an image of whole units; a unit is the side of the first."""
    corners = pattern.pattern().corners[:, :2] / pattern.size
    low, high = corners.min(0), corners.max(0)
    size = (float(high[0] - low[0]), float(high[1] - low[1]))
    before = corners[0] - low

    def draw(texels: int) -> Grey:
        image = np.full((math.ceil(size[1]) * texels, math.ceil(size[0]) * texels), PAPER_REFLECTANCE, np.uint8)
        for tag, modules in zip(corners.reshape(-1, 4, 2), tag_modules(pattern), strict=True):
            each = max(1, round(float(np.linalg.norm(tag[1] - tag[0])) * texels / len(modules)))
            printed = np.where(modules > 0.5, PAPER_REFLECTANCE, INK_REFLECTANCE).astype(np.uint8)
            drawn = printed.repeat(each, 0).repeat(each, 1)
            ends = _PAPER_TEXELS + each * len(modules) * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) - 0.5
            places = (tag[[0, 1, 3]] - low) * texels - 0.5
            M = cv2.getAffineTransform(ends.astype(np.float32), places.astype(np.float32))
            drawn = np.pad(drawn, _PAPER_TEXELS, constant_values=PAPER_REFLECTANCE)
            height, width = image.shape
            cv2.warpAffine(drawn, M, (width, height), dst=image, borderMode=cv2.BORDER_TRANSPARENT)
        return image

    return size, (float(before[0]), float(before[1])), draw


def tag_modules(pattern: PatternConfiguration) -> list[Array]:
    """Return the modules of a list of tags, upright, with their black border: 1 for white."""
    drawn = _modules_of(printed_dictionary(pattern), [tag.id for tag in pattern.tags])
    return [np.rot90(each, turns_of(pattern)) for each in drawn]


def _modules_of(dictionary: "cv2.aruco.Dictionary", ids: Iterable[int]) -> list[Array]:
    """Return the modules of markers as OpenCV draws them, with their black border: 1 for white."""
    side = dictionary.markerSize + 2
    return [np.array(cv2.aruco.generateImageMarker(dictionary, i, side), float) / 255 for i in ids]


def circle_diameter(pattern: PatternConfiguration) -> float:
    """Return the diameter of the circles of a grid, m.

    Raises:
        InputError: the pattern does not state it.
    """
    if pattern.inner_size is None:
        raise InputError(f"pattern '{pattern.name}': found no inner_size, expected the diameter of its circles, m")
    return pattern.inner_size


DRAWN_PATTERNS: dict[str, Callable[[PatternConfiguration, bool], _Sketch]] = {
    "charuco": _draw_squares,
    "chessboard": _draw_squares,
    "aprilgrid": _draw_tags,
    "circles": _draw_circles,
    "asymmetric-circles": _draw_circles,
    "tags": _placed_tags,
}
"""Functions that draw a pattern, by its kind."""


def _interval_coverage(texels: int, ends: Array) -> Array:
    """Return the coverage (texels, N - 1) of each texel by the intervals between consecutive ends (N,)."""
    texel = np.arange(texels)[:, None]
    return np.asarray(np.clip(np.minimum(texel + 1, ends[1:]) - np.maximum(texel, ends[:-1]), 0, None))


def _with_border(image: Grey, margin: tuple[int, int], paper: int) -> Grey:
    x, y = margin
    return np.pad(image, ((y, y), (x, x)), constant_values=paper)


def _square_with_marker(pattern: PatternConfiguration, bits: Array, texels: int) -> Array:
    """Return the share of white (texels, texels) of a white square with a marker in its centre, exact to the texel."""
    assert pattern.inner_size is not None  # noqa: S101 (checked with the markers)
    side = texels * pattern.inner_size / pattern.size
    ends = (texels - side) / 2 + side * np.linspace(0, 1, len(bits) + 1)
    cover = _interval_coverage(texels, ends)
    black: Array = cover @ (1 - bits) @ cover.T
    return 1 - black


def marker_modules(pattern: PatternConfiguration, count: int) -> list[Array]:
    """Return the modules of the markers 0 to count - 1, with their black border: 1 for white."""
    if pattern.inner_size is None:
        raise InputError(
            f"pattern '{pattern.name}': found no inner_size; a charuco board needs the side of its markers"
        )
    dictionary = printed_dictionary(pattern)
    first = pattern.first_marker
    if first + count > len(dictionary.bytesList):
        raise InputError(
            f"pattern '{pattern.name}': {count} markers are needed for {pattern.dimension[0] + 1} x "
            f"{pattern.dimension[1] + 1} squares, but {pattern.dictionary} has {len(dictionary.bytesList)}; "
            "take a larger dictionary or fewer squares"
        )
    return _modules_of(dictionary, range(first, first + count))
