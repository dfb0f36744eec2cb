"""Detection of single tags and markers, one or several in a plane.

OpenCV reads them; their sides are then fitted to the edges of the image, and meet in their corners: blur moves no
straight edge, but it rounds a corner. A side may be bent by the lens, so the fit is a parabola.
"""

import cv2
import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.detection import Image, NotDetected, grey
from calibration.robot.labelling.markers import MarkerFinder, Markers, printed_dictionary, turns_of

CORNER_DECIMALS = 4
"""Decimals of the corners' pixels."""
MAX_CORRECTED = 0.3
"""Limit of the share of a code's wrong bits that are corrected, of those that can be: a single tag has no neighbours
that confirm it."""
MIN_SIDE = 16.0
"""Minimum height of a tag above its longest side, px."""
SIDE_POSITIONS = np.linspace(0.08, 0.92, 43)
"""Positions along a side where its edge is looked for; the rest is rounded by blur."""
MAX_SEARCH_DEPTH, MIN_SEARCH_DEPTH, ENOUGH_PX = 0.45, 0.2, 2.5
"""How far an edge is looked for to each side: in modules as seen across it, and what is enough for any blur (px).

A tag's black border is one module wide, and its white margin is often cut: in public images with a margin of 0.35
modules of 12 px, corners by 0.45 modules were off by 1.3 px, and 27 of 42 tags had no clear edges.
"""
FIT_ROUNDS = 3
"""Number of times that the sides are fitted, each from the corners before."""
MIN_EDGES = 0.6
"""Minimum share of the positions where an edge is found."""


class TagListDetector:
    """Corner detector of tags at known places; see `calibration.robot.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """Create the detector for printed tags.

        Raises:
            InputError: their dictionary is unknown, or has no such tag.
        """
        dictionary = printed_dictionary(pattern)
        self._finder = MarkerFinder(dictionary, len(dictionary.bytesList), correction=MAX_CORRECTED)
        self._modules = dictionary.markerSize + 2
        self._ids = [tag.id for tag in pattern.tags]
        self._turns = turns_of(pattern)

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """Detect the corners in an 8-bit image (H, W) or (H, W, 3), BGR; pixel (0, 0) is a centre.

        Raises:
            InputError: it is not such an image.
        """
        image = grey(image)
        if min(image.shape) < MIN_SIDE:
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no tag")
        seen = self._finder.find(image)
        if self._count_missing(seen):
            seen = max(seen, self._finder.find_small(image), key=lambda each: -self._count_missing(each))
        ids: list[IntArray] = []
        pixels: list[Array] = []
        for place, own in enumerate(self._ids):
            for corners in seen.corners[seen.ids == own]:
                refined = refined_corners(image, np.roll(corners, -self._turns, axis=0), self._modules)
                if refined is not None:
                    ids.append(4 * place + np.arange(4))
                    pixels.append(refined)
        if not ids:
            return NotDetected(f"none of its {len(self._ids)} tags, of {len(seen)} of the dictionary in the image")
        return CornerLabels(np.concatenate(ids), np.concatenate(pixels).round(CORNER_DECIMALS))

    def _count_missing(self, seen: Markers) -> int:
        return len(set(self._ids) - set(seen.ids.tolist()))


def refined_corners(image: Image, corners: Array, modules: int) -> Array | None:
    """Return the corners (4, 2) in which the sides of a tag meet, px; None if it is too small or its edges are unclear.

    Args:
        image: (H, W), grey.
        corners: (4, 2), px, roughly, around the tag in the sense of a clock.
        modules: number of its modules along a side.
    """
    for _ in range(FIT_ROUNDS):
        sides = np.roll(corners, -1, axis=0) - corners
        lengths = np.linalg.norm(sides, axis=-1)
        x, y = (corners - np.roll(corners, 2, axis=0))[:2].T  # the diagonals
        height = abs(x[0] * y[1] - x[1] * y[0]) / 2 / lengths.max()
        if height < MIN_SIDE:
            return None
        along = sides / lengths[:, None]
        outwards = np.stack([along[:, 1], -along[:, 0]], -1)
        fits = []
        for corner, side, out, length in zip(corners, sides, outwards, lengths, strict=True):
            module = height / modules
            reach = min(MAX_SEARCH_DEPTH * module, max(ENOUGH_PX, MIN_SEARCH_DEPTH * module))
            edge = _edge_offsets(image, corner + SIDE_POSITIONS[:, None] * side, out, reach)
            found = np.isfinite(edge)
            if found.mean() < MIN_EDGES:
                return None
            fits.append(np.polynomial.polynomial.polyfit(SIDE_POSITIONS[found], edge[found], 2) / [1, length, length])
        bends = np.array(fits)  # offset outwards, slope and half the curvature, by the position in px
        before = np.roll(np.arange(4), 1)
        at_end = bends[before] @ [1, 0, 0] + (bends[before, 1] + bends[before, 2]) * lengths[before]
        slope_at_end = bends[before, 1] + 2 * bends[before, 2]
        # the tangents of two sides at their corner: normals and offsets
        n = np.stack([outwards - bends[:, 1:2] * along, outwards[before] - slope_at_end[:, None] * along[before]], 1)
        corners = corners + np.linalg.solve(n, np.stack([bends[:, 0], at_end], -1)[..., None])[..., 0]
    return corners


def _edge_offsets(image: Image, places: Array, out: Array, reach: float) -> Array:
    """Return how far outwards (N,) of places (N, 2) black becomes white, px; NaN where it does not."""
    steps = np.linspace(-reach, reach, 2 * int(np.ceil(2 * reach)) + 3)
    x, y = np.moveaxis(places[:, None] + steps[:, None] * out, -1, 0).astype(np.float32)
    shades = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(float)
    # light may vary along a side, by which a common white would slant its edge
    line = np.polynomial.polynomial.polyvander(SIDE_POSITIONS, 1)
    black, white = (line @ np.linalg.lstsq(line, shades[:, end], rcond=None)[0] for end in (0, -1))
    share = (shades - black[:, None]) / np.maximum(white - black, 1.0)[:, None]
    # the width of what is dark, as its edge is at half of it: the sum over the profile takes all of its samples
    dark = np.clip(1 - share, -0.25, 1.25)
    width = (dark.sum(1) - dark[:, [0, -1]].sum(1) / 2) * (steps[1] - steps[0])
    clear: np.ndarray = (abs(share[:, 0]) < 0.25) & (abs(share[:, -1] - 1) < 0.25)
    return np.where(clear, width - reach, np.nan)
