"""What a job is: containers that run together, what is brought out of them, and what counts as success.

A job says nothing of where it runs: a backend does that.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from calibration.errors import InputError
from calibration.execution.placeholders import split_command
from calibration.execution.sizes import Bytes, Seconds
from calibration.records import (
    UNIQUE,
    Converted,
    Place,
    above,
    at_least,
    between,
    field,
    length,
    matching,
    one_of,
    record,
)

Network = Literal["private", "internal", "host", "none"]
"""private: the job's containers find each other by name, and those of no other job. internal: the same without a
way out. host: that of the machine (a relaxation). none: no network.

A container alone in its job has nobody to find: the Docker backend puts it on a network on which the engine keeps
all containers apart, or, where it is all that there is in a run, on the engine's default network, as ``docker run``
does."""

NETWORK_HELP = "private: a network of its own. internal: without a way out. host: the machine's. none: no network."
OUTPUT = "/calibration/output"
"""A volume of the job's own, writable and shared by its containers; it is gone with the job."""

Text = Annotated[str, length(1)]
Absolute = Annotated[str, matching("/.*", "an absolute path")]
Variable = Annotated[str, matching("[A-Za-z_][A-Za-z0-9_]*", "the name of a variable")]
ExitCode = Annotated[int, between(0, 255)]


def _command(value: str | tuple[str, ...], place: Place) -> tuple[str, ...]:
    return split_command(value, str(place))


def _entrypoint(value: str | tuple[str, ...], place: Place) -> tuple[str, ...]:
    return () if value == () else split_command(value, str(place))


def _value(value: str | float, _: Place) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


Command = Annotated[tuple[str, ...], Converted(str | tuple[str, ...], _command)]
Value = Annotated[str, Converted(str | int | float | bool, _value)]
"""A number as it is written, a truth value as ``true`` or ``false``."""


@record
class Mount:
    """A folder or file of this machine, seen in a container; read-only unless told otherwise."""

    source: Path = field("The folder or file.")
    target: Absolute = field("Where it is in the container.")
    writable: bool = field("Whether the container may write to it.", default=False)


_MOUNT = matching("[^:]+:/[^:]*(:ro)?", "HERE:THERE with an absolute THERE, or keys: source, target, writable")


def _mount(value: str | Mount, place: Place) -> Mount:
    if isinstance(value, Mount):
        return value
    source, target = value.removesuffix(":ro").split(":")
    return Mount(place.folder / source, target)


@record
class Limits:
    """What a container may use; None where there is no limit."""

    memory: Bytes | None = field("The most it may use, swap included: 2g, 512m.", default=None)
    cpus: Annotated[float, above(0)] | None = field("The most it may use: 1.5 of the machine's cores.", default=None)
    processes: Annotated[int, at_least(1)] | None = field("The most it may have at once.", default=4096)
    seconds: Seconds | None = field(
        "It is stopped when it runs longer, and has failed: 90s, 10m.", default=None, key="timeout"
    )


@record(rules=(one_of("port", "log", "file", "command", why="expected port, log, file or command"),))
class Readiness:
    """When those after it may start; everything that is given must hold."""

    port: Annotated[int, between(1, 65535)] | None = field("It accepts connections on this TCP port.", default=None)
    log: Text | None = field("This regular expression is found in a line of its log.", default=None)
    file: Annotated[str, matching("[/{].*", "an absolute path")] | None = field("This file is there.", default=None)
    command: Command = field("This command, run in it, answers 0.", default=())
    seconds: Seconds = field("The job has failed when it is not ready after so long.", default=60.0, key="timeout")


@record
class Relaxations:
    """What is allowed that is forbidden by default; each is named by whoever writes the job."""

    new_privileges: bool = field("Programs such as sudo may gain privileges.", default=False)
    capabilities: Annotated[
        tuple[Annotated[str, matching("[A-Z_]+", "the name of a capability such as NET_RAW")], ...], UNIQUE
    ] = field("Linux capabilities that it keeps: NET_RAW.", default=())
    devices: Annotated[tuple[Annotated[str, matching("/dev/.*", "a device such as /dev/video0")], ...], UNIQUE] = field(
        "Devices of the machine: /dev/video0.", default=()
    )
    gpus: bool = field("All GPUs of the machine.", default=False)
    docker_socket: bool = field("The engine's socket: whoever has it is root on the machine.", default=False)
    privileged: bool = field("Everything that root on the machine may.", default=False)


@record
class Artifact:
    """Files to bring out of a container when the job has ended."""

    path: Text = field("The path in the container, with *, ?, [...] and **.")
    """Absolute, as in a shell. A folder stands for all
    that is in it. What is found lands relative to the path's last folder without a wildcard: ``/out/a/*.csv`` as
    ``x.csv``, ``/out/a`` as ``a/x.csv``. Links to what is inside are left out, with a note; other links and what is
    no file or folder are refused."""
    required: bool = field("Whether the job has failed where nothing is found.", default=True)


@record
class Container:
    """One container: what runs in it, what it may use, and what is brought out of it.

    Everything is forbidden that is not named here.
    """

    name: str = ""
    """Unique in the job; its host name on the job's network."""
    image: str = field("The image, such as ghcr.io/team/robot:latest.", default="")
    """Empty, as calibration.yml describes it, for the image that the pipeline builds."""
    command: Command = field(
        "Arguments, run without a shell; a text is split as a shell would. The image's own command where there is "
        "none.",
        default=(),
    )
    entrypoint: Annotated[tuple[str, ...], Converted(str | tuple[str, ...], _entrypoint)] | None = field(
        "In the place of the image's; an empty list for none.", default=None
    )
    environment: Mapping[Annotated[str, matching("[^=]+", "a name without =")], Value] = field(
        "Variables and their values.", default_factory=dict, repr=False
    )
    """Those of ``secrets`` too, where `with_secrets` has taken them."""
    secrets: Annotated[
        frozenset[str],
        Converted(Annotated[tuple[Variable, ...], UNIQUE], lambda names, _: frozenset(names)),
    ] = field(
        "Names of variables of this machine's environment that are passed on; their values are hidden in every log.",
        default=frozenset(),
    )
    """Their values appear in no log, file or message."""
    working_directory: Absolute | None = field("Absolute, in the container.", default=None)
    user: Annotated[str, Converted(str | int, lambda user, _: str(user))] | None = field(
        "A name or a number of the image, or both with a group (1000:1000).", default=None
    )
    mounts: tuple[Annotated[Mount, Converted(Annotated[str, _MOUNT] | Mount, _mount)], ...] = field(
        "Folders and files of this machine, read-only unless told otherwise; paths are relative to this file.",
        default=(),
    )
    limits: Limits = field(flat=True, default_factory=Limits)
    readiness: Readiness | None = field("When those after it may start.", default=None, key="ready")
    after: Annotated[tuple[Text, ...], UNIQUE] = field(
        "Containers that have to be ready (or, where they do not say when, started) before this one starts.",
        default=(),
    )
    essential: bool = field("Whether its end ends the job.", default=True)
    """What is not essential is stopped then, and its end is no success or failure."""
    success: Annotated[
        tuple[int, ...],
        Converted(ExitCode | tuple[ExitCode, ...], lambda codes, _: codes if isinstance(codes, tuple) else (codes,)),
    ] = field("The exit codes that are a success; an empty list where it must not end by itself.", default=(0,))
    artifacts: tuple[
        Annotated[Artifact, Converted(Text | Artifact, lambda v, _: Artifact(v) if isinstance(v, str) else v)], ...
    ] = field("Files and folders to bring out; a required one that is missing fails the job.", default=())
    relaxations: Relaxations = field(flat=True, default_factory=Relaxations)


@dataclass(frozen=True)
class Job:
    """Containers that run together."""

    name: str
    """Unique among the jobs of a run; the name of its folder too, so it may have slashes but no dots as a part."""
    containers: tuple[Container, ...]
    network: Network = "private"
    seconds: float | None = 3600.0
    """A job that runs longer is stopped, and has failed."""
    artifact_bytes: int = 2 * 1024**3
    """More than this is not brought out."""
    artifact_files: int = 20_000
    own_network: bool = False
    """A private network of its own also for a container that is all that there is in a run: for software that
    finds its peers by multicast, as ROS 2 does."""


def with_secrets(container: Container, where: str, environment: Mapping[str, str] | None = None) -> Container:
    """The container with the values of its ``secrets`` among its variables.

    Args:
        container: as it was read.
        where: what messages begin with.
        environment: where the values are taken from; this process's own unless given.

    Raises:
        InputError: a secret is not set, or is a variable with another value too.
    """
    environment = os.environ if environment is None else environment
    for name in sorted(container.secrets):
        if not environment.get(name):
            raise InputError(f"{where}.secrets: the environment variable {name} is not set")
        if name in container.environment:
            raise InputError(f"{where}: {name} stands in environment and in secrets: its value belongs in neither file")
    secrets = {name: environment[name] for name in container.secrets}
    return replace(container, environment={**container.environment, **secrets})
