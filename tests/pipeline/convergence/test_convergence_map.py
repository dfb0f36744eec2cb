"""Up to where every start converges: known maps, and laws over any map."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import ExitCode
from calibration.pipeline.containers import SOFTWARE_METHOD
from calibration.pipeline.convergence.convergence_map import ConvergenceMap, maps_of
from calibration.pipeline.system import NoiseGrid

from .cells import cell, one_map

T, R = (0.0, 0.5, 1.0), (0.0, 1.0, 2.0, 3.0)
LEVELS = st.lists(st.integers(1, 40), max_size=6, unique=True).map(lambda n: (0.0, *(x / 10 for x in sorted(n))))


@st.composite
def maps(draw: st.DrawFn) -> ConvergenceMap:
    translations, rotations = draw(LEVELS), draw(LEVELS)
    lost = draw(st.sets(st.tuples(st.sampled_from(translations), st.sampled_from(rotations)), max_size=6))
    return one_map(translations, rotations, lambda t, r, _seed: (t, r) not in lost)


def test_everything_converges() -> None:
    largest = one_map(T, R, lambda *_: True).largest
    assert (largest.translation, largest.rotation, largest.diagonal) == (1.0, 3.0, (1.0, 3.0))


def test_not_even_without_noise() -> None:
    largest = one_map(T, R, lambda t, r, _: t > 0 or r > 0).largest
    assert (largest.translation, largest.rotation, largest.diagonal) == (None, None, None)


def test_what_converges_beyond_a_gap_does_not_count() -> None:
    largest = one_map(T, R, lambda t, r, _: t != 0.5 and r != 2.0).largest
    assert (largest.translation, largest.rotation) == (0.0, 1.0)


def test_one_seed_that_is_lost_is_enough() -> None:
    found = one_map(T, R, lambda t, r, seed: (t, r, seed) != (1.0, 0.0, 2), seeds=(1, 2, 3))
    assert found.largest.translation == 0.5
    assert found.largest.rotation == 3.0
    assert found.pairs[1.0, 0.0].lost == (2,)
    assert found.pairs[1.0, 0.0].share == pytest.approx(2 / 3, abs=1e-6)


def test_the_diagonal_grows_in_proportion_to_the_last_levels() -> None:
    """With 0.5 m of 1 come 1 of 3 rad (half of it is 1.5); with 2 rad of 3 come no more than 0.5 m."""
    largest = one_map(T, R, lambda t, r, _: (t, r) != (1.0, 2.0)).largest
    assert (largest.translation, largest.rotation) == (1.0, 3.0)
    assert largest.diagonal == (0.5, 2.0)
    assert one_map(T, R, lambda t, r, _: (t, r) != (0.5, 1.0)).largest.diagonal == (0.0, 1.0)


def test_the_same_share_of_both_axes_is_one_step() -> None:
    """0.1 of 0.3 and 0.3 of 0.9 are no equal floats."""
    found = one_map((0.0, 0.1, 0.3), (0.0, 0.3, 0.9), lambda t, r, _: not (t and r))
    assert (found.largest.translation, found.largest.rotation) == (0.3, 0.9)
    assert found.largest.diagonal == (0.0, 0.0)


@given(maps())
def test_every_pair_up_to_the_largest_converges_and_the_next_does_not(found: ConvergenceMap) -> None:
    largest = found.largest
    assert (largest.translation is None) == (largest.rotation is None) == (largest.diagonal is None)
    if largest.translation is None or largest.rotation is None or largest.diagonal is None:
        assert not found.pairs[0.0, 0.0].always
        return
    assert all(found.pairs[t, 0.0].always for t in found.translations if t <= largest.translation)
    assert all(found.pairs[0.0, r].always for r in found.rotations if r <= largest.rotation)
    beyond = [t for t in found.translations if t > largest.translation]
    assert not beyond or not found.pairs[beyond[0], 0.0].always
    t_last, r_last = largest.diagonal
    assert all(pair.always for (t, r), pair in found.pairs.items() if t <= t_last and r <= r_last)
    assert t_last <= largest.translation
    assert r_last <= largest.rotation
    if all(pair.always for pair in found.pairs.values()):
        assert largest.diagonal == (found.translations[-1], found.rotations[-1])


@pytest.mark.parametrize(
    ("converged", "starts", "percent"),
    [(0, 7, "0"), (7, 7, "100"), (1, 1000, "1"), (999, 1000, "99"), (1, 3, "33"), (1, 2, "50")],
)
def test_only_all_are_100_percent_and_only_none_are_0(converged: int, starts: int, percent: str) -> None:
    found = one_map((0.0,), (0.0,), lambda _t, _r, seed: seed <= converged, seeds=tuple(range(1, starts + 1)))
    assert found.pairs[0.0, 0.0].percent == percent


def test_cells_in_any_order_make_the_same_map() -> None:
    noise = NoiseGrid((0.0, 1.0), (0.0, 2.0), (3, 1))
    cells = [cell(t, r, seed, seed == 3) for t in noise.translations for r in noise.rotations for seed in noise.seeds]
    [expected] = maps_of(cells, noise)
    random.Random(1).shuffle(cells)
    [found] = maps_of(cells, noise)
    assert found == expected
    assert list(found.pairs) == [(0.0, 0.0), (0.0, 2.0), (1.0, 0.0), (1.0, 2.0)]
    assert [each.seed for each in found.pairs[1.0, 0.0].cells] == [3, 1]


def test_our_engine_beside_software_is_not_judged() -> None:
    cells = [cell(0, 0, method=SOFTWARE_METHOD), cell(0, 0), cell(0, 0, system="leg"), cell(0, 0, start="linear")]
    found = maps_of(cells, NoiseGrid())
    assert [(each.name, each.judged) for each in found] == [
        ("arm, software, given", True),
        ("arm, calibration-ci, given", False),
        ("arm, calibration-ci, linear", False),
        ("leg, given", True),
    ]


def test_bad_input_counts_only_where_there_is_no_noise_to_blame() -> None:
    noisy = one_map((0.0, 1.0), (0.0,), lambda t, _r, _s: t == 0, error=ExitCode.BAD_INPUT)
    assert noisy.error is None
    without = one_map((0.0, 1.0), (0.0,), lambda *_: False, error=ExitCode.BAD_INPUT)
    assert without.error == ExitCode.BAD_INPUT
    world = one_map((0.0, 1.0), (0.0,), lambda t, _r, _s: t == 0, error=ExitCode.INFRASTRUCTURE)
    assert world.error == ExitCode.INFRASTRUCTURE
