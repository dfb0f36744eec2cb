"""``accept``: make the results of a run the accepted baseline of later runs."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import click

from calibration.base import ExitCode, InputError, one_line, write_atomically
from calibration.base.addons import import_attribute, of_addons
from calibration.ci.execution.tasks import locked
from calibration.ci.workflow import Runner, stop_commands
from calibration.commands.parameters import TEXT_LIST, path, text
from calibration.engine.baseline.document import read_baseline, write_baseline
from calibration.pipeline.baselines import AcceptedSystems, accept
from calibration.pipeline.configuration import DEFAULT_FILE, read_configuration
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
def command(
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
