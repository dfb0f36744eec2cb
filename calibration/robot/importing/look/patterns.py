"""The pattern that images are searched for: as described, or found in them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from calibration.engine.dataset.configuration import TAGS
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.patterns.near_miss import FAMILIES, GRID, LOOKED_AT, OF_A_BOARD, Family
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import CornerDetector, Image

MAX_SEARCHED_SIDE = 1600
"""px: larger images are reduced before they are searched for an unknown pattern."""
LEAST_BOARD = (4, 4)
"""Corners of the smallest chessboard that is looked for."""
MAX_BOARD_SEARCHES = 4
"""Images that are searched for a chessboard of unknown size, which takes long where there is none."""
NONE = CornerLabels(np.zeros(0, np.int64), np.zeros((0, 2)))


@dataclass(frozen=True)
class LookedFor:
    """Pattern that is looked for."""

    name: str
    """In words."""
    find: Callable[[Image], CornerLabels]
    """Function that returns the corners in a grey image, none if it is not there."""


def described_pattern(described: ImportDescription) -> LookedFor | None:
    """Return the patterns that import.yml describes, together; None if it describes none that is printed.

    Raises:
        InputError: a description is wrong.
    """
    detectors = {
        each.name: corner_detector(pattern_configuration(each, described.root))
        for each in described.patterns
        if each.is_printed
    }
    return LookedFor(", ".join(detectors), lambda image: _detected(image, detectors)) if detectors else None


def _detected(image: Image, detectors: Mapping[str, CornerDetector]) -> CornerLabels:
    seen = [each.detect(image) for each in detectors.values()]
    found = [(i, each) for i, each in enumerate(seen) if isinstance(each, CornerLabels)]
    if not found:
        return NONE
    ids = [each.ids + (i << 32) for i, each in found]  # of several patterns, different ones
    return CornerLabels(np.concatenate(ids), np.concatenate([each.pixels for _, each in found]))


def pattern_in(images: Sequence[Image]) -> LookedFor | None:
    """Return the pattern that grey images show: markers of a known dictionary, else a chessboard; None without any."""
    some = [_reduced(image)[0] for image in images[:: -(-len(images) // LOOKED_AT)]] if images else []
    counts = {family: [len(family.finder().find(image)) for image in some] for family in FAMILIES}
    if max(counts[GRID], default=0) > 1:
        del counts[Family(TAGS)]  # with a border of one module the same tags decode differently
    best = max(counts, key=lambda family: sum(counts[family]))
    if max(counts[best], default=0) >= OF_A_BOARD:
        return _markers(best, some)
    return _chessboard(some)


def _markers(family: Family, images: Sequence[Image]) -> LookedFor:
    finder = family.finder()
    highest = max(int(found.ids.max()) for image in images if len(found := finder.find(image)))

    def find(image: Image) -> CornerLabels:
        small, scale = _reduced(image)
        found = finder.find(small)
        if len(found) < OF_A_BOARD:
            found = finder.find_small(small)
        if len(found) < OF_A_BOARD:
            return NONE
        ids = 4 * np.repeat(found.ids, 4) + np.tile(np.arange(4), len(found))
        return CornerLabels(ids, found.corners.reshape(-1, 2) * scale)

    return LookedFor(f"markers of {family.named(highest)}, ids up to {highest}", find)


def _chessboard(images: Sequence[Image]) -> LookedFor | None:
    for image in images[:: -(-len(images) // MAX_BOARD_SEARCHES)] if images else ():
        found, _, meta = cv2.findChessboardCornersSBWithMeta(image, LEAST_BOARD, cv2.CALIB_CB_LARGER)
        if found:
            rows, columns = meta.shape[:2]
            return LookedFor(f"chessboard of {columns} x {rows} corners", partial(_corners, columns, rows))
    return None


def _corners(columns: int, rows: int, image: Image) -> CornerLabels:
    small, scale = _reduced(image)
    found, corners = cv2.findChessboardCornersSB(small, (columns, rows))
    return CornerLabels(np.arange(columns * rows), np.asarray(corners, float).reshape(-1, 2) * scale) if found else NONE


def _reduced(image: Image) -> tuple[Image, float]:
    """Return an image no larger than `MAX_SEARCHED_SIDE`, and the size of its pixels in those of the image."""
    scale = max(image.shape) / MAX_SEARCHED_SIDE
    if scale <= 1:
        return image, 1.0
    return np.asarray(cv2.resize(image, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)), scale
