"""The pattern that images are searched for: as described, or found in them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.importing.description import ImportDescription
from calibration.robot.importing.files.target_files import pattern_configuration
from calibration.robot.importing.patterns.near_miss import LOOKED_AT
from calibration.robot.importing.patterns.shown_patterns import (
    MAX_BOARD_SEARCHES,
    MIN_BOARD_MARKERS,
    Family,
    shown_board,
    shown_chessboard,
    shown_circles,
    shown_markers,
    shown_tags,
)
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import CornerDetector, Image

MAX_SEARCHED_SIDE = 1600
"""px: larger images are reduced before they are searched for an unknown pattern."""
NO_LABELS = CornerLabels(np.zeros(0, np.int64), np.zeros((0, 2)))


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
    return LookedFor(", ".join(detectors), lambda image: _detect_best(image, detectors)) if detectors else None


def _detect_best(image: Image, detectors: Mapping[str, CornerDetector]) -> CornerLabels:
    seen = [each.detect(image) for each in detectors.values()]
    found = [(i, each) for i, each in enumerate(seen) if isinstance(each, CornerLabels)]
    if not found:
        return NO_LABELS
    ids = [each.ids + (i << 32) for i, each in found]  # of several patterns, different ones
    return CornerLabels(np.concatenate(ids), np.concatenate([each.pixels for _, each in found]))


def pattern_in(images: Sequence[Image]) -> LookedFor | None:
    """Return the pattern that grey images show; None without any.

    A board with markers of a known dictionary, a chessboard, a grid of circles, or single tags.
    """
    some = [_reduce_image(image)[0] for image in images[:: -(-len(images) // LOOKED_AT)]] if images else []
    markers = shown_markers(some)
    if board := shown_board(markers):
        return _board_with(*board)
    if pattern := shown_chessboard(some) or shown_circles(some) or shown_tags(markers):
        return _as_looked_for(pattern)
    board = shown_board(shown_markers(some[:: -(-len(some) // MAX_BOARD_SEARCHES)], small=True)) if some else None
    return _board_with(*board) if board else None


def _board_with(family: Family, highest: int) -> LookedFor:
    finder = family.finder()

    def find(image: Image) -> CornerLabels:
        small, scale = _reduce_image(image)
        found = finder.find(small)
        if len(found) < MIN_BOARD_MARKERS:
            found = finder.find_small(small)
        if len(found) < MIN_BOARD_MARKERS:
            return NO_LABELS
        ids = 4 * np.repeat(found.ids, 4) + np.tile(np.arange(4), len(found))
        return CornerLabels(ids, found.corners.reshape(-1, 2) * scale)

    return LookedFor(f"markers of {family.named(highest)}, ids up to {highest}", find)


def _as_looked_for(pattern: PatternConfiguration) -> LookedFor:
    columns, rows = pattern.dimension
    if pattern.tags:
        name = f"tags {', '.join(str(tag.id) for tag in pattern.tags)} of {pattern.dictionary}"
    else:
        name = f"{pattern.kind} of {columns} x {rows}" + (" corners" if pattern.kind == "chessboard" else "")
    detectors = {name: corner_detector(pattern)}

    def find(image: Image) -> CornerLabels:
        small, scale = _reduce_image(image)
        found = _detect_best(small, detectors)
        return CornerLabels(found.ids, found.pixels * scale)

    return LookedFor(name, find)


def _reduce_image(image: Image) -> tuple[Image, float]:
    """Return an image no larger than `MAX_SEARCHED_SIDE`, and the size of its pixels in those of the image."""
    scale = max(image.shape) / MAX_SEARCHED_SIDE
    if scale <= 1:
        return image, 1.0
    return np.asarray(cv2.resize(image, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)), scale
