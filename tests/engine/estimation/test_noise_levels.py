"""Noise levels: the standard deviation of the labels from what is left, outliers or not."""

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels, Labels, PointLabels
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.least_squares.noise_levels import MIN_SIGMA_OF_KIND, NoiseLevels, estimate_scales
from calibration.engine.estimation.start.build import build
from tests.engine.estimation.scenes import relabelled, true_values
from tests.engine.estimation.systems import ALL, camera_and_lidar, stereo


def outliers(share: float, seed: int = 0):
    """Up to 60 px and 0.5 m off."""
    rng = np.random.default_rng(seed)

    def spoil(_: int, __: str, label: Labels) -> Labels:
        if isinstance(label, PointLabels):
            bad = rng.random(len(label.points)) < share
            return PointLabels(label.points * (1 + bad * rng.uniform(-0.25, 0.25, len(bad)))[:, None], label.limits)
        bad = rng.random(len(label.ids)) < share
        return CornerLabels(label.ids, label.pixels + bad[:, None] * rng.uniform(-60, 60, label.pixels.shape))

    return spoil


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("sigma", [0.02, 0.3, 3.0])
def test_gaussian_noise_at_the_truth_is_recovered(robust, sigma):
    """In two dimensions (px) and one (m); 12 000 and thousands of labels: 3 sigmas are 2 and 4 per cent."""
    setup = build(camera_and_lidar(100, pixel_noise=sigma, range_noise=0.02 * sigma, border=False).dataset())
    scales = estimate_scales(setup.problem, true_values(setup), {}, robust)
    assert scales["pixel"] == pytest.approx(sigma, rel=0.035)
    assert scales["range"] == pytest.approx(0.02 * sigma, rel=0.03)
    assert set(scales) == {"pixel", "range"}


def test_outliers_hardly_move_the_robust_estimate():
    dataset = camera_and_lidar(60, pixel_noise=0.3, range_noise=0.01, border=False).dataset()
    setup = build(relabelled(dataset, outliers(0.2)))
    robust, plain = (estimate_scales(setup.problem, true_values(setup), {}, r) for r in (True, False))
    assert 0.3 * 0.95 < robust["pixel"] < 0.3 * 1.3
    assert 0.01 * 0.95 < robust["range"] < 0.01 * 1.3
    assert plain["pixel"] > 10 * 0.3
    assert plain["range"] > 5 * 0.01


@pytest.mark.parametrize("robust", [False, True])
def test_parameters_are_paid_for(robust):
    """By as much as they take from the degrees of freedom."""
    setup = build(stereo(30, pixel_noise=0.3).dataset())
    labels = 30 * 2 * 30 * 2
    free, paid = (estimate_scales(setup.problem, true_values(setup), {"pixel": p}, robust)["pixel"] for p in (0, 900))
    assert paid / free == pytest.approx(np.sqrt(labels / (labels - 900)), rel=1e-6)


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_few_labels_are_no_reason_to_be_overconfident(loss):
    """Six corners a view: half of the 24 coordinates of a collection go into its pattern's pose."""
    rng = np.random.default_rng(1)
    few = [np.sort([0, 5, 24, 29, *(6 + rng.permutation(18)[:2])]) for _ in range(50)]

    def six(i: int, _: str, label: Labels) -> Labels:
        return CornerLabels(label.ids[few[i]], label.pixels[few[i]])

    sigmas = []
    for seed in range(4):
        dataset = relabelled(stereo(50, seed=seed, anchored="left", pixel_noise=0.3).dataset(seed), six)
        result = calibrate(dataset, Options(loss=loss))
        assert result.degrees_of_freedom == 50 * 24 - 50 * 6 - 6
        sigmas.append(result.noise_levels.pixel)
    assert np.sqrt(np.mean(np.square(sigmas))) == pytest.approx(0.3, rel=0.05 if loss == "linear" else 0.12)


@pytest.mark.parametrize("scene", ALL)
@pytest.mark.parametrize("robust", [False, True])
def test_exact_labels_have_the_least_noise_that_there_is(scene, robust):
    setup = build(ALL[scene](4, border=False).dataset())
    scales = estimate_scales(setup.problem, true_values(setup), {}, robust)
    assert scales == {kind: MIN_SIGMA_OF_KIND[kind] for kind in scales}


def test_given_levels_are_respected_and_the_others_estimated():
    dataset = camera_and_lidar(10, pixel_noise=0.3, range_noise=0.01).dataset()
    for loss in ("linear", "huber"):
        given = NoiseLevels(pixel=1.0, border=0.003)
        result = calibrate(dataset, Options(loss=loss, noise_levels=given))
        assert (result.noise_levels.pixel, result.noise_levels.border) == (1.0, 0.003)
        assert result.noise_levels.range == pytest.approx(0.01, rel=0.1)
    all_given = NoiseLevels(0.3, 0.01, 0.004)
    assert calibrate(dataset, Options(noise_levels=all_given)).noise_levels == all_given


def test_a_given_level_scales_the_covariance_and_the_cost():
    dataset = stereo(10, anchored="left", pixel_noise=0.3).dataset()
    one, two = (calibrate(dataset, Options("linear", "linear", NoiseLevels(pixel=s))) for s in (0.3, 0.6))
    edge = ("world", "right")
    np.testing.assert_allclose(4 * one.label_covariances[edge], two.label_covariances[edge], rtol=1e-6)
    assert one.cost == pytest.approx(4 * two.cost)
    assert one.cost == pytest.approx(one.degrees_of_freedom, rel=0.2)


def test_levels_of_kinds_that_are_not_there_do_not_matter():
    dataset = stereo(6, pixel_noise=0.3).dataset()
    result = calibrate(dataset, Options(noise_levels=NoiseLevels(range=0.5, border=0.5)))
    assert result.noise_levels.range is None
    assert result.noise_levels.border is None
    assert result.cost == calibrate(dataset).cost
