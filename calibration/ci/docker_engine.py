"""Docker Engine: the connection, its properties and errors, and its images, found or pulled.

The engine is the one in ``DOCKER_HOST``, or in the current context of the ``docker`` command
(Docker Desktop has one; the SDK supports contexts since 7.2), or the one of this machine.
"""

import os
import socket
import struct
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import docker.errors
import requests
import urllib3
from docker import APIClient, DockerClient
from docker.errors import APIError
from docker.utils import parse_repository_tag

from calibration.base import InfrastructureError, InputError, innermost_message, one_line, shorten

REQUEST_SECONDS = 60
"""Timeout of a request to the engine."""
_UNIX_SCHEME = "unix://"
DEFAULT_ADDRESS = f"{_UNIX_SCHEME}/var/run/docker.sock"
_BY_SOCKET = "http+docker://localhost"
"""The SDK's base URL for engines at a local socket."""
_OUR_FAULT = (
    "unable to find user",
    "no matching entries in",
    "executable file not found",
    "error gathering device information",
    "could not select device driver",
    "no such image",
    "no command specified",
    "invalid ",
)
"""Parts of error messages that mean that the request was wrong, whatever the HTTP status."""


class EngineLostError(InfrastructureError):
    """The connection to the engine is lost."""


@dataclass(frozen=True)
class Engine:
    """A reachable engine. Each thread creates its own client."""

    address: str
    version: str
    """Version of its API; a client that knows it does not have to ask."""
    cores: int
    memory: int
    """Bytes."""
    local: bool
    """Whether it uses our file system: it runs on this machine, and this process is not in a container."""

    def client(self, seconds: int = REQUEST_SECONDS) -> DockerClient:
        """Create a client, without a request to the engine."""
        return _open_client(self.version, seconds)


def connect(seconds: int = REQUEST_SECONDS) -> DockerClient:
    """Create a client of the engine and check that it answers.

    Raises:
        InfrastructureError: no engine answers.
    """
    try:
        if os.environ.get("DOCKER_HOST", "").startswith(_UNIX_SCHEME):
            _pid_listening_at(address().removeprefix(_UNIX_SCHEME))  # the SDK leaks the socket if nobody listens
        client = _open_client(None, seconds)
        client.ping()
    except (docker.errors.DockerException, requests.RequestException, OSError, ValueError) as error:
        raise InfrastructureError(
            f"no Docker Engine answers at {address()}: {_reason_of(error)}; start it, or set DOCKER_HOST"
        ) from None
    return client


def engine_available() -> bool:
    """Return whether an engine answers."""
    try:
        connect(5).close()
    except InfrastructureError:
        return False
    return True


def find_engine() -> Engine:
    """Connect to the engine and read its properties.

    Raises:
        InfrastructureError: no engine answers, or it runs no Linux containers.
    """
    client = connect()
    try:
        with engine_errors():
            facts = client.info()
            if facts.get("OSType", "linux") != "linux":
                raise InfrastructureError(f"the Docker Engine at {address()} runs no Linux containers")
            return Engine(
                address=address(),
                version=client.api.api_version,
                cores=max(1, int(facts.get("NCPU", 1))),
                memory=int(facts.get("MemTotal", 0)),
                local=_sees_our_files(client.api.base_url),
            )
    finally:
        client.close()


def address() -> str:
    """Return the address of the engine."""
    return os.environ.get("DOCKER_HOST") or DEFAULT_ADDRESS


@contextmanager
def engine_errors(where: str = "") -> Iterator[None]:
    """Convert exceptions of the Docker SDK to errors for users.

    Args:
        where: prefix of the messages.

    Raises:
        EngineLostError: the connection broke, or the engine did not answer in time.
        InputError: the engine refused the request as invalid.
        InfrastructureError: the engine failed.
    """
    try:
        yield
    except docker.errors.APIError as error:
        message = f"{where}{': ' if where else ''}{engine_message(error)}"
        raise (InputError if is_our_fault(error) else InfrastructureError)(message) from None
    except (requests.RequestException, urllib3.exceptions.HTTPError, docker.errors.DockerException) as error:
        raise lost(error) from None
    except (ConnectionError, TimeoutError) as error:
        raise lost(error) from None


def lost(error: Exception | None = None) -> EngineLostError:
    """Return the error for a lost connection to the engine."""
    cause = f": {_reason_of(error)}" if error is not None else ""
    return EngineLostError(f"the Docker Engine at {address()} does not answer any more{cause}")


def _reason_of(error: Exception) -> str:
    return shorten(one_line(innermost_message(error)), 200)


def engine_message(error: APIError) -> str:
    """Return the engine's error message on one line."""
    return shorten(one_line(f"the Docker Engine reports: {error.explanation or error}"), 400)


def is_our_fault(error: APIError) -> bool:
    """Return whether the engine refused an invalid request, as opposed to a failure of its own."""
    message = engine_message(error).lower()
    return error.is_client_error() or any(sentence in message for sentence in _OUR_FAULT)


def _open_client(version: str | None, seconds: int) -> DockerClient:
    return docker.from_env(version=version, timeout=seconds, use_ssh_client=address().startswith("ssh://"))


def _sees_our_files(base_url: str) -> bool:
    """Return whether the engine behind a local socket has the same file system as this process.

    Not in a container into which the engine's socket is mounted: there the pid of the engine is not visible.
    """
    if base_url != _BY_SOCKET:
        return False
    path = address().removeprefix(_UNIX_SCHEME)
    return not Path(path).exists() or _pid_listening_at(path) != 0


def _pid_listening_at(path: str) -> int:
    """Return the pid of the process that listens at a socket; 0 if it is not visible, -1 where unknown (not Linux)."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(REQUEST_SECONDS)
        connection.connect(path)
        if sys.platform != "linux":
            return -1
        credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
        return int(struct.unpack("3i", credentials)[0])


_NOT_THERE = (
    "not found",
    "no such image",
    "manifest unknown",
    "name unknown",
    "does not exist",
    "denied",
    "unauthorized",
    "no basic auth",
    "invalid reference",
    "invalid repository name",
    "no matching manifest",
)
"""Parts of registries' messages if an image does not exist, or access is denied."""


def find_images(api: APIClient, images: Iterable[str]) -> dict[str, str]:
    """Find images on the engine, or pull them.

    Returns:
        Id of each image, so that a tag moved meanwhile has no effect.

    Raises:
        InputError: an image does not exist, or access is denied.
        InfrastructureError: the engine or the registry cannot be reached.
    """
    found = {image: _find_image(api, image) for image in images}
    for image in [name for name, identity in found.items() if identity is None]:
        pull(api, image, *parse_repository_tag(image))
        if (pulled := _find_image(api, image)) is None:
            raise InfrastructureError(f"image '{image}': was pulled, but the engine does not have it")
        found[image] = pulled
    return {image: identity for image, identity in found.items() if identity is not None}


def _find_image(api: APIClient, image: str) -> str | None:
    with engine_errors(f"image '{image}'"):
        try:
            return str(api.inspect_image(image)["Id"])  # type: ignore[no-untyped-call]
        except docker.errors.NotFound:
            return None


def pull(
    api: APIClient,
    image: str,
    repository: str,
    tag: str | None,
    clean: Callable[[str], str] = one_line,
    show: Callable[[str], None] = lambda _: None,
    **options: Any,
) -> None:
    """Pull an image.

    Args:
        api: client of the engine.
        image: its name, for messages.
        repository: its name without tag and digest.
        tag: its tag or digest; None for latest.
        clean: makes a message of the engine safe to show.
        show: receives the lines about its layers, without their progress.
        options: those of docker-py's ``pull``.

    Raises:
        InputError: it does not exist, or access is denied.
        InfrastructureError: the engine or the registry cannot be reached.
    """
    message = ""
    with engine_errors(f"image '{image}'"):
        try:
            for event in api.pull(repository, tag=tag or "latest", stream=True, decode=True, **options):
                message = message or str(event.get("error", ""))
                if not event.get("progressDetail"):  # skip progress events, hundreds per layer
                    show(f"{event.get('id', '')} {event.get('status', '')}\n")
        except docker.errors.APIError as error:
            message = str(error.explanation or error)
    if not message:
        return
    problem = f"image '{image}': it cannot be pulled: {shorten(clean(message), 300)}"
    if any(sentence in message.lower() for sentence in _NOT_THERE):
        raise InputError(f"{problem}: check the name, or log in, or build it")
    raise InfrastructureError(problem)
