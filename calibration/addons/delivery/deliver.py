"""``deliver``: bundle a pushed commit's calibrations, and deliver them to a registry, a GitHub release or a folder."""

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import click

from calibration.addons.delivery.artifact import GitHubReleases, RegistryRepository
from calibration.addons.delivery.bundle import masked_signing_key, run_to_bundle, signing_key_option
from calibration.addons.delivery.bundling import BUNDLE_FOLDER, PREDICATE_ENDING, Bundle, make_bundle, write_bundle
from calibration.addons.delivery.changes import DeliveredBundle, deliver_bundle
from calibration.addons.delivery.destinations import CHANGELOG_FILE, DeliveryFolder, Destination
from calibration.addons.delivery.manifest import MAX_BUNDLE_BYTES
from calibration.addons.delivery.results import KEY_VARIABLE, DeliverySettings
from calibration.base import ExitCode, InputError, one_line, write_atomically
from calibration.base.records import field, length, record
from calibration.ci.execution.tasks import locked
from calibration.ci.github.api import API_URL, GitHubApi
from calibration.ci.registries.login import registry_login
from calibration.ci.registries.reference import RegistrySettings, parse_reference
from calibration.ci.registries.registry import RegistryClient
from calibration.ci.workflow import Level, Runner, add_summary, annotate, set_outputs, stop_commands
from calibration.ci.workflow.runner import Annotation, Event
from calibration.commands.parameters import (
    chosen,
    given,
    masked_token,
    password_variable,
    record_options,
    registry_password_option,
)
from calibration.pipeline.configuration import DEFAULT_FILE

TITLE = "deliver"
PERMISSION = "contents: write"


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
def command(context: click.Context, /, **options: Any) -> ExitCode:
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
