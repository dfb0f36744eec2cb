"""Why a pattern is never seen: what else is in the images."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from calibration.dataset.configuration import PatternConfiguration
from calibration.errors import InputError
from calibration.importing.looking import View, read_image
from calibration.labelling.chessboard import LEAST_CORNERS
from calibration.labelling.detection import Image, grey
from calibration.labelling.markers import MarkerFinder

LOOKED_AT = 8
"""So many images are searched for other patterns."""
FAMILIES = tuple(f"DICT_{bits}X{bits}_1000" for bits in (4, 5, 6, 7))
"""The largest dictionaries of their kind: the smaller ones are their beginnings."""
_SIZES = (50, 100, 250, 1000)
_OFF_BY = ((-1, -1), (-1, 0), (0, -1), (1, 1), (1, 0), (0, 1), (-2, -2))
"""How far people miscount corners."""


def never_seen(
    sensor: str, pattern: PatternConfiguration, views: Sequence[View], read: Callable[[int], Image]
) -> InputError:
    """The error for a pattern that a camera sees in none of its images, with the nearest that is there.

    Args:
        sensor: the camera.
        pattern: what was looked for.
        views: of all its images, at least one.
        read: gives the image of a view, by its place among them.
    """
    step = -(-len(views) // LOOKED_AT)
    images = [grey(read(i)) for i in range(0, len(views), step)]
    hint = _markers(pattern, images) if pattern.kind == "charuco" else _corners(pattern, images)
    reasons = Counter(view.found[pattern.name].reason for view in views)
    usual = f"; in most images: {reasons.most_common(1)[0][0]}" if not hint else ""
    return InputError(
        f"'{sensor}' sees pattern '{pattern.name}' ({_named(pattern)}) in none of its {len(views)} images{hint}{usual}"
    )


def _named(pattern: PatternConfiguration) -> str:
    dictionary = f", {pattern.dictionary}" if pattern.dictionary else ""
    return f"{pattern.kind}, {pattern.dimension[0]} x {pattern.dimension[1]} corners{dictionary}"


def _markers(pattern: PatternConfiguration, images: Sequence[Image]) -> str:
    """The markers of the dictionary that most are found of."""
    columns, rows = pattern.dimension
    expected = (columns + 1) * (rows + 1) // 2
    named = pattern.dictionary or ""
    best: tuple[int, int, str] = (0, 0, "")
    for family in FAMILIES:
        finder = MarkerFinder(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, family)), 1000)
        found = [set(finder.find(image).ids.tolist()) for image in images]
        most = max(map(len, found))
        highest = max((max(ids) for ids in found if len(ids) > most / 2), default=0)
        best = max(best, (most, highest, family), key=lambda each: each[0])
    most, highest, family = best
    if most < 2:
        return "; no markers of 4x4 to 7x7 bits are found either"
    if family.rpartition("_")[0] != named.rpartition("_")[0]:
        smallest = next(size for size in _SIZES if highest < size)
        other = f"{family.rpartition('_')[0]}_{smallest}"
        return f"; found {most} markers of another dictionary, {other}"
    if highest + 1 != expected:
        return (
            f"; found its markers with ids up to {highest}, expected 0 to {expected - 1}: are columns and rows those "
            f"of the printed board (corners inside: squares less one)?"
        )
    return f"; found {most} of its markers, not as a board of this size has them: are columns and rows exchanged?"


def _corners(pattern: PatternConfiguration, images: Iterable[Image]) -> str:
    """A chessboard of nearly that size."""
    columns, rows = pattern.dimension
    for image in images:
        for more in _OFF_BY:
            size = (columns + more[0], rows + more[1])
            if min(size) >= LEAST_CORNERS and cv2.findChessboardCornersSB(image, size)[0]:
                return (
                    f"; found one of {size[0]} x {size[1]} corners: are columns and rows those of the printed board "
                    "(corners inside: squares less one)?"
                )
    return ""


def check_board(sensor: str, pattern: PatternConfiguration, views: Sequence[View]) -> None:
    """Refuse a charuco board whose own markers tell that it is larger than described.

    Markers that a board of this size has not, in most of the images that are looked at, are the rest of it.

    Raises:
        InputError: names the highest marker.
    """
    if pattern.kind != "charuco" or not pattern.dictionary:
        return
    columns, rows = pattern.dimension
    expected = (columns + 1) * (rows + 1) // 2
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, pattern.dictionary))
    finder = MarkerFinder(dictionary, len(dictionary.bytesList))
    labelled = [view for view in views if view.found[pattern.name].ids]
    others = []
    for view in labelled[:: -(-len(labelled) // LOOKED_AT) or 1]:
        ids = finder.find(grey(read_image(Path(view.file)))).ids
        others.append(int(np.max(ids[ids >= expected], initial=-1)))
    if sum(highest >= 0 for highest in others) > len(others) / 2:
        raise InputError(
            f"'{sensor}' sees marker {max(others)} of {pattern.dictionary}, expected 0 to {expected - 1}, as pattern "
            f"'{pattern.name}' of {columns} x {rows} corners has: are columns and rows those of the printed board "
            "(corners inside: squares less one)?"
        )
