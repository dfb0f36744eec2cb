"""Run of the pipeline: its stages in order, and the report of their results.

A stage takes a `PipelineRun` and returns it with its results; it only decides what runs and what counts. A new one is a
function in a module of its own, and a line in `STAGES`.
"""

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.base import InputError, did_you_mean, line_of
from calibration.base.addons import AddonStage, import_attribute, of_addons
from calibration.ci.execution.backends import ExecutionTarget, Sections
from calibration.ci.execution.job import Container
from calibration.ci.execution.tasks import locked
from calibration.ci.report import Report, show
from calibration.ci.report.report import StageResult
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import LogDisplay
from calibration.engine.baseline.quality import BaselineSettings
from calibration.engine.dataset.model import Dataset
from calibration.pipeline.matrix.loaded_system import load
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.page.run_page import accepted_history, report_page
from calibration.pipeline.report import report, write_cells, write_results
from calibration.pipeline.results import PAGE_FILE, PipelineResults, clear_results, reason_of_end

if TYPE_CHECKING:
    from calibration.ci.image.specification import ImageSpecification
    from calibration.pipeline.collection.request import CollectionRequest


COLLECTED_FOLDER = "collected"
"""Folder of collected datasets, in a pipeline's output folder."""


@dataclass(frozen=True)
class PipelineRun:
    """Options of a run of the pipeline, and the results of its stages so far."""

    matrix: Matrix
    """Cells, and how they are judged."""
    output: Path
    """Folder for the files of all stages."""
    runner: Runner
    """Output of progress, logs of containers and the report."""
    title: str = "calibration run"
    """Title of the progress and the annotations."""
    config: Path | None = None
    """Configuration file, for annotations in it."""
    jobs: int | None = None
    """Number of parallel processes or containers; None for as many as the machine can run."""
    fail_fast: bool = False
    """Whether the first cell that fails stops the others."""
    simulations: "tuple[CollectionRequest, ...]" = ()
    """Simulations of the stage collect."""
    image: "ImageSpecification | None" = None
    """Image of the stage build."""
    baseline: BaselineSettings | None = None
    """Baseline and allowed changes; None for no comparison."""
    sections: Sections = field(default_factory=Sections)
    """Sections of calibration.yml for the stages of add-ons."""
    target: ExecutionTarget = field(default_factory=ExecutionTarget)
    """Execution target of the containers, and settings of the others."""
    results: PipelineResults = field(default_factory=PipelineResults)
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Duration of each stage that has run."""
    given: Mapping[str, Dataset] = field(default_factory=dict)
    """Datasets that the stage calibrate has read, by system."""

    def with_result(self, section: str, result: StageResult) -> "PipelineRun":
        """Return the run with the result of an add-on's stage."""
        of_stages = replace(self.results.of_stages, **{section: result})
        return replace(self, results=replace(self.results, of_stages=of_stages))


@dataclass(frozen=True)
class PipelineStage:
    """Entry of a stage in `STAGES`: its function, and when it applies."""

    target: str
    """``module:function`` from run to run; imported when it runs, as it may need packages that others do not."""
    applies: Callable[[PipelineRun], bool] = lambda _: True
    """Returns whether the stage has something to do in a run."""
    needs_image: Callable[[PipelineRun], bool] = lambda _: False
    """Returns whether it runs in the image of the run, which is built for it."""


def _lack_image(containers: Iterable[Container]) -> bool:
    """Return whether one of them has no image of its own."""
    return not all(container.image for container in containers)


def _stage_of_addon(stage: AddonStage) -> PipelineStage:
    return PipelineStage(
        stage.target, lambda run: run.sections.of(stage.section) is not None, lambda _: stage.needs_image
    )


STAGES: Mapping[str, PipelineStage] = {
    "build": PipelineStage("calibration.pipeline.stages:build_stage", lambda run: run.image is not None),
    "collect": PipelineStage(
        "calibration.pipeline.collection.collecting:collect_stage",
        lambda run: bool(run.simulations),
        lambda run: _lack_image(each for request in run.simulations for each in request.applications.containers),
    ),
    "calibrate": PipelineStage(
        "calibration.pipeline.stages:calibrate_stage",
        needs_image=lambda run: _lack_image(software.container for software in run.matrix.software.values()),
    ),
    "introspect": PipelineStage("calibration.pipeline.stages:introspect_stage"),
    "export": PipelineStage(
        "calibration.pipeline.stages:export_stage",
        lambda run: any(system.exports for system in run.matrix.systems),
    ),
    **{
        name: _stage_of_addon(stage)
        for name, stage in sorted(of_addons(lambda addon: addon.stages).items(), key=lambda entry: entry[1].last)
    },
    "promote": PipelineStage(
        "calibration.pipeline.stages:promote_stage", lambda run: bool(run.image and run.image.promote)
    ),
}
"""All stages, in order."""


def run_stages(run: PipelineRun, stages: Collection[str] = tuple(STAGES)) -> PipelineResults:
    """Run stages, and report their results; see `stages_reported`."""
    run, found = stages_reported(run, stages)
    show(found, run.runner, run.output)
    return run.results


def stages_reported(run: PipelineRun, stages: Collection[str]) -> tuple[PipelineRun, Report]:
    """Run stages, and write the report of their results, which is not shown yet.

    Args:
        run: options of the run.
        stages: the stages to run; an image that their containers need is built in any case.

    Raises:
        InputError: there is no such stage, an input is wrong, or another run uses the output folder.
        InfrastructureError: a file cannot be written, a process died, an engine or a registry does not answer.
    """
    check_stages(stages)
    if "calibrate" in stages:
        _check_systems(run)
    with locked(run.output):
        return _run_stages(_with_collected_datasets(run), stages)


def _run_stages(run: PipelineRun, stages: Collection[str]) -> tuple[PipelineRun, Report]:
    if "calibrate" in stages or "collect" in stages:
        clear_results(run.output, _input_paths(run.matrix))
    wants_image = any(STAGES[name].needs_image(run) and STAGES[name].applies(run) for name in stages)
    try:
        for name, stage in STAGES.items():
            if stage.applies(run) and (name in stages or (name == "build" and wants_image)):
                begin = time.perf_counter()
                run = import_attribute(stage.target)(run)
                run = replace(run, seconds={**run.seconds, name: time.perf_counter() - begin})
        write_cells(run.results, run.output, run.jobs)
        found = report(run.results, run.output)
        files = {**found.files, PAGE_FILE: _page_of_run(found, run)}
    except BaseException as error:  # signals too: the results of earlier stages are kept for another run
        # results of an earlier run are not replaced if only an image was built
        if run.results.has_verdict:
            write_results(run.results, run.output, reason_of_end(error))
        raise
    outputs = {**found.outputs, "report": run.output / PAGE_FILE}
    places = _places_of_reasons(found.all_reasons, run)
    found = replace(found, places=places, files=files, outputs=outputs)
    found.write(run.output)
    return run, found


def _page_of_run(found: Report, run: PipelineRun) -> str:
    accepted = accepted_history(run.baseline.file) if run.baseline and run.baseline.file.exists() else None
    return report_page(found, run.results, run.output, run.matrix, accepted, run.given)


def _places_of_reasons(reasons: Sequence[str], run: PipelineRun) -> dict[str, tuple[Path, int]]:
    """Return the lines of the rules or limits in the reasons, for a runner that annotates them."""
    if run.config is None or not run.runner.service.annotates_lines:
        return {}
    found = {}
    for reason in reasons:
        names = (system for system in run.matrix.systems if reason.startswith((f"{system.name},", f"{system.name}:")))
        system = next(names, None)
        if len(run.results.cells) == 1:  # its reasons have no name in front
            [cell] = run.results.cells
            own = reason.removeprefix("undecided: ") in cell.all_reasons
            system = next((each for each in run.matrix.systems if own and each.name == cell.system), system)
        if system is None:
            continue
        rules = system.rules.rules if system.rules else ()
        column = next((rule.column for rule in rules if f"{rule.column}, " in reason), None)
        keys = ("systems", system.name, "limits" if column is None else "rules")
        if (line := line_of(run.config, keys, column)) is not None:
            found[reason] = (run.config, line)
    return found


def check_stages(stages: Collection[str]) -> None:
    """Refuse stages that there are not, and a promotion without a verdict.

    Raises:
        InputError: names the stage.
    """
    for stage in stages:
        if stage not in STAGES:
            raise InputError(
                f"only: there is no stage '{stage}'{did_you_mean(stage, STAGES)} (stages: {', '.join(STAGES)})"
            )
    if "promote" in stages and "introspect" not in stages:
        raise InputError("only: promote needs the verdict of this run: add calibrate and introspect")


def _check_systems(run: PipelineRun) -> None:
    """Read the systems before an image is built or a dataset is collected, which takes minutes."""
    if run.image is not None or run.simulations:
        for system in run.matrix.systems:
            if system.collected is None:
                load(system)


def _with_collected_datasets(run: PipelineRun) -> PipelineRun:
    """Return the run with the paths of collected datasets, of this or an earlier run, and with visible logs."""
    systems = [
        system
        if system.collected is None
        else replace(system, dataset=run.output / COLLECTED_FOLDER / system.collected)
        for system in run.matrix.systems
    ]
    target = replace(run.target, show=LogDisplay(run.runner))
    return replace(run, matrix=replace(run.matrix, systems=tuple(systems)), target=target)


def _input_paths(matrix: Matrix) -> list[Path]:
    folders = [system.dataset for system in matrix.systems]
    known = [path for system in matrix.systems if isinstance(path := system.options.intrinsics_covariance, Path)]
    return [path / "dataset.json" if path.is_dir() else path for path in folders] + known
