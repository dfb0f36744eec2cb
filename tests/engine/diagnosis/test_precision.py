"""A limit must hold with the error bar; what would narrow the bar is said."""

import numpy as np
import pytest

from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.limits import DEFAULT_LIMIT_SIGMAS, Limits, allowed, of_a_good_robot
from calibration.engine.diagnosis.precision import false_accept, precision, too_few, worst_false_accept
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.options import ALL_EXACT
from tests.engine.estimation import systems
from tests.engine.estimation.systems import eye_to_hand, stereo


def test_a_limit_below_the_guard_band_is_undecided_with_a_remedy() -> None:
    dataset = systems.stereo(20, seed=1, pixel_noise=0.3).dataset(1)
    exact, assumed = (calibrate(dataset, options) for options in (Options(assume=ALL_EXACT), Options()))
    edge = next(iter(exact.covariances))
    between = 1.5 * exact.sigma_mm(edge)
    [found] = precision(exact, Limits(translation_mm=between))
    assert (found.kind, found.severity) == ("precision", "undecided")
    assert "take about 40 collections like these 20" in found.text
    assert precision(exact, Limits(translation_mm=between, guard_band=1)) == ()
    assert precision(exact, Limits(translation_mm=3 * exact.sigma_mm(edge))) == ()
    [wider] = precision(assumed, Limits(translation_mm=3 * exact.sigma_mm(edge)))
    assert "times as well (calibrate it with more views" in wider.text
    assert precision(exact, Limits()) == ()


@pytest.mark.parametrize(("share", "severity"), [(1.1, "undecided"), (1.15, "red")])
def test_where_no_limit_is_set_it_is_red_if_it_is_rather_broken_than_not(
    monkeypatch: pytest.MonkeyPatch, share: float, severity: str
) -> None:
    calibration = calibrate(systems.stereo(8, pixel_noise=0.3).dataset())
    name = next(name for name in ("left", "right") if name != calibration.gauge)
    limit = allowed(calibration, Limits(), name)
    least = max(limit.translation_mm, DEFAULT_LIMIT_SIGMAS * of_a_good_robot(calibration, name)[0])
    monkeypatch.setattr("calibration.engine.diagnosis.precision.stated", lambda _: {name: (share * least, 0.0)})
    assert [each.severity for each in precision(calibration, Limits())] == [severity]


def test_the_limits_of_a_joint_hold_with_its_error_bar() -> None:
    calibration = calibrate(systems.jointed_arm(20, seed=1, pixel_noise=0.3).dataset(1), Options(assume=ALL_EXACT))
    sigma = float(np.degrees(calibration.joints["j3"].sigmas[0]))
    [red] = precision(calibration, Limits(joint_deg=1.5 * sigma, translation_mm=1e3))
    assert red.sensors == ("j3",)
    assert "'j3' is not determined well enough" in red.text
    assert precision(calibration, Limits(joint_deg=2.5 * sigma, joint_mm=1e-6)) == ()
    assert worst_false_accept(calibration, Limits(joint_deg=sigma)) == pytest.approx(false_accept(1, 1), abs=1e-6)


def test_the_probability_of_a_false_accept_matches_random_draws() -> None:
    draws = np.linalg.norm(np.random.default_rng(1).normal(size=(200_000, 3)), axis=1)
    for limit in (0.5, 1.0, 2.0, 3.5):
        assert false_accept(np.sqrt(3), limit) == pytest.approx(np.mean(draws > limit), abs=0.005)
    assert false_accept(0.0, 1.0) == 0.0
    assert false_accept(1e-9, 1.0) == 0.0


def arm(collections: int, error: float) -> Dataset:
    """An arm whose poses are off by so much, m and rad."""
    dataset = eye_to_hand(collections, pixel_noise=0.1).dataset()
    poses = dataset.transforms["base", "flange"].copy()
    poses[:, :3, 3] += np.random.default_rng(3).normal(0, error, (collections, 3))
    return dataset.with_transforms({("base", "flange"): poses})


@pytest.mark.parametrize("collections", [3, 5, 6])
def test_few_that_disagree_are_undecided(collections: int) -> None:
    [found] = too_few(calibrate(arm(collections, 0.005)))
    assert (found.kind, found.severity) == ("too-few", "undecided")
    assert found.text.startswith(f"{collections} collections are too few")


@pytest.mark.parametrize("dataset", [arm(4, 0.0), arm(10, 0.005), stereo(4, pixel_noise=0.1).dataset()])
def test_few_that_agree_and_enough_are_not(dataset: Dataset) -> None:
    assert not too_few(calibrate(dataset))
