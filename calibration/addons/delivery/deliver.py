"""``bundle`` and ``deliver``: pack what passed and is accepted for the robot, sign it, and deliver it; and the stage.

Delivered are the calibrations of a pushed commit: to a registry, a GitHub release or a folder.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import click

from calibration.addons.delivery.bundling import (
    BUNDLE_FOLDER,
    PREDICATE_ENDING,
    Bundle,
    RunToBundle,
    make_bundle,
    with_collected,
    write_bundle,
)
from calibration.addons.delivery.changes import DeliveredBundle, deliver_bundle
from calibration.addons.delivery.destinations import (
    CHANGELOG_FILE,
    DeliveryFolder,
    Destination,
    GitHubReleases,
    RegistryRepository,
)
from calibration.addons.delivery.manifest import MAX_BUNDLE_BYTES
from calibration.addons.delivery.results import KEY_VARIABLE, BundleResults, Delivered, DeliverySettings
from calibration.base import ExitCode, InputError, one_line, write_atomically
from calibration.base.records import changed, field, length, record
from calibration.ci.execution.tasks import locked
from calibration.ci.github.service import API_URL, GitHubApi
from calibration.ci.registries.reference import RegistrySettings, parse_reference
from calibration.ci.registries.registry import RegistryClient, registry_login
from calibration.ci.report import remove_results
from calibration.ci.workflow import Level, Runner, add_mask, add_summary, annotate, set_outputs, stop_commands
from calibration.ci.workflow.runner import Annotation, Event
from calibration.commands.parameters import (
    chosen,
    given,
    masked_secret,
    masked_token,
    password_variable,
    record_options,
    registry_password_option,
)
from calibration.engine.baseline.quality import BaselineSettings
from calibration.pipeline.configuration import DEFAULT_FILE, read_configuration
from calibration.pipeline.results import read_results
from calibration.pipeline.running import COLLECTED_FOLDER, PipelineRun

BUNDLE_TITLE = "bundle"
TITLE = "deliver"
PERMISSION = "contents: write"


@record(kw_only=True)
class BundleSettings:
    """Inputs of ``bundle`` beside those of the section ``delivery``."""

    config: Path = field("The configuration (calibration.yml).", default=DEFAULT_FILE)
    output: Path = field(
        "Folder of the run's results; the bundle is written to its folder bundle.", default=Path("output")
    )
    although: str | None = field(
        "Reason to bundle red, undecided and not accepted systems too; they are marked, and verify refuses them.",
        default=None,
    )


signing_key_option = click.option(
    "--signing-key",
    envvar=KEY_VARIABLE,
    help=f"The private key itself, in PEM; on a command line by the variable {KEY_VARIABLE} instead.",
)
"""Option for the private key, to be passed to `masked_signing_key`."""


@click.command(BUNDLE_TITLE)
@record_options(BundleSettings)
@record_options(DeliverySettings)
@signing_key_option
@click.pass_context
def bundle_command(context: click.Context, /, signing_key: str | None, **options: Any) -> ExitCode:
    """Pack what systems that passed and are accepted leave for their robot: the same input, the same digest.

    A system that is red, undecided or not accepted is left out, or refused if --systems names it; --although bundles
    and marks it.
    """
    runner = Runner.from_environment()
    key = masked_signing_key(context, signing_key, runner)
    settings = chosen(BundleSettings, options)
    if settings.although is not None and not settings.although.strip():
        raise InputError("--although: found nothing, expected the reason")
    found = bundle_results(settings, given(DeliverySettings, options), key)
    _show_bundle(found, settings.output, runner)
    return ExitCode.PASS


def bundle_results(settings: BundleSettings, document: dict[str, Any], signing_key: str) -> BundleResults:
    """Write the bundle of a run, and return what it is.

    Args:
        settings: of the command.
        document: keys of the section ``delivery`` that take precedence over it.
        signing_key: the private key in PEM; empty for none.

    Raises:
        InputError: an input is wrong, or no system can be bundled.
        InfrastructureError: a file cannot be written.
    """
    with locked(settings.output):  # no run may write the results meanwhile
        run, delivery = run_to_bundle(settings.config, settings.output, document)
        bundle = make_bundle(run, delivery, settings.although)
        environment = {**os.environ, KEY_VARIABLE: signing_key}
        return write_bundle(bundle, settings.output, delivery.signing_key_file, environment)


def run_to_bundle(config: Path, output: Path, document: dict[str, Any]) -> tuple[RunToBundle, DeliverySettings]:
    """Read the results of a run, and the section ``delivery``, over which keys of a document take precedence.

    Raises:
        InputError: an input is wrong.
    """
    configuration = read_configuration(config)
    section = configuration.sections.of("delivery") or DeliverySettings()
    systems = with_collected(configuration.systems, output / COLLECTED_FOLDER)
    run = RunToBundle(read_results(output), systems, output, config, configuration.baseline)
    return run, changed(section, document, "options")


def masked_signing_key(context: click.Context, signing_key: str | None, runner: Runner) -> str:
    """Mask the private key that an option or its variable has, and return it; raises as `masked_secret`."""
    place = f"the environment variable {KEY_VARIABLE}, or use signing-key-file"
    return masked_secret(context, "signing-key", signing_key, runner, place) or ""


def _show_bundle(found: BundleResults, output: Path, runner: Runner) -> None:
    annotate(runner, [Annotation(warning, Level.WARNING, title="Bundle") for warning in found.warnings])
    set_outputs(
        runner,
        {
            "bundle": output / found.file,
            "digest": found.digest,
            "version": found.version,
            "attestation": output / found.attestation if found.attestation else "",
            "predicate": output / found.predicate,
        },
    )
    with stop_commands(runner):
        runner.log(one_line(f"{found.sentence}: {found.digest} ({output / found.file})"))


def deliver_stage(run: PipelineRun) -> PipelineRun:
    """Bundle what passed and is accepted; that nothing is to be bundled is no reason of the verdict.

    Raises:
        InputError: the key is wrong.
        InfrastructureError: a file cannot be written.
    """
    settings: DeliverySettings = run.sections.of("delivery")
    folder = run.output / BUNDLE_FOLDER
    if folder.is_dir():  # of an earlier run
        remove_results(folder, [path.name for path in folder.iterdir() if path.is_file()])
    to_bundle = RunToBundle(
        run.results, run.matrix.systems, run.output, run.config or run.output, run.baseline or BaselineSettings()
    )
    try:
        bundle = make_bundle(to_bundle, settings, None)
    except InputError as error:
        return run.with_result("delivery", Delivered(why_not=str(error), folder=BUNDLE_FOLDER))
    if key := os.environ.get(KEY_VARIABLE):
        add_mask(run.runner, key)
    written = write_bundle(bundle, run.output, settings.signing_key_file)
    return run.with_result("delivery", Delivered(bundle=written, folder=BUNDLE_FOLDER))


@record(kw_only=True)
class DeliverSettings:
    """Inputs of ``deliver`` beside those of the section ``delivery``."""

    config: Path = field("The configuration (calibration.yml).", default=DEFAULT_FILE)
    output: Path = field("Folder of the run's results.", default=Path("output"))
    branch: Annotated[str, length(1)] = field("The branch whose pushes are delivered (main).", default="main")
    registry: str | None = field(
        "Repository of a registry for this robot's bundles: ghcr.io/team/robot-calibration.", default=None
    )
    release: bool = field("Make a release on GitHub with the bundle and its changelog.", default=False)
    folder: Path | None = field("Folder that gets a folder for each version.", default=None)
    registry_username: str | None = field("User of the registry.", default=None)
    registry_insecure: bool = field("HTTP without TLS; the default for a registry on this machine.", default=False)
    api_url: str | None = field("Address of GitHub's API (the runner's).", default=None)
    token: str | None = field(
        f"Token that may make releases (permissions: {PERMISSION}); locally by GITHUB_TOKEN.", default=None, repr=False
    )


@click.command(TITLE)
@record_options(DeliverSettings)
@record_options(DeliverySettings)
@signing_key_option
@registry_password_option
@click.pass_context
def deliver_command(context: click.Context, /, **options: Any) -> ExitCode:
    """Bundle a pushed commit's calibrations, and deliver them: to a registry, as a release on GitHub, to a folder.

    The version follows from what changed since the last delivery; nothing is delivered of a pull request or a fork.
    """
    runner = Runner.from_environment()
    key = masked_signing_key(context, options.pop("signing_key"), runner)
    options["token"] = masked_token(context, options["token"], runner)
    password = password_variable(context, options.pop("registry_password"), runner)
    settings = chosen(DeliverSettings, options)
    event = runner.service.event(os.environ)
    if (reason := _why_not(settings, event)) is not None:
        annotate(runner, [Annotation(f"nothing is delivered: {reason}", Level.NOTICE, title="Delivery")])
        set_outputs(runner, {"delivered": False})
        return ExitCode.PASS
    _deliver(settings, given(DeliverySettings, options), event, password, key, runner)
    return ExitCode.PASS


def _why_not(settings: DeliverSettings, event: Event) -> str | None:
    """Return why a run of this event delivers nothing.

    Raises:
        InputError: there is no destination, or no event to judge by.
    """
    if settings.registry is None and not settings.release and settings.folder is None:
        raise InputError("found no destination, expected registry, release or folder")
    if not event.name:
        if settings.registry is not None or settings.release:
            raise InputError("a registry and a release are delivered to by a push in CI alone: found no event of one")
        return None
    if event.branch is None:
        return f"the event is {event.name}, not the push of a branch"
    if event.branch != settings.branch:
        return f"found a push to {event.branch}, expected {settings.branch}"
    return event.without_secrets


def _deliver(
    settings: DeliverSettings,
    document: dict[str, Any],
    event: Event,
    password: str | None,
    signing_key: str,
    runner: Runner,
) -> None:
    with ExitStack() as stack, locked(settings.output):
        run, delivery = run_to_bundle(settings.config, settings.output, document)
        bundle = make_bundle(run, delivery, None)
        commit = bundle.manifest.commit
        if event.commit and commit != event.commit:
            raise InputError(f"{settings.output}: found results of commit {commit}, expected {event.commit}, the push")
        folder = settings.output / BUNDLE_FOLDER

        def sign(versioned: Bundle) -> bytes | None:
            environment = {**os.environ, KEY_VARIABLE: signing_key}
            written = write_bundle(versioned, settings.output, delivery.signing_key_file, environment)
            return None if written.attestation is None else (settings.output / written.attestation).read_bytes()

        destinations = [*_destinations(settings, bundle.manifest.name, password, runner, os.environ, stack)]
        found = deliver_bundle(bundle, destinations, delivery.version, run.baseline.same_data, sign)
        if found.changelog:
            write_atomically(folder / CHANGELOG_FILE, found.changelog)
    _show(found, folder, runner)


def _destinations(
    settings: DeliverSettings,
    robot: str,
    password: str | None,
    runner: Runner,
    environment: Mapping[str, str],
    stack: ExitStack,
) -> Iterator[Destination]:
    """Yield the destinations, the release first: only GitHub refuses a second one of the same version."""
    if settings.release:
        repository = environment.get("GITHUB_REPOSITORY")
        if settings.token is None or not repository:
            raise InputError("token: found none, expected ${{ github.token }}, on a runner of GitHub")
        url = settings.api_url or environment.get("GITHUB_API_URL") or API_URL
        yield GitHubReleases(GitHubApi.open(settings.token, url, permission=PERMISSION), repository, robot)
    if settings.registry is not None:
        reference = parse_reference(settings.registry)
        if reference.tag is not None or reference.digest is not None:
            raise InputError(f"registry: found {settings.registry!r}, expected a repository: its tags are the versions")
        login = RegistrySettings(settings.registry_username, password, insecure=settings.registry_insecure)
        credentials = registry_login(login, settings.registry, runner)
        client = stack.enter_context(RegistryClient(credentials, most_bytes=MAX_BUNDLE_BYTES))
        yield RegistryRepository(client, reference)
    if settings.folder is not None:
        yield DeliveryFolder(settings.folder, runner)


def _show(found: DeliveredBundle, folder: Path, runner: Runner) -> None:
    manifest = found.contents.manifest
    named = f"{manifest.name} {manifest.version}"
    if found.later:
        line = f"nothing is delivered: {named} is of a later commit"
    elif not found.to:
        line = f"nothing is delivered: nothing has changed since {named}"
    else:
        line = f"{named} delivered to {', '.join(found.to)}"
    if found.to and found.contents.fetched.attestation is None:
        annotate(runner, [Annotation("it is not signed: there is no key", Level.WARNING, title="Delivery")])
    add_summary(runner, found.changelog)
    path = folder / manifest.file_name
    predicate = path.with_name(path.name + PREDICATE_ENDING)
    files = {"bundle": path, "predicate": predicate} if found.to else {"bundle": "", "predicate": ""}
    set_outputs(runner, {"delivered": bool(found.to), "version": manifest.version, "change": found.level, **files})
    with stop_commands(runner):
        if found.changelog:
            runner.log(found.changelog)
        runner.log(one_line(line))
