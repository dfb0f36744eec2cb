"""The corners of a board whose markers were read, from whole or partial views.

The small boards, strong perspectives and hidden parts of real data need more than the markers: these tell roughly
where the corners are, then every corner that is found helps to tell where its neighbours are, and a corner counts when
it looks as printed and lies where its neighbours say. So corners are found whose own markers are too small to be read.

Places are in the board's unit: the side of a square, or of a tag.
"""

import numpy as np

from calibration.dataset.model import CornerLabels
from calibration.estimation.planar_pose import planar_poses
from calibration.geometry.types import Array, IntArray
from calibration.labelling.board_image import fits_neighbours, predict
from calibration.labelling.detection import Image, NotDetected
from calibration.labelling.layouts import Reading
from calibration.labelling.printed_corners import refine, shortest

DECIMALS = 4
"""Of the corners' pixels."""
LIKENESS = 0.8
"""The least correlation of what is seen around a corner with what is printed there."""
SUPPORT = 1.0
"""A corner is looked for where at least so much speaks for it; see `Prediction.support`."""
ROUNDS = 5
"""How often corners that are found may lead to others."""
LEAST_SHARE = 0.25
"""A larger share of the corners makes a detection (ATOM's rule)."""


def find_corners(
    image: Image, reading: Reading, corners: Array, clearance: float, least: float = 0.0
) -> tuple[IntArray, Array]:
    """The corners of a board that has so far been read by its markers: from these, and then from each other.

    Args:
        image: (H, W), grey.
        reading: the markers, and the layout that they speak for.
        corners: (C, 2), places of all corners by id.
        clearance: how far nothing else is printed around a corner, along x and y.
        least: corners are not looked for where that is seen shorter, px.

    Returns:
        The ids (K,) and the pixels (K, 2).
    """
    places = reading.layout.markers[reading.markers.ids].reshape(-1, 2)
    predicted = predict(places, reading.markers.corners.reshape(-1, 2), corners)
    pixels, found = predicted.pixels.copy(), np.zeros(len(corners), bool)
    for _ in range(ROUNDS):
        free = clearance * shortest(predicted.jacobians)
        wanted = np.flatnonzero((predicted.support >= SUPPORT) & (free >= least) & ~found)
        refined, at = refine(image, predicted.pixels[wanted], predicted.jacobians[wanted], clearance)
        seen = found.copy()
        seen[wanted[at]] = True
        pixels[wanted[at]] = refined[at]
        likeness = reading.layout.patches.likeness(image, pixels, predicted.jacobians)
        before, found = found, seen & (likeness >= LIKENESS)
        if found.sum() < 4:
            break
        found[found] = fits_neighbours(corners[found], pixels[found])
        if found.sum() < 4 or not (found & ~before).any():
            break
        predicted = predict(corners[found], pixels[found], corners)
    return np.flatnonzero(found), pixels[found]


def enough(corners: Array, ids: IntArray, pixels: Array) -> CornerLabels | NotDetected:
    """The labels that corners make, if they are enough of a board's (C, 2) and tell its pose.

    Args:
        corners: (C, 2), places of all corners by id.
        ids: (K,), of those that were found.
        pixels: (K, 2), where.
    """
    if len(ids) <= LEAST_SHARE * len(corners):
        return NotDetected(f"{len(ids)} of {len(corners)} corners, more than {100 * LEAST_SHARE:g} % are needed")
    if _open_pose(corners[ids]):
        return NotDetected("the corners lie on a line")
    return CornerLabels(ids, np.round(pixels, DECIMALS))


def _open_pose(corners: Array) -> bool:
    """Whether corners (K, 2), all but at most one on a line, leave the pose of the board open."""
    flat = np.column_stack([corners, np.zeros(len(corners))])
    return bool(np.isnan(planar_poses(corners.T[None], flat)[0, 0, 0]))
