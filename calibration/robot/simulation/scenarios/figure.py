"""Figure of many scenarios: distribution of the errors, and their dependence on the drivers."""

import io
from typing import TYPE_CHECKING, Any

from calibration.base.optional import optional
from calibration.robot.simulation.scenarios.drivers import Driver
from calibration.robot.simulation.scenarios.statistics import Statistics, why_unknown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
