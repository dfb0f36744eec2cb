"""Contact sheet of many images with the detected corners."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.robot.importing.patterns.image_views import View, read_image
from calibration.robot.importing.patterns.png import encoded
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.sensors.drawing import PICTURE_HEIGHT_PX, draw_corner

FILE = "contact_sheet.png"
WIDTH = 1600
"""Approximate width of the sheet, px."""
MOST = 240
"""Limit of the number of images shown."""
_LINE, _GAP = 16, 6
_PAPER, _INK, _RED = (250, 250, 250), (60, 60, 60), (40, 40, 200)


def contact_sheet(views: Sequence[tuple[str, View]], patterns: Mapping[str, PatternConfiguration]) -> bytes:
    """Draw the sheet as PNG: each image with a title and the number of its corners, red if there are none.

    Raises:
        InputError: an image cannot be read.
    """
    tiles = [_tile(title, view, patterns) for title, view in views[:MOST]]
    width = max(tile.shape[1] for tile in tiles)
    tiles = [_padded(tile, width) for tile in tiles]
    columns = max(1, round(WIDTH / width))
    tiles += [np.full_like(tiles[0], _PAPER)] * (-len(tiles) % columns)
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


def _small(path: Path, width: int) -> Image:
    """Return the thumbnail (`PICTURE_HEIGHT_PX`, width, 3) of an image, from its file if there is one."""
    made = thumbnail_of(path)
    if made.is_file() and (small := read_image(made)).shape[:2] == (PICTURE_HEIGHT_PX, width):
        return small
    return thumbnail(read_image(path))


def _padded(tile: Image, width: int) -> Image:
    """Pad a tile with white below it and to its right."""
    right = width + _GAP - tile.shape[1]
    return np.asarray(cv2.copyMakeBorder(tile, 0, _GAP, 0, right, cv2.BORDER_CONSTANT, value=_PAPER), np.uint8)


def _tile(title: str, view: View, patterns: Mapping[str, PatternConfiguration]) -> Image:
    scale = PICTURE_HEIGHT_PX / view.height
    small = _small(Path(view.file), max(1, round(scale * view.width)))
    picture = np.asarray(cv2.convertScaleAbs(small, alpha=0.8, beta=40), np.uint8)  # paler, for the marks
    count = 0
    for name, found in view.found.items():
        if (labels := found.labels) is not None:
            corners = len(patterns[name].pattern().corners)
            count += len(labels.ids)
            for number, at in zip(labels.ids.tolist(), scale * (labels.pixels + 0.5) - 0.5, strict=True):
                draw_corner(picture, at, number / corners)
    colour = _INK if count else _RED
    line = np.full((_LINE, small.shape[1], 3), _PAPER, np.uint8)
    text = f"{title}: {f'{count} corners' if count else 'not detected'}".encode("ascii", "replace").decode()
    cv2.putText(line, text, (2, _LINE - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, 1, cv2.LINE_AA)
    return np.asarray(np.vstack([line, picture]), np.uint8)
