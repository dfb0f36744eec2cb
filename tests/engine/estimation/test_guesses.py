"""The matrix's noise on the dataset's guess, and the cost of given transforms."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.arrays import Array
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.problem.problem import Values
from calibration.engine.estimation.start.build import Setup, build
from calibration.engine.estimation.start.guesses import StartingNoise, cost_of, perturb, with_starting_noise
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import distance, retract, translation
from tests.engine.estimation import systems
from tests.engine.estimation.scenes import Scene, true_values
from tests.engine.estimation.systems import camera_and_lidar, hand_and_world, stereo, two_patterns

SETUP = build(hand_and_world(4).dataset())
TRUTH = true_values(SETUP)
SIGNS = np.array(list(itertools.product([-1.0, 1.0], repeat=3)))


def changed(setup: Setup, before: Values, after: Values) -> set[tuple[str, str]]:
    return {
        block.edge for block, a, b in zip(setup.problem.blocks, before, after, strict=True) if not np.array_equal(a, b)
    }


def turned(before: Array, after: Array, angle: float) -> bool:
    """Whether each Euler angle has moved by exactly plus or minus this."""
    possible = rotations.from_rpy(rotations.to_rpy(before[:3, :3]) + angle * SIGNS)
    return bool((np.abs(possible - after[:3, :3]).max((1, 2)) < 1e-12).any())


@given(t=st.floats(0, 5), r=st.floats(0, 3), seed=st.integers(0, 2**32 - 1))
def test_translations_move_by_exactly_t_and_euler_angles_by_exactly_r(t, r, seed):
    after = perturb(SETUP, TRUTH, StartingNoise(t, r, seed))
    for edge in (("world", "base"), ("flange", "mount")):
        block = SETUP.block(edge)
        assert np.linalg.norm(after[block][:3, 3] - TRUTH[block][:3, 3]) == pytest.approx(t, abs=1e-12)
        assert turned(TRUTH[block], after[block], r)


@pytest.mark.parametrize(
    ("scene", "edges"),
    [
        (hand_and_world, {("world", "base"), ("flange", "mount")}),  # not the anchored static camera, not the pattern
        (camera_and_lidar, {("world", "lidar")}),
        (stereo, {("world", "right")}),  # none is anchored: the one that is held as the origin stays
        (two_patterns, {("world", "right")}),
    ],
)
def test_only_sensors_and_additional_transforms_move(scene, edges):
    setup = build(scene(4).dataset())
    values = true_values(setup)
    before = [value.copy() for value in values]
    assert changed(setup, values, perturb(setup, values, StartingNoise(0.1, 0.1))) == edges
    for value, old in zip(values, before, strict=True):
        np.testing.assert_array_equal(value, old)


def test_no_noise_moves_nothing():
    for T, moved in zip(TRUTH, perturb(SETUP, TRUTH, StartingNoise()), strict=True):
        np.testing.assert_allclose(moved, T, atol=1e-15)


def test_additional_transforms_are_drawn_first():
    """Without the additional transform the sensor gets its draw."""
    without = build(replace(hand_and_world(4), additional=()).dataset())
    noise = StartingNoise(0.5, 0.5, seed=3)
    first = perturb(without, true_values(without), noise)[without.block(("flange", "mount"))]
    both = perturb(SETUP, TRUTH, noise)
    base, mount = SETUP.block(("world", "base")), SETUP.block(("flange", "mount"))
    shift = both[base][:3, 3] - TRUTH[base][:3, 3]
    np.testing.assert_allclose(shift, first[:3, 3] - TRUTH[mount][:3, 3])
    assert np.abs(both[mount] - first).max() > 0.01


def test_the_same_seed_gives_the_same_draw_for_every_size():
    small, large = (perturb(SETUP, TRUTH, StartingNoise(size, size, seed=7)) for size in (0.1, 0.5))
    again = perturb(SETUP, TRUTH, StartingNoise(0.1, 0.1, seed=7))
    other = perturb(SETUP, TRUTH, StartingNoise(0.1, 0.1, seed=8))
    for T, a, b, c in zip(TRUTH, small, large, again, strict=True):
        np.testing.assert_array_equal(a, c)
        np.testing.assert_allclose(5 * (a - T)[:3, 3], (b - T)[:3, 3], atol=1e-12)
    assert changed(SETUP, small, other)


def test_over_many_seeds_directions_fill_the_cube_and_signs_are_fair():
    mount = SETUP.block(("flange", "mount"))
    T = TRUTH[mount]
    moved = np.stack([perturb(SETUP, TRUTH, StartingNoise(1.0, 0.1, seed))[mount] for seed in range(1500)])
    direction = moved[:, :3, 3] - T[:3, 3]
    assert np.abs(direction.mean(0)).max() < 0.06  # 4 sigmas of the mean of a coordinate of variance 1/3
    np.testing.assert_allclose((direction**2).mean(0), 1 / 3, atol=0.03)
    # drawn in the cube, a direction's fourth moment is below the sphere's 1/5 (its corners reach farther)
    assert 0.165 < (direction**4).mean() < 0.19
    signs = np.sign(rotations.to_rpy(moved[:, :3, :3]) - rotations.to_rpy(T[:3, :3]))
    counts = [(signs == s).all(1).sum() for s in SIGNS]
    assert sum(counts) == 1500
    assert min(counts) > 1500 / 8 - 4.5 * 13
    assert max(counts) < 1500 / 8 + 4.5 * 13
    angle = distance(T, moved)[1]
    assert (angle > 0.09).all()


def test_a_dataset_gets_the_guess_that_the_engine_starts_from():
    dataset = hand_and_world(4).dataset()
    noise = StartingNoise(0.3, 0.1, 7)
    noisy = with_starting_noise(dataset, noise)
    setup = build(dataset)
    for edge in (("world", "base"), ("flange", "mount")):
        values = tuple(dataset.transform(*block.edge)[0] for block in setup.problem.blocks)
        guess = perturb(setup, values, noise)[setup.block(edge)]
        np.testing.assert_array_equal(noisy.transforms[edge], np.broadcast_to(guess, noisy.transforms[edge].shape))
        assert np.linalg.norm(guess[:3, 3] - dataset.transform(*edge)[0, :3, 3]) == pytest.approx(0.3)
    same = set(dataset.transforms) - {("world", "base"), ("flange", "mount")}
    assert all(noisy.transforms[edge] is dataset.transforms[edge] for edge in same)
    assert with_starting_noise(dataset, StartingNoise()).transforms == dataset.transforms


EVERY = [
    systems.stereo,
    systems.ring,
    systems.eye_to_hand,
    systems.eye_in_hand,
    systems.camera_and_lidar,
    systems.linked_by_an_arm,
    systems.hand_and_world,
    systems.two_patterns,
    systems.mobile_base,
    systems.jointed_arm,
]


@pytest.mark.parametrize("system", EVERY, ids=lambda system: system.__name__)
def test_at_the_optimum_it_is_the_optimum_s(system: Callable[..., Scene]) -> None:
    found = calibrate(system(seed=1, pixel_noise=0.3).dataset())
    assert cost_of(found.dataset, Options(), found.noise_levels) == pytest.approx(found.cost, rel=1e-6)


def test_beside_it_it_grows_with_the_information() -> None:
    """A step d costs d^T C^-1 d more, with C the covariance of the only transform that is free."""
    options = Options(loss="linear")
    found = calibrate(systems.eye_to_hand(seed=1, pixel_noise=0.3).dataset(), options)
    edge = found.dataset.sensors["cam"].edge
    rng = np.random.default_rng(1)
    for _ in range(3):
        step = np.linalg.cholesky(found.label_covariances[edge]) @ rng.normal(size=6)
        moved = found.dataset.with_transforms({edge: retract(found.transforms[edge], step)})
        expected = step @ np.linalg.inv(found.label_covariances[edge]) @ step
        excess = cost_of(moved, options, found.noise_levels) - found.cost
        assert excess == pytest.approx(expected, rel=0.02)


def test_undetermined_directions_have_no_cost() -> None:
    found = calibrate(systems.stereo(seed=1, pixel_noise=0.3).dataset())
    both = {sensor.edge: translation(np.array([0.3, 0.2, 0.1])) for sensor in found.dataset.sensors.values()}
    moved = found.dataset.with_transforms({edge: T @ found.dataset.transforms[edge] for edge, T in both.items()})
    assert cost_of(moved, Options(), found.noise_levels) == pytest.approx(found.cost, rel=1e-6)


def test_where_a_camera_looks_away_it_is_infinite() -> None:
    found = calibrate(systems.stereo(seed=1, pixel_noise=0.3).dataset())
    edge = found.dataset.sensors["right"].edge
    about = found.dataset.with_transforms({edge: found.dataset.transforms[edge] @ np.diag([-1.0, 1.0, -1.0, 1.0])})
    assert cost_of(about, Options(), found.noise_levels) == np.inf
