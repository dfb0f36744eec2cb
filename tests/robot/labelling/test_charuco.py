"""Charuco corners against the projected truth, in every way a board can be seen, and not seen."""

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest

from calibration.base import InputError
from calibration.ci.execution.tasks import Embedded
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Equidistant, PlumbBob
from calibration.robot.labelling.board_corners import board_layouts, readings
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.marked_boards import CharucoDetector
from calibration.robot.labelling.markers import MarkerFinder, Markers
from tests.robot.labelling.pictures import HD, HD_DISTORTED, VGA, Photograph, charuco, facing, in_view, true_corners

BOARD = charuco()
DETECTOR = corner_detector(BOARD)


def poses(count: int, seed: int, nearest: float, farthest: float, tilt: float, off: float, pattern=BOARD):
    random = np.random.default_rng(seed)
    for _ in range(count):
        distance = random.uniform(nearest, farthest)
        at = tuple(random.uniform(-off, off, 2) * [0.6, 0.4])
        yield facing(
            pattern, distance, random.uniform(0, tilt), random.uniform(-np.pi, np.pi), random.uniform(-np.pi, np.pi), at
        )


def detected(image, detector=DETECTOR) -> CornerLabels:
    found = detector.detect(image)
    assert isinstance(found, CornerLabels), found
    return found


def errors(found: CornerLabels, truth):
    return found.pixels - truth[found.ids]


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(("camera", "limit"), [(HD, 0.06), (HD_DISTORTED, 0.08)])
def test_corners_are_where_the_truth_projects_them(camera, limit) -> None:
    """The bars of the work: RMS, no bias, nothing far off, and hardly a corner missed."""
    photograph = Photograph(camera, supersampling=2)
    off, seen = [], 0
    for T in poses(6, 3, 1.0, 2.0, 0.7, 0.3):
        truth = true_corners(camera, BOARD, T)
        found = detected(photograph.of(BOARD, T))
        off.append(errors(found, truth))
        seen += in_view(camera, truth).sum()
    off = np.concatenate(off)
    assert len(off) > 0.98 * seen
    assert np.sqrt((off**2).sum(-1).mean()) < limit
    assert np.linalg.norm(off, axis=-1).max() < 0.3
    assert np.abs(off.mean(axis=0)).max() < 0.01


def test_small_boards_are_read_down_to_squares_of_13_pixels() -> None:
    T = facing(BOARD, 2.5, 0.3, 1.0, 0.2)
    found = detected(Photograph(VGA).of(BOARD, T))
    assert len(found.ids) > 80
    assert np.sqrt((errors(found, true_corners(VGA, BOARD, T)) ** 2).sum(-1).mean()) < 0.2


@pytest.mark.parametrize(("white", "black", "noise"), [(70, 5, 1.5), (255, 160, 2.0), (140, 60, 5.0)])
def test_in_any_light(white, black, noise) -> None:
    T = facing(BOARD, 1.2, 0.4, 0.5, -0.1)
    found = detected(Photograph(VGA, white=white, black=black, noise=noise).of(BOARD, T))
    assert len(found.ids) > 80
    assert np.linalg.norm(errors(found, true_corners(VGA, BOARD, T)), axis=-1).max() < 1.0


@pytest.mark.parametrize("at", [(0.5, 0.0), (-0.5, 0.1), (0.0, 0.42), (0.1, -0.42), (0.45, -0.35)])
def test_partial_views_have_the_ids_of_what_is_seen(at) -> None:
    T = facing(BOARD, 0.8, 0.3, 0.4, 0.3, at)
    truth = true_corners(VGA, BOARD, T)
    inside = in_view(VGA, truth)
    assert inside.sum() < 80
    found = detected(Photograph(VGA).of(BOARD, T))
    assert set(np.flatnonzero(inside)) - set(found.ids.tolist()) == set()
    assert np.linalg.norm(errors(found, truth), axis=-1).max() < 0.3


def test_turned_upside_down_the_ids_stay_and_the_pixels_turn() -> None:
    image = Photograph(VGA, noise=1.0).of(BOARD, facing(BOARD, 1.1, 0.4, 0.3, 0.1))
    upright, turned = detected(image), detected(image[::-1, ::-1].copy())
    np.testing.assert_array_equal(upright.ids, turned.ids)
    np.testing.assert_allclose(turned.pixels, [639, 479] - upright.pixels, atol=0.02)


def test_on_its_side_too() -> None:
    image = Photograph(VGA, noise=1.0).of(BOARD, facing(BOARD, 1.1, 0.4, 0.3, 0.1))
    upright, turned = detected(image), detected(np.rot90(image).copy())
    np.testing.assert_array_equal(upright.ids, turned.ids)
    x, y = upright.pixels.T
    np.testing.assert_allclose(turned.pixels, np.stack([y, 639 - x], -1), atol=0.02)


def test_a_mirrored_board_is_no_board() -> None:
    image = Photograph(VGA).of(BOARD, facing(BOARD, 1.1, 0.2))
    assert isinstance(DETECTOR.detect(image[:, ::-1].copy()), NotDetected)


def test_x_runs_along_a_row_and_y_down_a_column() -> None:
    found = detected(Photograph(VGA).of(BOARD, facing(BOARD, 1.1)))
    grid = found.pixels.reshape(8, 11, 2)
    assert (np.diff(grid[..., 0], axis=1) > 20).all()
    assert (np.diff(grid[..., 1], axis=0) > 20).all()


def test_colour_is_as_grey() -> None:
    image = Photograph(VGA).of(BOARD, facing(BOARD, 1.1, 0.3))
    grey, colour = detected(image), detected(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    np.testing.assert_array_equal(grey.pixels, colour.pixels)


# Both layouts of boards with an even number of rows of squares


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("dimension", [(7, 7), (6, 5), (11, 7), (4, 3)])
def test_the_layout_is_found_in_the_image(dimension, legacy) -> None:
    pattern = charuco(*dimension)
    detector = CharucoDetector(pattern)
    for T in poses(3, 5, 0.7, 1.0, 0.6, 0.2, pattern):
        truth = true_corners(VGA, pattern, T)
        found = detected(Photograph(VGA).of(pattern, T, legacy), detector)
        assert len(found.ids) > 0.9 * in_view(VGA, truth).sum()
        assert np.linalg.norm(errors(found, truth), axis=-1).max() < 0.3


@pytest.mark.parametrize("legacy", [False, True])
def test_partial_views_of_either_layout(legacy) -> None:
    pattern = charuco(7, 7)
    detector = CharucoDetector(pattern)
    for at in [(0.45, 0.0), (0.0, -0.3), (-0.4, 0.3)]:
        T = facing(pattern, 0.55, 0.3, 0.4, 0.2, at)
        found = detector.detect(Photograph(VGA).of(pattern, T, legacy))
        if isinstance(found, CornerLabels):
            assert np.linalg.norm(errors(found, true_corners(VGA, pattern, T)), axis=-1).max() < 0.3


@pytest.mark.parametrize("legacy", [False, True])
def test_few_rows_of_markers_never_give_the_wrong_layout(legacy) -> None:
    """With one visible row of markers, the two layouts differ by a shift: only its surroundings distinguish them."""
    pattern = replace(charuco(11, 3), border_size=(0.0, 0.0))
    detector = CharucoDetector(pattern)
    T = facing(pattern, 0.8)
    truth = true_corners(VGA, pattern, T)
    image = Photograph(VGA).of(pattern, T, legacy)
    for rows in range(150, 330, 12):
        cut = image.copy()
        cut[rows:] = 120
        found = detector.detect(cut)
        if isinstance(found, CornerLabels):
            assert np.linalg.norm(errors(found, truth), axis=-1).max() < 1.0


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(
    "camera",
    [
        Camera(350.0, 350.0, 319.5, 239.5, 640, 480, PlumbBob(-0.30, 0.10, 0.0004, -0.0003, -0.015)),
        Camera(300.0, 300.0, 421.0, 302.0, 848, 600, Equidistant(-0.012, 0.045, -0.036, 0.006)),
    ],
    ids=["wide", "fisheye"],
)
def test_lenses_that_bend_lines_never_give_the_wrong_layout(camera, legacy) -> None:
    pattern = charuco(8, 5)
    detector, found_views = CharucoDetector(pattern), 0
    for T in poses(3, 3, 0.25, 0.45, 0.6, 0.5, pattern):
        found = detector.detect(Photograph(camera).of(pattern, T, legacy))
        if isinstance(found, CornerLabels):
            found_views += 1
            assert np.median(np.linalg.norm(errors(found, true_corners(camera, pattern, T)), axis=-1)) < 0.3
    assert found_views >= 2


# Things in front


@pytest.mark.thorough(but_first=3)
@pytest.mark.parametrize("grey", [0, 90, 255])
@pytest.mark.parametrize("box", [(250, 180, 330, 260), (300, 100, 420, 300), (100, 230, 600, 260), (318, 0, 326, 480)])
def test_a_corner_beside_something_in_front_is_right_or_left_out(box, grey) -> None:
    T = facing(BOARD, 1.0, 0.4, 1.0, 0.2)
    truth = true_corners(VGA, BOARD, T)
    found = detected(Photograph(VGA).of(BOARD, T, hidden=(box, grey)))
    left, top, right, bottom = box
    under = (truth[found.ids] > [left + 1, top + 1]).all(-1) & (truth[found.ids] < [right - 2, bottom - 2]).all(-1)
    assert not under.any()
    assert np.linalg.norm(errors(found, truth), axis=-1).max() < 0.5
    clear = (truth < [left - 12, top - 12]).any(-1) | (truth > [right + 12, bottom + 12]).any(-1)
    clear |= (truth[:, 0] < left - 12) | (truth[:, 0] > right + 12)
    clear |= (truth[:, 1] < top - 12) | (truth[:, 1] > bottom + 12)
    missed = set(np.flatnonzero(clear & in_view(VGA, truth))) - set(found.ids.tolist())
    assert len(missed) <= 2


# No detection


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (1, 1), (3, 640), (480, 2), (1, 1, 3), (0, 0, 3), (20, 20)])
def test_images_too_small_for_anything(shape) -> None:
    found = DETECTOR.detect(np.zeros(shape, np.uint8))
    assert isinstance(found, NotDetected)
    assert found.reason


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_no_board(seed) -> None:
    noise = np.random.default_rng(seed).integers(0, 256, (240, 320), dtype=np.uint8)
    for image in (noise, cv2.resize(noise, (640, 480), interpolation=cv2.INTER_NEAREST), np.full_like(noise, 255)):
        found = DETECTOR.detect(image)
        assert isinstance(found, NotDetected)
        assert "markers" in found.reason


@pytest.mark.parametrize(
    "image",
    [np.zeros((480, 640)), np.zeros((480, 640), np.uint16), np.zeros((480, 640, 4), np.uint8), np.zeros(640, np.uint8)],
)
def test_an_invalid_image_is_a_one_line_error(image) -> None:
    with pytest.raises(InputError, match=r"expected 8 bits a channel") as error:
        DETECTOR.detect(image)
    assert str(image.dtype) in str(error.value)


def test_another_board_is_not_taken_for_this_one() -> None:
    other = charuco(11, 8, dictionary="DICT_4X4_100")
    found = DETECTOR.detect(Photograph(VGA).of(other, facing(other, 1.1, 0.3)))
    assert isinstance(found, NotDetected)


def test_a_view_with_too_few_markers_states_the_minimum() -> None:
    T = facing(BOARD, 0.5, at=(0.75, 0.55))
    found = DETECTOR.detect(Photograph(VGA).of(BOARD, T))
    assert isinstance(found, NotDetected)
    assert "needed" in found.reason


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dictionary": "DICT_9X9_50"}, "found dictionary 'DICT_9X9_50', expected one of OpenCV's: DICT_4X4_100"),
        ({"dictionary": None}, "found dictionary ''"),
        ({"dictionary": "CharucoBoard"}, "found dictionary 'CharucoBoard'"),
        ({"inner_size": None}, "needs inner_size"),
        ({"dimension": (20, 15)}, "has 168 markers, DICT_5X5_100 has 100"),
    ],
)
def test_boards_that_cannot_be_printed(change, message) -> None:
    with pytest.raises(InputError, match=message):
        CharucoDetector(replace(BOARD, **change))


# The same result whenever and wherever


def test_what_was_seen_before_changes_nothing() -> None:
    pattern = charuco(7, 7)
    photograph = Photograph(VGA)
    images = [photograph.of(pattern, facing(pattern, 0.8, 0.2 * i, 1.0, 0.3 * i), i % 2 == 0) for i in range(4)]
    images += [np.zeros((480, 640), np.uint8), images[0][:, 250:].copy()]
    fresh = [CharucoDetector(pattern).detect(image) for image in images]
    one = CharucoDetector(pattern)
    used = [one.detect(image) for image in reversed(images)][::-1]
    for a, b in zip(fresh, used, strict=True):
        assert type(a) is type(b)
        if isinstance(a, CornerLabels) and isinstance(b, CornerLabels):
            np.testing.assert_array_equal(a.ids, b.ids)
            np.testing.assert_array_equal(a.pixels, b.pixels)


def _in_a_worker(image) -> tuple[list[int], list[list[float]]]:
    found = detected(image)
    return found.ids.tolist(), found.pixels.tolist()


def test_a_forked_process_finds_the_same() -> None:
    images = [Photograph(VGA).of(BOARD, facing(BOARD, 1.0 + 0.2 * i, 0.3)) for i in range(3)]
    here = [_in_a_worker(image) for image in images]  # OpenCV's threads run before the fork
    assert dict(Embedded().run([partial(_in_a_worker, image) for image in images], workers=2)) == dict(enumerate(here))


def test_pixels_are_rounded() -> None:
    found = detected(Photograph(VGA).of(BOARD, facing(BOARD, 1.0, 0.3)))
    np.testing.assert_array_equal(found.pixels, np.round(found.pixels, 4))
    assert found.ids.dtype == np.int64


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("distance", [1.6, 2.2, 2.8])
@pytest.mark.parametrize("towards", [0.0, 2.0])
def test_small_markers_are_the_same_in_the_part_of_the_image_with_the_board(distance: float, towards: float) -> None:
    pattern = charuco()
    image = Photograph(VGA).of(pattern, facing(pattern, distance, 0.4, towards, 0.3, (0.1, -0.05)))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    finder = MarkerFinder(dictionary, 54)
    whole = finder.find_small(image)
    layouts = board_layouts(12, 9, 0.75, dictionary, pattern.pattern().corners[:, :2] / pattern.size)
    (reading,) = readings(layouts, whole)
    box = reading.box(*image.shape)
    assert box is not None
    left, top, right, bottom = box
    assert (right - left) * (bottom - top) < 0.8 * image.size
    part = finder.find_small(image, box)
    np.testing.assert_array_equal(part.ids, whole.ids)
    np.testing.assert_allclose(part.corners, whole.corners, atol=1e-4)
    again = finder.find_small(image)  # of a whole image, after a part of one
    np.testing.assert_array_equal(again.corners, whole.corners)


def test_few_markers_are_no_detection() -> None:
    pattern = charuco()
    image = Photograph(VGA).of(pattern, facing(pattern, 1.2))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    found = MarkerFinder(dictionary, 54).find(image)
    layouts = board_layouts(12, 9, 0.75, dictionary, pattern.pattern().corners[:, :2] / pattern.size)
    (few,) = readings(layouts, Markers(found.ids[:5], found.corners[:5]))
    assert few.box(*image.shape) is None
