"""Corners of a board from its markers, in whole or partial views.

The small boards, strong perspectives and occlusions of real data need more than the markers: these predict the corners
roughly, then every found corner improves the prediction of its neighbours, and a corner is accepted if it looks like
the print and agrees with its neighbours. So corners are found even if the markers next to them are too small to read.

Positions are in the board's unit: the side of a square, or of a tag.
"""

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.estimation.residuals.planar_pose import determines_pose
from calibration.robot.labelling.board_image import fits_neighbours, predict
from calibration.robot.labelling.detection import Image, NotDetected
from calibration.robot.labelling.layouts import Reading
from calibration.robot.labelling.printed_corners import angles, refine, shortest

CORNER_DECIMALS = 4
"""Decimals of the corners' pixels."""
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
    predicted = predict(places, reading.markers.corners.reshape(-1, 2), corners)
    pixels, found = predicted.pixels.copy(), np.zeros(len(corners), bool)
    agreed = found
    for _ in range(MAX_ROUNDS):
        free = clearance * shortest(predicted.jacobians)
        wanted = np.flatnonzero(
            (predicted.support >= MIN_SUPPORT) & (free >= least) & (angles(predicted.jacobians) >= least_angle) & ~found
        )
        refined, at = refine(image, predicted.pixels[wanted], predicted.jacobians[wanted], clearance)
        seen = found.copy()
        seen[wanted[at]] = True
        pixels[wanted[at]] = refined[at]
        likeness = reading.layout.patches.likeness(image, pixels, predicted.jacobians)
        before, found = found, seen & (likeness >= MIN_LIKENESS)
        if found.sum() < 4:
            break
        if not np.array_equal(found, agreed):  # else they agree as in the last round
            seen = found.copy()
            found[found] = fits_neighbours(corners[found], pixels[found])
            agreed = found.copy() if np.array_equal(found, seen) else np.zeros_like(found)
        if found.sum() < 4 or not (found & ~before).any():
            break
        predicted = predict(corners[found], pixels[found], corners)
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
