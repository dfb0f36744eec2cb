"""Statistics of many scenarios: distribution of the error, worst scenarios, parameters that drive it, and a figure.

What drives the error is found by Spearman's rank correlation of each parameter with the error (ties have their mean
rank). Its p-value is that of a permutation test: the probability that a permuted error correlates as strongly with
*any* of the parameters (P. Westfall and S. Young, "Resampling-Based Multiple Testing", 1993, the
single-step maxT). So it holds for any number of parameters, also for dependent ones.
"""

import io
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.base.optional import optional
from calibration.engine.statistics import FAMILY_WISE
from calibration.robot.simulation.kinematics import stream
from calibration.robot.simulation.scenarios.scenario import ScenarioResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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
    return (2 * below + counts - len(values))[inverse]


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
    def beyond_error_bars(self) -> list[ScenarioResult]:
        """The scenarios whose error chance does not explain, family-wise over all (Bonferroni), worst first."""
        least = FAMILY_WISE / max(1, len(self.calibrated))
        found = [result for result in self.calibrated if result.chance is not None and result.chance < least]
        return sorted(found, key=lambda result: (-(result.error_sigmas or 0.0), result.id))

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


DRIVERS_SHOWN = 3
_WIDTH_IN, _HEIGHT_IN, _DPI = 10.0, 7.0, 110
_DOT_COLOUR, _LIMIT_COLOUR, _LOST_COLOUR = "#1f5f8b", "#b03a2e", "#b03a2e"
_FIGURE_STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "axes.axisbelow": True,
    "legend.frameon": False,
}


def figure(
    report: Statistics, title: str, translation_limit: float | None = None, rotation_limit: float | None = None
) -> bytes:
    """Draw the report as a PNG; the same report gives the same bytes with the same matplotlib.

    Args:
        report: the results.
        title: such as "100 scenarios of t2rgb".
        translation_limit: limit of the translation error, mm; drawn as a line.
        rotation_limit: limit of the rotation error, deg.

    Raises:
        InfrastructureError: matplotlib is not installed.
    """
    figures, rc_context = optional("matplotlib.figure", "the figure"), optional("matplotlib", "the figure").rc_context
    with rc_context(_FIGURE_STYLE):
        drawing = figures.Figure(figsize=(_WIDTH_IN, _HEIGHT_IN), dpi=_DPI, layout="constrained")
        drawing.suptitle(
            f"{_escape_mathematics(title)}: {len(report.calibrated)} of {len(report.results)} calibrate", fontsize=12
        )
        drivers = report.drivers[:DRIVERS_SHOWN]
        halves = drawing.add_gridspec(2, 1)
        upper, lower = drawing.add_subfigure(halves[0]), drawing.add_subfigure(halves[1])
        left, right = upper.add_subplot(1, 2, 1), upper.add_subplot(1, 2, 2)
        _draw_distribution(left, report, "translation_mm", "Translation error (mm)", translation_limit)
        _draw_distribution(right, report, "rotation_deg", "Rotation error (deg)", rotation_limit)
        for number, driver in enumerate(drivers):
            _draw_scatter(lower.add_subplot(1, len(drivers), number + 1), report, driver)
        if not drivers:
            text = f"What drives the error is not known: {why_unknown(len(report.ran))}"
            lower.text(0.5, 0.5, text, ha="center", color="#666666")
        png = io.BytesIO()
        drawing.savefig(png, format="png", metadata={"Software": None})
    return png.getvalue()


def _draw_distribution(axes: "Axes", report: Statistics, measure: str, label: str, limit: float | None) -> None:
    """Draw the cumulative distribution of the errors; it ends below 100 % if some scenarios do not calibrate."""
    values = sorted(value for result in report.calibrated if (value := getattr(result, measure)) is not None)
    total = len(report.results)
    shares = [100 * (number + 1) / total for number in range(len(values))]
    axes.step([0.0, *values], [0.0, *shares], where="post", color=_DOT_COLOUR, linewidth=1.6)
    found = report.percentiles(measure)
    for percent in (50, 95):
        if percent in found:
            share = shares[values.index(found[percent])]
            axes.plot(found[percent], share, "o", color=_DOT_COLOUR, markersize=5)
            name = "median" if percent == 50 else f"{percent} %"
            axes.annotate(
                f"{name}: {found[percent]:.3g}", (found[percent], share), (7, -11), textcoords="offset points"
            )
    if limit is not None:
        axes.axvline(limit, color=_LIMIT_COLOUR, linewidth=1.2, linestyle="--", label=f"limit: {limit:g}")
        axes.legend(loc="upper left", borderaxespad=0)
    axes.set(xlabel=label, ylabel="Scenarios with at most that (%)", ylim=(0, 115))
    axes.set_xlim(0, 1.1 * max([*values[-1:], limit or 0]) or 1)
    axes.set_yticks(range(0, 101, 20))


def _draw_scatter(axes: "Axes", report: Statistics, driver: Driver) -> None:
    """Draw the error over one parameter; a cross at the top for each scenario without a calibration."""
    places = {result.id: driver.of(result.values) for result in report.results}
    errors = {result.id: result.translation_mm for result in report.calibrated if result.translation_mm is not None}
    lost = [place for scenario, place in places.items() if scenario not in errors]
    axes.plot(
        [places[scenario] for scenario in errors],
        list(errors.values()),
        "o",
        color=_DOT_COLOUR,
        markersize=3.5,
        alpha=0.75,
    )
    axes.set_ylim(0, 1.25 * max(errors.values(), default=0) or 1)
    if lost:
        top = axes.get_xaxis_transform()
        axes.plot(lost, [0.96] * len(lost), "x", color=_LOST_COLOUR, markersize=5, transform=top)
        axes.text(0.01, 0.9, "no calibration", color=_LOST_COLOUR, fontsize=8, transform=axes.transAxes)
    chance = "stands out" if driver.stands_out else "may be chance"
    axes.set_title(f"rank correlation {driver.correlation:+.2f} (p {driver.p:.2g}, {chance})", fontsize=8)
    axes.set(xlabel=_escape_mathematics(driver.parameter), ylabel="Translation error (mm)")


def _escape_mathematics(text: str) -> str:
    """Escape the characters that matplotlib takes for mathematics."""
    return text.replace("$", r"\$")
