"""The stages build and promote: the image of a run, and its release tags after a verdict that is pass."""

from dataclasses import replace
from pathlib import Path

from calibration.errors import WorldError
from calibration.image.building import build_image
from calibration.image.specification import ImageSpecification
from calibration.pipeline.report import write_results
from calibration.pipeline.results import ImageResult, Results
from calibration.registries.login import registry_login
from calibration.registries.promotion import promote
from calibration.workflow import Runner


def build_stage(specification: ImageSpecification, output: Path, runner: Runner) -> ImageResult:
    """Find the image, or build it; and push it where the specification says so.

    Raises:
        InputError: the specification, or a file that it names, is wrong.
        WorldError: there is no engine, or a registry does not answer.
        CalibrationError: a step of the build failed (exit code 1).
    """
    built = build_image(specification, runner, leave_out=[output])  # it changes with every run
    return ImageResult(built.reference, built.key, built.built, built.digest, round(built.seconds, 4))


def promote_stage(specification: ImageSpecification, results: Results, output: Path, runner: Runner) -> Results:
    """Give the image that was tested its release tags, if the verdict is pass; nothing is built or pulled.

    Raises:
        WorldError: the registry does not answer, or the image was not pushed.
    """
    image = results.image
    if image is None or results.verdict != "pass":
        runner.log(f"not promoted: the verdict is {results.verdict}")
        return results
    if runner.pull_request:
        runner.log("not promoted: a pull request is not merged yet")
        return results
    if image.digest is None:
        raise WorldError(f"image.promote: {image.reference} is in no registry; add push: true to the section image")
    credentials = registry_login(specification.registry, specification.name, runner)
    promoted = promote(specification.name, image.digest, specification.promote, credentials, runner)
    results = replace(results, image=replace(image, promoted=tuple(promoted)))
    write_results(results, output)
    return results
