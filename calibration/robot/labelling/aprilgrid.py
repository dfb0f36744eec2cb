"""Detection of aprilgrids, the boards of tags that Kalibr prints, in whole or partial views.

OpenCV reads the tags; the corners are found from them (`labelling.board_corners`). OpenCV's own corners
of tags are about 3 px off, because the squares at the corners touch the tags.

Ids are Kalibr's (`calibration.engine.dataset.pattern.tag_grid`).
"""

import math

from calibration.base.errors import InputError
from calibration.engine.dataset.configuration import TAG_COUNT, PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.board_corners import enough, find_corners
from calibration.robot.labelling.detection import Image, NotDetected, grey
from calibration.robot.labelling.layouts import TEXELS_PER_SQUARE, Layout, Reading, readings
from calibration.robot.labelling.markers import WINDOWS_FOR_TOUCHED, MarkerFinder, Markers
from calibration.robot.labelling.printed_corners import PrintedPatches
from calibration.robot.labelling.tags import (
    BORDER_MODULES,
    MODULES_PER_TAG,
    corner_ids,
    corner_places,
    drawn,
    tag_dictionary,
    unit,
)

LEAST_TAGS = 2
"""Minimum of tags: a single one may be a false detection in noise."""
LEAST_AGREEING = 0.5
"""Minimum share of all tags that match the board; with less it is another board, and a few match by chance."""
LEAST_FREE = 3.0
"""Corners of smaller tags (below 15 px, by the usual spacing) are skipped: the print next to them biases them. Measured
errors are 0.05 px for squares wider than 20 px, 0.2 px and more at 14 px.
"""
LEAST_ANGLE = math.radians(25)
"""Corners whose edges meet at a smaller angle are skipped: blur fills the wedge (0.2 to 2.4 px off)."""


class AprilgridDetector:
    """Corner detector of one aprilgrid; see `calibration.robot.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """Create the detector for a printed pattern.

        Raises:
            InputError: such a board cannot be printed.
        """
        columns, rows = pattern.dimension
        first = pattern.first_marker
        if first + columns * rows > TAG_COUNT:
            raise InputError(f"pattern '{pattern.name}': found {columns} x {rows} tags, expected {TAG_COUNT} at most")
        self._corners = corner_places(columns, rows, pattern.spacing)
        self._clearance = min(pattern.spacing, BORDER_MODULES / MODULES_PER_TAG) / unit(pattern.spacing)
        self._first, self._count = first, columns * rows
        self._finder = MarkerFinder(tag_dictionary(), TAG_COUNT, BORDER_MODULES, windows=WINDOWS_FOR_TOUCHED)
        patches = PrintedPatches(
            drawn(columns, rows, pattern.spacing, TEXELS_PER_SQUARE, first), TEXELS_PER_SQUARE, self._corners
        )
        self._layout = Layout(self._corners[corner_ids(columns, rows)], patches)

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """Detect corners in an 8-bit image (H, W) or (H, W, 3), BGR; pixel (0, 0) is a centre.

        Raises:
            InputError: it is not such an image.
        """
        image = grey(image)
        if min(image.shape) < 2 * MarkerFinder.LEAST_SIDE:
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no pattern")
        reading, seen = self._read_board(image)
        if reading is None or len(reading.markers) < LEAST_TAGS:
            return NotDetected(f"{seen} tags, {LEAST_TAGS} are needed that lie as on the board")
        if len(reading.markers) <= LEAST_AGREEING * seen:
            return NotDetected(f"{len(reading.markers)} of {seen} tags lie as on the board, more than half are needed")
        return enough(
            self._corners, *find_corners(image, reading, self._corners, self._clearance, LEAST_FREE, LEAST_ANGLE)
        )

    def _read_board(self, image: Image) -> tuple[Reading | None, int]:
        """Return the tags that match the board, and the number of all tags.

        The search is repeated at a finer scale if many expected tags are missing.
        """
        found, seen = self._matching_tags(self._finder.find(image))
        if found is not None and found.share(*image.shape) >= 0.5:
            return found, seen
        finer = self._matching_tags(self._finder.find_small(image))
        return max((found, seen), finer, key=lambda each: len(each[0].markers) if each[0] else 0)

    def _matching_tags(self, tags: Markers) -> tuple[Reading | None, int]:
        """Return the tags that match the board, and their number."""
        ids = tags.ids - self._first
        own = (ids >= 0) & (ids < self._count)
        lying = readings([self._layout], Markers(ids[own], tags.corners[own]))
        return (lying[0] if lying else None), len(tags)
