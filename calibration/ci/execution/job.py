"""A job of containers, as it is described: commands with placeholders, limits with their sizes and times, files.

Placeholders in commands, such as ``{seed}``, are replaced in each argument separately, without a shell.
"""

import math
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, TypeGuard

from calibration.base import InputError, did_you_mean, shorten
from calibration.base.records import (
    UNIQUE,
    ByName,
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

_SIZE_TEXT = r"([0-9]+(?:\.[0-9]+)?)\s*([kmgt]?)(?:i?b)?"
_DURATION_TEXT = r"(?:[0-9]+(?:\.[0-9]+)?(?:ms|s|m|h|d)\s*)+"
_DURATION_PART = r"([0-9]+(?:\.[0-9]+)?)(ms|s|m|h|d)"
_SECONDS_OF_UNIT = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
_MOST_BYTES = 2**60
_MOST_SECONDS = 366 * 86400.0
_BRACED_TEXT = r"\{\{|\}\}|\{([^{}]*)\}|[{}]"


def parse_bytes(value: object, where: str) -> int:
    """Parse a number of bytes: 1024, "512 MiB", "2g". As in Docker, units are powers of 1024.

    Raises:
        InputError: it is not a size above 0; the message names the key.
    """
    match = re.fullmatch(_SIZE_TEXT, str(value).strip(), re.IGNORECASE) if _is_amount(value) else None
    if match is not None:
        found = int(float(match[1]) * 1024 ** " kmgt".index(match[2].lower() or " "))
        if 0 < found <= _MOST_BYTES:
            return found
    raise InputError(f"{where}: found {value!r}, expected a size such as 512m or 2g")


def parse_seconds(value: object, where: str) -> float:
    """Parse a time in seconds: 45, "90s", "10m", "1h30m".

    Raises:
        InputError: it is not a time above 0; the message names the key.
    """
    found = 0.0
    if isinstance(value, str) and len(value) < 100:
        text = value.strip().lower()
        text += "s" if re.fullmatch(r"[0-9]+(\.[0-9]+)?", text) else ""
        if re.fullmatch(_DURATION_TEXT, text):
            found = math.fsum(
                float(number) * _SECONDS_OF_UNIT[unit] for number, unit in re.findall(_DURATION_PART, text)
            )
    elif _is_amount(value):
        found = float(value)
    if 0 < found <= _MOST_SECONDS:
        return found
    raise InputError(f"{where}: found {value!r}, expected a time such as 90s, 10m or 1h30m, of at most a year")


Bytes = Annotated[int, Converted(str | int, lambda value, place: parse_bytes(value, str(place)))]
"""Type of a record's field: bytes, parsed by `parse_bytes`."""
Seconds = Annotated[float, Converted(str | float, lambda value, place: parse_seconds(value, str(place)))]
"""Type of a record's field: seconds, parsed by `parse_seconds`."""


def describe_bytes(count: int) -> str:
    """Format a number of bytes for a message: ``512 MiB``."""
    amount, units = float(count), ["bytes", "KiB", "MiB", "GiB", "TiB"]
    while amount >= 1024 and len(units) > 1:
        amount, units = amount / 1024, units[1:]
    return f"{amount:.4g} {units[0]}"


def _is_amount(value: object) -> TypeGuard[str | float]:
    return isinstance(value, str | int | float) and not isinstance(value, bool) and len(str(value)) < 100


def fill(arguments: Sequence[str], values: Mapping[str, str], where: str) -> tuple[str, ...]:
    """Replace ``{name}`` by its value in each argument; ``{{`` and ``}}`` are literal braces.

    An argument remains one argument, whatever the value.

    Raises:
        InputError: unknown name, or a single brace; the message contains the argument.
    """

    def replacement(match: re.Match[str]) -> str:
        found, name = match[0], match[1]
        if found in ("{{", "}}"):
            return found[0]
        if name in values:
            return values[name]
        if name is None:
            raise InputError(f"{where}: a single '{found}' in '{shorten(match.string)}': write {found * 2} for a brace")
        raise InputError(
            f"{where}: there is no placeholder '{{{shorten(name)}}}'{did_you_mean(name, values)} "
            f"(known: {', '.join(values) or 'none'}; write {{{{ and }}}} for braces)"
        )

    return tuple(re.sub(_BRACED_TEXT, replacement, argument) for argument in arguments)


def split_command(command: str | Sequence[str], where: str) -> tuple[str, ...]:
    """Convert a command to arguments: a string is split as in a shell, a list is unchanged.

    No other syntax of a shell is supported: no variables, no ``&&``, no ``>``. Call it before :func:`fill`.

    Raises:
        InputError: the quoting is wrong, it is empty, or an argument is not a string.
    """
    arguments = _split_words(command, where) if isinstance(command, str) else tuple(command)
    for argument in arguments:
        if not isinstance(argument, str):
            raise InputError(f"{where}: found {argument!r} among the arguments, expected strings: put it in quotes")
        if "\0" in argument:
            raise InputError(f"{where}: {argument!r} has a NUL character, which no argument can have")
    if not arguments:
        raise InputError(f"{where}: the command is empty")
    return arguments


def _split_words(text: str, where: str) -> tuple[str, ...]:
    try:
        return tuple(shlex.split(text))
    except ValueError as error:
        raise InputError(f"{where}: '{shorten(text)}' cannot be split into arguments: {error}") from None


Network = Literal["private", "internal", "host", "none"]
"""private: the job's containers find each other by name, isolated from other jobs. internal: the same without
access to the outside. host: network of the machine (a relaxation). none: no network.

A single container of a job has no peers: the Docker backend uses a network on which the engine isolates
all containers, or, if it is the only one of a run, the engine's default network, as ``docker run``
does."""

NETWORK_HELP = "private: a network of the job. internal: without internet. host: the machine's. none: no network."
OUTPUT = "/calibration/output"
"""Volume of the job, writable and shared by its containers; removed with the job."""

Text = Annotated[str, length(1)]
Absolute = Annotated[str, matching("/.*", "an absolute path")]
Variable = Annotated[str, matching("[A-Za-z_][A-Za-z0-9_]*", "the name of a variable")]
ExitCode = Annotated[int, between(0, 255)]


def _command_words(value: str | tuple[str, ...], place: Place) -> tuple[str, ...]:
    return split_command(value, str(place))


def _entrypoint_words(value: str | tuple[str, ...], place: Place) -> tuple[str, ...]:
    return () if value == () else split_command(value, str(place))


def _variable_text(value: str | float, _: Place) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


Command = Annotated[tuple[str, ...], Converted(str | tuple[str, ...], _command_words)]
Value = Annotated[str, Converted(str | int | float | bool, _variable_text)]
"""Numbers as written, booleans as ``true`` or ``false``."""


@record
class Mount:
    """A folder or file of this machine, mounted in a container; read-only by default."""

    source: Path = field("The folder or file.")
    target: Absolute = field("Path in the container.")
    writable: bool = field("Whether the container may write to it.", default=False)


_MOUNT_TEXT = matching("[^:]+:/[^:]*(:ro)?", "HERE:THERE with an absolute THERE, or keys: source, target, writable")


def _parse_mount(value: str | Mount, place: Place) -> Mount:
    if isinstance(value, Mount):
        return value
    source, target = value.removesuffix(":ro").split(":")
    return Mount(place.folder / source, target)


@record
class Limits:
    """Limits of a container; None for no limit."""

    memory: Bytes | None = field("Limit of memory, including swap: 2g, 512m.", default=None)
    cpus: Annotated[float, above(0)] | None = field("Limit of cores: 1.5 of the machine's.", default=None)
    processes: Annotated[int, at_least(1)] | None = field("Limit of concurrent processes.", default=4096)
    seconds: Seconds | None = field(
        "Time limit, after which it is stopped and has failed: 90s, 10m.", default=None, key="timeout"
    )


@record(rules=(one_of("port", "log", "file", "command", why="expected port, log, file or command"),))
class Readiness:
    """Readiness check of a container, on which others wait; all given conditions must be met."""

    port: Annotated[int, between(1, 65535)] | None = field("It accepts connections on this TCP port.", default=None)
    log: Text | None = field("This regular expression matches in a line of its log.", default=None)
    file: Annotated[str, matching("[/{].*", "an absolute path")] | None = field("This file exists.", default=None)
    command: Command = field("This command, run in the container, returns 0.", default=())
    seconds: Seconds = field("Time limit, after which the job fails.", default=60.0, key="timeout")


@record
class Relaxations:
    """Privileges of a container that are forbidden by default."""

    new_privileges: bool = field("Programs such as sudo may gain privileges.", default=False)
    capabilities: Annotated[
        tuple[Annotated[str, matching("[A-Z_]+", "the name of a capability such as NET_RAW")], ...], UNIQUE
    ] = field("Linux capabilities of the container: NET_RAW.", default=())
    devices: Annotated[tuple[Annotated[str, matching("/dev/.*", "a device such as /dev/video0")], ...], UNIQUE] = field(
        "Devices of the machine: /dev/video0.", default=()
    )
    gpus: bool = field("All GPUs of the machine.", default=False)
    docker_socket: bool = field("Mount the engine's socket: equivalent to root on the machine.", default=False)
    privileged: bool = field("All privileges of root on the machine.", default=False)


@record
class Artifact:
    """Files to copy out of a container at the end of the job."""

    path: Text = field("The path in the container, with *, ?, [...] and **.")
    """Absolute, with shell wildcards. A folder includes all
    its content. Targets are relative to the path's last folder without a wildcard: ``/out/a/*.csv`` to
    ``x.csv``, ``/out/a`` to ``a/x.csv``. Links within the folder are skipped, with a note; other links and
    special files are refused."""
    required: bool = field("Whether the job fails if no file matches.", default=True)


@record
class Container:
    """A container: its command, its limits and privileges, and its artifacts.

    Everything that is not listed here is forbidden.
    """

    name: str = ""
    """Unique in the job; host name on the job's network."""
    image: str = field("The image, such as ghcr.io/team/robot:latest.", default="")
    """Empty in calibration.yml for the image that the pipeline builds."""
    command: Command = field(
        "Arguments, run without a shell; a string is split as in a shell. By default the command of the image.",
        default=(),
    )
    entrypoint: Annotated[tuple[str, ...], Converted(str | tuple[str, ...], _entrypoint_words)] | None = field(
        "Entrypoint instead of the image's; an empty list for none.", default=None
    )
    environment: Mapping[Annotated[str, matching("[^=]+", "a name without =")], Value] = field(
        "Variables and their values.", default_factory=dict, repr=False
    )
    """Including those of ``secrets``, after `with_secrets`."""
    secrets: Annotated[
        frozenset[str],
        Converted(Annotated[tuple[Variable, ...], UNIQUE], lambda names, _: frozenset(names)),
    ] = field(
        "Names of environment variables of this machine to pass on; their values are masked in every log.",
        default=frozenset(),
    )
    """Their values are redacted in every log, file and message."""
    working_directory: Absolute | None = field("Absolute path in the container.", default=None)
    user: Annotated[str, Converted(str | int, lambda user, _: str(user))] | None = field(
        "User name or id in the image, optionally with a group (1000:1000).", default=None
    )
    mounts: tuple[Annotated[Mount, Converted(Annotated[str, _MOUNT_TEXT] | Mount, _parse_mount)], ...] = field(
        "Folders and files of this machine, read-only by default; paths are relative to this file.",
        default=(),
    )
    limits: Limits = field(flat=True, default_factory=Limits)
    readiness: Readiness | None = field("Readiness check, on which other containers wait.", default=None, key="ready")
    after: Annotated[tuple[Text, ...], UNIQUE] = field(
        "Containers that must be ready (or started, without a readiness check) before this one starts.",
        default=(),
    )
    essential: bool = field("Whether the job ends with this container.", default=True)
    """Other containers are stopped then, and their ends do not affect the verdict."""
    success: Annotated[
        tuple[int, ...],
        Converted(ExitCode | tuple[ExitCode, ...], lambda codes, _: codes if isinstance(codes, tuple) else (codes,)),
    ] = field("Exit codes of success; an empty list if it must not end by itself.", default=(0,))
    artifacts: tuple[
        Annotated[Artifact, Converted(Text | Artifact, lambda v, _: Artifact(v) if isinstance(v, str) else v)], ...
    ] = field("Files and folders to copy out of the container; a missing required one fails the job.", default=())
    relaxations: Relaxations = field(flat=True, default_factory=Relaxations)


CONTAINER_NAME = matching("[A-Za-z0-9][A-Za-z0-9_.-]{0,62}", "the name of a container")
"""Also its host name, and part of file names."""


@record(nulls=True)
class Job:
    """Containers that run together."""

    name: Text = field("Name of the job, unique among those of a run.")
    """Also the name of its folder, so it may contain slashes, but no parts of dots."""
    containers: Annotated[tuple[Container, ...], ByName(CONTAINER_NAME)] = field("The containers, by name.")
    network: Network = field(NETWORK_HELP, default="private")
    seconds: Seconds | None = field(
        "Time limit, after which the job is stopped and has failed.", default=3600.0, key="timeout"
    )
    artifact_bytes: Annotated[int, at_least(0)] = field("Size limit of the artifacts.", default=2 * 1024**3)
    artifact_files: Annotated[int, at_least(0)] = field("Limit of the number of artifacts.", default=20_000)
    own_network: bool = field(
        "Use a private network even for a single container of a run: for software that finds its peers by multicast, "
        "as ROS 2 does.",
        default=False,
    )


def with_secrets(container: Container, where: str, environment: Mapping[str, str] | None = None) -> Container:
    """Add the values of a container's ``secrets`` to its variables.

    Args:
        container: container as read.
        where: prefix of messages.
        environment: source of the values; by default the environment of this process.

    Raises:
        InputError: a secret is not set, or has a value in the file too.
    """
    environment = os.environ if environment is None else environment
    for name in sorted(container.secrets):
        if not environment.get(name):
            raise InputError(f"{where}.secrets: the environment variable {name} is not set")
        if name in container.environment:
            raise InputError(f"{where}: {name} is in environment and in secrets: remove it from environment")
    secrets = {name: environment[name] for name in container.secrets}
    return replace(container, environment={**container.environment, **secrets})
