"""What a user sees of many worlds: the distribution of errors in the log, the summary, annotations, outputs."""

from pathlib import Path
from typing import TYPE_CHECKING

from calibration.pipeline.collection.scenarios import (
    FIGURE_FILE,
    FILE,
    SUMMARY_FILE,
    ScenarioResults,
    scenario_markdown,
)
from calibration.workflow import Annotation, Level, Runner, add_summary, annotate, set_outputs, stop_commands
from calibration.workflow.text import aligned

if TYPE_CHECKING:
    from calibration.simulation.scenarios.result import ScenarioResult


def world_line(result: "ScenarioResult") -> str:
    """What came of one world, for the progress."""
    if not result.converged:
        return f"{result.id}: {'; '.join(result.reasons) or 'does not calibrate'}"
    error = "" if result.translation_mm is None else f", {result.translation_mm:.3g} mm, {result.rotation_deg:.2g} deg"
    return f"{result.id}: {result.kept}/{result.poses} collections{error}"


def report_scenarios(results: ScenarioResults, output: Path, runner: Runner, title: str) -> None:
    """Show the results that stand in the output folder.

    Raises:
        WorldError: a file of the runner cannot be written.
    """
    report = results.report
    columns = {50: "median", 95: "95 %", 100: "worst"}
    rows = []
    for measure, name in (("translation_mm", "Translation error (mm)"), ("rotation_deg", "Rotation error (deg)")):
        if found := report.percentiles(measure):
            rows.append((name, *(f"{found[p]:.3g}" for p in columns)))
    with stop_commands(runner):
        runner.log("")
        if rows:
            runner.log(aligned(("", *columns.values()), rows))
        runner.log(f"worst worlds: {', '.join(result.id for result in report.worst(5))}")
        strong = [d for d in report.drivers if d.stands_out][:5]
        drivers = ", ".join(f"{d.parameter} ({d.correlation:+.2f})" for d in strong) or "nothing stands out"
        runner.log(f"what drives the error: {drivers}")
        runner.log("")
    failed = [f"{each}: {'; '.join(why)}" for each, why in results.failed.items()]
    annotations = [Annotation(reason, title=title) for reason in results.reasons]
    annotations += [Annotation(line, Level.WARNING, title=title) for line in failed]
    annotations += [Annotation(note, Level.NOTICE, title=title) for note in results.notes]
    annotate(runner, annotations)
    add_summary(runner, scenario_markdown(results))
    worst = report.percentiles("translation_mm").get(100)
    turned = report.percentiles("rotation_deg").get(100)
    set_outputs(
        runner,
        {
            "verdict": results.verdict,
            **dict.fromkeys(("dataset", "collections", "lost", "detection-rate", "corner-error-px"), ""),
            "success-rate": results.success_rate,
            "worst-worlds": [result.id for result in report.worst(5)],
            "translation-mm": "" if worst is None else worst,
            "rotation-deg": "" if turned is None else turned,
            "contact-sheet": "" if results.notes else output / FIGURE_FILE,
            "results": output / FILE,
            "summary": output / SUMMARY_FILE,
        },
    )
    passed = len(report.results) - len(results.failed)
    runner.log(f"{results.verdict}: {passed} of {results.title} pass ({output / FILE})")
