"""Moved sensors are significant and named with their direction; others are not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import compare
from calibration.engine.statistics import (
    change_points,
    chi_squared_quantile,
    chi_squared_tail,
    creeps,
    noise_of,
    t_squared_quantile,
    t_squared_tail,
)
from tests.engine.baseline.scenes import stereo, taken
from tests.properties import at_most

MOVED = (0.0, 0.0, 0.005, 0.0, 0.009, 0.0)


def test_the_distributions_have_their_known_values() -> None:
    assert chi_squared_tail(12.592) == pytest.approx(0.05, rel=1e-3)
    assert chi_squared_tail(22.458) == pytest.approx(0.001, rel=1e-3)
    assert chi_squared_tail(math.inf) == 0
    assert chi_squared_quantile(0.001) == pytest.approx(22.458, abs=0.001)
    assert t_squared_tail(22.458, 6, math.inf) == pytest.approx(0.001, rel=0.1)
    assert t_squared_tail(10.828, 1, math.inf) == pytest.approx(0.001, rel=0.2)
    assert t_squared_quantile(0.05, 20) == pytest.approx(20 * 6 / 15 * 2.790, rel=0.02)  # F of 6 and 15
    assert t_squared_tail(math.inf, 6, 20) == 0
    assert t_squared_tail(1e5, 6, 5) == 1
    assert t_squared_quantile(0.05, 5) == math.inf


def test_a_calibration_does_not_differ_from_itself() -> None:
    found = taken(stereo())
    comparison = compare(found, found)
    assert comparison.same_data
    assert {each.kind for each in comparison.changes} == {"pose"}
    assert all(each.mm == each.deg == each.sigmas == 0 and each.p > 1 - 1e-5 for each in comparison.changes)


def test_other_data_of_the_same_robot_are_no_change() -> None:
    before = taken(stereo(1))
    for seed in range(2, 12):
        comparison = compare(before, taken(stereo(seed)))
        assert not comparison.same_data
        assert all(each.p > comparison.significance for each in comparison.changes)


def test_a_sensor_that_moved_is_the_one_that_changes_in_its_direction() -> None:
    comparison = compare(taken(stereo(1)), taken(stereo(2, MOVED)))
    [change] = [each for each in comparison.changes if each.p < comparison.significance]
    assert change.name == "right"
    assert change.translation_mm == pytest.approx((0, 0, 5), abs=4 * change.sigma_mm)
    assert change.rotation_deg == pytest.approx((0, math.degrees(0.009), 0), abs=4 * change.sigma_deg)
    assert change.mm == pytest.approx(np.linalg.norm(change.translation_mm), rel=1e-3)


def test_the_largest_undetected_move_is_about_as_large_as_reported() -> None:
    before = taken(stereo(1))
    unseen = next(each for each in compare(before, taken(stereo(2))).changes if each.name == "right").unseen_mm
    far = (0.0, 0.0, 3e-3 * unseen, 0.0, 0.0, 0.0)
    comparison = compare(before, taken(stereo(2, far)))
    assert min(each.p for each in comparison.changes) < comparison.significance


def test_added_and_removed_sensors_are_reported() -> None:
    found = taken(stereo())
    less = replace(found, poses=tuple(each for each in found.poses if each.name != "right"))
    assert [(each.kind, each.name) for each in compare(found, less).changes if each.kind != "pose"] == [
        ("removed", "right")
    ]
    assert [(each.kind, each.name) for each in compare(less, found).changes if each.kind != "pose"] == [
        ("added", "right")
    ]


def test_what_both_hold_differs_without_an_error_bar() -> None:
    found = taken(stereo())
    [left] = [each for each in found.poses if each.sigma_mm is None]
    other: CalibrationDocument = replace(
        found,
        poses=tuple(replace(each, xyz_mm=(1.0, 2.0, 3.0)) if each is left else each for each in found.poses),
    )
    change = next(each for each in compare(found, other).changes if each.name == left.name)
    assert change.p == 0
    assert change.mm > 0


def test_what_both_hold_errs_alike_and_widens_no_difference() -> None:
    before, now = taken(stereo(1)), taken(stereo(2))
    [right] = [each for each in before.poses if each.held]
    [change] = [each for each in compare(before, now).changes if each.name == "right"]
    assert right.norm_mm > 3 * change.sigma_mm / math.sqrt(2)
    apart = replace(now, poses=tuple(replace(each, held={}) for each in now.poses))
    [alone] = [each for each in compare(before, apart).changes if each.name == "right"]
    assert alone.sigma_mm > 2 * change.sigma_mm


ONE = np.ones(6)


def series(levels: list[tuple[int, float]], seed: int = 1) -> np.ndarray:
    """(n, 6): unit noise about levels of a first column, each for some time."""
    level = np.concatenate([np.full(count, height) for count, height in levels])
    return np.random.default_rng(seed).normal(size=(len(level), 6)) + np.outer(level, np.eye(6)[0])


def test_noise_alone_has_no_change() -> None:
    found = [change_points(series([(40, 0.0)], seed), ONE) for seed in range(200)]
    assert sum(map(bool, found)) <= 2


@given(at=st.integers(3, 37), seed=st.integers(0, 1000))
@at_most(25)
def test_a_step_is_found_where_it_is(at: int, seed: int) -> None:
    found = change_points(series([(at, 0.0), (40 - at, 12.0)], seed), ONE)
    assert at in found


def test_several_steps_and_a_spike() -> None:
    assert change_points(series([(10, 0), (12, 10), (1, 30), (12, 10), (10, -5)]), ONE) == [10, 22, 23, 35]


def test_it_is_the_best_segmentation_of_all() -> None:
    values = series([(4, 0), (3, 7), (4, 0)])
    [*found] = change_points(values, ONE)

    def cost(cuts: tuple[int, ...]) -> float:
        parts = np.split(values, cuts)
        return sum(float(((part - part.mean(axis=0)) ** 2).sum()) for part in parts)

    pairs = [(a, b) for a in range(1, 11) for b in range(a + 1, 11)]
    assert found == list(min(pairs, key=cost))


@pytest.mark.parametrize("n", [0, 1])
def test_nothing_changes_in_nothing(n: int) -> None:
    assert change_points(np.zeros((n, 6)), ONE) == []
    assert not creeps(np.zeros((n, 6)), ONE, [])


def test_a_drift_creeps_and_a_step_does_not() -> None:
    drift = series([(20, 0.0)]) + np.outer(np.arange(20), np.eye(6)[0])
    assert creeps(drift, ONE, change_points(drift, ONE))
    step = series([(10, 0.0), (10, 10.0)])
    assert not creeps(step, ONE, change_points(step, ONE))
    still = series([(20, 0.0)])
    assert not creeps(still, ONE, change_points(still, ONE))


def test_noise_is_estimated_from_differences_and_for_few_values_as_stated() -> None:
    values = 0.2 * series([(200, 0.0), (200, 50.0)])
    assert noise_of(values, ONE) == pytest.approx(0.2, rel=0.25)
    assert noise_of(values[:4], ONE) == pytest.approx(1)
    assert noise_of(np.zeros((40, 6)), ONE) == pytest.approx(0.02)
    wider = np.concatenate([values[:200], 4 * values[:200]])
    assert noise_of(wider, ONE) == pytest.approx(0.8, rel=0.25)
