"""The Docker Engine: how to reach it, what it has, and what its errors mean.

The engine is the one that ``DOCKER_HOST`` names, or the current context of the ``docker`` command
(Docker Desktop has one; the SDK knows contexts from 7.2 on), or that of this machine.
"""

import os
import socket
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import docker.errors
import requests
import urllib3
from docker import DockerClient
from docker.errors import APIError

from calibration.errors import InfrastructureError, InputError
from calibration.workflow.text import one_line, shorten

SECONDS = 60
"""How long the engine may take for an answer."""
_UNIX = "unix://"
DEFAULT_ADDRESS = f"{_UNIX}/var/run/docker.sock"
_BY_SOCKET = "http+docker://localhost"
"""The SDK's address of every engine behind a socket of this machine."""
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
"""What the engine says, whatever the status of its answer, where the job asks for what there is not."""


class EngineLostError(InfrastructureError):
    """The engine does not answer any more."""


@dataclass(frozen=True)
class Engine:
    """An engine that has answered. Each thread makes a client of its own."""

    address: str
    version: str
    """Of its API; a client that is told needs not ask."""
    cores: int
    memory: int
    """Bytes."""
    local: bool
    """Whether it sees the files that we see: it runs on this machine, and we are in no container of it."""

    def client(self, seconds: int = SECONDS) -> DockerClient:
        """Make a client; nothing is asked of the engine."""
        return _client(self.version, seconds)


def connect(seconds: int = SECONDS) -> DockerClient:
    """Make a client of the engine, which has answered.

    Raises:
        InfrastructureError: no engine answers.
    """
    try:
        if os.environ.get("DOCKER_HOST", "").startswith(_UNIX):
            _peer(address().removeprefix(_UNIX))  # the SDK leaves a socket open where nobody listens
        client = _client(None, seconds)
        client.ping()
    except (docker.errors.DockerException, requests.RequestException, OSError, ValueError) as error:
        raise InfrastructureError(
            f"no Docker Engine answers at {address()}: {_cause(error)}; start it, or set DOCKER_HOST"
        ) from None
    return client


def engine_available() -> bool:
    """Whether an engine answers."""
    try:
        connect(5).close()
    except InfrastructureError:
        return False
    return True


def find_engine() -> Engine:
    """Find the engine, and what it has.

    Raises:
        InfrastructureError: there is none, or it runs no Linux containers.
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
    """Where the engine is."""
    return os.environ.get("DOCKER_HOST") or DEFAULT_ADDRESS


@contextmanager
def engine_errors(where: str = "") -> Iterator[None]:
    """Turn what goes wrong between us and the engine into errors for users.

    Args:
        where: what messages begin with.

    Raises:
        EngineLostError: the connection broke, or the engine did not answer in time.
        InputError: the engine says that what was asked makes no sense.
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
    """The error for an engine that does not answer any more."""
    cause = f": {_cause(error)}" if error is not None else ""
    return EngineLostError(f"the Docker Engine at {address()} does not answer any more{cause}")


def engine_message(error: APIError) -> str:
    """What the engine says, on one line."""
    return shorten(one_line(f"the Docker Engine says: {error.explanation or error}"), 400)


def is_our_fault(error: APIError) -> bool:
    """Whether the engine refused what was asked of it, and did not fail itself."""
    said = engine_message(error).lower()
    return error.is_client_error() or any(sentence in said for sentence in _OUR_FAULT)


def _client(version: str | None, seconds: int) -> DockerClient:
    return docker.from_env(version=version, timeout=seconds, use_ssh_client=address().startswith("ssh://"))


def _sees_our_files(base_url: str) -> bool:
    """Whether the engine behind a socket of this machine sees the same files as we do.

    In a container that was given the engine's socket we do not: there the engine is a process that we cannot see.
    """
    if base_url != _BY_SOCKET:
        return False
    path = address().removeprefix(_UNIX)
    return not Path(path).exists() or _peer(path) != 0


def _peer(path: str) -> int:
    """The process that listens at a socket, as far as the system tells; 0 for one that we cannot see."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(SECONDS)
        connection.connect(path)
        if sys.platform != "linux":
            return -1
        credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
        return int(struct.unpack("3i", credentials)[0])


def _cause(error: Exception) -> str:
    """The innermost reason of an error of many layers, in a few words."""
    reason: BaseException = error
    for _ in range(10):
        inner = (
            reason.__cause__
            or reason.__context__
            or next((part for part in getattr(reason, "args", ()) if isinstance(part, BaseException)), None)
        )
        if inner is None or isinstance(inner, NameError):  # NameError: how the SDK finds out what is not installed
            break
        reason = inner
    text = reason.strerror if isinstance(reason, OSError) and reason.strerror else str(reason)
    return shorten(one_line(text or type(reason).__name__), 200)
