import sys
from collections.abc import Sequence
from types import ModuleType

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.base import InfrastructureError
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.scenarios.statistics import (
    LEAST_SCENARIOS,
    Driver,
    Statistics,
    centred_ranks,
    figure,
    find_drivers,
)


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


def many(errors: Sequence[float | None]) -> Statistics:
    return Statistics(
        [
            ScenarioResult(f"s1-{i:05d}", "0" * 12, {}, converged=error is not None, translation_mm=error)
            for i, error in enumerate(errors)
        ]
    )


@settings(deadline=None)
@given(st.lists(st.floats(0, 1e3), min_size=1, max_size=60))
def test_percentiles_are_values_of_scenarios(errors: list[float]) -> None:
    found = many(errors).percentiles("translation_mm")
    assert list(found) == [0, 5, 25, 50, 75, 95, 100]
    assert (found[0], found[100]) == (min(errors), max(errors))
    expected = np.percentile(errors, list(found), method="inverted_cdf")
    assert list(found.values()) == expected.tolist()


def test_the_worst_are_those_without_a_calibration_then_the_largest_errors() -> None:
    report = many([0.5, None, 3.0, 0.1, None, 3.0])
    assert [r.id for r in report.worst(4)] == ["s1-00001", "s1-00004", "s1-00002", "s1-00005"]
    assert len(report.worst(100)) == 6


def report(count: int, lost: int = 0) -> Statistics:
    random = np.random.default_rng(0)
    return Statistics(
        [
            ScenarioResult(
                f"s1-{i:05d}",
                "0" * 12,
                {"motion.sway_mm": float(sway), r"$\frac$.bow_x_mm": float(bow)},
                converged=i >= lost,
                translation_mm=float(0.1 + sway + bow**2) if i >= lost else None,
                rotation_deg=float(0.01 + sway / 30) if i >= lost else None,
            )
            for i, (sway, bow) in enumerate(zip(random.random(count), random.standard_normal(count), strict=True))
        ]
    )


@pytest.mark.parametrize(("count", "lost"), [(40, 3), (3, 3), (1, 0)])
def test_any_report_is_drawn(count: int, lost: int) -> None:
    png = figure(report(count, lost), r"Scenarios of $\frac$", translation_limit=1, rotation_limit=0.1)
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (770, 1100, 3)
    assert np.ptp(image) > 100


def test_the_same_report_gives_the_same_picture() -> None:
    png = figure(report(5), "5 scenarios")
    assert png == figure(report(5), "5 scenarios")
    assert b"matplotlib" not in png
    assert png != figure(report(5, 1), "5 scenarios")


def test_without_matplotlib_the_error_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InfrastructureError, match=r"pip install matplotlib"):
        figure(report(3), "3 scenarios")
