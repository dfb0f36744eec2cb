"""Stages build and promote: the image of a run, and its release tags after a pass verdict."""

from dataclasses import replace

from calibration.base import InfrastructureError
from calibration.ci.image.building import build_image
from calibration.ci.registries.push import promote
from calibration.ci.registries.registry import registry_login
from calibration.pipeline.collection.request import CollectionRequest
from calibration.pipeline.results import ImageResult
from calibration.pipeline.stages.running import PipelineRun
from calibration.pipeline.system import System


def build_stage(run: PipelineRun) -> PipelineRun:
    """Find the image, or build it, push it if specified, and use it for containers that name no other.

    Raises:
        InputError: the specification, or a file that it names, is wrong.
        InfrastructureError: there is no engine, or a registry does not answer.
        CalibrationError: a step of the build failed (exit code 1).
    """
    if run.image is None:
        return run
    built = build_image(run.image, run.runner, leave_out=[run.output])  # it changes with every run
    image = ImageResult(built.reference, built.key, built.built, built.digest, round(built.seconds, 4))
    systems = tuple(_in_image(system, image.reference) for system in run.matrix.systems)
    return replace(
        run,
        matrix=replace(run.matrix, systems=systems),
        simulations=tuple(_collected_in(simulation, image.reference) for simulation in run.simulations),
        results=replace(run.results, image=image),
    )


def _in_image(system: System, image: str) -> System:
    return system if system.software is None else replace(system, software=system.software.with_image(image))


def _collected_in(request: CollectionRequest, image: str) -> CollectionRequest:
    return replace(request, applications=request.applications.with_image(image))


def promote_stage(run: PipelineRun) -> PipelineRun:
    """Give the tested image its release tags, if the verdict is pass; nothing is built or pulled.

    Raises:
        InfrastructureError: the registry does not answer, or the image was not pushed.
    """
    specification, image = run.image, run.results.image
    if specification is None or image is None or not run.results.passes:
        run.runner.log(f"not promoted: the verdict is {run.results.verdict}")
        return run
    if run.runner.pull_request:
        run.runner.log("not promoted: a pull request is not merged yet")
        return run
    if image.digest is None:
        raise InfrastructureError(
            f"image.promote: {image.reference} is in no registry; add push: true to the section image"
        )
    credentials = registry_login(specification.registry, specification.name, run.runner)
    promoted = promote(specification.name, image.digest, specification.promote, credentials, run.runner)
    return replace(run, results=replace(run.results, image=replace(image, promoted=tuple(promoted))))
