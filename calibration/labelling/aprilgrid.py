"""The corners of aprilgrids, the boards of tags that Kalibr prints, from whole or partial views.

OpenCV reads the tags; they lead to the corners (`calibration.labelling.board_corners`). Corners of the tags as OpenCV
finds them are some 3 px off, because the squares at the corners touch the tags.

Ids are Kalibr's (`calibration.dataset.pattern.tag_grid`).
"""

from calibration.dataset.configuration import TAG_COUNT, PatternConfiguration
from calibration.dataset.model import CornerLabels
from calibration.errors import InputError
from calibration.labelling.board_corners import enough, find_corners
from calibration.labelling.detection import Image, NotDetected, grey
from calibration.labelling.layouts import TEXELS, Layout, Reading, readings
from calibration.labelling.markers import MarkerFinder, Markers
from calibration.labelling.printed_corners import PrintedPatches
from calibration.labelling.tags import BORDER, MODULES, corner_ids, corner_places, drawn, tag_dictionary, unit

LEAST_TAGS = 2
"""One alone may be what noise looks like."""
LEAST_AGREEING = 0.5
"""A larger share of all tags lies as on the board; else it is another one, of which a few tags fit this by chance."""
LEAST_FREE = 3.0
"""Corners of smaller tags (of less than 15 px, by the usual spacing) are not looked for: what is printed beside them
pulls them away. By measurement they err by 0.05 px where they are wider than 20 px, by 0.2 px and more at 14 px."""


class AprilgridDetector:
    """Finds the corners of one aprilgrid; see `calibration.labelling.detection.CornerDetector`."""

    def __init__(self, pattern: PatternConfiguration) -> None:
        """For a pattern as it is printed.

        Raises:
            InputError: no such board can be printed.
        """
        columns, rows = pattern.dimension
        if columns * rows > TAG_COUNT:
            raise InputError(f"pattern '{pattern.name}': found {columns} x {rows} tags, expected {TAG_COUNT} at most")
        self._corners = corner_places(columns, rows, pattern.spacing)
        self._clearance = min(pattern.spacing, BORDER / MODULES) / unit(pattern.spacing)
        self._count = columns * rows
        self._finder = MarkerFinder(tag_dictionary(), TAG_COUNT, BORDER)
        patches = PrintedPatches(drawn(columns, rows, pattern.spacing, TEXELS), TEXELS, self._corners)
        self._layout = Layout(self._corners[corner_ids(columns, rows)], patches)

    def detect(self, image: Image) -> CornerLabels | NotDetected:
        """The corners in an image (H, W) or (H, W, 3) of 8 bits, blue first; pixel (0, 0) is a centre.

        Raises:
            InputError: it is no such image.
        """
        image = grey(image)
        if min(image.shape) < 2 * MarkerFinder.LEAST_SIDE:
            return NotDetected(f"an image of {image.shape[1]} x {image.shape[0]} pixels holds no pattern")
        reading, seen = self._read(image)
        if reading is None or len(reading.markers) < LEAST_TAGS:
            return NotDetected(f"{seen} tags, {LEAST_TAGS} are needed that lie as on the board")
        if len(reading.markers) <= LEAST_AGREEING * seen:
            return NotDetected(f"{len(reading.markers)} of {seen} tags lie as on the board, more than half are needed")
        return enough(self._corners, *find_corners(image, reading, self._corners, self._clearance, LEAST_FREE))

    def _read(self, image: Image) -> tuple[Reading | None, int]:
        """The tags that lie as on the board, and how many there are in all.

        Looked for again, finer, where many should be and are not.
        """
        found, seen = self._lying(self._finder.find(image))
        if found is not None and found.share(*image.shape) >= 0.5:
            return found, seen
        finer = self._lying(self._finder.find_small(image))
        return max((found, seen), finer, key=lambda each: len(each[0].markers) if each[0] else 0)

    def _lying(self, tags: Markers) -> tuple[Reading | None, int]:
        """Those of the tags that lie as on the board, and how many they are."""
        own = tags.ids < self._count
        lying = readings([self._layout], Markers(tags.ids[own], tags.corners[own]))
        return (lying[0] if lying else None), len(tags)
