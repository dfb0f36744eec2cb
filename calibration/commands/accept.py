"""``accept``: make the results of a run the accepted baseline of later runs."""

from contextlib import ExitStack
from pathlib import Path

import click

from calibration.base.errors import ExitCode, InputError
from calibration.base.text import one_line
from calibration.ci.execution.workspace import locked
from calibration.ci.workflow import Runner, stop_commands
from calibration.commands.parameters import TEXT_LIST, path, text
from calibration.engine.baseline.document import read_baseline, write_baseline
from calibration.pipeline.baselines import accept
from calibration.pipeline.configuration import DEFAULT_FILE, read_configuration
from calibration.pipeline.matrix.cell_verdict import judge_results
from calibration.pipeline.results import read_results


@click.command("accept")
@click.option("--config", type=path, default=DEFAULT_FILE, show_default=True, help="The configuration.")
@click.option("--output", type=path, default="output", show_default=True, help="Folder of the run's results.")
@click.option("--systems", type=TEXT_LIST, help="Only these systems (all of the results).")
@click.option("--although", type=text, help="Reason to accept a failed system; saved in the file.")
def command(config: Path, output: Path, systems: tuple[str, ...] | None, although: str | None) -> ExitCode:
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
        write_baseline(file, baseline)
    with stop_commands(runner):
        for name in names:
            runner.log(one_line(f"{name}: accepted"))
        runner.log(one_line(f"{file} is written: commit it"))
    return ExitCode.PASS
