"""Calibrations of a prepared dataset from many initial guesses: the same, to the last bit, as one by one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calibration.base import UndeterminedError
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate, prepare, solve, solve_from_guess
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.least_squares.minimisation import WeightedOptimum, optimise
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.estimation.start.wrong_views import without
from calibration.engine.geometry.frames import JOINT_PARAMETERS
from calibration.engine.geometry.transforms import transform
from tests.engine.estimation.scenes import AHEAD, Scene, board, lidar2d, relabelled
from tests.engine.estimation.systems import camera_and_lidar, eye_in_hand, jointed_arm, stereo
from tests.engine.estimation.test_wrong_views import exchanged
from tests.pipeline.conftest import DATASETS

NOISES = [StartingNoise(0.02, 0.02, seed) for seed in (1, 2, 3)]
ANYWHERE = StartingNoise(0.5, 0.5, 7)


def scene(name: str) -> Dataset:
    if name == "LiDAR":
        return camera_and_lidar(8, pixel_noise=0.3, range_noise=0.005).dataset()
    if name == "exchanged views":
        return exchanged(read_dataset(DATASETS / "riwbot"), "rgb_world", (3, 8, 11))
    if name.startswith("guessed"):
        dataset = hand_with_a_guessed_lidar().dataset()
        return exchanged(dataset, "cam", (2, 6)) if name.endswith("exchanged") else dataset
    return stereo(8, pixel_noise=0.3).dataset()


def hand_with_a_guessed_lidar() -> Scene:
    """A camera and a 2D LiDAR in an arm's hand; its planes are too few to start from, so it starts from its guess."""
    scene = eye_in_hand(14, pixel_noise=0.3, range_noise=0.005)
    beside = scene.transforms["flange", "mount"] @ scene.transforms["mount", "cam"] @ transform(AHEAD, (0.05, 0.0, 0.0))
    return replace(
        scene,
        sensors=[*scene.sensors, lidar2d("scan", "flange")],
        patterns=[board(fixed=True, square=0.2)],
        transforms={**scene.transforms, ("flange", "scan"): beside},
        sees=lambda sensor, _, i: sensor == "cam" or i in (1, 3, 5, 7),
    )


def assert_equal(one: Calibration, other: Calibration) -> None:
    for name in ("converged", "reason", "cost", "iterations", "noise_levels", "rejected", "notes", "dropped_views"):
        assert getattr(one, name) == getattr(other, name)
    for edge, T in other.transforms.items():
        np.testing.assert_array_equal(one.transforms[edge], T)
    for edge, covariance in other.covariances.items():
        np.testing.assert_array_equal(one.covariances[edge], covariance)


@pytest.mark.thorough(but_first=4)
@pytest.mark.parametrize("name", ["cameras", "LiDAR", "exchanged views", "guessed", "guessed, exchanged"])
@pytest.mark.parametrize("start", ["linear", "given"])
def test_calibrations_of_one_prepared_dataset_are_those_of_calibrate(name: str, start: str) -> None:
    dataset, options = scene(name), Options(start=start)  # type: ignore[arg-type]
    prepared = prepare(dataset, options)
    for noise in (NOISES[0], ANYWHERE):
        assert_equal(solve(prepared, noise), calibrate(dataset, options, noise))


@pytest.mark.parametrize("system", ["t2rgb", "rlbot", "softbot", "riwbot", "spjbot"])
def test_a_guess_ends_at_the_calibration_of_the_linear_start_to_the_last_bit(system: str) -> None:
    dataset = read_dataset(DATASETS / system)
    linear, given = prepare(dataset, Options()), prepare(dataset, Options(start="given"))
    assert solve(linear, ANYWHERE) is solve(linear, StartingNoise()) is linear.optimum
    for noise in NOISES:
        found = solve(given, noise)
        assert found.converged
        assert_equal(replace(found, iterations=linear.optimum.iterations), linear.optimum)


def test_a_guess_that_ends_elsewhere_has_the_calibration_there() -> None:
    dataset = scene("cameras")
    given = prepare(dataset, Options(start="given"))
    linear = given.optimum
    found = [solve(given, StartingNoise(3.0, 2.5, seed)) for seed in range(1, 6)]
    elsewhere = [each for each in found if not each.converged]
    assert elsewhere
    for each in elsewhere:
        assert each.reason
        assert each.cost != linear.cost
        assert each.error_bars is None


def test_nothing_to_calibrate_is_refused() -> None:
    with pytest.raises(UndeterminedError, match="nothing to calibrate"):
        prepare(stereo(6).dataset(), Options(hold=("world-left", "world-right")))


@pytest.mark.parametrize("name", ["guessed", "guessed, exchanged"])
def test_where_the_start_depends_on_the_guess_so_do_the_iterations(name: str) -> None:
    prepared = prepare(scene(name), Options())
    assert prepared.start.depends_on_guess
    found = [solve(prepared, noise) for noise in (*NOISES, ANYWHERE)]
    assert len({each.iterations for each in found}) > 1
    assert {each.dropped_views for each in found} == {prepared.optimum.dropped_views}
    assert solve(prepared, StartingNoise(seed=5)) is prepared.optimum


@pytest.mark.parametrize("noise", NOISES)
def test_a_guess_with_views_left_out_is_that_of_the_dataset_without_them(noise: StartingNoise) -> None:
    dataset, options = scene("exchanged views"), Options(start="given")
    found = calibrate(dataset, options, noise)
    assert len(found.dropped_views) == 3
    rest = calibrate(without(dataset, found.dropped_views), options, noise)
    assert_equal(replace(found, dropped_views=()), rest)


def test_each_guess_has_its_own_number_of_iterations() -> None:
    prepared = prepare(scene("LiDAR"), Options(start="given"))
    near, far = (solve(prepared, StartingNoise(size, size, 1)) for size in (0.0, 0.1))
    assert near.solution is far.solution
    assert near.iterations < far.iterations


def test_a_guess_that_ends_elsewhere_has_the_notes_and_the_dropped_views_too() -> None:
    def few(i: int, sensor: str, label: Labels) -> Labels:
        if not isinstance(label, CornerLabels) or (i, sensor) != (1, "left"):
            return label
        return CornerLabels(label.ids[:3], label.pixels[:3])

    dataset = relabelled(exchanged(stereo(10, pixel_noise=0.1).dataset(), "left", (3, 8)), few)
    given = prepare(dataset, Options(start="given"))
    linear = given.optimum
    assert linear.dropped_views
    assert linear.notes
    found = [solve(given, StartingNoise(3.0, 2.5, seed)) for seed in range(1, 6)]
    elsewhere = [each for each in found if not each.converged]
    assert elsewhere
    for each in elsewhere:
        assert (each.notes, each.dropped_views) == (linear.notes, linear.dropped_views)


def test_an_optimum_of_the_same_cost_with_other_values_is_its_own() -> None:
    """An encoder's offset of a whole turn more has no effect on any label."""
    dataset = jointed_arm(free={"j4": ("position_bias",)}, pixel_noise=0.3).dataset()
    prepared = prepare(dataset, Options(start="given"))
    linear = prepared.optimum
    guess = list(linear.solution.values)
    block = linear.solution.setup.block(dataset.joints["j4"].edge)
    guess[block] = guess[block] + 2 * np.pi * np.isin(JOINT_PARAMETERS, ["position_bias"])
    found = solve_from_guess(prepared, tuple(guess))
    assert found.converged
    assert found.cost == pytest.approx(linear.cost, rel=1e-6)
    assert found.joints["j4"].values - linear.joints["j4"].values == pytest.approx(2 * np.pi)


def test_where_no_minimum_was_reached_it_is_said_even_beside_the_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*arguments: Any) -> WeightedOptimum:
        result = optimise(*arguments)
        return replace(result, optimum=replace(result.optimum, reached=False))

    prepared = prepare(scene("cameras"), Options(start="given"))
    monkeypatch.setattr("calibration.engine.estimation.calibrate.optimise", interrupted)
    found = solve_from_guess(prepared, prepared.optimum.solution.values)
    assert not found.converged
    assert found.reason == f"no minimum was reached in {found.iterations} iterations"
