"""From the given guess, as the software under test must: the optimum, or an honest no."""

from functools import cache

import numpy as np
import pytest

from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Loss
from calibration.engine.estimation.start.guesses import StartingNoise
from tests.engine.estimation.scenes import Scene
from tests.engine.estimation.systems import ALL, camera_and_lidar, eye_in_hand, stereo, two_bodies

GIVEN = Options(start="given")
NOISY = {"pixel_noise": 0.3, "range_noise": 0.01, "partial": 0.3}


@cache
def optimum(scene: str, loss: Loss) -> tuple[Dataset, Calibration]:
    """A scene's dataset, and its calibration from the linear start."""
    dataset = ALL[scene](**NOISY).dataset(1)
    return dataset, calibrate(dataset, Options(loss=loss))


@pytest.mark.thorough(but_first=12)
@pytest.mark.parametrize("scene", ALL)
@pytest.mark.parametrize("loss", ["linear", "huber"])
@pytest.mark.parametrize("size", [0.0, 0.03])
def test_a_near_guess_leads_to_the_optimum(scene, loss, size):
    dataset, best = optimum(scene, loss)
    result = calibrate(dataset, Options("given", loss), StartingNoise(size, size, 2))
    assert result.converged, result.reason
    assert result.reason == ""
    # where outliers begin depends on the way there, a little
    assert result.cost == pytest.approx(best.cost, rel=1e-6 if loss == "linear" else 1e-3)
    for edge, covariance in best.label_covariances.items():
        np.testing.assert_allclose(
            result.label_covariances[edge], covariance, rtol=0.02, atol=0.02 * np.abs(covariance).max()
        )


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("scene", ["stereo", "two bodies", "hand and world", "lidar behind", "ring"])
def test_a_bad_start_leads_to_the_optimum_or_a_reason(scene):
    dataset = ALL[scene](10, **NOISY).dataset(1)
    best = calibrate(dataset, Options(loss="linear"))
    for seed in range(6):
        result = calibrate(dataset, Options("given", "linear"), StartingNoise(1.0, 1.0, seed))
        if result.converged:
            assert result.cost == pytest.approx(best.cost, rel=1e-6)
            assert result.reason == ""
        else:
            assert len(result.reason) > 10
            assert "\n" not in result.reason
            assert result.label_covariances == {}
            assert result.weak_directions == ()
        for T in result.transforms.values():
            assert np.isfinite(T).all()
            np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
            assert np.linalg.det(T[:3, :3]) > 0


def first_with(reason: str, scene: Scene, size: float) -> Calibration:
    """Result from the first of some noisy guesses that ends for this reason."""
    dataset = scene.dataset()
    for seed in range(40):
        result = calibrate(dataset, GIVEN, StartingNoise(size, size, seed))
        if reason in result.reason:
            assert not result.converged
            return result
    raise AssertionError(f"no guess ended with '{reason}'")


def test_patterns_left_in_their_mirrored_pose_are_named():
    scene = stereo(20, anchored="left", **NOISY)
    result = first_with("mirrored", scene, 1.0)
    _, _, where = result.reason.partition("mirrored pose in ")
    keys = [key for key in result.dataset.keys if key in where]
    assert where == (f"collection {keys[0]}" if len(keys) == 1 else f"{len(keys)} collections ({', '.join(keys)})")
    assert set(keys) <= set(result.dataset.keys)
    # the named patterns are turned far from where they truly are
    normals, truth = result.dataset.transforms["world", "board_link"][:, :3, 2], scene.transforms["world", "board_link"]
    turned = np.arccos(np.clip((normals * truth[:, :3, 2]).sum(-1), -1, 1)) > 0.2
    assert {result.dataset.keys[i] for i in np.flatnonzero(turned)} >= set(keys)


def test_a_local_minimum_is_reported_with_both_costs():
    result = first_with("a false minimum", camera_and_lidar(behind=True, **NOISY), 1.0)
    cost, lower = (float(part.split()[0].rstrip(",")) for part in result.reason.split("cost ")[1].split("while "))
    assert cost == pytest.approx(result.cost, rel=1e-5)
    assert lower < 0.99 * cost


def test_a_pattern_behind_the_camera_is_no_start():
    result = first_with("behind a camera", two_bodies(8, **NOISY), 2.0)
    assert result.cost == np.inf
    assert result.iterations == 0


def test_the_noise_of_the_guess_does_not_reach_the_patterns():
    """As in ATOM: without noise on the sensors, patterns start where the first guess sees them."""
    dataset = eye_in_hand(**NOISY).dataset()
    result = calibrate(dataset, GIVEN)
    assert result.converged
    assert result.iterations < 25
