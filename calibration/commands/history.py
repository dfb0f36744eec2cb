"""``history``: accepted calibrations over the commits of a repository."""

from collections.abc import Iterator
from pathlib import Path

import click

from calibration.base import CalibrationError, ExitCode
from calibration.ci.report import Lines, Report, Table, count_of, publish
from calibration.ci.workflow import Runner
from calibration.commands.parameters import TEXT_LIST, path, text
from calibration.pipeline.configuration import DEFAULT_FILE, read_configuration
from calibration.pipeline.history import History, LevelStep, Trend, figure, history_of

FIGURE_FILE = "history.svg"
MAX_COMMITS = 10_000
STEPS_SHOWN = 200


@click.command("history")
@click.option("--config", type=path, default=DEFAULT_FILE, show_default=True, help="The configuration.")
@click.option("--systems", type=TEXT_LIST, help="Only these systems (all).")
@click.option("--since", type=text, help="Only commits after this one, or after this date (2026-11-02).")
@click.option("--output", type=path, default="output/history", show_default=True, help="Folder for results and figure.")
def command(config: Path, systems: tuple[str, ...] | None, since: str | None, output: Path) -> ExitCode:
    """Follow calibration-baseline.json through git: movements of sensors, sudden or gradual.

    Nothing is checked out. The verdict is always pass: changes in commits were accepted.
    """
    runner = Runner.from_environment()
    file = read_configuration(config).baseline.file
    found = history_of(file, systems or (), since, MAX_COMMITS)
    try:
        drawing = figure(found)
    except CalibrationError as error:
        drawing = None
        runner.log(str(error))
    publish(report(found, drawing), runner, output)
    return ExitCode.PASS


def report(found: History, drawing: bytes | None) -> Report:
    """Return the report of a history.

    Args:
        found: the history.
        drawing: its figure as SVG, or None.
    """
    steps = [(trend, step) for trend in found.trends for step in trend.steps]
    creeping = [trend for trend in found.trends if trend.crept_mm is not None]
    return Report(
        title="history",
        verdict="pass",
        sentence=f"{found.commits} accepted, {count_of(len(steps), 'change')}",
        blocks=(
            Table(
                ("Commit", "What", "Change", "Subject"),
                tuple(
                    (f"{step.date} {step.commit[:7]}", _name_of_trend(t), _size_of_step(step), step.subject)
                    for t, step in steps
                ),
                STEPS_SHOWN,
            ),
            Lines(tuple(_creep_text(trend) for trend in creeping), title="Creeping"),
            Lines(tuple(f"{each[:12]}: no baseline of this version" for each in found.unreadable), title="Left out"),
            Table(
                ("Trend", "From", "To", "Moved in all", "Standard deviation"),
                tuple(_rows_of_trends(found)),
                STEPS_SHOWN,
            ),
        ),
        results=found,
        outputs={"changes": found.changes},
        notes=tuple(_creep_text(trend) for trend in creeping),
        files={FIGURE_FILE: drawing} if drawing else {},
    )


def _name_of_trend(trend: Trend) -> str:
    return f"{trend.system}: {trend.name}"


def _size_of_step(step: LevelStep) -> str:
    return f"{step.rms_px:+.3g} px" if step.rms_px is not None else f"{step.mm:.3g} mm, {step.deg:.2g} deg"


def _creep_text(trend: Trend) -> str:
    first, count = trend.points[0], len(trend.points)
    return (
        f"{_name_of_trend(trend)} has crept {trend.crept_mm:.3g} mm in {count - 1} accepted changes since {first.date} "
        f"({first.commit[:7]})"
    )


def _rows_of_trends(found: History) -> Iterator[tuple[str, ...]]:
    for trend in found.trends:
        first, last = trend.points[0], trend.points[-1]
        if trend.name == "RMS":
            yield _name_of_trend(trend), f"{first.rms_px:.4g} px", f"{last.rms_px:.4g} px", "-", "-"
        else:
            moved = sum(v * v for v in last.translation_mm) ** 0.5
            yield _name_of_trend(trend), first.date, last.date, f"{moved:.3g} mm", f"{last.sigma_mm:.2g} mm"
