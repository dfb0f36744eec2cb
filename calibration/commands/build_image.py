"""``build-image``: build an image from a specification or a Dockerfile, and push it to a registry on request."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.base.records import field, record
from calibration.ci.image.build_request import BuildFailedError
from calibration.ci.image.building import REPORT_TITLE, BuilderName, BuildResult, Failure, build_image, report
from calibration.ci.image.context import Context
from calibration.ci.image.plan import add_recipe
from calibration.ci.image.specification import (
    ImageSpecification,
    OwnDockerfile,
    parse_image_specification,
    read_image_specification,
)
from calibration.ci.registries.push import promote
from calibration.ci.registries.reference import RegistrySettings, check_tag
from calibration.ci.registries.registry import registry_login
from calibration.ci.report import FILES, publish, remove_results
from calibration.ci.workflow import Runner, stop_commands
from calibration.commands.parameters import (
    chosen,
    option_keys,
    password_variable,
    record_options,
    registry_password_option,
)

DEFAULT_SPECIFICATION = Path("calibration.yml")


@record
class BuildSettings:
    """Inputs of ``build-image``; None means as in the specification."""

    spec: Path | None = field(
        "YAML file with the specification of the image, or with a key image (calibration.yml).", default=None
    )
    dockerfile: Path | None = field("Your own Dockerfile, instead of a specification.", default=None)
    context: Path | None = field("Build context of this Dockerfile (the working directory).", default=None)
    name: str | None = field("Registry and repository without a tag: ghcr.io/team/robot.", default=None)
    tags: tuple[str, ...] | None = field("Tags beside the content key.", default=None)
    push: bool | None = field("Push the image to its registry.", default=None)
    load: bool | None = field("Load the image into this machine's engine (not if it is pushed).", default=None)
    promote: tuple[str, ...] = field(
        "Tags that the image gets in its registry, such as stable; it is pushed.", default=()
    )
    digest: str | None = field("Digest of an image to promote (sha256:...), without a build.", default=None)
    builder: BuilderName = field("auto (BuildKit if docker supports it), engine or buildkit (auto).", default="auto")
    force: bool = field("Build even if nothing has changed, without a cache.", default=False)
    pull: bool = field("Look for a newer base image in its registry.", default=False)
    render: Path | None = field(
        "Write the Dockerfile and its context into this folder, without building.", default=None
    )
    registry_username: str | None = field("User of the registry.", default=None)
    password_variable: str | None = None
    output: Path | None = field("Folder for results.json, junit.xml and summary.md.", default=None)


_OPTION_KEYS = option_keys(BuildSettings)


@click.command(REPORT_TITLE)
@record_options(BuildSettings, *_OPTION_KEYS[:-1])
@registry_password_option
@record_options(BuildSettings, _OPTION_KEYS[-1])
@click.pass_context
def command(click_context: click.Context, /, **options: Any) -> ExitCode:
    """Build an image from a specification or a Dockerfile, unless nothing has changed."""
    runner = Runner.from_environment()
    password = password_variable(click_context, options.pop("registry_password"), runner)
    settings = chosen(BuildSettings, options, password_variable=password)
    remove_results(settings.output, FILES)  # so that they are not mistaken for current ones
    begin = time.monotonic()
    specification = _read_specification(settings)
    if settings.render is not None:
        return _print_dockerfile(specification, settings.render, runner)
    try:
        result = (
            _promotion_result(settings, specification, runner)
            if settings.digest
            else _build_result(settings, specification, runner)
        )
    except BuildFailedError as error:
        result = BuildResult(failure=Failure(error.headline, error.lines))
    source = settings.dockerfile or settings.spec or DEFAULT_SPECIFICATION
    found = report(replace(result, seconds=round(time.monotonic() - begin, 3)), source, runner)
    return publish(found, runner, settings.output)


def _build_result(settings: BuildSettings, specification: ImageSpecification, runner: Runner) -> BuildResult:
    push = bool(settings.promote) or (specification.push if settings.push is None else settings.push)
    image = build_image(
        specification,
        runner,
        push=push,
        load=settings.load if settings.load is not None else not push,
        builder=settings.builder,
        force=settings.force,
        pull=settings.pull,
        leave_out=() if settings.output is None else (settings.output,),
    )
    if not settings.promote:
        return BuildResult(**vars(image))
    if image.digest is None:
        raise InfrastructureError(
            f"{image.reference}: pushed, but its digest is unknown, which the tags of promote need"
        )
    return BuildResult(**vars(image), promoted=_promote_image(specification, image.digest, settings, runner))


def _promotion_result(settings: BuildSettings, specification: ImageSpecification, runner: Runner) -> BuildResult:
    if not settings.promote or settings.digest is None:
        raise InputError("digest is given without promote: give the tags of the image")
    reference = f"{specification.name}@{settings.digest}"
    names = _promote_image(specification, settings.digest, settings, runner)
    return BuildResult(reference=reference, digest=settings.digest, promoted=names)


def _promote_image(
    specification: ImageSpecification, digest: str, settings: BuildSettings, runner: Runner
) -> tuple[str, ...]:

    credentials = registry_login(specification.registry, specification.name, runner)
    return tuple(promote(specification.name, digest, settings.promote, credentials, runner))


def _read_specification(settings: BuildSettings) -> ImageSpecification:
    """Read the specification, and replace its keys by those given as options."""
    if settings.dockerfile is not None and settings.spec is not None:
        raise InputError("spec and dockerfile are both given: a specification can name a Dockerfile of your own")
    if settings.context is not None and settings.dockerfile is None:
        raise InputError("context is given without the dockerfile that it is for")
    named = {} if settings.name is None else {"name": settings.name}
    if settings.dockerfile is not None:
        entry = {"dockerfile": str(settings.dockerfile), "context": str(settings.context or "."), **named}
        specification = parse_image_specification(entry, Path(), "options")
    elif settings.digest is not None and settings.spec is None and named:
        specification = parse_image_specification({"base": "unused", **named}, Path(), "options")
    else:
        specification = read_image_specification(settings.spec or DEFAULT_SPECIFICATION)
        if named:
            name = parse_image_specification({"base": "unused", **named}, Path(), "options").name
            specification = replace(specification, name=name)
    if settings.tags is not None:
        specification = replace(specification, tags=tuple(map(check_tag, settings.tags)))
    if (settings.registry_username is None) != (settings.password_variable is None):
        missing = "registry-username" if settings.registry_username is None else "registry-password"
        raise InputError(f"{missing} is not given: user and password go together")
    if settings.registry_username is not None:
        registry = specification.registry or RegistrySettings()
        registry = replace(registry, username=settings.registry_username, password_variable=settings.password_variable)
        specification = replace(specification, registry=registry)
    return specification


def _print_dockerfile(specification: ImageSpecification, folder: Path, runner: Runner) -> ExitCode:

    if isinstance(specification.source, OwnDockerfile):
        raise InputError("render: your own Dockerfile exists already; there is nothing to generate")
    context = Context()
    rendered = add_recipe(specification, context)
    context.write_folder(folder)
    with stop_commands(runner):
        runner.log(rendered.dockerfile)
    runner.log(f"pass: {folder} has the Dockerfile and all that it copies")
    return ExitCode.PASS
