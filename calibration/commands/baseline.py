"""``accept``, ``history``: results of a run made the baseline of later ones, and the baseline over the commits."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import click

from calibration.base import CalibrationError, ExitCode, InputError, one_line, write_atomically
from calibration.base.addons import import_attribute, of_addons
from calibration.ci.execution.tasks import locked
from calibration.ci.report import Lines, Report, Table, count_of, publish
from calibration.ci.workflow import Runner, stop_commands
from calibration.commands.parameters import TEXT_LIST, path, text
from calibration.engine.baseline.document import read_baseline, write_baseline
from calibration.pipeline.baselines import AcceptedSystems, accept
from calibration.pipeline.configuration import DEFAULT_FILE, read_configuration
from calibration.pipeline.history import History, LevelStep, Trend, figure, history_of
from calibration.pipeline.matrix.matrix import judge_results
from calibration.pipeline.results import read_results
from calibration.pipeline.running import COLLECTED_FOLDER

KEPT = of_addons(lambda addon: addon.keeps)
"""Options of add-ons."""


def _options_of_addons(function: Callable[..., ExitCode]) -> Callable[..., ExitCode]:
    for name, kept in KEPT.items():
        function = click.option(f"--{name}", name, multiple=True, type=text, help=kept.help)(function)
    return function


@click.command("accept")
@click.option("--config", type=path, default=DEFAULT_FILE, show_default=True, help="The configuration.")
@click.option("--output", type=path, default="output", show_default=True, help="Folder of the run's results.")
@click.option("--systems", type=TEXT_LIST, help="Only these systems (all of the results).")
@click.option("--although", type=text, help="Reason to accept a failed system; saved in the file.")
@_options_of_addons
def accept_command(
    config: Path, output: Path, systems: tuple[str, ...] | None, although: str | None, **kept: tuple[str, ...]
) -> ExitCode:
    """Keep the results of a run in calibration-baseline.json, to be committed.

    Later runs are compared with it. Results that fail by the rules and limits of the configuration, except by a
    change from the baseline, are refused unless --although gives a reason to accept them.
    """
    runner = Runner.from_environment()
    if although is not None and not although.strip():
        raise InputError("--although: found nothing, expected the reason")
    configuration = read_configuration(config)
    file = configuration.baseline.file
    with ExitStack() as locks:
        # no run may write the results meanwhile, and no other accept the file
        for folder in sorted({each.resolve() for each in (output, file.parent) if each.is_dir()}):
            locks.enter_context(locked(folder))
        results = judge_results(read_results(output), configuration.systems, output)
        baseline, names = accept(results, output, systems or (), although, read_baseline(file))
        datasets = {
            each.name: output / COLLECTED_FOLDER / each.collected if each.collected else each.dataset
            for each in configuration.systems
            if each.name in names
        }
        accepted = AcceptedSystems(file, baseline, datasets)
        files: dict[Path, str] = {}
        for name, values in kept.items():
            files |= import_attribute(KEPT[name].target)(values, accepted) if values else {}
        write_baseline(file, baseline)
        for path_, content in files.items():
            write_atomically(path_, content)
    with stop_commands(runner):
        for name in names:
            runner.log(one_line(f"{name}: accepted"))
        for written in (file, *files):
            runner.log(one_line(f"{written} is written: commit it"))
    return ExitCode.PASS


FIGURE_FILE = "history.svg"
MAX_COMMITS = 10_000
STEPS_SHOWN = 200


@click.command("history")
@click.option("--config", type=path, default=DEFAULT_FILE, show_default=True, help="The configuration.")
@click.option("--systems", type=TEXT_LIST, help="Only these systems (all).")
@click.option("--since", type=text, help="Only commits after this one, or after this date (2026-11-02).")
@click.option("--output", type=path, default="output/history", show_default=True, help="Folder for results and figure.")
def history_command(config: Path, systems: tuple[str, ...] | None, since: str | None, output: Path) -> ExitCode:
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
    publish(history_report(found, drawing), runner, output)
    return ExitCode.PASS


def history_report(found: History, drawing: bytes | None) -> Report:
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
