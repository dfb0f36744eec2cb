"""Statistics of many scenarios: distribution of the error, worst scenarios, parameters that drive the error."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

from calibration.robot.simulation.scenarios.drivers import LEAST_SCENARIOS, Driver, find_drivers
from calibration.robot.simulation.scenarios.scenario import ScenarioResult

REPORTED_PERCENTILES = (0, 5, 25, 50, 75, 95, 100)


@dataclass(frozen=True)
class Statistics:
    """Results of many scenarios of one system; at least one."""

    results: Sequence[ScenarioResult]
    lost: Collection[str] = ()
    """Ids of the scenarios that could not run because of the infrastructure."""

    @cached_property
    def calibrated(self) -> list[ScenarioResult]:
        """The scenarios that gave a calibration."""
        return [result for result in self.results if result.converged]

    @cached_property
    def drivers(self) -> list[Driver]:
        """Parameters that drive the translation error, strongest first; without a calibration is worst."""
        return find_drivers([result.values for result in self.ran], [_translation_error(result) for result in self.ran])

    @property
    def ran(self) -> list[ScenarioResult]:
        """The scenarios without those that could not run."""
        return [result for result in self.results if result.id not in self.lost]

    def worst(self, count: int) -> list[ScenarioResult]:
        """Return the scenarios without a calibration, then those with the largest translation error."""
        return sorted(self.results, key=lambda result: (-_translation_error(result), result.id))[:count]

    def percentiles(self, measure: str) -> dict[int, float]:
        """Return `REPORTED_PERCENTILES` of a measure over the scenarios that have it, by nearest rank."""
        values = sorted(value for result in self.calibrated if (value := getattr(result, measure)) is not None)
        if not values:
            return {}
        return {p: values[max(math.ceil(p / 100 * len(values)), 1) - 1] for p in REPORTED_PERCENTILES}


def _translation_error(result: ScenarioResult) -> float:
    """Return the sort key of scenarios: the translation error, infinite if there is none."""
    return result.translation_mm if result.converged and result.translation_mm is not None else math.inf


def why_unknown(scenarios: int) -> str:
    """Return the reason why no drivers are known."""
    return f"it takes {LEAST_SCENARIOS} scenarios" if scenarios < LEAST_SCENARIOS else "nothing varies"
