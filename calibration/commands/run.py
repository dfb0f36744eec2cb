"""``run``: run the whole pipeline of ``calibration.yml``, with one verdict."""

from collections.abc import Mapping
from dataclasses import field as dataclass_field
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import click

from calibration.base import ExitCode
from calibration.base.records import at_least, changed, field, record
from calibration.ci.image.specification import ImageSpecification
from calibration.ci.workflow import Runner, set_outputs
from calibration.commands.parameters import chosen, given, record_options
from calibration.pipeline.configuration import DEFAULT_FILE, read_configuration
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.repetition.repetition import Repetitions
from calibration.pipeline.repetition.running import repeat_stages
from calibration.pipeline.running import STAGES, PipelineRun


@record(kw_only=True)
class RunSettings:
    """Inputs of ``run``."""

    config: Path = field("The configuration (calibration.yml).", default=DEFAULT_FILE)
    output: Path = field("Folder for results, tables and datasets (output).", default=Path("output"))
    only: tuple[str, ...] = field(f"Only these stages: {', '.join(STAGES)}.", default=())
    parallel: Annotated[int, at_least(1)] | None = field(
        "Number of parallel processes or containers (one per core).", default=None, formerly="jobs"
    )
    push: bool | None = field("Push the image; if false, it is not promoted either (as in config).", default=None)
    repetitions: Mapping[str, Any] = dataclass_field(default_factory=dict)
    """Keys of `Repetitions` that replace those of the configuration."""


@click.command("run")
@record_options(RunSettings)
@record_options(Repetitions, "repeat")
@record_options(Repetitions, "max-flake-rate", instead="")
def command(**options: Any) -> ExitCode:
    """Run the pipeline of calibration.yml, stage by stage; the verdict is fail if one of them fails."""
    settings = chosen(RunSettings, options, repetitions=given(Repetitions, options))
    return run(settings, Runner.from_environment())


def run(settings: RunSettings, runner: Runner) -> ExitCode:
    """Run the stages and report their results.

    Raises:
        InputError: the configuration or the data are wrong.
        InfrastructureError: a result cannot be written.
    """
    configuration = read_configuration(settings.config)
    matrix = Matrix(configuration.systems, configuration.noise)
    asked = PipelineRun(
        matrix,
        settings.output,
        runner,
        config=settings.config,
        jobs=settings.parallel,
        simulations=configuration.simulations,
        image=_image_to_build(configuration.image, settings.push),
        baseline=configuration.baseline,
        sections=configuration.sections,
        target=configuration.target,
    )
    repetitions = changed(configuration.repetitions, settings.repetitions, "options")
    exit_code, results = repeat_stages(asked, settings.only or tuple(STAGES), repetitions)
    image = results.image
    set_outputs(runner, {"image": image.reference if image else "", "digest": (image.digest if image else None) or ""})
    return exit_code


def _image_to_build(image: ImageSpecification | None, push: bool | None) -> ImageSpecification | None:
    if image is None or push is None:
        return image
    return replace(image, push=push, promote=image.promote if push else ())
