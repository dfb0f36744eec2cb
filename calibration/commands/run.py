"""``run``: run the whole pipeline of ``calibration.yml``, with one verdict."""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from calibration.base.errors import ExitCode
from calibration.ci.image.specification import ImageSpecification
from calibration.ci.workflow import Runner, set_outputs
from calibration.commands.parameters import TEXT_LIST, boolean_option, count, path
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.stages import STAGES, PipelineRun, run_stages


@dataclass(frozen=True)
class RunSettings:
    """Inputs of ``run``."""

    config: Path = Path("calibration.yml")
    output: Path = Path("output")
    only: tuple[str, ...] = ()
    """Stages to run; empty for all."""
    jobs: int | None = None
    push: bool | None = None
    """Whether to push the image; None as in the configuration."""


@click.command("run")
@click.option("--config", type=path, help="The configuration (calibration.yml).")
@click.option("--output", type=path, help="Folder for results, tables and datasets (output).")
@click.option("--only", type=TEXT_LIST, help=f"Only these stages: {', '.join(STAGES)}.")
@click.option("--jobs", type=count, help="Number of parallel processes or containers (one per core).")
@boolean_option("--push", default=None, help="Push the image; if false, it is not promoted either (as in config).")
def command(**options: Any) -> ExitCode:
    """Run the pipeline of calibration.yml, stage by stage; the verdict is fail if one of them fails."""
    settings = RunSettings(**{name: value for name, value in options.items() if value is not None})
    return run(settings, Runner.from_environment(os.environ))


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
        jobs=settings.jobs,
        simulations=configuration.simulations,
        image=_image_to_build(configuration.image, settings.push),
        baseline=configuration.baseline,
        sections=configuration.sections,
        target=configuration.target,
    )
    results = run_stages(asked, settings.only or STAGES)
    image = results.image
    set_outputs(runner, {"image": image.reference if image else "", "digest": (image.digest if image else None) or ""})
    return results.exit_code


def _image_to_build(image: ImageSpecification | None, push: bool | None) -> ImageSpecification | None:
    if image is None or push is None:
        return image
    return replace(image, push=push, promote=image.promote if push else ())
