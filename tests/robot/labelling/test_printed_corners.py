"""Corners to a hundredth of a pixel, and patches that are what is printed."""

import cv2
import numpy as np
import pytest

from calibration.robot.labelling.board_image import PrintedPatches, _moments_of_windows, refine
from calibration.robot.labelling.detection import Image
from tests.robot.labelling.pictures import TEXELS, VGA, Photograph, chessboard, facing, printed, true_corners

BOARD = chessboard()
T = facing(BOARD, 1.0, 0.4, 0.7, 0.3)
TRUTH = true_corners(VGA, BOARD, T)
GRID = TRUTH.reshape(7, 10, 2)
JACOBIANS = np.stack([np.gradient(GRID, axis=1), np.gradient(GRID, axis=0)], -1).reshape(-1, 2, 2)


@pytest.fixture(scope="module")
def picture() -> Image:
    return Photograph(VGA, noise=0.0, supersampling=5).of(BOARD, T)


def test_from_anywhere_near_to_the_same_place(picture: Image) -> None:
    random = np.random.default_rng(0)
    first, found = refine(picture, TRUTH + random.uniform(-1, 1, TRUTH.shape), JACOBIANS, 0.2)
    assert found.all()
    assert np.sqrt(((first - TRUTH) ** 2).sum(-1).mean()) < 0.03
    second, _ = refine(picture, TRUTH + random.uniform(-1, 1, TRUTH.shape), JACOBIANS, 0.2)
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_it_is_opencvs_refinement_to_more_digits(picture: Image) -> None:
    half = 4
    flat = np.broadcast_to(np.eye(2) * 20.0, JACOBIANS.shape)
    ours, found = refine(picture, TRUTH, flat, (half + 0.1) / 20)
    assert found.all()
    start = TRUTH.astype(np.float32).reshape(-1, 1, 2)
    theirs = cv2.cornerSubPix(picture, start, (half, half), (-1, -1), (3, 100, 1e-6)).reshape(-1, 2)
    np.testing.assert_allclose(ours, theirs, atol=1e-3)


def test_a_shifted_image_shifts_the_corners(picture: Image) -> None:
    shifted = np.roll(picture, (3, 5), axis=(0, 1))
    a, _ = refine(picture, TRUTH, JACOBIANS, 0.2)
    b, _ = refine(shifted, TRUTH + np.array([5, 3]), JACOBIANS, 0.2)
    np.testing.assert_allclose(b - a, np.broadcast_to([5.0, 3.0], a.shape), atol=1e-6)


@pytest.mark.parametrize("image", [np.zeros((480, 640), np.uint8), np.tile(np.arange(640) % 256, (480, 1))])
def test_where_there_is_no_corner_none_is_found(image) -> None:
    _, found = refine(image.astype(np.uint8), TRUTH, JACOBIANS, 0.2)
    assert not found.any()


def test_beyond_the_image_and_nowhere(picture: Image) -> None:
    off = np.array([[-50.0, 10.0], [0.0, 0.0], [639.0, 479.0], [1e9, 0.0], [np.nan, 1.0], [300.0, np.inf]])
    _, found = refine(picture, off, np.broadcast_to(np.eye(2) * 30.0, (6, 2, 2)), 0.2)
    assert not found.any()
    _, found = refine(picture, TRUTH[:1], np.full((1, 2, 2), np.nan), 0.2)
    assert not found.any()
    assert refine(picture, np.zeros((0, 2)), np.zeros((0, 2, 2)), 0.2)[0].shape == (0, 2)


def test_patches_are_recognised_in_any_light_and_only_where_they_are(picture: Image) -> None:
    half = TEXELS // 2
    patches = PrintedPatches(printed(BOARD)[half:-half, half:-half], TEXELS, BOARD.pattern().corners[:, :2] / 0.06 + 1)
    for image in (picture, (picture * 0.3 + 20).astype(np.uint8)):
        assert patches.likeness(image, TRUTH, JACOBIANS).min() > 0.9
    assert patches.likeness(255 - picture, TRUTH, JACOBIANS).max() < -0.9
    assert patches.likeness(picture, TRUTH + JACOBIANS @ [0.5, 0.5], JACOBIANS).max() < 0.5
    assert (patches.likeness(np.full_like(picture, 90), TRUTH, JACOBIANS) == 0).all()
    assert np.isfinite(patches.likeness(picture, TRUTH - 1000, JACOBIANS)).all()


@pytest.mark.parametrize("half", [2, 5])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.3, 0.8), (0.999, 0.001)])
def test_the_moments_are_sums_over_the_window(picture: Image, half: int, place: tuple[float, float]) -> None:
    """Against the image itself, interpolated between pixels and then differentiated."""
    corner = np.floor(TRUTH[33]).astype(int)
    ticks = np.arange(-half - 1, half + 2)
    x, y = np.meshgrid(corner[0] + place[0] + ticks, corner[1] + place[1] + ticks)
    columns, rows = np.floor(x).astype(int), np.floor(y).astype(int)
    at = picture.astype(float)
    above, below = (
        at[rows + i, columns] * (1 - x + columns) + at[rows + i, columns + 1] * (x - columns) for i in (0, 1)
    )
    smooth = above * (1 - y + rows) + below * (y - rows)
    gx, gy = smooth[1:-1, 2:] - smooth[1:-1, :-2], smooth[2:, 1:-1] - smooth[:-2, 1:-1]
    tx, ty = np.meshgrid(ticks[1:-1], ticks[1:-1])
    w = np.exp(-(tx**2 + ty**2) / half**2)
    past = gx * tx + gy * ty
    expected = [(w * each).sum() for each in (gx * gx, gx * gy, gy * gy, gx * past, gy * past)]
    a, b = place
    share = np.array([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
    (forms,) = _moments_of_windows(picture, corner[None], half)
    np.testing.assert_allclose(share @ forms @ share, expected, rtol=1e-9, atol=1e-6)
