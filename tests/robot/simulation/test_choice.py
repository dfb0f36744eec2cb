from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base.arrays import Array, BoolArray
from calibration.engine.estimation.least_squares.observability import PRIOR_SIGMA, choose
from tests.properties import at_most

SEEDS = st.integers(0, 10_000)


def matrices(seed: int, count: int = 30, size: int = 4) -> Array:
    """Information matrices (count, size, size), each singular."""
    rows = np.random.default_rng(seed).normal(0, 30, (count, size - 1, size))
    return np.asarray(np.swapaxes(rows, 1, 2) @ rows)


def whole(count: int) -> Array:
    """No partial views."""
    return np.zeros(count)


def nowhere(count: int) -> BoolArray:
    """No pose covers anything."""
    return np.zeros((count, 0), bool)


def best(information: Array, count: int, parameters: int = 4) -> list[int]:
    N = len(information)
    return choose(information, parameters, whole(N), 0.0, nowhere(N), count)


def variance(information: Array, chosen: list[int], parameters: int = 4) -> float:
    known = np.eye(information.shape[-1]) / PRIOR_SIGMA**2 + information[chosen].sum(0)
    return float(np.trace(np.linalg.inv(known)[:parameters, :parameters]))


@at_most(40)
@given(seed=SEEDS, count=st.integers(0, 40))
def test_so_many_each_once(seed: int, count: int) -> None:
    chosen = best(matrices(seed), count)
    assert len(chosen) == len(set(chosen)) == min(count, 30)
    assert all(0 <= i < 30 for i in chosen)


@at_most(40)
@given(seed=SEEDS)
def test_a_longer_motion_begins_as_a_shorter_one_and_knows_more(seed: int) -> None:
    information = matrices(seed)
    chosen = best(information, 12)
    assert best(information, 5) == chosen[:5]
    variances = [variance(information, chosen[:n]) for n in range(13)]
    assert all(later < earlier for earlier, later in pairwise(variances))


@at_most(40)
@given(seed=SEEDS)
def test_each_next_one_is_the_best(seed: int) -> None:
    information = matrices(seed)
    chosen = best(information, 6)
    for n, taken in enumerate(chosen):
        others = [variance(information, [*chosen[:n], i]) for i in range(30) if i not in chosen[:n]]
        assert variance(information, [*chosen[:n], taken]) <= min(others) * (1 + 1e-5)


def test_one_parameter_takes_the_largest() -> None:
    information = np.array([3.0, 9.0, 1.0, 7.0, 8.0])[:, None, None] * 1e3
    assert best(information, 4, parameters=1) == [1, 4, 3, 0]


def test_different_directions_before_large_ones() -> None:
    east, north = np.diag([100.0, 0.0]), np.diag([0.0, 50.0])
    assert best(np.stack([east, 0.9 * east, north]) * 1e3, 2, parameters=2) == [0, 2]


def test_what_is_not_calibrated_does_not_count() -> None:
    of_the_pattern, of_the_sensor = np.diag([0.0, 1e6]), np.diag([1e4, 0.0])
    information = np.stack([of_the_pattern, of_the_sensor])
    assert best(information, 1, parameters=1) == [1]
    assert best(information, 1, parameters=2) == [0]


@at_most(40)
@given(seed=SEEDS)
def test_rounding_errors_change_nothing(seed: int) -> None:
    information = matrices(seed)
    information = np.concatenate([information, information])  # all of them tie
    noise = 1 + 1e-13 * np.random.default_rng(seed + 1).normal(size=information.shape)
    chosen = best(information, 10)
    assert best(information * noise, 10) == chosen


def test_of_equal_ones_the_first() -> None:
    assert best(np.repeat(matrices(0, 1), 5, axis=0), 3) == [0, 1, 2]


@at_most(40)
@given(seed=SEEDS, share=st.floats(0, 0.5))
def test_the_share_of_partial_views(seed: int, share: float) -> None:
    """Poses of two cameras: both views whole, one of them partial, or both."""
    partial = np.random.default_rng(seed).choice([0.0, 0.5, 1.0], 60)
    partial[:40] = np.repeat([0.0, 1.0], 20)
    chosen = choose(matrices(seed, 60), 4, partial, share, nowhere(60), 15)
    assert partial[chosen].sum() == pytest.approx(15 * share, abs=1)


def test_where_there_are_only_whole_views_they_are_taken() -> None:
    assert len(choose(matrices(0), 4, whole(30), 0.5, nowhere(30), 10)) == 10


@at_most(40)
@given(seed=SEEDS)
def test_every_cell_is_covered_and_soon(seed: int) -> None:
    cells = np.random.default_rng(seed).random((30, 12)) < 0.3
    chosen = choose(matrices(seed), 4, whole(30), 0.0, cells, 12)
    np.testing.assert_array_equal(cells[chosen].any(0), cells.any(0))
    shown = np.zeros(12, bool)
    for i in chosen:
        assert (cells[i] & ~shown).any() or (shown | ~cells.any(0)).all()
        shown |= cells[i]


@at_most(40)
@given(seed=SEEDS)
def test_better_than_chance(seed: int) -> None:
    information = matrices(seed)
    rng = np.random.default_rng(seed)
    by_chance = [variance(information, rng.choice(30, 6, replace=False).tolist()) for _ in range(30)]
    assert variance(information, best(information, 6)) < np.median(by_chance)
