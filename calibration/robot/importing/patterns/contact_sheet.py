"""Contact sheet of many images with the detected corners."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.robot.importing.patterns.image_views import View, encoded, read_image
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.collection.contact_sheet import (
    GAP_PX,
    INK_COLOUR,
    PAPER_COLOUR,
    REJECTED_COLOUR,
    arrange_tiles,
    draw_text_line,
)
from calibration.robot.simulation.sensors.sensor import PICTURE_HEIGHT_PX, draw_corner

MAX_IMAGES_SHOWN = 240
"""Limit of the number of images shown."""


def contact_sheet(views: Sequence[tuple[str, View]], patterns: Mapping[str, PatternConfiguration]) -> bytes:
    """Draw the sheet as PNG: each image with a title and the number of its corners, red if there are none.

    Raises:
        InputError: an image cannot be read.
    """
    tiles = [_draw_view(title, view, patterns) for title, view in views[:MAX_IMAGES_SHOWN]]
    width = max(tile.shape[1] for tile in tiles)
    tiles = [_pad_tile(tile, width) for tile in tiles]
    return encoded(arrange_tiles(tiles))


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
    right = width + GAP_PX - tile.shape[1]
    return np.asarray(cv2.copyMakeBorder(tile, 0, GAP_PX, 0, right, cv2.BORDER_CONSTANT, value=PAPER_COLOUR), np.uint8)


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
    colour = INK_COLOUR if count else REJECTED_COLOUR
    text = f"{title}: {f'{count} corners' if count else 'not detected'}".encode("ascii", "replace").decode()
    return np.vstack([draw_text_line(text, small.shape[1], colour), picture])
