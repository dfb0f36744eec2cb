"""Checks of a dataset before any calibration, for faults that would make the least squares meaningless.

That of the corner numbering of patterns, from the ids that cameras detected, is here.
"""

from collections.abc import Sequence

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.configuration import MAX_SPACING
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.pattern import MIN_SIZE, Pattern, grid, tag_grid
from calibration.engine.diagnosis.copies import check_copies
from calibration.engine.diagnosis.finding import first_names
from calibration.engine.diagnosis.units import check_units
from calibration.engine.statistics import median

LEAST_CORNERS = 12
"""Minimum of corners of a view: with fewer, another layout would fit as well."""
MAX_TESTED_VIEWS = 9
"""Number of views per camera that are tested, those with the most corners; their median decides."""
MAX_MISFIT = 0.1
"""Misfit of a flat pattern, relative to the view's extent, above which the numbering is wrong."""
MAX_MISFIT_RATIO = 0.2
"""A layout is right if its misfit is below this fraction of the other's."""
MIN_SCRAMBLED_MISFIT = 0.3
"""Misfit above which no layout by rows fits; a smaller one may be due to unmodelled distortion."""
LONGEST_ROW = 60
"""Limit of the number of corners, or of an aprilgrid's tags, in a row that is tried."""

MIN_MIRRORED_SHARE = 0.1
"""Share of a camera's views, mirrored or not, that is no single wrong view."""
MAX_NAMED_COLLECTIONS = 5
"""Number of collections that a message names."""

View = tuple[IntArray, Array]
"""Ids (K,) and normalised image coordinates (K, 2) of the corners in a camera's view."""


def check_board_order(dataset: Dataset) -> None:
    """Refuse a pattern whose corners are numbered by rows of other length, as with x and y of ``dimension`` swapped.

    For any pose and focal length, the image of a flat pattern is a homography, and all cameras see the same side.

    Raises:
        InputError: the ids from a camera fit no homography; the message names the layout that they fit. Or they
            are mirrored for some cameras or collections, and not for others; if they are in all, it is harmless.
    """
    for name, pattern in dataset.patterns.items():
        columns = pattern.columns
        count = len(pattern.corners)
        if count % columns or columns == count or pattern.kind == "tags":
            continue
        mirrored = {}
        for sensor in dataset.sensors:
            views = _views_with_most_corners(dataset, name, sensor)
            if views:
                mirrored[sensor] = (
                    median(np.array([_side_of_plane(pattern.corners[ids, :2], xy) for ids, xy in views])) < 0
                )
            misfit = _median_misfit(pattern.corners, views)
            if misfit <= MAX_MISFIT:
                continue
            several = "" if dataset.version.startswith("2") else f"s/{name}"
            where = f"{dataset.path}: calibration_config/calibration_pattern{several}/dimension"
            each, what = (2, "tags") if pattern.kind == "aprilgrid" else (1, "corners")
            found = f"{where}: found x: {columns // each}, y: {count // columns // each}, but the labels of '{sensor}'"
            row = _best_row_length(pattern, views)
            if _median_misfit(_corners_in_rows(pattern, row), views) >= MAX_MISFIT_RATIO * misfit:
                if misfit < MIN_SCRAMBLED_MISFIT:
                    continue
                raise InputError(
                    f"{found} fit no view of a flat pattern with rows of 2 to {LONGEST_ROW} {what}; look at how its "
                    f"detector numbers the corners, and at its distortion"
                )
            row //= each
            expected = f"x: {row}, y: {count // row // each**2}" if count % (row * each**2) == 0 else f"x: {row}"
            raise InputError(
                f"{found} are numbered by rows of {row} {what}; expected {expected} (x counts the {what} of a row)"
            )
        for sensor in mirrored:
            _check_sides(dataset, pattern, sensor)
        if any(mirrored.values()) and not all(mirrored.values()):
            one, other = (next(s for s, each in mirrored.items() if each is is_so) for is_so in (True, False))
            raise InputError(
                f"{dataset.path}: sensors/{one}: its labels of pattern '{name}' look mirrored, numbered as from "
                f"behind it or from right to left, those of '{other}' do not; look at its images and its detector"
            )


def _check_sides(dataset: Dataset, pattern: Pattern, sensor: str) -> None:
    """Refuse a camera that sees a pattern mirrored in some collections, as by a driver that flips since its restart."""
    sides: dict[bool, list[str]] = {True: [], False: []}
    for i, labels in dataset.detections(pattern.name, sensor):
        if isinstance(labels, CornerLabels) and len(labels.ids) >= LEAST_CORNERS:
            sides[_side_of_plane(pattern.corners[labels.ids, :2], labels.pixels) < 0].append(dataset.keys[i])
    fewer = min(sides.values(), key=len)
    if len(fewer) > max(1, MIN_MIRRORED_SHARE * sum(map(len, sides.values()))):
        raise InputError(
            f"{dataset.path}: sensors/{sensor}: its labels of pattern '{pattern.name}' in collections "
            f"{first_names(fewer, MAX_NAMED_COLLECTIONS)} look mirrored beside those in the others; does a driver flip "
            "its images since a restart? Flip them back, or leave these collections out"
        )


def _side_of_plane(plane: Array, image: Array) -> float:
    """Return a positive number if an image (K, 2) shows the front of points (K, 2), negative for back or mirrored.

    It is the determinant of the best affine map.
    """
    p, q = plane - plane.mean(0), image - image.mean(0)
    return float(np.sign(np.linalg.det(p.T @ q)))


def _views_with_most_corners(dataset: Dataset, pattern: str, sensor: str) -> list[View]:
    camera = dataset.sensors[sensor].camera
    labels = [labels for _, labels in dataset.detections(pattern, sensor) if isinstance(labels, CornerLabels)]
    most = sorted(labels, key=lambda labels: -len(labels.ids))[:MAX_TESTED_VIEWS] if camera else []
    views = []
    for each in most:
        rays = camera.normalise(each.pixels) if camera else np.empty((0, 2))
        seen = np.isfinite(rays).all(-1)  # no ray where a strong distortion folds the image over
        if np.count_nonzero(seen) >= LEAST_CORNERS:
            views.append((each.ids[seen], rays[seen]))
    return views


def _best_row_length(pattern: Pattern, views: Sequence[View]) -> int:
    """Return the length of rows that fits the views' ids best."""
    each = 2 if pattern.kind == "aprilgrid" else 1
    return min(
        range(2, each * LONGEST_ROW + 1, each), key=lambda row: _median_misfit(_corners_in_rows(pattern, row), views)
    )


def _corners_in_rows(pattern: Pattern, row: int) -> Array:
    """Return the corners (K, 3) by id, for rows of this length."""
    if pattern.kind == "aprilgrid":
        tag, gap = (abs(float(pattern.corners[i + 1, 0] - pattern.corners[i, 0])) for i in (0, 1))
        spacing = min(gap / max(tag, MIN_SIZE), MAX_SPACING)
        return tag_grid(row // 2, -(-len(pattern.corners) // (2 * row)), 1.0, spacing)
    return grid(row, -(-len(pattern.corners) // row), 1.0, (0.0, 0.0))


def _median_misfit(corners: Array, views: Sequence[View]) -> float:
    """Return the median misfit of the views with enough corners; 0 if there are none."""
    misfits = [_misfit_of_homography(corners[ids, :2], xy) for ids, xy in views]
    return median(np.array(misfits)) if misfits else 0.0


def _misfit_of_homography(plane: Array, image: Array) -> float:
    """Return the misfit of a plane's points (K, 2) and pixels (K, 2) under the best homography, by the view's extent.

    By the normalised DLT: R. Hartley, A. Zisserman, Multiple View Geometry, 2nd edition, 4.1 and 4.4.
    """
    if not np.isfinite(image).all():
        return 0.0
    p, q = ((points - points.mean(0)) / max(points.std(), 1e-12) for points in (plane, image))
    one, zero = np.ones((len(p), 1)), np.zeros((len(p), 3))
    h = np.concatenate([p, one], -1)
    A = np.concatenate([np.concatenate([h, zero, -q[:, :1] * h], -1), np.concatenate([zero, h, -q[:, 1:] * h], -1)])
    H = np.linalg.eigh(A.T @ A)[1][:, 0].reshape(3, 3)
    x = h @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.sqrt(((x[:, :2] / x[:, 2:] - q) ** 2).sum(-1).mean())
    return float(error) if np.isfinite(error) else np.inf


def check_data(dataset: Dataset) -> None:
    """Refuse data that would calibrate to nonsense; `calibration.engine.dataset.reading` has checked the form.

    Raises:
        InputError: lengths look like millimetres, angles like degrees, the corners are not numbered as in the
            dataset's patterns, or collections are copies of others.
    """
    check_units(dataset)
    check_board_order(dataset)
    check_copies(dataset)
