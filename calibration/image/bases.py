"""The image that a build starts from: what its name stands for just now, and how it gets to the engine."""

import re
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import docker.errors

from calibration.docker.engine import connect, engine_errors
from calibration.errors import InfrastructureError, InputError
from calibration.image.builders.build_log import BuildLog
from calibration.registries.credentials import Credentials, RegistrySettings
from calibration.registries.login import registry_login
from calibration.registries.reference import Reference, parse_reference
from calibration.registries.registry import RegistryClient
from calibration.workflow import Runner, group, stop_commands
from calibration.workflow.progress import progress
from calibration.workflow.text import one_line, shorten

if TYPE_CHECKING:
    from docker import DockerClient
    from docker.models.images import Image

Login = Callable[[str], Credentials]
"""Finds the credentials for the registry of an image."""

_MISSING = re.compile(r"not found|manifest unknown|does not exist|denied|unauthorized|name unknown|no such image")


@dataclass(frozen=True)
class Base:
    """What the name of a base stands for."""

    name: str
    identity: str
    """Its digest; the engine's id where it is known to no registry."""
    digest: str | None = None


def find_base(client: "DockerClient", name: str, login: Login, *, ask_registry: bool = False) -> Base:
    """Find out what a base is: the engine's own where it has one, else its registry's.

    Args:
        client: of the engine.
        name: of the image.
        login: finds the credentials for a registry.
        ask_registry: the registry first, although the engine has one.

    Raises:
        InputError: neither has such an image.
        InfrastructureError: the registry cannot be reached.
    """
    reference = parse_reference(name)
    if reference.digest:
        return Base(name, reference.digest, reference.digest)
    local = None if ask_registry else local_image(client, str(reference))
    if local is not None:
        digest = _digest(local, reference)
        return Base(name, digest or str(local.id), digest)
    with RegistryClient(login(name)) as registry:
        found = registry.find_manifest(reference)
    if found is None:
        raise InputError(
            f"base image {name}: neither this machine nor {reference.registry} has it, or it may not be seen: "
            "check the name, or log in"
        )
    return Base(name, found, found)


def local_image(client: "DockerClient", name: str) -> "Image | None":
    """The engine's image of that name, or None."""
    try:
        return client.images.get(name)
    except docker.errors.ImageNotFound:
        return None


def fetch(client: "DockerClient", name: str, login: Login, platform: str | None, log: BuildLog) -> None:
    """Bring an image to the engine, where it has none such.

    Raises:
        InputError: there is no such image, or it may not be seen.
        InfrastructureError: it cannot be fetched.
    """
    if local_image(client, name) is not None:
        return
    reference = parse_reference(name)
    log.output(f"pulling {name}\n")
    try:
        events = client.api.pull(
            reference.name,
            tag=reference.digest or reference.tag or "latest",
            stream=True,
            decode=True,
            auth_config=login(name).auth_config(),
            platform=platform,
        )
        for event in events:
            if "error" in event:
                raise _failed(name, str(event["error"]), log)
            if not event.get("progressDetail"):  # not each of the hundreds of a layer
                log.output(f"{event.get('id', '')} {event.get('status', '')}\n")
    except docker.errors.APIError as error:
        raise _failed(name, str(error.explanation or error), log) from None


def _failed(name: str, message: str, log: BuildLog) -> InputError | InfrastructureError:
    message = shorten(log.clean(message), 300)
    if _MISSING.search(message.lower()):
        return InputError(f"image {name}: it cannot be pulled: {message}: check the name, or log in")
    return InfrastructureError(f"image {name}: it cannot be pulled: {message}")


def _digest(image: "Image", reference: Reference) -> str | None:
    """The digest that a registry knows an image by, where the engine has noted it for this name."""
    for text in image.attrs.get("RepoDigests") or ():
        known = parse_reference(one_line(text))
        if known.name == reference.name:
            return known.digest
    return None


def pull_image(name: str, settings: RegistrySettings, runner: Runner, title: str) -> None:
    """Pull an image as the user of the settings, unless the engine has it.

    Args:
        name: of the image; the login is for its registry, and for no other.
        settings: who one is there.
        runner: takes the log.
        title: of the progress.

    Raises:
        InputError: there is no such image, or it may not be seen.
        InfrastructureError: the engine or the registry cannot be reached.
    """
    credentials = registry_login(settings, name, runner)
    with (
        closing(connect()) as client,
        engine_errors(f"image '{name}'"),
        group(runner, f"{title}: {name}"),
        stop_commands(runner),
        progress(runner, title) as advance,
    ):
        log = BuildLog(runner, advance, credentials.secrets)
        fetch(client, name, lambda _: credentials, None, log)
