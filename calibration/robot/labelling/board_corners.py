"""Corners of a board from its markers, in whole or partial views, and the layout that matches the markers.

The small boards, strong perspectives and occlusions of real data need more than the markers: these predict the corners
roughly, then every found corner improves the prediction of its neighbours, and a corner is accepted if it looks like
the print and agrees with its neighbours. So corners are found even if the markers next to them are too small to read.

OpenCV 4.6 changed the layout of charuco boards with an even number of rows of squares: the square at the top
left was white and is black since ("legacy pattern"). The corners and their ids are the same, the
markers are elsewhere. With an odd number of rows both layouts are equal. In the wrong layout every second row of
markers is one square too far to the left and the others too far to the right, so no homography of the board agrees
with both.

Positions on the board are from its top left corner; x to the right, y down. The unit is the side of a square, or of a
tag.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.estimation.residuals.planar_pose import determines_pose
from calibration.robot.labelling import board_image
from calibration.robot.labelling.detection import CORNER_DECIMALS, Image, NotDetected
from calibration.robot.labelling.markers import Markers

LEAST_FOR_BOX = 6
"""Number of markers from which it is known roughly where the others are."""
SEARCH_ROOM, MORE_ROOM = 0.3, 30
"""Distance from these markers within which the others are searched: a share of their extent, and pixels."""
MAX_MISFIT = 0.3
"""Limit of a marker's misfit of a homography of the board, at its corners (squares)."""

NEIGHBOUR_LIMITS, IN_PLACE = 2.3, 0.7
"""Largest distance of neighbouring markers, and limit of its error, squares: a small marker tells it roughly."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Layout of a board."""

    markers: Array
    """(M, 4, 2): the corners of each marker, by id, clockwise from its top left."""
    patches: board_image.PrintedPatches
    """Print around each corner."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Markers of an image that agree with one layout."""

    layout: Layout
    markers: Markers
    H: Array
    """(3, 3): approximate homography from positions on the board to pixels."""

    def box(self, height: int, width: int) -> tuple[int, int, int, int] | None:
        """Return a part (left, top, right, bottom) of the image that contains all markers; None if unknown."""
        if len(self.markers) < LEAST_FOR_BOX:
            return None
        corners, _ = board_image.project(self.H, self.layout.markers.reshape(-1, 2))
        if not np.isfinite(corners).all():
            return None
        low, high = corners.min(axis=0), corners.max(axis=0)
        room = SEARCH_ROOM * (high - low) + MORE_ROOM
        left, top = np.clip(low - room, 0, (width, height)).astype(int).tolist()
        right, bottom = np.clip(high + room, 0, (width, height)).astype(int).tolist()
        return (left, top, right, bottom) if min(right - left, bottom - top) > MORE_ROOM else None

    def share(self, height: int, width: int) -> float:
        """Share of the markers expected in the image that are read, 0 to 1."""
        centres, _ = board_image.project(self.H, self.layout.markers.mean(axis=1))
        expected = ((centres > 0) & (centres < np.array([width, height]) - 1)).all(-1).sum()
        return len(self.markers) / max(int(expected), len(self.markers), 1)


def board_layouts(
    columns: int, rows: int, marker: float, dictionary: "cv2.aruco.Dictionary", corners: Array, first: int = 0
) -> list[Layout]:
    """Return the possible layouts of a board: one, or the modern and the legacy one.

    Args:
        columns: number of columns of squares.
        rows: number of rows of squares.
        marker: the side of a marker, in squares.
        dictionary: the markers' dictionary.
        corners: (K, 2), the inner corners by id.
        first: the lowest id of its markers.
    """
    layouts, ids = [], np.arange(first, first + columns * rows // 2, dtype=np.int32)
    for legacy in (False, True) if rows % 2 == 0 else (False,):
        board = cv2.aruco.CharucoBoard((columns, rows), 1.0, marker, dictionary, ids)
        board.setLegacyPattern(legacy)
        drawing = np.asarray(
            board.generateImage(
                (columns * board_image.TEXELS_PER_SQUARE, rows * board_image.TEXELS_PER_SQUARE),
                marginSize=0,
                borderBits=1,
            ),
            np.uint8,
        )
        markers = np.array(board.getObjPoints(), float)[..., :2]
        layouts.append(Layout(markers, board_image.PrintedPatches(drawing, board_image.TEXELS_PER_SQUARE, corners)))
    return layouts


def readings(layouts: Sequence[Layout], markers: Markers) -> list[Reading]:
    """Return the layouts with which most markers agree, and those markers; several if it is ambiguous.

    Neighbouring markers decide first: lenses that bend lines let fewer markers agree with one homography, and the wrong
    layout may have a marker more.
    """
    in_place = [_in_place(layout, markers) for layout in layouts] if len(layouts) > 1 else [0.0]
    likely = [layout for layout, share in zip(layouts, in_place, strict=True) if share == max(in_place)]
    found = [reading for layout in likely if (reading := _read_layout(layout, markers)) is not None]
    most = max((len(reading.markers) for reading in found), default=0)
    return [reading for reading in found if len(reading.markers) == most]


def neighbours_in_place(layouts: Sequence[Layout], markers: Markers) -> float:
    """Return the share of neighbouring markers that are where a layout has them, 0 to 1; 1 without neighbours.

    Each marker by itself tells where its neighbours are on the board, so that distortion has no effect.
    """
    return max(_in_place(layout, markers) for layout in layouts)


def _in_place(layout: Layout, markers: Markers) -> float:
    places, centres = layout.markers[markers.ids], markers.corners.mean(axis=1)
    found = []
    for i, (place, corners) in enumerate(zip(places, markers.corners, strict=True)):
        H = cv2.getPerspectiveTransform(corners.astype(np.float32), place.astype(np.float32))
        seen, _ = board_image.project(np.array(H, float), centres)
        distances = np.linalg.norm(seen - place.mean(axis=0), axis=-1)
        near = (distances < NEIGHBOUR_LIMITS) & (np.arange(len(places)) != i)
        found.append((np.linalg.norm(seen - places.mean(axis=1), axis=-1) < IN_PLACE)[near])
    agree = np.concatenate([*found, np.zeros(0, bool)])
    return float(agree.mean()) if len(agree) else 1.0


def _read_layout(layout: Layout, markers: Markers) -> Reading | None:
    """Find the largest group of markers that fit one homography; None if there is none."""
    if not len(markers):
        return None
    places = layout.markers[markers.ids]
    # Measured on the board, so that the tolerance does not depend on the board's size in the image.
    # OpenCV's RANSAC seeds its own generator, always the same.
    found, _ = cv2.findHomography(markers.corners.reshape(-1, 2), places.reshape(-1, 2), cv2.RANSAC, MAX_MISFIT)
    if found is None or abs(np.linalg.det(np.asarray(found))) < 1e-12:
        return None
    H = np.array(found, float)
    distance = np.linalg.norm(board_image.project(H, markers.corners)[0] - places, axis=-1)
    agrees = (distance < MAX_MISFIT).all(-1)
    if not agrees.any():
        return None
    return Reading(layout, Markers(markers.ids[agrees], markers.corners[agrees]), np.asarray(np.linalg.inv(H), float))


MIN_LIKENESS = 0.8
"""Minimum correlation of the image around a corner with the print."""
MIN_SUPPORT = 1.0
"""Minimum support of a predicted corner; see `Prediction.support`."""
MAX_ROUNDS = 5
"""Limit of the number of rounds in which found corners predict others."""
LEAST_SHARE = 0.25
"""Minimum share of corners for a detection (ATOM's rule)."""


def find_corners(
    image: Image, reading: Reading, corners: Array, clearance: float, least: float = 0.0, least_angle: float = 0.0
) -> tuple[IntArray, Array]:
    """Find the corners of a board, first from its markers, and then from each other.

    Args:
        image: (H, W), grey.
        reading: the markers, and the board's layout by them.
        corners: (C, 2), positions of all corners by id.
        clearance: distance around a corner without other print, along x and y.
        least: corners are skipped if this distance is shorter in the image, px.
        least_angle: they are skipped too if their edges meet at a smaller angle in the image, rad.

    Returns:
        The ids (K,) and the pixels (K, 2).
    """
    places = reading.layout.markers[reading.markers.ids].reshape(-1, 2)
    predicted = board_image.predict(places, reading.markers.corners.reshape(-1, 2), corners)
    pixels, found = predicted.pixels.copy(), np.zeros(len(corners), bool)
    agreed = found
    for _ in range(MAX_ROUNDS):
        free = clearance * board_image.shortest(predicted.jacobians)
        wanted = np.flatnonzero(
            (predicted.support >= MIN_SUPPORT)
            & (free >= least)
            & (board_image.angles(predicted.jacobians) >= least_angle)
            & ~found
        )
        refined, at = board_image.refine(image, predicted.pixels[wanted], predicted.jacobians[wanted], clearance)
        seen = found.copy()
        seen[wanted[at]] = True
        pixels[wanted[at]] = refined[at]
        likeness = reading.layout.patches.likeness(image, pixels, predicted.jacobians)
        before, found = found, seen & (likeness >= MIN_LIKENESS)
        if found.sum() < 4:
            break
        if not np.array_equal(found, agreed):  # else they agree as in the last round
            seen = found.copy()
            found[found] = board_image.fits_neighbours(corners[found], pixels[found])
            agreed = found.copy() if np.array_equal(found, seen) else np.zeros_like(found)
        if found.sum() < 4 or not (found & ~before).any():
            break
        predicted = board_image.predict(corners[found], pixels[found], corners)
    return np.flatnonzero(found), pixels[found]


def enough(corners: Array, ids: IntArray, pixels: Array) -> CornerLabels | NotDetected:
    """Return the labels of corners, if they are enough of a board's (C, 2) and determine its pose.

    Args:
        corners: (C, 2), positions of all corners by id.
        ids: (K,), of the found corners.
        pixels: (K, 2), their positions in the image.
    """
    if len(ids) <= LEAST_SHARE * len(corners):
        return NotDetected(f"{len(ids)} of {len(corners)} corners, more than {100 * LEAST_SHARE:g} % are needed")
    if _open_pose(corners[ids]):
        return NotDetected("the corners lie on a line")
    return CornerLabels(ids, np.round(pixels, CORNER_DECIMALS))


def _open_pose(corners: Array) -> bool:
    """Whether the pose of the board is ambiguous by corners (K, 2): all but at most one are on a line."""
    flat = np.column_stack([corners, np.zeros(len(corners))])
    return not determines_pose(flat, np.ones((1, len(flat)), bool))[0]
