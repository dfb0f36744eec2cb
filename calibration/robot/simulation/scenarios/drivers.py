"""Parameters that drive the error: rank correlations over the scenarios, with their significance.

Spearman's rank correlation of each parameter with the error (ties have their mean rank). Its
p-value is that of a permutation test: the probability that a permuted error correlates as strongly with
*any* of the parameters (P. Westfall and S. Young, "Resampling-Based Multiple Testing", 1993, the
single-step maxT). So it holds for any number of parameters, also for dependent ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.robot.simulation.random_streams import stream

PERMUTATIONS = 4000
SIGNIFICANCE_LEVEL = 0.01
"""Significance level of a driver."""
LEAST_SCENARIOS = 10
"""Minimum of scenarios for a statement."""
_NUMBERS_PER_BATCH = 2_000_000  # permuted numbers per batch


@dataclass(frozen=True)
class Driver:
    """Parameter with its correlation with the error."""

    parameter: str
    """Between bars, ``|left_camera.k1|``, if it is the parameter's magnitude."""
    correlation: float
    """Spearman's, -1 to 1: above 0 if the error grows with it."""
    p: float
    """Probability that so strong a correlation with any parameter is due to chance."""

    @property
    def name(self) -> str:
        """Name of the parameter, without bars."""
        return self.parameter.strip("|")

    def of(self, values: Mapping[str, float]) -> float:
        """Return the value of the parameter in a scenario, or its magnitude."""
        value = values[self.name]
        return value if self.name == self.parameter else abs(value)

    @property
    def stands_out(self) -> bool:
        """Whether the correlation is significant."""
        return self.p < SIGNIFICANCE_LEVEL


def find_drivers(values: Sequence[Mapping[str, float]], errors: Sequence[float]) -> list[Driver]:
    """Rank the parameters by the strength of their correlation with the error, strongest first.

    A parameter with both signs is tested twice, as it is and by its magnitude (a pattern
    bent to either side has the same effect), and listed with the stronger correlation. One
    that never varies is left out.

    Args:
        values: of each scenario, by parameter; the same parameters in all.
        errors: of each scenario; infinite if a scenario gave no calibration: such a scenario is worse
            than any other.

    Returns:
        The list; empty if there are fewer than `LEAST_SCENARIOS` scenarios, or the error never varies.
    """
    if len(values) < LEAST_SCENARIOS:
        return []
    error_ranks = centred_ranks(np.array(errors, float))
    columns = {name: centred_ranks(column) for name, column in _value_columns(values).items()}
    columns = {name: ranks for name, ranks in columns.items() if ranks.any()}
    if not columns or not error_ranks.any():
        return []
    ranks = np.stack(list(columns.values()), -1)
    unit = ranks / np.linalg.norm(ranks, axis=0) / np.linalg.norm(error_ranks)
    correlations = error_ranks @ unit
    strongest = _strongest_by_chance(error_ranks, unit)
    reached = (strongest[:, None] >= np.abs(correlations) - 1e-9).sum(0)
    p = (1 + reached) / (1 + PERMUTATIONS)
    found = [
        Driver(name, round(float(rho), 4), round(float(chance), 6))
        for name, rho, chance in zip(columns, correlations, p, strict=True)
    ]
    found.sort(key=lambda driver: (-abs(driver.correlation), driver.parameter))
    stronger = {driver.name: driver for driver in reversed(found)}
    return [driver for driver in found if stronger[driver.name] is driver]


def centred_ranks(values: Array) -> IntArray:
    """Twice the ranks (N,) of values (N,), minus their mean; equal values have their mean rank.

    Integers, so that sums of them are exact.
    """
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    below = np.cumsum(counts) - counts
    ranks: IntArray = (2 * below + counts - len(values))[inverse]
    return ranks


def _value_columns(values: Sequence[Mapping[str, float]]) -> dict[str, Array]:
    columns = {name: np.array([scenario[name] for scenario in values]) for name in values[0]}
    signed = [name for name, column in columns.items() if column.min() < 0 < column.max()]
    return {**columns, **{f"|{name}|": np.abs(columns[name]) for name in signed}}


def _strongest_by_chance(error_ranks: IntArray, unit: Array) -> Array:
    """Return the largest magnitude of a correlation with any parameter, for each of `PERMUTATIONS` permuted errors."""
    random = stream(0, "drivers")
    step = max(1, _NUMBERS_PER_BATCH // len(error_ranks))
    strongest = []
    for first in range(0, PERMUTATIONS, step):
        rows = np.tile(error_ranks, (min(step, PERMUTATIONS - first), 1))
        strongest.append(np.abs(random.permuted(rows, axis=1) @ unit).max(-1))
    return np.concatenate(strongest)
