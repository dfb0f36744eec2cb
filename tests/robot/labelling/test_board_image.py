"""The map from a board to its image: exact where it should be, smooth where it is bent, wary of what does not fit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling.board_image import fits_neighbours, homography, predict, project
from tests.properties import at_most
from tests.robot.labelling.pictures import HD, HD_DISTORTED, charuco, facing

BOARD = charuco()
PLACES = BOARD.pattern().corners[:, :2] / BOARD.size

poses = st.builds(
    facing,
    st.just(BOARD),
    st.floats(1.1, 3.0),
    st.floats(0, 0.7),
    st.floats(-3, 3),
    st.floats(-3, 3),
    st.tuples(st.floats(-0.2, 0.2), st.floats(-0.15, 0.15)),
)


def seen(camera, T):
    return camera.project(apply(T, BOARD.pattern().corners))


@given(poses)
def test_without_distortion_the_homography_is_the_map(T) -> None:
    pixels = seen(HD, T)
    found, jacobians = project(homography(PLACES, pixels), PLACES)
    np.testing.assert_allclose(found, pixels, atol=1e-6)
    step = 1e-5 * np.array([0.6, -0.8])
    moved, _ = project(homography(PLACES, pixels), PLACES + step)
    np.testing.assert_allclose((moved - found) / 1e-5, jacobians @ [0.6, -0.8], atol=1e-2)


def test_four_points_are_enough_and_the_horizon_has_no_pixel() -> None:
    places = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    pixels = np.array([[10.0, 20], [110, 30], [90, 95], [15, 100]])
    H = homography(places, pixels)
    np.testing.assert_allclose(project(H, places)[0], pixels, atol=1e-9)
    found, _ = project(np.array([[1.0, 0, 0], [0, 1, 0], [1, 0, 0]]), np.zeros((1, 2)))
    assert np.isnan(found).all()


@at_most(30)
@given(poses, st.integers(0, 2**32 - 1))
def test_hidden_corners_are_predicted_through_the_distortion(T, seed) -> None:
    """From two thirds of the corners, to a fraction of a pixel, where a homography is pixels off."""
    pixels = seen(HD_DISTORTED, T)
    known = np.random.default_rng(seed).random(len(PLACES)) < 0.67
    predicted = predict(PLACES[known], pixels[known], PLACES[~known])
    near = (predicted.support > 3) & (predicted.spread < 1)
    np.testing.assert_allclose(predicted.pixels[near], pixels[~known][near], atol=0.5)


def test_the_jacobian_is_that_of_the_bent_map() -> None:
    T = facing(BOARD, 0.9, 0.5, 1.0, 0.3)
    predicted = predict(PLACES, seen(HD_DISTORTED, T), PLACES)
    step = 1e-4 * BOARD.size
    for axis in (0, 1):
        moved = BOARD.pattern().corners.copy()
        moved[:, axis] += step
        slope = (HD_DISTORTED.project(apply(T, moved)) - seen(HD_DISTORTED, T)) / 1e-4
        np.testing.assert_allclose(predicted.jacobians[:, :, axis], slope, rtol=0.02, atol=0.3)


@at_most(30)
@given(poses, st.integers(0, 2**32 - 1), st.floats(0.02, 0.3), st.sampled_from([HD, HD_DISTORTED]))
def test_wrong_corners_are_distinguished_from_noisy_ones(T, seed, noise, camera) -> None:
    random = np.random.default_rng(seed)
    pixels = seen(camera, T) + noise * random.normal(size=(len(PLACES), 2)) / np.sqrt(2)
    wrong = random.choice(len(PLACES), 5, replace=False)
    angle = random.uniform(0, 2 * np.pi, 5)
    pixels[wrong] += (3 + 20 * noise) * np.stack([np.cos(angle), np.sin(angle)], -1)
    fits = fits_neighbours(PLACES, pixels)
    assert not fits[wrong].any()
    assert fits.sum() >= len(PLACES) - 5 - 3


@pytest.mark.parametrize("count", [4, 5, 6, 9])
def test_few_corners_are_not_doubted(count) -> None:
    pixels = seen(HD, facing(BOARD, 1.0, 0.4))
    chosen = [0, 1, 11, 12, 2, 13, 22, 23, 24][:count]
    assert fits_neighbours(PLACES[chosen], pixels[chosen]).all()
