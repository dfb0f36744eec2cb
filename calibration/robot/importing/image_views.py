"""Images of cameras, the detection of the patterns in them, and a contact sheet of both."""

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration import MAX_IMAGE_PIXELS
from calibration.base import InputError, read_bytes, write_atomically
from calibration.base.records import field, result
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.detection import CornerDetector, DepthImage, Image
from calibration.robot.simulation.record import (
    GAP_PX,
    INK_COLOUR,
    PAPER_COLOUR,
    REJECTED_COLOUR,
    arrange_tiles,
    draw_text_line,
)
from calibration.robot.simulation.sensors.sensor import PICTURE_HEIGHT_PX, draw_corner

MAX_BYTES = 500_000_000
"""Limit of an image file's size in bytes."""
BRIGHTEST_SHARE = 0.999
"""Share of the pixels that are not saturated when 16 bits are stretched to 8: the brightest ones may be reflections."""
_FAST_COMPRESSION = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
"""Half the time of OpenCV's own choice; photographs become no larger, drawings a third."""


@result
class FoundCorners:
    """Corners of one pattern in one image; empty if it is not detected."""

    ids: tuple[int, ...] = field("Of the corners.")
    pixels: tuple[float, ...] = field("x and y of each corner, one after the other.", unit="px")
    reason: str = field("Reason why the pattern is not detected; empty if it is.", default="")

    @property
    def labels(self) -> CornerLabels | None:
        """The corners; None if the pattern is not detected."""
        if not self.ids:
            return None
        return CornerLabels(np.array(self.ids, np.int64), np.array(self.pixels).reshape(-1, 2))


@result
class View:
    """Image, and the patterns in it."""

    file: str = field("The image.")
    width: int = field("Of the image.", unit="px")
    height: int = field("Of the image.", unit="px")
    found: Mapping[str, FoundCorners] = field("By pattern.")
    digest: str = field("Of the pixels of a file, in which copies are looked for.", default="")

    @property
    def labelled(self) -> bool:
        """Whether a pattern is detected in it."""
        return any(found.ids for found in self.found.values())

    @property
    def reason(self) -> str:
        """Why no pattern is detected in it."""
        return "; ".join(dict.fromkeys(found.reason for found in self.found.values()))


@result
class LabelledMoment:
    """Images of one moment, and the patterns in them."""

    views: Mapping[str, View] = field("By sensor.")


def read_image(path: Path) -> Image:
    """Read an image (H, W, 3), BGR, in 8 bits, without rotation by its EXIF data; one of 16 bits is stretched.

    Raises:
        InputError: the file cannot be read, or is not an image.
    """
    return decoded_image(read_bytes(path, MAX_BYTES, "an image"), str(path))


def decoded_image(data: bytes, where: str) -> Image:
    """Decode an image from the content of a file, like `read_image`.

    Raises:
        InputError: it is not an image, or has too many pixels, which its header tells.
    """
    content = np.frombuffer(data, np.uint8)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION | cv2.IMREAD_ANYDEPTH
    try:
        with _without_stderr():
            image = cv2.imdecode(content, flags)
    except cv2.error as error:
        if "CV_IO_MAX_IMAGE" in error.err:
            raise InputError(f"{where}: this image is too large, expected {MAX_IMAGE_PIXELS} pixels at most") from None
        raise InputError(f"{where}: this image cannot be read: {error.err}") from None
    if image is None:
        raise InputError(f"{where}: this is not a readable image, or it is truncated")
    if image.dtype == np.uint16:
        return stretched(np.asarray(image, np.uint16))
    if image.dtype != np.uint8:
        raise InputError(f"{where}: found pixels of {image.dtype}, expected 8 or 16 bits")
    return np.asarray(image, np.uint8)


def stretched(levels: NDArray[np.uint16]) -> Image:
    """Return 8 bits of 16, any shape, so that all but the brightest pixels keep below 255.

    Cameras of 10 to 14 bits use the lower ones.
    """
    native = np.ascontiguousarray(levels, np.uint16)
    counts = cv2.calcHist([native.reshape(len(native), -1)], [0], None, [1 << 16], [0, 1 << 16])
    below = np.cumsum(counts, dtype=float)
    top = max(1, int(np.searchsorted(below, BRIGHTEST_SHARE * native.size)))
    table = np.minimum(np.arange(1 << 16) * (255 / top), 255).astype(np.uint8)
    return np.asarray(table[native])


@contextmanager
def _without_stderr() -> Iterator[None]:
    """Discard what libraries of C write: of a damaged image libpng and libjpeg print lines beside our error."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def view_of_file(path: Path, detectors: Mapping[str, CornerDetector]) -> View:
    """Detect every pattern in an image file.

    Raises:
        InputError: it cannot be read.
    """
    image = read_image(path)
    digest = hashlib.sha256(np.ascontiguousarray(image).data).hexdigest()
    return replace(view_of_image(image, str(path), detectors), digest=digest)


def view_of_image(image: Image, file: str, detectors: Mapping[str, CornerDetector]) -> View:
    """Detect every pattern in an image; ``file`` is its name."""
    found = {}
    for pattern, detector in detectors.items():
        seen = detector.detect(image)
        if isinstance(seen, CornerLabels):
            found[pattern] = FoundCorners(tuple(seen.ids.tolist()), tuple(seen.pixels.ravel().tolist()))
        else:
            found[pattern] = FoundCorners((), (), seen.reason)
    return View(file, image.shape[1], image.shape[0], found)


def check_sizes(sensor: str, views: Sequence[View]) -> None:
    """Refuse images of one camera with different sizes.

    Raises:
        InputError: names two of them.
    """
    first = views[0]
    for view in views:
        if (view.width, view.height) != (first.width, first.height):
            raise InputError(
                f"{view.file}: found {view.width} x {view.height} pixels, expected {first.width} x {first.height} as "
                f"{first.file} has, of the same camera '{sensor}'"
            )


def check_copies(sensor: str, views: Sequence[View]) -> None:
    """Refuse a duplicated image: it would count twice.

    Raises:
        InputError: names both files.
    """
    seen: dict[str, View] = {}
    for view in views:
        if view.labelled and (other := seen.setdefault(view.digest, view)) is not view:
            raise InputError(
                f"{view.file}: found the same pixels as in {other.file} ('{sensor}'): leave one of them out"
            )


if hasattr(cv2, "IMWRITE_PNG_FILTER"):  # since OpenCV 4.12
    _FAST_COMPRESSION += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP]


def encoded(image: Image | DepthImage) -> bytes:
    """Encode a PNG file."""
    done, data = cv2.imencode(".png", image, _FAST_COMPRESSION)
    if not done:
        raise AssertionError("OpenCV cannot write .png")
    return bytes(data)


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


def write_image(image: Image, path: Path) -> None:
    """Write an image as PNG, and its thumbnail.

    Raises:
        InfrastructureError: they cannot be written.
    """
    write_atomically(thumbnail_of(path), encoded(thumbnail(image)))
    write_atomically(path, encoded(image))


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
