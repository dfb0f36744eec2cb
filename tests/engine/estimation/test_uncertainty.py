"""The stated covariance is that of the errors, over many scenes with noise drawn anew."""

from collections.abc import Callable

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Edge
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.calibrated import covariances_of_transforms
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry.transforms import inverse, local, retract, translation
from tests.engine.estimation.scenes import Scene
from tests.engine.estimation.systems import camera_and_lidar, eye_in_hand, hand_and_world, stereo, two_bodies

SCENES = 30
CASES: dict[str, tuple[Callable[..., Scene], dict[str, object], Edge]] = {
    "rig": (stereo, {}, ("world", "right")),
    "arm": (eye_in_hand, {}, ("flange", "mount")),
    "base of an arm": (hand_and_world, {}, ("world", "base")),
    "two bodies": (two_bodies, {}, ("body_b", "b")),
    "camera and LiDAR": (camera_and_lidar, {"border": False}, ("world", "lidar")),
    "camera and LiDAR, border": (camera_and_lidar, {}, ("world", "lidar")),
}


def error(result: Calibration, truth: dict[Edge, Array], edge: Edge) -> Array:
    """The twist from the result to the truth, in the child frame, relative to the fixed sensor."""
    back = np.eye(4)
    if result.gauge:
        held = result.dataset.sensors[result.gauge].edge
        back = truth[held] @ inverse(result.transforms[held])
    return local(back @ result.transforms[edge], truth[edge])


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("case", CASES)
@pytest.mark.many_scenes
def test_the_errors_are_as_large_as_stated(case):
    make, changes, edge = CASES[case]
    options = Options(loss="huber" if case in ("rig", "two bodies") else "linear")
    nees, normalised = [], []
    for seed in range(SCENES):
        scene = make(8, seed=seed, pixel_noise=0.3, range_noise=0.008, partial=0.3, **changes)
        result = calibrate(scene.dataset(seed), options)
        assert result.converged, seed
        covariance = result.label_covariances[edge]
        e = error(result, {k: T if T.ndim == 2 else T[0] for k, T in scene.transforms.items()}, edge)
        nees.append(e @ np.linalg.solve(covariance, e))
        normalised.append(e / np.sqrt(np.diagonal(covariance)))
    # 6 degrees of freedom: the mean of the normalised squares has a standard deviation of sqrt(12 / scenes)
    assert abs(np.mean(nees) - 6) < 3 * np.sqrt(12 / SCENES)
    z = np.array(normalised)
    assert np.abs(z.mean(0)).max() < 4 / np.sqrt(SCENES)  # no bias
    assert np.abs((z**2).mean(0) - 1).max() < 4 * np.sqrt(2 / SCENES)


def test_sigmas_in_words_are_the_roots_of_the_traces():
    result = calibrate(stereo(8, pixel_noise=0.3).dataset())
    edge = ("world", "right")
    assert list(result.label_covariances) == [edge]
    assert result.label_sigma_mm(edge) == pytest.approx(1e3 * np.sqrt(np.trace(result.label_covariances[edge][:3, :3])))
    assert result.label_sigma_mrad(edge) == pytest.approx(
        1e3 * np.sqrt(np.trace(result.label_covariances[edge][3:, 3:]))
    )


def test_four_times_the_collections_give_half_the_standard_deviation():
    few, many = (calibrate(stereo(n, pixel_noise=0.3).dataset(3)) for n in (30, 120))
    edge = ("world", "right")
    assert few.label_sigma_mm(edge) / many.label_sigma_mm(edge) == pytest.approx(2, rel=0.15)
    assert few.label_sigma_mrad(edge) / many.label_sigma_mrad(edge) == pytest.approx(2, rel=0.15)


def test_the_covariance_of_a_pattern_is_about_its_own_frame():
    """The engine has it about the centre of the corners: by differences, what that is for the pattern's frame."""
    dataset, edge = eye_in_hand().dataset(), ("world", "board_link")
    setup = build(dataset)
    A = np.random.default_rng(0).normal(size=(6, 6))
    T, centre = dataset.transforms[edge][0], translation(dataset.patterns["board"].centre)
    moved = [local(T, retract(T @ centre, 1e-6 * axis) @ inverse(centre)) / 1e-6 for axis in np.eye(6)]
    J = np.stack(moved, -1)

    found = covariances_of_transforms(setup, {setup.block(edge): A @ A.T})

    np.testing.assert_allclose(found[edge], J @ A @ A.T @ J.T, rtol=1e-4, atol=1e-4)
    assert np.abs(J - np.eye(6)).max() > 0.1
