"""Corners of aprilgrids against the projected truth, in every way a board can be seen, and not seen."""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.aprilgrid import look
from calibration.base import InputError
from calibration.engine.dataset.configuration import APRILGRID_TAGS, PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import Image, NotDetected
from calibration.robot.labelling.marked_boards import (
    BORDER_MODULES,
    MODULES_PER_TAG,
    AprilgridDetector,
    corner_ids,
    tag_cells,
    tag_dictionary,
)
from tests.robot.labelling.pictures import (
    HD,
    HD_DISTORTED,
    TEXELS,
    VGA,
    Photograph,
    facing,
    in_view,
    printed,
    true_corners,
)

BOARD = PatternConfiguration(
    "board", "aprilgrid", "board", "world", False, (6, 6), 0.088, None, (0.02, 0.02), APRILGRID_TAGS, spacing=0.3
)
DETECTOR = corner_detector(BOARD)
CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98)
"""Of the first tags of AprilTag's family 36h11."""


def detected(image: Image, detector=DETECTOR) -> CornerLabels:
    found = detector.detect(image)
    assert isinstance(found, CornerLabels), found
    return found


def poses(count: int, seed: int, nearest: float, farthest: float) -> Iterator[np.ndarray]:
    random = np.random.default_rng(seed)
    for _ in range(count):
        distance, at = random.uniform(nearest, farthest), random.uniform(-0.2, 0.2, 2) * [0.8, 0.5]
        yield facing(BOARD, distance, random.uniform(0, 0.7), *random.uniform(-np.pi, np.pi, 2), tuple(at))


def test_tags_are_printed_as_kalibr_does() -> None:
    """The bits of a code from the top left, row by row, the highest first; 1 is white. Tag 0 is at the bottom left."""
    step = MODULES_PER_TAG + 1
    cells = tag_cells(2, 2)
    assert cells.shape == (2 * step + 1, 2 * step + 1)
    for tag, code in enumerate(CODES):
        top, left = (1 - tag // 2) * step + 1, tag % 2 * step + 1
        black = cells[top : top + MODULES_PER_TAG, left : left + MODULES_PER_TAG]
        inside = black[BORDER_MODULES:-BORDER_MODULES, BORDER_MODULES:-BORDER_MODULES]
        assert "".join("01"[not module] for module in inside.ravel()) == f"{code:036b}"
        assert black.sum() == (~np.array([b == "1" for b in f"{code:036b}"])).sum() + MODULES_PER_TAG**2 - 36
    assert cells[::step, ::step].all()
    assert not cells[::step, 1:step].any()


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(("camera", "limit"), [(HD, 0.06), (HD_DISTORTED, 0.06)])
def test_corners_are_where_the_truth_projects_them(camera, limit) -> None:
    photograph = Photograph(camera, supersampling=2)
    off, seen = [], 0
    for T in poses(6, 3, 0.9, 2.0):
        truth = true_corners(camera, BOARD, T)
        found = detected(photograph.of(BOARD, T))
        off.append(found.pixels - truth[found.ids])
        seen += in_view(camera, truth).sum()
    off = np.concatenate(off)
    assert len(off) > 0.95 * seen
    assert np.sqrt((off**2).sum(-1).mean()) < limit
    assert np.linalg.norm(off, axis=-1).max() < 0.3
    assert np.abs(off.mean(axis=0)).max() < 0.02


def test_ids_run_to_the_right_and_upwards() -> None:
    found = detected(Photograph(VGA).of(BOARD, facing(BOARD, 0.9)))
    rows = found.pixels.reshape(12, 12, 2)
    assert (np.diff(rows[..., 0], axis=1) > 5).all()
    assert (np.diff(rows[..., 1], axis=0) < -5).all()


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(("distance", "tilt", "least"), [(3.5, 0.3, 0.95), (1.2, 1.15, 0.9), (0.55, 0.2, 0.9)])
def test_small_sheared_and_near_tags(distance: float, tilt: float, least: float) -> None:
    T = facing(BOARD, distance, tilt, 1.0, 0.2)
    truth = true_corners(HD, BOARD, T)
    found = detected(Photograph(HD).of(BOARD, T))
    assert len(found.ids) > least * in_view(HD, truth).sum()
    assert np.linalg.norm(found.pixels - truth[found.ids], axis=-1).max() < 0.4


def test_what_is_seen_so_steeply_that_its_gaps_close_is_not_found() -> None:
    """Beside one corner the next one is seen, and would pull it a pixel away and more."""
    photograph = Photograph(HD_DISTORTED, supersampling=2)
    for distance in (0.7, 0.9):
        T = facing(BOARD, distance, 1.17, 0.6, 0.3, (-0.2, 0.15))
        found = detected(photograph.of(BOARD, T))
        off = np.linalg.norm(found.pixels - true_corners(HD_DISTORTED, BOARD, T)[found.ids], axis=-1)
        assert len(off) > 36
        assert off.max() < 0.95


def test_sharp_wedges_are_not_found() -> None:
    """In this image, at 70 degrees and along a diagonal, corners between edges that nearly agree were 1.4 px off."""
    found = look(936)
    assert len(found.errors) > 36
    assert np.linalg.norm(found.errors, axis=-1).max() < 0.6


def test_what_is_hidden_is_not_found() -> None:
    T = facing(BOARD, 0.9, 0.3, 0.5, 0.1)
    truth = true_corners(VGA, BOARD, T)
    for grey in (20, 128, 240):
        box = (250, 150, 420, 300)
        found = detected(Photograph(VGA).of(BOARD, T, hidden=(box, grey)))
        behind = ((truth > [box[0], box[1]]) & (truth < [box[2], box[3]])).all(-1)
        assert behind.sum() > 15
        assert not set(found.ids.tolist()) & set(np.flatnonzero(behind).tolist())
        assert len(found.ids) > 0.85 * (~behind).sum()
        assert np.linalg.norm(found.pixels - truth[found.ids], axis=-1).max() < 0.3


def test_turned_upside_down_and_on_its_side_the_ids_stay() -> None:
    image = Photograph(VGA, noise=1.0).of(BOARD, facing(BOARD, 0.9, 0.4, 0.3, 0.1))
    upright, turned, side = detected(image), detected(image[::-1, ::-1].copy()), detected(np.rot90(image).copy())
    for other, places in ((turned, [639, 479] - upright.pixels), (side, upright.pixels[:, ::-1] * [1, -1] + [0, 639])):
        _, here, there = np.intersect1d(upright.ids, other.ids, return_indices=True)
        assert len(here) > 135
        np.testing.assert_allclose(other.pixels[there], places[here], atol=0.02)


@pytest.mark.parametrize(("white", "black", "noise"), [(70, 5, 1.5), (255, 160, 2.0), (140, 60, 4.0)])
def test_in_any_light(white, black, noise) -> None:
    T = facing(BOARD, 0.9, 0.4, 0.5, -0.1)
    found = detected(Photograph(VGA, white=white, black=black, noise=noise).of(BOARD, T))
    assert len(found.ids) > 125
    assert np.linalg.norm(found.pixels - true_corners(VGA, BOARD, T)[found.ids], axis=-1).max() < 1.0


def turned_tags(pattern: PatternConfiguration) -> Image:
    """The print with each tag turned by half a turn, as OpenCV draws it."""
    picture = printed(pattern).copy()
    for row, column in np.ndindex(6, 6):
        left, top = (round(TEXELS * (0.5 + 0.3 + n * 1.3)) for n in (column, row))
        tag = slice(top, top + TEXELS), slice(left, left + TEXELS)
        picture[tag] = picture[tag][::-1, ::-1]
    return picture


def test_boards_that_are_others_are_not_this_one() -> None:
    T = facing(BOARD, 0.9, 0.2)
    for other in ((5, 6), (7, 6)):
        found = DETECTOR.detect(Photograph(VGA).of(replace(BOARD, dimension=other), T))
        assert isinstance(found, NotDetected)
    assert isinstance(DETECTOR.detect(cv2.resize(turned_tags(BOARD), None, fx=0.8, fy=0.8)), NotDetected)
    assert isinstance(detected(cv2.resize(printed(BOARD), None, fx=0.8, fy=0.8)), CornerLabels)
    assert isinstance(DETECTOR.detect(Photograph(VGA).of(BOARD, T)[:, ::-1].copy()), NotDetected)


def test_a_tag_that_lies_elsewhere_does_no_harm() -> None:
    T = facing(BOARD, 0.9, 0.2)
    image = Photograph(VGA).of(BOARD, T)
    image[:90, :90] = 230
    tag = cv2.aruco.generateImageMarker(tag_dictionary(), 14, 70, borderBits=BORDER_MODULES)
    image[10:80, 10:80] = tag
    found = detected(image)
    truth = true_corners(VGA, BOARD, T)
    assert np.linalg.norm(found.pixels - truth[found.ids], axis=-1).max() < 0.3
    assert len(found.ids) > 0.9 * in_view(VGA, truth).sum()


def test_noise_has_no_tags() -> None:
    random = np.random.default_rng(0)
    for size in (1, 3, 8, 21):
        noise = random.integers(0, 256, (480 // size, 640 // size), np.uint8)
        image = cv2.resize(noise, (640, 480), interpolation=cv2.INTER_NEAREST)
        assert isinstance(DETECTOR.detect(image), NotDetected)


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (5, 300), (480, 640)])
def test_images_that_show_nothing(shape: tuple[int, int]) -> None:
    found = DETECTOR.detect(np.zeros(shape, np.uint8))
    assert isinstance(found, NotDetected)


def test_what_is_no_image_or_no_board_is_refused() -> None:
    with pytest.raises(InputError, match="found an image of float64"):
        DETECTOR.detect(np.zeros((480, 640)))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="found 30 x 20 tags, expected 587 at most"):
        AprilgridDetector(replace(BOARD, dimension=(30, 20)))


def test_the_corners_of_a_tag_are_those_of_its_square() -> None:
    corners = BOARD.pattern().corners
    for tag, ids in enumerate(corner_ids(6, 6)):
        row, column = divmod(tag, 6)
        middle = np.array([column * 1.3 + 0.5, -(row * 1.3 + 0.5), 0]) * 0.088
        np.testing.assert_allclose(corners[ids].mean(0), middle, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(corners[ids] - corners[np.roll(ids, 1)], axis=-1), 0.088)
