"""Base images: resolving their names to digests, and pulling them."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import docker.errors

from calibration.base.errors import InputError
from calibration.base.text import one_line
from calibration.ci.docker_engine import connect, engine_errors, pull
from calibration.ci.image.build_request import BuildLog
from calibration.ci.registries.credentials import Credentials, RegistrySettings
from calibration.ci.registries.login import registry_login
from calibration.ci.registries.reference import Reference, parse_reference
from calibration.ci.registries.registry import RegistryClient
from calibration.ci.workflow import Runner, group, stop_commands
from calibration.ci.workflow.streams import progress

if TYPE_CHECKING:
    from docker import DockerClient
    from docker.models.images import Image

Login = Callable[[str], Credentials]
"""Returns the credentials for the registry of an image."""


@dataclass(frozen=True)
class Base:
    """A base image and its current digest."""

    name: str
    identity: str
    """Identifier of the content: the digest; the engine's image id if it is in no registry."""
    digest: str | None = None


def find_base(client: "DockerClient", name: str, login: Login, *, ask_registry: bool = False) -> Base:
    """Resolve the name of a base: to the engine's image if it has one, else in its registry.

    Args:
        client: client of the engine.
        name: name of the image.
        login: returns the credentials for a registry.
        ask_registry: resolve the name in the registry, even if the engine has an image.

    Raises:
        InputError: neither has the image.
        InfrastructureError: the registry cannot be reached.
    """
    reference = parse_reference(name)
    if reference.digest:
        return Base(name, reference.digest, reference.digest)
    local = None if ask_registry else local_image(client, str(reference))
    if local is not None:
        digest = _digest_in_registry(local, reference)
        return Base(name, digest or str(local.id), digest)
    with RegistryClient(login(name)) as registry:
        found = registry.find_manifest(reference)
    if found is None:
        raise InputError(
            f"base image {name}: found neither on this machine nor in {reference.registry}, or access is denied: "
            "check the name, or log in"
        )
    return Base(name, found, found)


def local_image(client: "DockerClient", name: str) -> "Image | None":
    """Return the engine's image with a name, or None."""
    try:
        return client.images.get(name)
    except docker.errors.ImageNotFound:
        return None


def fetch(client: "DockerClient", name: str, login: Login, platform: str | None, log: BuildLog) -> None:
    """Pull an image unless the engine has it.

    Raises:
        InputError: the image does not exist, or access is denied.
        InfrastructureError: the pull fails.
    """
    if local_image(client, name) is not None:
        return
    reference = parse_reference(name)
    log.output(f"pulling {name}\n")
    login_options = {"auth_config": login(name).auth_config(), "platform": platform}
    pull(client.api, name, reference.name, reference.digest or reference.tag, log.clean, log.output, **login_options)


def _digest_in_registry(image: "Image", reference: Reference) -> str | None:
    """Return the digest of an image in its registry, if the engine has recorded it for this name."""
    for text in image.attrs.get("RepoDigests") or ():
        known = parse_reference(one_line(text))
        if known.name == reference.name:
            return known.digest
    return None


def pull_image(name: str, settings: RegistrySettings, runner: Runner, title: str) -> None:
    """Pull an image with the login in the settings, unless the engine has it.

    Args:
        name: name of the image; the login is used only for its registry.
        settings: login to the registry.
        runner: runner whose log shows the pull.
        title: title of the progress.

    Raises:
        InputError: the image does not exist, or access is denied.
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
