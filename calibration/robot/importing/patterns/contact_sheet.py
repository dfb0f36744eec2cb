"""Contact sheet of many images with the detected corners."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.robot.importing.patterns.image_views import View, read_image
from calibration.robot.importing.patterns.png import encoded
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.sensors.sensor import PICTURE_HEIGHT_PX, draw_corner

CONTACT_SHEET_FILE = "contact_sheet.png"
SHEET_WIDTH_PX = 1600
"""Approximate width of the sheet, px."""
MAX_IMAGES_SHOWN = 240
"""Limit of the number of images shown."""
_LINE_HEIGHT_PX, _GAP_PX = 16, 6
_PAPER_COLOUR, _INK_COLOUR, _REJECTED_COLOUR = (250, 250, 250), (60, 60, 60), (40, 40, 200)


def contact_sheet(views: Sequence[tuple[str, View]], patterns: Mapping[str, PatternConfiguration]) -> bytes:
    """Draw the sheet as PNG: each image with a title and the number of its corners, red if there are none.

    Raises:
        InputError: an image cannot be read.
    """
    tiles = [_draw_view(title, view, patterns) for title, view in views[:MAX_IMAGES_SHOWN]]
    width = max(tile.shape[1] for tile in tiles)
    tiles = [_pad_tile(tile, width) for tile in tiles]
    columns = max(1, round(SHEET_WIDTH_PX / width))
    tiles += [np.full_like(tiles[0], _PAPER_COLOUR)] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    return encoded(np.asarray(np.vstack(rows), np.uint8))


def thumbnail(image: Image) -> Image:
    """Reduce an image to the size in the sheet, (`PICTURE_HEIGHT_PX`, W) or (`PICTURE_HEIGHT_PX`, W, 3)."""
    height, width = image.shape[:2]
    size = (max(1, round(PICTURE_HEIGHT_PX / height * width)), PICTURE_HEIGHT_PX)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def thumbnail_of(path: Path) -> Path:
    """Return the path of an image's thumbnail, which need not exist; reading it takes a tenth of the time."""
    return path.with_name(f"{path.stem}.thumbnail.png")


def _thumbnail_of(path: Path, width: int) -> Image:
    """Return the thumbnail (`PICTURE_HEIGHT_PX`, width, 3) of an image, from its file if there is one."""
    made = thumbnail_of(path)
    if made.is_file() and (small := read_image(made)).shape[:2] == (PICTURE_HEIGHT_PX, width):
        return small
    return thumbnail(read_image(path))


def _pad_tile(tile: Image, width: int) -> Image:
    """Pad a tile with white below it and to its right."""
    right = width + _GAP_PX - tile.shape[1]
    return np.asarray(
        cv2.copyMakeBorder(tile, 0, _GAP_PX, 0, right, cv2.BORDER_CONSTANT, value=_PAPER_COLOUR), np.uint8
    )


def _draw_view(title: str, view: View, patterns: Mapping[str, PatternConfiguration]) -> Image:
    scale = PICTURE_HEIGHT_PX / view.height
    small = _thumbnail_of(Path(view.file), max(1, round(scale * view.width)))
    picture = np.asarray(cv2.convertScaleAbs(small, alpha=0.8, beta=40), np.uint8)  # paler, for the marks
    count = 0
    for name, found in view.found.items():
        if (labels := found.labels) is not None:
            corners = len(patterns[name].pattern().corners)
            count += len(labels.ids)
            for number, at in zip(labels.ids.tolist(), scale * (labels.pixels + 0.5) - 0.5, strict=True):
                draw_corner(picture, at, number / corners)
    colour = _INK_COLOUR if count else _REJECTED_COLOUR
    line = np.full((_LINE_HEIGHT_PX, small.shape[1], 3), _PAPER_COLOUR, np.uint8)
    text = f"{title}: {f'{count} corners' if count else 'not detected'}".encode("ascii", "replace").decode()
    cv2.putText(line, text, (2, _LINE_HEIGHT_PX - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, 1, cv2.LINE_AA)
    return np.asarray(np.vstack([line, picture]), np.uint8)
