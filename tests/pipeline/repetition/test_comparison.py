"""Runs beside each other: spreads, their limits, and the first stage that differs."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.pipeline.repetition.repetition import MaxSpread, Repetition
from calibration.pipeline.repetition.results import (
    Spread,
    first_differences,
    number_ranges,
    spreads_of_results,
    stage_times,
)

RMS = ("arm: RMS", "px")


def run(**content: object) -> Repetition:
    return Repetition(folder=Path("run"), verdict="pass", **content)  # type: ignore[arg-type]


def outputs(*of_stages: str) -> dict[str, dict[str, str]]:
    return dict(zip(("collect", "calibrate"), ({"left": each[0], "right": each[1]} for each in of_stages), strict=True))


@given(st.floats(1e-6, 1e6), st.integers(2, 20))
def test_equal_numbers_have_no_spread_whatever_their_sum_rounds_to(value: float, count: int) -> None:
    [spread] = spreads_of_results([run(numbers={RMS: value})] * count, None)
    assert (spread.mean, spread.standard_deviation, spread.largest, spread.runs) == (value, 0.0, 0.0, count)


def test_a_spread_is_the_standard_deviation_of_a_run() -> None:
    [spread] = spreads_of_results([run(numbers={RMS: value}) for value in (1.0, 2.0, 3.0, 6.0)], None)
    assert (spread.mean, spread.largest) == (3.0, 3.0)
    assert spread.standard_deviation == pytest.approx(math.sqrt(14 / 3))


def test_transforms_spread_by_their_distances_from_the_mean() -> None:
    away = [from_xyz_rpy((0.5 + x, 0, 0), (1, 0.3, yaw)) for x, yaw in ((-0.001, -0.01), (0.001, 0.01))]
    mm, deg = spreads_of_results([run(poses={"arm": T}) for T in away], MaxSpread(translation_mm=1.4))
    assert (mm.unit, mm.verdict, mm.mean) == ("mm", "fail", None)
    assert mm.largest == pytest.approx(1)
    assert mm.standard_deviation == pytest.approx(math.sqrt(2))
    assert (deg.unit, deg.limit) == ("deg", None)
    assert deg.largest == pytest.approx(math.degrees(0.01), rel=1e-6)
    same = spreads_of_results([run(poses={"arm": away[0]})] * 3, None)
    assert [each.largest for each in same] == [0.0, 0.0]


@pytest.mark.parametrize(
    ("deviation", "runs", "verdict"),
    [(0.0, 2, "pass"), (0.5, 2, "undecided"), (0.5, 10, "pass"), (0.9, 10, "undecided"), (1.1, 10, "fail")],
)
def test_a_limit_is_undecided_where_few_runs_may_be_below_it_by_chance(
    deviation: float, runs: int, verdict: str
) -> None:
    found = Spread(name="RMS", unit="px", runs=runs, mean=1, standard_deviation=deviation, largest=deviation, limit=1.0)
    assert found.verdict == verdict


def test_a_spread_is_not_worse_than_its_guard_band_says() -> None:
    """Of 1000 sets of ten runs whose true spread is the limit, few pass."""
    draws = np.random.default_rng(1).normal(size=(1000, 10))
    sets = [spreads_of_results([run(numbers={RMS: v}) for v in each], MaxSpread(rms_px=1.0))[0] for each in draws]
    assert 0 < sum(each.verdict == "pass" for each in sets) < 100


def test_runs_differ_from_the_largest_group_from_the_first_stage_on() -> None:
    usual, late, early = outputs("aa", "bb"), outputs("aa", "bX"), outputs("Xa", "cc")
    runs = [run(outputs=each) for each in (late, usual, early, usual, late, usual)]
    found = {each.runs: (each.stage, each.outputs, each.reference) for each in first_differences(runs)}
    assert found == {(1, 5): ("calibrate", ("right",), 2), (3,): ("collect", ("left",), 2)}
    assert first_differences([run(outputs=usual)] * 3) == ()


def test_what_no_two_runs_have_in_common_hides_no_other_difference() -> None:
    runs = [run(outputs=outputs(f"{n}a", f"{n}{'X' if n == 3 else 'b'}")) for n in range(1, 6)]
    found = [(each.runs, each.stage, each.outputs) for each in first_differences(runs)]
    assert found == [((2, 3, 4, 5), "collect", ("left",)), ((3,), "calibrate", ("right",))]


def test_what_is_cut_short_or_alone_differs_from_nothing() -> None:
    assert first_differences([run(outputs=outputs("aa", "bb")), run(cut_short="it was stopped")]) == ()
    assert first_differences([]) == ()


def test_an_output_that_a_run_lacks_is_a_difference() -> None:
    whole = {"build": {}, "export": {"arm": "a"}}
    [found] = first_differences([run(outputs=whole), run(outputs=whole), run(outputs={"export": {}})])
    assert (found.runs, found.stage, found.outputs) == ((3,), "export", ("arm",))


def test_times_are_of_each_stage_then_of_the_whole_run() -> None:
    runs = [
        run(seconds={"build": 2.0, "calibrate": 1.0}, whole_seconds=4.0),
        run(seconds={"build": 4.0}, whole_seconds=5.0),
    ]
    assert [(each.name, each.mean, each.runs) for each in stage_times(runs)] == [
        ("build", 3.0, 2),
        ("calibrate", 1.0, 1),
        ("whole run", 4.5, 2),
    ]


def test_consecutive_numbers_are_ranges() -> None:
    assert number_ranges((1, 2, 3, 5, 9, 10)) == "1-3, 5, 9-10"
