"""Report on many scenarios of one system."""

import re
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from calibration.base import InfrastructureError
from calibration.ci.report import FILES, Block, Code, Lines, Outcome, Report, Table, Text, count_of, shown
from calibration.pipeline.collection.results import ScenarioResults
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.scenarios.statistics import (
    REPORTED_PERCENTILES,
    SIGNIFICANCE_LEVEL,
    Statistics,
    figure,
    why_unknown,
)

TABLE_FILE, FIGURE_FILE = "scenarios.csv", "scenarios.png"
REPORT_FILES = (*FILES, TABLE_FILE, FIGURE_FILE)
WORST_SHOWN = 5
DRIVERS_SHOWN = 8
REASONS_SHOWN = 20
_NAME_OF_PERCENTILE = {0: "least", 50: "median", 100: "worst"}
_HEADING_OF_MEASURE = {
    "translation_mm": "Translation error (mm)",
    "rotation_deg": "Rotation error (deg)",
    "joint_mm": "Joint error (mm)",
    "joint_deg": "Joint error (deg)",
    "error_sigmas": "Error (stated standard deviations)",
    "rms_px": "RMS of the reprojection (px)",
    "corner_rms_px": "Corners against the truth (px)",
}
_NUMBER_PATTERN = re.compile(r"\d+(\.\d+)?")


def report(results: ScenarioResults, output: Path) -> Report:
    """Return the report, with its figure if it can be drawn.

    Args:
        results: the results.
        output: the folder for the results.
    """
    statistics, checks = results.statistics, results.request.collection.effective_checks
    notes: tuple[str, ...] = ()
    pictures: dict[str, str | bytes] = {}
    try:
        drawn = figure(statistics, results.title, checks.limits.translation_mm, checks.limits.rotation_deg)
        pictures = {FIGURE_FILE: drawn}
    except InfrastructureError as error:  # matplotlib is not installed
        notes = (str(error),)
    worst = [result.id for result in statistics.worst(WORST_SHOWN)]
    passed = len(statistics.results) - len(results.failed)
    return Report(
        title="Scenarios in simulation",
        verdict=results.verdict,
        error=results.exit_code,
        sentence=f"{passed} of {results.title} pass",
        reasons=tuple(results.reasons),
        warnings=(*(f"{each}: {'; '.join(why)}" for each, why in results.failed.items()), *results.findings),
        notes=notes,
        blocks=(
            Text(_counts_sentence(statistics), only="summary"),
            distribution(statistics),
            Text("Over the scenarios that calibrate; errors are those of the worst sensor.", only="summary"),
            *_worst_scenarios(results),
            *drivers(statistics),
            Lines(tuple(results.findings), title="Errors beyond what is stated"),
            _reasons_of_losses(statistics),
        ),
        suites={f"scenarios of {results.system}": [_junit_outcome(results, result) for result in statistics.results]},
        results={
            "system": results.system,
            "seed": results.request.collection.seed,
            "success_rate": results.success_rate,
            "failed": results.failed,
            "errors": dict(results.errors),
            "findings": results.findings,
            **document(statistics),
        },
        outputs={
            **dict.fromkeys(("dataset", "collections", "lost", "detection-rate", "corner-error-px")),  # of one dataset
            "success-rate": results.success_rate,
            "worst-scenarios": worst,
            "translation-mm": statistics.percentiles("translation_mm").get(100),
            "rotation-deg": statistics.percentiles("rotation_deg").get(100),
            "report": None,  # of one scenario
            "contact-sheet": output / FIGURE_FILE if pictures else None,
        },
        files={TABLE_FILE: scenarios_table(statistics.results).csv(), **pictures},
    )


def scenario_line(result: ScenarioResult) -> str:
    """Return a line on one scenario, for the progress."""
    if not result.converged:
        return f"{result.id}: {'; '.join(result.reasons) or 'does not calibrate'}"
    error = "" if result.translation_mm is None else f", {result.translation_mm:.3g} mm, {result.rotation_deg:.2g} deg"
    return f"{result.id}: {result.kept}/{result.poses} collections{error}"


def document(statistics: Statistics) -> dict[str, Any]:
    """Return the statistics for ``results.json``."""
    return {
        "count": len(statistics.results),
        "calibrated": len(statistics.calibrated),
        "percentiles": {
            measure: {str(p): value for p, value in statistics.percentiles(measure).items()}
            for measure in _HEADING_OF_MEASURE
        },
        "worst": [result.id for result in statistics.worst(WORST_SHOWN)],
        "drivers": [{**asdict(driver), "stands_out": driver.stands_out} for driver in statistics.drivers],
        "scenarios": [{**asdict(result), "kept": result.kept} for result in statistics.results],
    }


def _junit_outcome(results: ScenarioResults, result: ScenarioResult) -> Outcome:
    reasons = tuple(results.failed.get(result.id, ()))
    return Outcome(name=result.id, group=results.system, reasons=reasons, error=results.errors.get(result.id))


def _counts_sentence(statistics: Statistics) -> str:
    poses, kept = (sum(getattr(result, what) for result in statistics.results) for what in ("poses", "kept"))
    scenarios = count_of(len(statistics.results), "scenario")
    return f"{len(statistics.calibrated)} of {scenarios} calibrate; {kept} of {poses} poses gave a collection."


def distribution(statistics: Statistics) -> Table:
    """Return the percentiles of each error."""
    rows = (
        (name, *(f"{value:.3g}" for value in percentiles.values()))
        for measure, name in _HEADING_OF_MEASURE.items()
        if (percentiles := statistics.percentiles(measure))
    )
    return Table(("", *(_NAME_OF_PERCENTILE.get(p, f"{p} %") for p in REPORTED_PERCENTILES)), tuple(rows))


def _worst_scenarios(results: ScenarioResults) -> list[Block]:
    """Return the worst scenarios, with their parameters and replay commands folded."""
    statistics = results.statistics
    worst = statistics.worst(WORST_SHOWN)
    rows = (
        (
            result.id,
            shown(result.translation_mm, ".3g"),
            shown(result.rotation_deg, ".2g"),
            shown(result.sigma_mm, ".3g"),
            shown(result.error_sigmas, ".2g"),
            f"{result.kept}/{result.poses}",
            "; ".join(result.reasons) or "calibrates",
        )
        for result in worst
    )
    header = ("Scenario", "Error (mm)", "Error (deg)", "Stated sigma (mm)", "Error (sigmas)", "Collections", "Outcome")
    first = statistics.results[0].values
    names = [name for name in first if any(result.values[name] != first[name] for result in statistics.results)]
    values = tuple((name, *(f"{result.values[name]:g}" for result in worst)) for name in names)
    parameters = Table(("Parameter", *(result.id for result in worst)), values)
    commands = "\n".join(replay(results, result.id) for result in worst)
    return [
        Table(header, tuple(rows), title="Worst scenarios"),
        replace(parameters, title="Their parameters", folded=True, only="summary"),
        Code(commands, title="How to replay them", folded=True, only="summary"),
    ]


def replay(results: ScenarioResults, scenario: str) -> str:
    """Return the command that collects one of the scenarios."""
    of, request = results.request.collection, results.request
    words = ["calibration", "collect-data-sim", "--system", str(of.system or results.system)]
    words += [*request.applications, "--scenario", scenario]
    options = (("scenario-set", of.scenario_set), ("robot", of.robot), ("config", of.config))
    for option, value in (*options, ("motion", of.motion)):
        words += [f"--{option}", str(value)] if value is not None else []
    return shlex.join([*words, "--output", scenario])


def drivers(statistics: Statistics) -> list[Block]:
    """Return the parameters that correlate significantly with the translation error."""
    title, ranked = "What drives the error", statistics.drivers
    strong = [driver for driver in ranked if driver.stands_out]
    if not ranked:
        return [Text(f"Not known: {why_unknown(len(statistics.ran))}.", title=title)]
    if not strong:
        text = (
            f"None of the parameters that vary ({len(ranked)}) stands out. The strongest is {ranked[0].parameter}, "
            f"rank correlation {ranked[0].correlation:+.2f}: chance gives as much with probability {ranked[0].p:.2g}."
        )
        return [Text(text, title=title)]
    rows = tuple((d.parameter, f"{d.correlation:+.2f}", f"{d.p:.2g}") for d in strong[:DRIVERS_SHOWN])
    text = (
        f"Spearman's; p (below {SIGNIFICANCE_LEVEL:g} here) is the probability that chance gives as much with any of "
        f"the {len(ranked)} parameters. Between bars: a parameter's magnitude. A scenario without a calibration counts "
        "as the worst."
    )
    header = ("Parameter", "Rank correlation with the translation error", "p")
    return [Table(header, rows, title=title), Text(text, only="summary")]


def _reasons_of_losses(statistics: Statistics) -> Lines:
    """Return the reasons of rejected poses, most frequent first; reasons that differ only in numbers are merged."""
    lost = [each for result in statistics.results for reasons in (result.lost or {}).values() for each in reasons]
    examples: dict[str, str] = {}
    for reason in lost:
        examples.setdefault(_NUMBER_PATTERN.sub("#", reason), reason)
    counts = Counter(_NUMBER_PATTERN.sub("#", reason) for reason in lost)
    listed = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    lines = tuple(f"{count}: {examples[kind]}" for kind, count in listed)
    title = "Why poses were lost: one example of each reason"
    return Lines(lines, REASONS_SHOWN, title=title, only="summary")


def scenarios_table(results: Sequence[ScenarioResult]) -> Table:
    """Return a row for each scenario, for ``scenarios.csv``; an empty cell where there is no value."""
    rows = [
        {name: "" if value is None else str(value) for name, value in _csv_row(result).items()} for result in results
    ]
    return Table(tuple(rows[0]) if rows else (), tuple(tuple(row.values()) for row in rows))


def _csv_row(result: ScenarioResult) -> dict[str, object]:
    measures = (
        "corner_rms_px",
        "rms_px",
        "translation_mm",
        "rotation_deg",
        "joint_mm",
        "joint_deg",
        "sigma_mm",
        "sigma_deg",
        "error_sigmas",
        "chance",
    )
    return {
        "id": result.id,
        "hash": result.hash,
        "converged": int(result.converged),
        "poses": result.poses,
        "kept": result.kept,
        "detection_rate": min((result.detection or {}).values(), default=0.0),
        **{measure: getattr(result, measure) for measure in measures},
        **result.values,
        "reasons": "; ".join(result.reasons),
    }
