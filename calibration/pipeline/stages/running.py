"""All stages, one after the other, and the report of what they found."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calibration.errors import InputError
from calibration.execution.backends import Place
from calibration.image.specification import ImageSpecification
from calibration.pipeline.collection.collected import COLLECTED
from calibration.pipeline.collection.request import ContainerRequest
from calibration.pipeline.configuration import Simulation
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.report import report
from calibration.pipeline.results import Results, clear_results
from calibration.pipeline.stages.calibrating import calibrate_stage, introspect_stage
from calibration.pipeline.system import System
from calibration.report import publish
from calibration.workflow import Runner
from calibration.workflow.streams import LogDisplay
from calibration.workflow.text import did_you_mean

STAGES = ("build", "collect", "calibrate", "introspect", "promote")
"""In their order."""


def run_stages(
    matrix: Matrix,
    output: Path,
    runner: Runner,
    title: str,
    jobs: int | None = None,
    fail_fast: bool = False,
    stages: Sequence[str] = STAGES,
    simulations: Sequence[Simulation] = (),
    image: ImageSpecification | None = None,
    place: Place | None = None,
) -> Results:
    """Run stages, and report what they found.

    Args:
        matrix: what to calibrate, and how to judge it.
        output: the folder between the stages.
        runner: where to report.
        title: of the annotations.
        jobs: processes, or containers at once; None for as many as the machine holds.
        fail_fast: whether the first cell that fails stops the others.
        stages: which ones.
        simulations: what the stage collect collects.
        image: what the stage build builds.
        place: where the team's software runs, and what is known of the cloud; this machine's engine unless given.

    Raises:
        InputError: there is no such stage, or an input is wrong.
        WorldError: a file cannot be written, a process died, an engine or a registry does not answer.
    """
    _check(stages)
    matrix = _placed(matrix, output)
    place = replace(place or Place(), show=LogDisplay(runner))
    results = Results(())
    if "calibrate" in stages or "collect" in stages:
        clear_results(output, _inputs(matrix))
    if image is not None and ("build" in stages or _needs_image(matrix, simulations)):
        from calibration.pipeline.stages.building import build_stage  # the engine's SDK, for those who need it

        built = build_stage(image, output, runner)
        matrix = replace(matrix, systems=tuple(_in_image(system, built.reference) for system in matrix.systems))
        simulations = [_simulated_in(simulation, built.reference) for simulation in simulations]
        results = replace(results, image=built)
    if "collect" in stages and simulations:
        from calibration.pipeline.stages.collecting import collect_stage  # OpenCV, which calibrating does without

        results = collect_stage(simulations, results, output, runner, jobs, place)
    if "calibrate" in stages:
        results = calibrate_stage(matrix, results, output, runner, title, jobs, fail_fast, place)
    if "introspect" in stages:
        results = introspect_stage(matrix.systems, results, output)
    if image is not None and image.promote and "promote" in stages:
        from calibration.pipeline.stages.building import promote_stage

        results = promote_stage(image, results, output, runner)
    publish(report(results, output, title), runner, output)
    return results


def _check(stages: Sequence[str]) -> None:
    for stage in stages:
        if stage not in STAGES:
            raise InputError(f"only: there is no stage '{stage}'{did_you_mean(stage, STAGES)}: {', '.join(STAGES)}")
    if "promote" in stages and "introspect" not in stages:
        raise InputError("only: promote needs the verdict of this run: add calibrate and introspect")


def _placed(matrix: Matrix, output: Path) -> Matrix:
    """The matrix with the datasets that are collected where this run, or an earlier one, puts them."""
    systems = [
        system if system.collected is None else replace(system, dataset=output / COLLECTED / system.collected)
        for system in matrix.systems
    ]
    return replace(matrix, systems=tuple(systems))


def _inputs(matrix: Matrix) -> list[Path]:
    folders = [system.dataset for system in matrix.systems]
    known = [system.intrinsics_covariance for system in matrix.systems if system.intrinsics_covariance]
    return [path / "dataset.json" if path.is_dir() else path for path in folders] + known


def _needs_image(matrix: Matrix, simulations: Sequence[Simulation]) -> bool:
    software = any(not software.container.image for software in matrix.software.values())
    requests = [s.request for s in simulations if isinstance(s.request, ContainerRequest)]
    return software or any(not container.image for r in requests for container in r.applications.containers)


def _in_image(system: System, image: str) -> System:
    return system if system.software is None else replace(system, software=system.software.with_image(image))


def _simulated_in(simulation: Simulation, image: str) -> Simulation:
    request = simulation.request
    if not isinstance(request, ContainerRequest):
        return simulation
    return replace(simulation, request=replace(request, applications=request.applications.with_image(image)))
