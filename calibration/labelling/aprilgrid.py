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
from calibration.labelling.markers import MarkerFinder
from calibration.labelling.printed_corners import PrintedPatches
from calibration.labelling.tags import BORDER, MODULES, corner_ids, corner_places, drawn, tag_dictionary, unit

LEAST_TAGS = 2
"""One alone may be what noise looks like."""


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
        self._finder = MarkerFinder(tag_dictionary(), columns * rows, BORDER)
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
        reading = self._read(image)
        if reading is None or len(reading.markers) < LEAST_TAGS:
            return NotDetected(f"{0 if reading is None else len(reading.markers)} tags, {LEAST_TAGS} are needed")
        return enough(self._corners, *find_corners(image, reading, self._corners, self._clearance))

    def _read(self, image: Image) -> Reading | None:
        """The tags that lie as on the board; looked for again, finer, where many should be and are not."""
        found = next(iter(readings([self._layout], self._finder.find(image))), None)
        if found is not None and found.share(*image.shape) >= 0.5:
            return found
        finer = next(iter(readings([self._layout], self._finder.find_small(image))), None)
        return max(found, finer, key=lambda each: len(each.markers) if each else 0)
