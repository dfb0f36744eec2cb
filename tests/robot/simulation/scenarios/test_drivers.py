from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.robot.simulation.scenarios.drivers import LEAST_SCENARIOS, Driver, centred_ranks, find_drivers


def scenarios(count: int, parameters: int, seed: int = 0) -> list[dict[str, float]]:
    values = np.random.default_rng(seed).standard_normal((count, parameters)).round(5)
    return [{f"p{k:02d}": float(value) for k, value in enumerate(row)} for row in values]


@pytest.fixture(scope="module")
def stats() -> ModuleType:
    import scipy.stats  # slow to import, for every worker that collects the tests

    return scipy.stats


def noise(count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(count)


@given(st.lists(st.one_of(st.integers(-3, 3).map(float), st.floats(allow_nan=False)), min_size=1, max_size=30))
def test_ranks_are_those_of_scipy(stats: ModuleType, values: list[float]) -> None:
    ranks = centred_ranks(np.array(values))
    np.testing.assert_array_equal(ranks, (2 * stats.rankdata(values) - len(values) - 1).astype(int))
    assert ranks.sum() == 0


def test_a_planted_driver_is_found_and_nothing_else(stats: ModuleType) -> None:
    values = scenarios(60, 30)
    errors = [0.5 + np.exp(scenario["p07"]) + 0.3 * abs(n) for scenario, n in zip(values, noise(60), strict=True)]
    found = find_drivers(values, errors)
    assert found[0].parameter == "p07"
    expected = stats.spearmanr([scenario["p07"] for scenario in values], errors).statistic
    assert found[0].correlation == pytest.approx(expected, abs=1e-4)
    assert [driver.parameter for driver in found if driver.stands_out] == ["p07"]


def test_a_driver_may_be_a_magnitude_or_make_the_error_smaller() -> None:
    values = [{**scenario, "light": abs(scenario["p00"])} for scenario in scenarios(80, 5)]
    errors = [abs(scenario["p03"]) ** 2 - scenario["light"] + 5 for scenario in values]
    found = {driver.parameter: driver for driver in find_drivers(values, errors)}
    assert found["|p03|"].stands_out
    assert found["|p03|"].correlation > 0.7
    assert found["|p03|"].of({"p03": -2.0}) == 2
    assert "p03" not in found  # its magnitude says more
    assert found["light"].correlation < 0
    assert found["light"].stands_out
    assert "|light|" not in found  # it never is below 0


def test_chance_is_rarely_significant() -> None:
    """Of 60 sets of scenarios without any driver, each with 30 parameters, hardly any has a significant one."""
    wrong = sum(find_drivers(scenarios(40, 30, seed), noise(40, seed + 1000))[0].stands_out for seed in range(60))
    assert wrong <= 4


def test_the_p_value_of_a_single_parameter_is_that_of_scipy(stats: ModuleType) -> None:
    values = [{"a": abs(scenario["p00"])} for scenario in scenarios(50, 1)]
    errors = [0.4 * scenario["a"] + n for scenario, n in zip(values, 0.8 * noise(50), strict=True)]
    (found,) = find_drivers(values, errors)
    assert 0.001 < found.p < 0.5
    assert found.p == pytest.approx(stats.spearmanr([scenario["a"] for scenario in values], errors).pvalue, rel=0.2)


def test_many_parameters_make_one_less_sure() -> None:
    values = [{name: value + 10 for name, value in scenario.items()} for scenario in scenarios(30, 40)]
    errors = [scenario["p00"] + 1.5 * n for scenario, n in zip(values, noise(30), strict=True)]
    alone = find_drivers([{"p00": scenario["p00"]} for scenario in values], errors)[0]
    among = next(driver for driver in find_drivers(values, errors) if driver.parameter == "p00")
    assert alone.correlation == among.correlation
    assert 10 * alone.p < among.p


def test_scenarios_without_a_calibration_are_the_worst() -> None:
    values = [{"a": float(i), "b": float(i % 7)} for i in range(40)]
    errors = [np.inf if i > 25 else float(i % 3) for i in range(40)]
    found = find_drivers(values, errors)
    assert (found[0].parameter, found[0].stands_out) == ("a", True)


def test_what_never_varies_is_left_out() -> None:
    values = [{**scenario, "poses": 12.0} for scenario in scenarios(20, 2)]
    assert {driver.name for driver in find_drivers(values, noise(20))} == {"p00", "p01"}


def test_no_drivers_for_few_or_equal_scenarios() -> None:
    assert find_drivers(scenarios(LEAST_SCENARIOS - 1, 3), noise(LEAST_SCENARIOS - 1)) == []
    assert find_drivers(scenarios(20, 3), [1.0] * 20) == []
    assert find_drivers([{"a": 1.0}] * 20, noise(20)) == []
    assert find_drivers([{}] * 20, noise(20)) == []


def test_the_order_of_scenarios_and_parameters_does_not_matter_to_the_correlations() -> None:
    values, errors = scenarios(30, 6), noise(30)
    turned = [dict(reversed(scenario.items())) for scenario in reversed(values)]
    one = find_drivers(values, errors)
    other = find_drivers(turned, errors[::-1])
    assert [(d.parameter, d.correlation) for d in one] == [(d.parameter, d.correlation) for d in other]
    assert find_drivers(values, errors) == one


def test_standing_out_is_a_small_p() -> None:
    assert Driver("a", 0.9, 0.0003).stands_out
    assert not Driver("a", 0.9, 0.01).stands_out
