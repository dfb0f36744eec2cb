"""Levenberg-Marquardt: exact labels give the truth, the cost never rises, nothing that is not finite is an optimum."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.estimation.least_squares import minimisation
from calibration.engine.estimation.least_squares.minimisation import Termination, choose, minimise, settle
from calibration.engine.estimation.least_squares.normal_equations import NormalEquations, Weighting, assemble
from calibration.engine.estimation.problem.problem import Values
from calibration.engine.estimation.start.build import build
from calibration.engine.geometry.transforms import retract
from tests.engine.estimation.scenes import looks, pose, shaken, true_values
from tests.engine.estimation.systems import ALL, STEREO, camera_and_lidar, ring, stereo

PLAIN = Weighting({"pixel": 0.3, "range": 0.01, "border": 0.01, "lidar2d_range": 0.01}, None)
ROBUST = Weighting(PLAIN.scales, 2.5)


def apart(a: Values, b: Values) -> float:
    """The largest difference, observed or not."""
    return max(float(np.abs(x - y).max()) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("scene", ALL)
@pytest.mark.parametrize("weighting", [PLAIN, ROBUST], ids=["plain", "robust"])
def test_exact_labels_give_the_truth_from_a_start_nearby(scene, weighting):
    setup = build(ALL[scene](border=False).dataset())
    truth = true_values(setup)
    seen = assemble(setup.problem, truth, weighting)
    assert seen.cost.sum() == pytest.approx(0, abs=1e-15)
    result = minimise(setup.problem, shaken(setup, truth, 0.03), weighting)
    assert result.reached
    # the last step may leave a cost of 1e-8: a part in 10^4 of the noise; then the truth is what is left to find
    result = minimise(setup.problem, result.values, weighting, Termination(decrease=0, iterations=10))
    for block, value, true in zip(setup.problem.blocks, result.values, truth, strict=True):
        observed = np.isin(np.arange(setup.problem.collections), observations(setup, block.name))
        error = (value - true)[observed] if block.per_collection else value - true
        assert np.abs(error).max() < 1e-9, block.name


def observations(setup, pattern: str) -> np.ndarray:
    return np.concatenate([[-1], *(g.collections for g in setup.problem.groups if g.pattern == pattern)])


def test_the_optimum_is_a_minimum_and_its_equations_are_those_there():
    setup = build(camera_and_lidar(8, pixel_noise=0.3, range_noise=0.01).dataset(1))
    result = minimise(setup.problem, shaken(setup, true_values(setup), 0.02), ROBUST)
    assert result.reached
    again = assemble(setup.problem, result.values, ROBUST)
    np.testing.assert_allclose(result.equations.cost, again.cost, atol=1e-2)
    np.testing.assert_allclose(result.equations.H_shared, again.H_shared, rtol=1e-3)
    assert again.cost.sum() <= result.cost <= again.cost.sum() + 1e-6
    *_, predicted = again.step(0.0)
    assert predicted < 1e-7
    sigma = 1 / np.sqrt(np.diagonal(result.equations.schur))
    for k, axis in enumerate(np.eye(6)):
        for sign in (1, -1):
            step = 0.1 * sign * sigma[k] * axis
            moved = setup.problem.moved(result.values, step, np.zeros((8, 6)))
            assert assemble(setup.problem, moved, ROBUST).cost.sum() > result.cost


@pytest.mark.parametrize("scene", [stereo, camera_and_lidar])
@pytest.mark.parametrize("weighting", [PLAIN, ROBUST], ids=["plain", "robust"])
def test_the_cost_never_rises(scene, weighting):
    setup = build(scene(pixel_noise=0.3, range_noise=0.01, border=False).dataset(2))
    start = shaken(setup, true_values(setup), 0.2, seed=3)
    at_start = assemble(setup.problem, start, weighting).cost.sum()
    stops = [Termination(iterations=n) for n in range(1, 25)]
    costs = [at_start, *(minimise(setup.problem, start, weighting, stop).cost for stop in stops)]
    assert np.isfinite(costs).all()
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] < 0.01 * costs[0]


def test_running_out_of_iterations_is_not_an_optimum():
    setup = build(stereo(pixel_noise=0.3).dataset())
    result = minimise(setup.problem, shaken(setup, true_values(setup), 0.1), PLAIN, Termination(iterations=2))
    assert not result.reached
    assert result.iterations == 2


@pytest.mark.parametrize("bad", [np.nan, -1.0], ids=["not a number", "behind the camera"])
def test_a_start_without_a_finite_cost_is_no_optimum(bad):
    setup = build(stereo(8).dataset())
    values = list(true_values(setup))
    pattern = setup.block(setup.pattern_edge("board"))
    camera = setup.dataset.transforms["world", "left"][0]
    values[pattern] = values[pattern].copy()
    values[pattern][3] = camera @ np.diag([1, 1, 1, 1.0])
    values[pattern][3, :3, 3] += bad * camera[:3, 2]
    result = minimise(setup.problem, tuple(values), PLAIN)
    assert not result.reached
    assert not np.isfinite(result.cost)
    assert result.iterations == 0


class Indefinite(NormalEquations):
    """A nearly singular system with rounding errors: steps that increase the cost, until they are damped."""

    def step(self, damping: float) -> tuple[Array, Array, float]:
        shared, local, predicted = super().step(damping)
        return (shared, local, predicted) if damping > 1e-2 else (-shared, -local, -predicted)


def test_a_system_that_rounding_has_made_indefinite_is_damped_and_no_minimum(monkeypatch):
    def indefinite(*arguments) -> NormalEquations:
        return Indefinite(**vars(assemble(*arguments)))

    setup = build(stereo(pixel_noise=0.3).dataset())
    start = shaken(setup, true_values(setup), 0.05)
    best = minimise(setup.problem, start, PLAIN)
    monkeypatch.setattr(minimisation, "assemble", indefinite)
    costs = [minimise(setup.problem, start, PLAIN, Termination(iterations=n)).cost for n in range(1, 60, 3)]
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] == pytest.approx(best.cost, rel=0.01)


def test_from_the_optimum_it_goes_nowhere():
    setup = build(stereo(pixel_noise=0.3).dataset())
    first = minimise(setup.problem, true_values(setup), PLAIN)
    second = minimise(setup.problem, first.values, PLAIN)
    assert second.reached
    assert second.iterations <= 2
    assert apart(first.values, second.values) < 1e-7


@pytest.mark.parametrize("scene", [stereo, ring])
def test_the_optimum_does_not_depend_on_the_start(scene):
    setup = build(scene(pixel_noise=0.3).dataset(5))
    truth = true_values(setup)
    first, second = (minimise(setup.problem, shaken(setup, truth, 0.05, seed), PLAIN) for seed in (1, 2))
    assert first.cost == pytest.approx(second.cost, abs=1e-6)
    assert apart(first.values, second.values) < 1e-5


def test_settling_finds_each_collections_own_minimum_and_leaves_the_rest():
    setup = build(stereo(8, pixel_noise=0.3).dataset())
    best = minimise(setup.problem, true_values(setup), PLAIN)
    pattern = setup.block(setup.pattern_edge("board"))
    which = np.arange(8) % 2 == 0
    moved = retract(best.values[pattern], np.random.default_rng(0).uniform(-0.05, 0.05, (8, 6)))
    start = tuple(moved if i == pattern else v for i, v in enumerate(best.values))
    before = assemble(setup.problem, start, PLAIN).cost
    settled, cost = settle(setup.problem, start, PLAIN, which)
    np.testing.assert_allclose(cost[which], best.equations.cost[which], atol=0.02)
    np.testing.assert_array_equal(cost[~which], before[~which])
    np.testing.assert_array_equal(settled[pattern][~which], moved[~which])
    for i, value in enumerate(best.values):
        if i != pattern:
            np.testing.assert_array_equal(settled[i], value)


def test_settling_below_a_cost_gives_up_only_what_would_stay_above_it():
    setup = build(stereo(8, 2, pixel_noise=0.3).dataset(2))
    best = minimise(setup.problem, true_values(setup), PLAIN)
    pattern = setup.block(setup.pattern_edge("board"))
    moved = retract(best.values[pattern], np.random.default_rng(0).uniform(-0.3, 0.3, (8, 6)))
    start = tuple(moved if i == pattern else v for i, v in enumerate(best.values))
    which = np.ones(8, bool)
    _, minimum = settle(setup.problem, start, PLAIN, which)
    reachable = np.arange(8) % 2 == 0
    below = np.where(reachable, minimum + 1, minimum - 1000)
    _, cost = settle(setup.problem, start, PLAIN, which, below=below)
    given_up = cost > minimum
    assert given_up.any()
    assert not given_up[reachable].any()


def test_choosing_takes_local_blocks_collection_by_collection_and_shared_ones_from_the_first():
    setup = build(stereo(4).dataset())
    a = true_values(setup)
    b = shaken(setup, a, 0.1)
    first = np.array([True, False, False, True])
    chosen = choose(setup.problem, first, a, b)
    pattern = setup.block(setup.pattern_edge("board"))
    np.testing.assert_array_equal(chosen[pattern][first], a[pattern][first])
    np.testing.assert_array_equal(chosen[pattern][~first], b[pattern][~first])
    assert all(chosen[i] is a[i] for i in range(len(a)) if i != pattern)


@pytest.mark.parametrize("weighting", [PLAIN, ROBUST], ids=["plain", "robust"])
def test_far_boards_that_face_the_cameras_do_not_keep_it_from_the_minimum(weighting):
    scene = stereo(40, 6, pixel_noise=0.5, partial=0.3)
    far = STEREO["world", "left"] @ pose(0.0, 0.0, 4.0) @ looks(40, 6)
    setup = build(replace(scene, transforms={**STEREO, ("world", "board_link"): far}).dataset(6))
    result = minimise(setup.problem, true_values(setup), weighting)
    assert result.reached
    assert result.iterations < 200


def test_a_step_damped_to_nothing_is_no_minimum(monkeypatch):
    """Every trial is made worse, so the steps shrink until they promise nothing; the start is no minimum for that."""
    setup = build(stereo(8, pixel_noise=0.3).dataset(1))
    start = shaken(setup, true_values(setup), 0.05)
    calls = []

    def worse_and_worse(*arguments):
        calls.append(arguments)
        equations = assemble(*arguments)
        return replace(equations, cost=equations.cost + 1e9 * len(calls))

    monkeypatch.setattr(minimisation, "assemble", worse_and_worse)
    assert not minimise(setup.problem, start, PLAIN).reached
