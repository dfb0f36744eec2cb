"""Statistics of many scenarios: how the error is distributed, which scenarios are worst, what drives the error."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

from calibration.simulation.scenarios.drivers import LEAST_SCENARIOS, Driver, find_drivers
from calibration.simulation.scenarios.scenario import ScenarioResult

PERCENTILES = (0, 5, 25, 50, 75, 95, 100)


@dataclass(frozen=True)
class Statistics:
    """The results of many scenarios of one system; at least one."""

    results: Sequence[ScenarioResult]
    lost: Collection[str] = ()
    """The ids of those that could not be run: nothing about their scenarios is to blame."""

    @cached_property
    def calibrated(self) -> list[ScenarioResult]:
        """The scenarios that gave a calibration."""
        return [result for result in self.results if result.converged]

    @cached_property
    def drivers(self) -> list[Driver]:
        """What goes with the translation error, the strongest first. A scenario without a calibration is the worst."""
        return find_drivers([result.values for result in self.ran], [_error(result) for result in self.ran])

    @property
    def ran(self) -> list[ScenarioResult]:
        """The scenarios that say something: without those that could not be run."""
        return [result for result in self.results if result.id not in self.lost]

    def worst(self, count: int) -> list[ScenarioResult]:
        """The scenarios without a calibration, then those with the largest translation error."""
        return sorted(self.results, key=lambda result: (-_error(result), result.id))[:count]

    def percentiles(self, measure: str) -> dict[int, float]:
        """`PERCENTILES` of a measure over the scenarios that have it: each the value of one of them (nearest rank)."""
        values = sorted(value for result in self.calibrated if (value := getattr(result, measure)) is not None)
        if not values:
            return {}
        return {p: values[max(math.ceil(p / 100 * len(values)), 1) - 1] for p in PERCENTILES}


def _error(result: ScenarioResult) -> float:
    """What the scenarios are ordered by: the translation error, infinite where there is none."""
    return result.translation_mm if result.converged and result.translation_mm is not None else math.inf


def why_unknown(scenarios: int) -> str:
    """Why nothing is known of drivers."""
    return f"it takes {LEAST_SCENARIOS} scenarios" if scenarios < LEAST_SCENARIOS else "nothing varies"
