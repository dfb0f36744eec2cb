"""Small pictures of sensor data: points and labelled corners, drawn with a resolution of 1/16 px."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from calibration.base.arrays import Array
from calibration.robot.labelling.detection import Image

PICTURE_HEIGHT_PX = 160
"""Height of one picture, px."""
NO_DATA_COLOUR = (45, 40, 35)
"""Colour without a measurement."""
ON_PATTERN, ON_BORDER = (90, 200, 90), (60, 120, 255)
"""Colours of labelled points."""
_POINT_COLOUR = (150, 140, 130)
_SHIFT_BITS = 4  # drawing in sixteenths of a pixel
_DOT_RADIUS = 24  # radius of a corner's mark, in sixteenths of a pixel
_COLOUR_MAP = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_JET)[:, 0]


def blank(width: int, colour: tuple[int, int, int] = (128, 128, 128)) -> Image:
    """Return a picture of one colour; grey by default."""
    return np.full((PICTURE_HEIGHT_PX, width, 3), colour, np.uint8)


def draw_points(picture: Image, place: Array, shown: Iterable[int], labels: Sequence[Mapping[str, Any]]) -> None:
    """Draw points of a cloud or scan into a picture.

    Args:
        picture: (H, W, 3).
        place: (N, 2), position of each point in it.
        shown: the indices of the points that are drawn, labelled or not.
        labels: of each pattern, with ``idxs`` and ``idxs_limit_points``.
    """
    groups = [(list(shown), _POINT_COLOUR, 1)]
    for label in labels:
        groups += [(label["idxs"], ON_PATTERN, 1), (label["idxs_limit_points"], ON_BORDER, 2)]
    for indices, colour, radius in groups:
        for at in place[indices]:
            cv2.circle(picture, _as_sixteenths(at), radius << _SHIFT_BITS, colour, -1, cv2.LINE_AA, _SHIFT_BITS)


def draw_corner(picture: Image, at: Array, share: float) -> None:
    """Draw a corner at a position (2,) in a colour between red (share 0) over green to blue (share 1)."""
    blue, green, red = _COLOUR_MAP[round(255 * (1 - share))]
    cv2.circle(
        picture, _as_sixteenths(at), _DOT_RADIUS, (int(blue), int(green), int(red)), -1, cv2.LINE_AA, _SHIFT_BITS
    )


def _as_sixteenths(at: Array) -> tuple[int, int]:
    """Convert a position to sixteenths of a pixel."""
    x, y = np.floor(at * (1 << _SHIFT_BITS) + 0.5 + 1e-6).astype(
        int
    )  # so that ties are rounded equally on all machines
    return int(x), int(y)
