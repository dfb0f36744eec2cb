from collections.abc import Sequence

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.scenarios.statistics import Statistics


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
