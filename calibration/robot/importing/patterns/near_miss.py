"""Reasons why a pattern is never detected: other patterns in the images."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.configuration import APRILGRID_TAGS, PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import CIRCLE_KINDS, UNMARKED_KINDS
from calibration.robot.importing.patterns.image_views import View, read_image
from calibration.robot.importing.patterns.shown_patterns import (
    APRILGRID_FAMILY,
    MIN_BOARD_MARKERS,
    Family,
    shown_circles,
    shown_markers,
)
from calibration.robot.labelling.charuco import CharucoDetector
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import Image, grey
from calibration.robot.labelling.markers import Markers, turned_tags
from calibration.robot.labelling.unmarked_grids import LEAST_CORNERS

LOOKED_AT = 8
"""Number of images that are searched for other patterns."""
_OFF_BY = ((-1, -1), (-1, 0), (0, -1), (1, 1), (1, 0), (0, 1), (-2, -2))
"""Typical errors in counting corners."""
IN_PLACE = 0.5
"""Least share of neighbouring markers that are where the described board has them."""
GAP_OFF = 0.2
"""Tolerance of the gaps between tags, in sides of a tag: small tags are blurred."""


SPACING_OFF = 0.02
"""Limit of the error of a described gap between tags, in sides of a tag."""
LEAST_GAPS = 10
"""Minimum of gaps by which a described one is judged."""


def never_seen(
    sensor: str, pattern: PatternConfiguration, views: Sequence[View], read: Callable[[int], Image]
) -> InputError:
    """Return the error for a pattern that is in none of a camera's images, with the most similar pattern found.

    Args:
        sensor: the camera.
        pattern: the described pattern.
        views: of all its images, at least one.
        read: function that returns the image of a view, by index.
    """
    step = -(-len(views) // LOOKED_AT)
    images = [grey(read(i)) for i in range(0, len(views), step)]
    hint = _otherwise_printed(pattern, images)
    if pattern.inverted:
        images = [np.bitwise_not(image) for image in images]
    hint = hint or _describe_markers(pattern, images)
    if pattern.kind == "chessboard":
        hint = hint or _describe_chessboard(pattern, images)
    if pattern.kind in CIRCLE_KINDS:
        hint = hint or _describe_circles(pattern, images)
    reasons = Counter(view.found[pattern.name].reason for view in views)
    usual = f"; in most images: {reasons.most_common(1)[0][0]}" if not hint else ""
    return InputError(
        f"'{sensor}' sees pattern '{pattern.name}' ({_describe_pattern(pattern)}) in none of its {len(views)} "
        f"images{hint}{usual}"
    )


def _otherwise_printed(pattern: PatternConfiguration, images: Sequence[Image]) -> str:
    """Say whether the pattern is in the images with black and white exchanged, or mirrored; markers tell it."""
    if pattern.kind == "chessboard":
        return ""
    detector = corner_detector(pattern)
    inverted = f"the board's colours are {'not ' if pattern.inverted else ''}inverted"
    mirrored = "it is seen from its back, mirrored"
    for hint, changed in (
        (f"; {inverted}: add 'inverted: {'false' if pattern.inverted else 'true'}' to the pattern", np.bitwise_not),
        (f"; {mirrored}: turn its printed side to this camera", np.fliplr),
        (f"; {inverted}, and {mirrored}", lambda image: np.bitwise_not(np.fliplr(image))),
    )[: 1 if pattern.kind in CIRCLE_KINDS else 3]:  # most grids of circles look the same mirrored
        if any(isinstance(detector.detect(np.ascontiguousarray(changed(i))), CornerLabels) for i in images):
            return hint
    return ""


def _describe_pattern(pattern: PatternConfiguration) -> str:
    size = f"{pattern.kind}, {pattern.dimension[0]} x {pattern.dimension[1]}"
    if pattern.kind == "aprilgrid":
        return f"{size} tags"
    if pattern.kind == "tags":
        return f"tags {', '.join(str(tag.id) for tag in pattern.tags)} of {pattern.dictionary}"
    if pattern.kind in CIRCLE_KINDS:
        return size
    dictionary = f", {pattern.dictionary}" if pattern.dictionary else ""
    return f"{size} corners{dictionary}"


def _describe_markers(pattern: PatternConfiguration, images: Sequence[Image]) -> str:
    """Describe the markers of the family with most detections."""
    plain = shown_markers(images)
    family = max(plain, key=lambda each: max(map(len, plain[each])))
    if max(map(len, plain[family])) < {"tags": 1, **dict.fromkeys(UNMARKED_KINDS, MIN_BOARD_MARKERS)}.get(
        pattern.kind, 2
    ):
        return "" if pattern.kind in UNMARKED_KINDS else "; no markers of 4x4 to 7x7 bits and no tags are found either"
    found = [max(one, family.finder().find_small(i), key=len) for one, i in zip(plain[family], images, strict=True)]
    seen = max(found, key=len)
    many = np.concatenate([markers.ids for markers in found if len(markers) > len(seen) / 2])
    lowest, highest = int(many.min()), int(many.max())
    if pattern.kind == "tags":
        return f"; found {family.named(highest)} with ids {lowest} to {highest}"
    if pattern.kind in UNMARKED_KINDS:
        return f"; found {len(seen)} markers of {family.named(highest)}: is it a charuco board or an aprilgrid?"
    if pattern.kind == "aprilgrid":
        return _describe_tags(pattern, family, lowest, highest, seen)
    if family.border > 1 or family.named(0).rpartition("_")[0] != (pattern.dictionary or "").rpartition("_")[0]:
        return f"; found {len(seen)} markers of another dictionary, {family.named(highest)}"
    expected = marker_ids(pattern)
    if other_first := _other_first(pattern, "markers", lowest, highest):
        return other_first
    if highest != expected[-1]:
        return (
            f"; found its markers with ids up to {highest}, expected {expected[0]} to {expected[-1]}: are columns and "
            f"rows those of the printed board (corners inside: squares less one)?"
        )
    return f"; found {len(seen)} of its markers, not as a board of this size has them: are columns and rows exchanged?"


def _other_first(pattern: PatternConfiguration, markers: str, lowest: int, highest: int) -> str:
    """Say that the ids of the found markers begin elsewhere, if they are as many as the board has, or all others."""
    expected = marker_ids(pattern)
    count = highest - lowest + 1
    if lowest == expected[0] or count > len(expected) or (lowest <= expected[-1] and count < len(expected)):
        return ""
    return (
        f"; found its {markers} with ids {lowest} to {highest}, expected {expected[0]} to {expected[-1]}: the ids "
        f"begin at {lowest}: add 'first: {lowest}' to the pattern"
    )


def _describe_tags(pattern: PatternConfiguration, family: Family, lowest: int, highest: int, seen: Markers) -> str:
    """Describe the differences of an image's tags from an aprilgrid."""
    if family != APRILGRID_FAMILY:
        border = (
            " with a border of one module, expected two, as Kalibr prints them"
            if family.dictionary == APRILGRID_TAGS
            else ""
        )
        other = border or f", expected {APRILGRID_TAGS}"
        return f"; found {len(seen)} markers of {family.named(highest)}{other}"
    expected, gap = marker_ids(pattern), _median_gap(seen)
    if other_first := _other_first(pattern, "tags", lowest, highest):
        return other_first
    if highest == expected[-1] and 0 < gap < 1 and abs(gap - pattern.spacing) > GAP_OFF:
        return (
            f"; found {len(seen)} of its tags, with gaps of about {gap:.1f} sides of a tag, expected "
            f"{pattern.spacing:g}: spacing is the gap by the side of a tag, both in one unit"
        )
    if highest != expected[-1]:
        return (
            f"; found its tags with ids up to {highest}, expected {expected[0]} to {expected[-1]}: are columns and "
            "rows those of the printed board (tags)?"
        )
    return (
        f"; found {len(seen)} of its tags, not as a board of this size has them: are columns and rows exchanged, or is "
        "it not printed by Kalibr (tag 0 at the bottom left, its corner squares black)?"
    )


def _median_gap(seen: Markers) -> float:
    """Return the median gap between neighbours in a row, in sides of a tag; NaN if no two are detected."""
    (first,) = np.nonzero(np.diff(seen.ids) == 1)
    corners = np.roll(seen.corners, -turned_tags(), axis=1)  # from the top left
    right, left = corners[first, 2], corners[first, 3]
    gaps = np.linalg.norm(corners[first + 1, 3] - right, axis=-1) / np.linalg.norm(right - left, axis=-1)
    return float(np.median(gaps)) if len(gaps) else np.nan


def marker_ids(pattern: PatternConfiguration) -> Sequence[int]:
    """Ids of a charuco board's markers, of an aprilgrid's tags, or of single tags; none of another pattern."""
    if pattern.kind == "tags":
        return sorted(tag.id for tag in pattern.tags)
    columns, rows = pattern.dimension
    count = {"aprilgrid": columns * rows, "charuco": (columns + 1) * (rows + 1) // 2}.get(pattern.kind, 0)
    return range(pattern.first_marker, pattern.first_marker + count)


def check_told_apart(patterns: Mapping[str, PatternConfiguration]) -> None:
    """Refuse boards of one dictionary that share ids: each would be found on the other.

    Raises:
        InputError: names two of them.
    """
    for one, other in combinations((each for each in patterns.values() if marker_ids(each)), 2):
        ids, others = marker_ids(one), marker_ids(other)
        alike = (one.dictionary, one.kind, one.inverted) == (other.dictionary, other.kind, other.inverted)
        if alike and set(ids) & set(others):
            raise InputError(
                f"patterns '{one.name}' and '{other.name}' have markers of {one.dictionary} with ids {ids[0]} to "
                f"{ids[-1]} and {others[0]} to {others[-1]}, expected no id on both: print them with other ids, and "
                "say where they begin (first: 27)"
            )


def _describe_chessboard(pattern: PatternConfiguration, images: Iterable[Image]) -> str:
    """Describe a chessboard of nearly that size."""
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


def _describe_circles(pattern: PatternConfiguration, images: Sequence[Image]) -> str:
    """Describe a grid of circles of another kind or size."""
    shown = shown_circles(images)
    if shown is None or (shown.kind, sorted(shown.dimension)) == (pattern.kind, sorted(pattern.dimension)):
        return ""
    return f"; found {_describe_pattern(shown)}: are type, columns and rows those of the printed grid?"


def check_board(
    sensor: str, pattern: PatternConfiguration, views: Sequence[View], others: Iterable[PatternConfiguration] = ()
) -> None:
    """Refuse a board whose detected markers belong to another board than described.

    Markers that the described board lacks, in most of the searched images, are the rest of a larger one. Markers that
    are not where the described board has them are those of a board with other columns and rows.

    Args:
        sensor: the camera.
        pattern: the described board.
        views: of the camera.
        others: other boards, whose markers may be seen too.

    Raises:
        InputError: names the highest marker, or asks whether columns and rows are exchanged.
    """
    if pattern.kind in (*UNMARKED_KINDS, "tags") or not pattern.dictionary:
        return
    expected = marker_ids(pattern)
    of_others = [n for each in others if each.dictionary == pattern.dictionary for n in marker_ids(each)]
    finder = (APRILGRID_FAMILY if pattern.kind == "aprilgrid" else Family(pattern.dictionary)).finder()
    labelled = [view for view in views if view.found[pattern.name].ids]
    charuco = CharucoDetector(pattern) if pattern.kind == "charuco" else None
    strange, misplaced = [], 0
    for view in labelled[:: -(-len(labelled) // LOOKED_AT) or 1]:
        image = grey(read_image(Path(view.file)))
        markers = finder.find_small(np.bitwise_not(image) if pattern.inverted else image)
        strange.append(int(np.max(np.setdiff1d(markers.ids, [*expected, *of_others]), initial=-1)))
        misplaced += charuco is not None and charuco.in_place(markers) < IN_PLACE
    if sum(highest >= 0 for highest in strange) > len(strange) / 2:
        marker, corners, counted = (
            ("tag", "tags", "tags")
            if pattern.kind == "aprilgrid"
            else ("marker", "corners", "corners inside: squares less one")
        )
        raise InputError(
            f"'{sensor}' sees {marker} {max(strange)} of {pattern.dictionary}, expected {expected[0]} to "
            f"{expected[-1]}, as pattern '{pattern.name}' of {pattern.dimension[0]} x {pattern.dimension[1]} {corners} "
            f"has: are columns and rows those of the printed board ({counted})?"
        )
    if misplaced > len(strange) / 2:
        raise InputError(
            f"'{sensor}' sees markers of {pattern.dictionary}, but not where pattern '{pattern.name}' of "
            f"{pattern.dimension[0]} x {pattern.dimension[1]} corners has them: are columns and rows those of the "
            "printed board (corners inside: squares less one), or exchanged?"
        )


def check_spacing(sensor: str, pattern: PatternConfiguration, views: Sequence[View]) -> None:
    """Refuse an aprilgrid whose images show another gap between tags than described.

    The begins and ends of two neighbouring tags are four points of a line, whose cross-ratio is the same in any image:
    ``(1 + s)^2 / (s (2 + s))`` for a gap of s sides of a tag. A lens bends lines little over two tags.

    Raises:
        InputError: states the gap.
    """
    if pattern.kind != "aprilgrid":
        return
    seen = np.concatenate(
        [_tag_spacings(pattern, labels) for view in views if (labels := view.found[pattern.name].labels)]
    )
    if len(seen) < LEAST_GAPS:
        return
    shown = float(np.median(seen))
    if abs(shown - pattern.spacing) > SPACING_OFF:
        raise InputError(
            f"'{sensor}': pattern '{pattern.name}' has a spacing of {pattern.spacing:g}, the images show {shown:.3f} "
            f"({len(seen)} gaps): spacing is the gap between two tags by the side of a tag: measure both again"
        )


def _tag_spacings(pattern: PatternConfiguration, labels: CornerLabels) -> Array:
    """Return the gaps (N,) between the neighbouring tags of a view, in sides of a tag."""
    columns, rows = pattern.dimension
    places = np.full((2 * rows * 2 * columns, 2), np.nan)
    places[labels.ids] = labels.pixels
    across = places.reshape(2 * rows, 2 * columns, 2)
    found = []
    for lines in (across, across.swapaxes(0, 1)):
        a, b, c, d = (lines[:, i : lines.shape[1] - 3 + i : 2] for i in range(4))
        ac, bd, bc, ad = (np.linalg.norm(q - p, axis=-1).ravel() for p, q in ((a, c), (b, d), (b, c), (a, d)))
        ratio = ac * bd / (bc * ad)
        ratio = ratio[np.isfinite(ratio)]
        found.append(np.sqrt(ratio / (ratio - 1)) - 1)
    return np.concatenate(found)
