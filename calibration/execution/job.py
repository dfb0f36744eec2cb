"""What a job is: containers that run together, what is brought out of them, and what counts as success.

A job says nothing of where it runs: a backend does that.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

Network = Literal["private", "internal", "host", "none"]
"""private: the job's containers find each other by name, and those of no other job. internal: the same without a
way out. host: that of the machine (a relaxation). none: no network.

A container alone in its job has nobody to find: the Docker backend puts it on a network on which the engine keeps
all containers apart, or, where it is all that there is in a run, on the engine's default network, as ``docker run``
does."""

OUTPUT = "/calibration/output"
"""A volume of the job's own, writable and shared by its containers; it is gone with the job."""


@dataclass(frozen=True)
class Mount:
    """A folder or file of this machine, seen in a container; read-only unless told otherwise."""

    source: Path
    target: str
    """Absolute, in the container."""
    writable: bool = False


@dataclass(frozen=True)
class Limits:
    """What a container may use; None where there is no limit."""

    memory: int | None = None
    """Bytes, swap included."""
    cpus: float | None = None
    processes: int | None = 4096
    seconds: float | None = None
    """From its start; one that runs longer is stopped, and has failed."""


@dataclass(frozen=True)
class Readiness:
    """When a container is ready, so that those after it may start; everything that is given must hold."""

    port: int | None = None
    """It accepts connections on this TCP port."""
    log: str | None = None
    """This regular expression is found in a line of its log."""
    file: str | None = None
    """This file is there."""
    command: tuple[str, ...] = ()
    """This command, run in it, answers 0."""
    seconds: float = 60.0
    """It is not ready after so long: the job has failed, and the software in it is to blame (exit code 1)."""


@dataclass(frozen=True)
class Relaxations:
    """What is allowed that is forbidden by default; each is named by whoever writes the job."""

    new_privileges: bool = False
    """Programs such as sudo may gain privileges."""
    capabilities: tuple[str, ...] = ()
    """Linux capabilities that are not dropped: ``NET_RAW``."""
    devices: tuple[str, ...] = ()
    """Devices of the machine: ``/dev/video0``."""
    gpus: bool = False
    docker_socket: bool = False
    """The engine's socket: whoever has it is root on the machine."""
    privileged: bool = False


@dataclass(frozen=True)
class Artifact:
    """Files to bring out of a container when the job has ended."""

    path: str
    """Absolute, in the container, with ``*``, ``?``, ``[...]`` and ``**`` as in a shell. A folder stands for all
    that is in it. What is found lands relative to the path's last folder without a wildcard: ``/out/a/*.csv`` as
    ``x.csv``, ``/out/a`` as ``a/x.csv``. Links to what is inside are left out, with a note; other links and what is
    no file or folder are refused."""
    required: bool = True
    """Whether the job has failed where nothing is found."""


@dataclass(frozen=True)
class Container:
    """One container of a job."""

    name: str
    """Unique in the job; its host name on the job's network."""
    image: str
    command: tuple[str, ...] = ()
    """Arguments, run without a shell; the image's own command where there are none."""
    entrypoint: tuple[str, ...] | None = None
    """In the place of the image's; None for the image's."""
    environment: Mapping[str, str] = field(default_factory=dict, repr=False)
    secrets: frozenset[str] = frozenset()
    """Names of variables of the environment whose values appear in no log, file or message."""
    working_directory: str | None = None
    user: str | None = None
    mounts: tuple[Mount, ...] = ()
    limits: Limits = field(default_factory=Limits)
    readiness: Readiness | None = None
    after: tuple[str, ...] = ()
    """Containers that have to be ready (or, without a readiness, started) before this one starts."""
    essential: bool = True
    """Its end ends the job. What is not essential is stopped then, and its end is no success or failure."""
    success: tuple[int, ...] = (0,)
    """The exit codes of an essential container that are a success; none where it must not end by itself."""
    artifacts: tuple[Artifact, ...] = ()
    relaxations: Relaxations = field(default_factory=Relaxations)


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
