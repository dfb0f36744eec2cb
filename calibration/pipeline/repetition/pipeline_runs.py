"""Repeated runs of the pipeline's stages."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from calibration.base.addons import import_attribute, of_addons
from calibration.base.errors import ExitCode
from calibration.ci.report import show
from calibration.ci.workflow.runner import OutputValue
from calibration.pipeline.repetition.repetition import (
    Repetition,
    numbers_of_run,
    outcomes_of_stages,
    outputs_of_run,
    poses_of_run,
)
from calibration.pipeline.repetition.running import repeated, run_of_repetition
from calibration.pipeline.repetition.settings import Repetitions
from calibration.pipeline.results import PipelineResults
from calibration.pipeline.stages.running import STAGES, PipelineRun, check_stages, run_stages, stages_reported

AFTER_ALL = ("promote", *(name for name, stage in of_addons(lambda addon: addon.stages).items() if stage.last))
"""Stages that follow from the verdict: made once, of the last run, after a pass of all."""


def repeat_stages(run: PipelineRun, stages: Collection[str], settings: Repetitions) -> tuple[ExitCode, PipelineResults]:
    """Run stages as often as it is asked for, and report; return the exit code, and the results of the last run.

    What follows from the verdict (`AFTER_ALL`) is done once.

    Raises:
        InputError: an input is wrong, or another run uses the output folder.
        InfrastructureError: a file cannot be written, a process died, an engine or a registry does not answer.
    """
    if settings.repeat == 1:
        results = run_stages(run, stages)
        return results.exit_code, results
    check_stages(stages)
    last: PipelineRun = run
    outputs: Mapping[str, OutputValue | None] = {}
    tested = [name for name in stages if name not in AFTER_ALL]

    def once(folder: Path) -> Repetition:
        nonlocal last, outputs
        target = replace(run.target, run=run_of_repetition(run.target.run, folder))
        last, found = stages_reported(replace(run, output=folder, target=target), tested)
        results, outputs = last.results, found.outputs
        return Repetition(
            folder=folder,
            verdict=results.verdict,
            sentence=found.sentence,
            seconds=last.seconds,
            outcomes=(*(each for suite in found.suites.values() for each in suite), *outcomes_of_stages(results)),
            numbers=numbers_of_run(results),
            poses=poses_of_run(results, folder, last.given),
            outputs=outputs_of_run(results, folder),
            error=results.exit_code if results.exit_code > ExitCode.FAIL else None,
        )

    passes = all(system.undecided == "pass" for system in run.matrix.systems)
    whole, found = repeated(settings, run.output, run.runner, "Repeated calibration", once, passes)
    for name, stage in STAGES.items():
        if whole.passes and name in AFTER_ALL and name in stages and stage.applies(run):
            last = import_attribute(stage.target)(last)
    outputs = {**outputs, **found.outputs, "output": run.output}
    show(replace(found, outputs=outputs), run.runner, run.output)
    return whole.exit_code, last.results
