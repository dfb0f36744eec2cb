"""Levels and lines are found in noise, and noise is not taken for either."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.baseline.change_points import change_points, creeps, noise_of
from tests.properties import at_most

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
