import math
from statistics import fmean, pstdev
from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.base.records import Place, read_as
from calibration.robot.simulation.scenarios.distributions import (
    Choice,
    Distribution,
    Integers,
    LogUniform,
    Normal,
    Uniform,
    drawn,
)

EVENLY = [(i + 0.5) / 1000 for i in range(1000)]
ENDS = (0.0, 1 - 2**-53)

finite = st.floats(-1e6, 1e6, allow_subnormal=False)
pairs = st.tuples(finite, finite).filter(lambda pair: pair[0] < pair[1]).map(lambda pair: (pair[0], pair[1]))
shares = st.floats(0, 1, exclude_max=True)


def read(value: Any, low: float = -math.inf, high: float = math.inf, whole: bool = False) -> Distribution:
    found = read_as(Annotated[Any, drawn(low, high, whole=whole)], value, Place("set.yml", ("light", "ambient")))
    assert isinstance(found, Choice | Integers | LogUniform | Normal | Uniform)
    return found


@st.composite
def distributions(draw: st.DrawFn) -> Distribution:
    low, high = draw(pairs)
    match draw(st.sampled_from(["uniform", "log", "normal", "choice", "integer"])):
        case "uniform":
            return Uniform(low, high)
        case "log":
            return LogUniform(math.exp(low / 1e5), math.exp(high / 1e5 + 1e-3))
        case "normal":
            mean, sigma = (low + high) / 2, (high - low) * draw(st.floats(0.05, 3))
            return Normal(mean, sigma, low, high)
        case "choice":
            return Choice(tuple(sorted(draw(st.lists(finite, min_size=1, max_size=9)))))
    return Integers(math.floor(low), math.floor(low) + draw(st.integers(1, 1000)))


@given(distributions(), shares, shares)
def test_values_keep_to_the_bounds_and_never_fall(distribution: Distribution, a: float, b: float) -> None:
    low, high = distribution.bounds
    values = [distribution.value(u) for u in (0.0, *sorted((a, b)), ENDS[1])]
    assert low <= values[0] <= values[1] <= values[2] <= values[3] <= high
    assert all(math.isfinite(value) for value in values)


@given(distributions(), shares)
def test_values_have_six_digits(distribution: Distribution, u: float) -> None:
    value = distribution.value(u)
    if value not in distribution.bounds and not isinstance(distribution, Choice | Integers):
        assert value == float(f"{value:.5e}")
    assert math.copysign(1, value) == 1 or value < 0  # no negative zero


@given(pairs)
def test_moments_of_the_uniform_ones(bounds: tuple[float, float]) -> None:
    low, high = bounds
    values = [Uniform(low, high).value(u) for u in EVENLY]
    step = max(abs(low), abs(high)) * 1e-5
    assert fmean(values) == pytest.approx((low + high) / 2, abs=step)
    assert pstdev(values) == pytest.approx((high - low) / math.sqrt(12), rel=1e-3, abs=step)


@given(finite, st.floats(1e-3, 1e6))
def test_moments_of_the_normal_ones(mean: float, sigma: float) -> None:
    values = [Normal(mean, sigma).value(u) for u in EVENLY]
    assert fmean(values) == pytest.approx(mean, abs=1e-5 * abs(mean) + 1e-3 * sigma)
    assert pstdev(values) == pytest.approx(sigma, rel=0.02, abs=1e-5 * abs(mean))


def test_a_truncated_normal_equals_the_normal_between_its_limits() -> None:
    cut = [Normal(0, 1, -1, 2).value(u) for u in EVENLY]
    whole = [value for u in [(i + 0.5) / 10000 for i in range(10000)] if -1 <= (value := Normal(0, 1).value(u)) <= 2]
    assert fmean(cut) == pytest.approx(fmean(whole), abs=2e-3)
    assert pstdev(cut) == pytest.approx(pstdev(whole), abs=2e-3)


def test_a_normal_one_is_finite_at_both_ends() -> None:
    low, high = (Normal(0, 1).value(u) for u in ENDS)
    assert -9 < low < -8
    assert 8 < high < 9


def test_half_of_a_log_uniform_one_is_below_the_geometric_mean() -> None:
    assert LogUniform(0.01, 100).value(0.5) == 1
    assert LogUniform(0.01, 100).value(0.25) == 0.1


def test_choices_and_integers_are_equally_likely() -> None:
    assert [Choice((1.0, 2.0, 2.0, 5.0)).value(u) for u in (0, 0.24, 0.26, 0.5, 0.74, 0.76)] == [1, 1, 2, 2, 2, 5]
    values = [Integers(-1, 2).value(u) for u in EVENLY]
    assert {value: values.count(value) for value in values} == {-1: 250, 0: 250, 1: 250, 2: 250}


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (3, Choice((3.0,))),
        (0.1234567891, Choice((0.1234567891,))),
        ({"uniform": [0, 1]}, Uniform(0, 1)),
        ({"log_uniform": [0.1, 1]}, LogUniform(0.1, 1)),
        ({"normal": [0, 1]}, Normal(0, 1, -10, 10)),
        ({"normal": [0, 1], "within": [-2, 3]}, Normal(0, 1, -2, 3)),
        ({"choice": [3, 1]}, Choice((1.0, 3.0))),
        ({"integer": [1, 3]}, Integers(1, 3)),
    ],
)
def test_each_is_read(value: Any, expected: Distribution) -> None:
    assert read(value, -10, 10) == expected


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (None, "found null, expected a number or keys: uniform, log_uniform, normal, within, choice, int"),
        ("much", "found 'much', expected a number or keys: uniform, log_uniform, normal, within, choice, i"),
        (True, "found true, expected a number or keys: uniform, log_uniform, normal, within, choice, int"),
        (math.nan, "found nan, expected a number or keys: uniform, log_uniform, normal, within, choice, inte"),
        (11, "found values from 11 to 11, expected them from 0 to 10"),
        ({}, "found nothing, expected one of uniform"),
        (
            {"unifrom": [0, 1]},
            "unknown key 'unifrom': did you mean 'uniform'? (known: uniform, log_uniform, normal, wit",
        ),
        ({"uniform": [0, 1], "normal": [0, 1]}, "found uniform and normal, expected one of"),
        ({"uniform": [0, 1], "within": [0, 1]}, "within needs normal: say normal too"),
        ({"uniform": [1, 0]}, "uniform: found [1, 0], expected two numbers, the second above the first"),
        ({"uniform": [0]}, "uniform: found a list of 1, expected a list of 2"),
        ({"uniform": [0, "1"]}, "uniform.1: found '1', expected a number"),
        ({"uniform": [-1, 1]}, "found values from -1 to 1, expected them from 0 to 10"),
        ({"uniform": [-1e308, 1e308]}, "which are too far apart"),
        ({"log_uniform": [0, 1]}, "log_uniform.0: found 0, expected a number above 0"),
        ({"log_uniform": [1e-300, 1e300]}, "log_uniform: found [1e-300, 1e+300], which are too far apart"),
        ({"normal": [0, 0]}, "found a standard deviation of 0, expected one above 0"),
        ({"normal": [50, 1]}, "nearly nothing of a normal distribution [50, 1] is from 0 to 10"),
        ({"normal": [5, 1], "within": [0, 20]}, "found values from 0 to 20, expected them from 0 to 10"),
        ({"normal": [5, 1], "within": [6, 6]}, "within: found [6, 6], expected two numbers"),
        ({"choice": []}, "choice: found an empty list, expected a list of 1 to 1000"),
        ({"choice": [1, "a"]}, "choice.1: found 'a', expected a number"),
        ({"integer": [0, 1.5]}, "integer.1: found 1.5, expected a whole number"),
        ({"integer": [0, 1e300]}, "found values from 0 to 1e+300, expected them from 0 to 10"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(value: Any, message: str) -> None:
    with pytest.raises(InputError) as error:
        read(value, 0, 10)
    assert str(error.value).startswith("set.yml: light.ambient")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [1.5, {"uniform": [0, 3]}, {"normal": [1, 1]}, {"choice": [1, 1.5]}])
def test_what_is_counted_is_whole(value: Any) -> None:
    with pytest.raises(InputError, match=r"whole number|known: choice, integer"):
        read(value, 0, 10, whole=True)
    assert read({"integer": [0, 3]}, 0, 10, whole=True) == Integers(0, 3)
    assert read({"choice": [1, 4]}, 0, 10, whole=True) == Choice((1.0, 4.0))
