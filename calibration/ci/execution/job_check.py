"""Validation of jobs, before anything is started: what the records of a job cannot say of themselves."""

import os
import re
import stat
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from calibration.base import InputError, did_you_mean, shorten
from calibration.ci.execution.job import CONTAINER_NAME, OUTPUT, Container, Job, Mount, Readiness
from calibration.ci.execution.outcome import Glob

_JOB_NAME_PART = r"[A-Za-z0-9_+=,@][A-Za-z0-9_+=,@ .:-]{0,127}"
_VARIABLE_NAME = r"[^=\0]+"
_ENGINE_SOCKETS = ("/var/run/docker.sock", "/run/docker.sock")
_LEAST_MEMORY = 6 * 1024**2
"""Minimum in bytes that engines accept."""
_MOST_CONTAINERS = 100


def check_jobs(jobs: Sequence[Job], workers: int | None = None) -> None:
    """Refuse invalid jobs of a run, jobs whose folders are equal or nested, and a number of workers below one.

    Raises:
        InputError: the message names the job, the container and the problem.
    """
    names: dict[str, str] = {}
    for job in jobs:
        check_job(job)
        name = job.name.casefold()  # on some file systems "A" and "a" are the same folder
        if name in names:
            raise InputError(f"job '{job.name}': another job of the run has the name '{names[name]}'")
        names[name] = job.name
    for name, written in names.items():
        parts = name.split("/")
        for count in range(1, len(parts)):
            if (outer := "/".join(parts[:count])) in names:
                raise InputError(f"job '{written}': its folder would lie in that of job '{names[outer]}': rename one")
    if workers is not None and workers < 1:
        raise InputError(f"jobs: found {workers}, expected at least 1")


def check_job(job: Job) -> None:
    """Refuse an invalid job.

    Raises:
        InputError: the message names the job, the container and the problem.
    """
    where = f"job '{shorten(job.name)}'"
    parts = job.name.split("/")
    if not all(re.fullmatch(_JOB_NAME_PART, part) for part in parts) or {".", ".."} & set(parts) or len(parts) > 8:
        raise InputError(f"{where}: this is no name for a job: letters, digits and _ + = , @ : . - with / between")
    if not 1 <= len(job.containers) <= _MOST_CONTAINERS:
        raise InputError(f"{where}: it has {len(job.containers)} containers, expected 1 to {_MOST_CONTAINERS}")
    if not any(container.essential for container in job.containers):
        raise InputError(f"{where}: no container is essential, so nothing would end it")
    seen: set[str] = set()
    for container in job.containers:
        _check_container(container, f"{where}, container '{shorten(container.name)}'")
        if container.name.casefold() in seen:
            raise InputError(f"{where}: two containers have the name '{container.name}'")
        seen.add(container.name.casefold())
    start_order(job)


def start_order(job: Job) -> tuple[Container, ...]:
    """Return the containers sorted so that each follows those that it waits for, otherwise in the given order.

    Raises:
        InputError: a container waits for an unknown one, or containers wait for each other.
    """
    known = {container.name: container for container in job.containers}
    order: dict[str, Container] = {}

    def place(container: Container, waiting: tuple[str, ...]) -> None:
        if container.name in waiting:
            circle = " after ".join((*waiting[waiting.index(container.name) :], container.name))
            raise InputError(f"job '{job.name}': containers wait for each other: {circle}")
        for name in container.after:
            if name not in known:
                raise InputError(
                    f"job '{job.name}', container '{container.name}': after: there is no container '{shorten(name)}'"
                    f"{did_you_mean(name, known)}"
                )
            if name not in order:
                place(known[name], (*waiting, container.name))
        order.setdefault(container.name, container)

    for container in job.containers:
        place(container, ())
    return tuple(order.values())


def _check_container(container: Container, where: str) -> None:
    if not CONTAINER_NAME.holds(container.name):
        raise InputError(f"{where}: this is no name for a container: letters, digits, _ . and -, at most 63")
    if not container.image.strip():
        raise InputError(f"{where}: it has no image")
    for problem in _container_problems(container):
        raise InputError(f"{where}: {problem}")


def _container_problems(container: Container) -> Iterator[str]:
    yield from _in_texts(container)
    if container.limits.memory is not None and container.limits.memory < _LEAST_MEMORY:
        yield f"memory: {container.limits.memory} bytes are below the minimum of all engines (6m)"
    if container.readiness is not None:
        yield from _in_readiness(container.readiness)
    yield from _in_mounts(container.mounts)
    for artifact in container.artifacts:
        if not _is_plain_absolute(artifact.path):
            yield f"artifact '{artifact.path}': expected an absolute path in the container without . and .."
        elif Glob(artifact.path).source == "/":
            yield f"artifact '{artifact.path}': the whole container would have to be read; give a folder"


def _in_texts(container: Container) -> Iterator[str]:
    for key, value in container.environment.items():
        if not re.fullmatch(_VARIABLE_NAME, key) or "\0" in value:
            yield f"environment: '{shorten(key)}' is no name of a variable, or its value has a NUL character"
    for name in sorted(container.secrets - set(container.environment)):
        yield f"secrets: '{shorten(name)}' is no variable of its environment"
    if any("\0" in argument for argument in (*container.command, *(container.entrypoint or ()))):
        yield "command: an argument has a NUL character"
    folder = container.working_directory
    if folder is not None and not _is_plain_absolute(folder):
        yield f"working-directory '{folder}': expected an absolute path in the container"


def _in_readiness(readiness: Readiness) -> Iterator[str]:
    if readiness.file is not None and not _is_plain_absolute(readiness.file):
        yield f"ready: file '{readiness.file}': expected an absolute path in the container"
    try:
        re.compile(readiness.log or "")
    except re.error as error:
        yield f"ready: log: '{shorten(readiness.log or '')}' is no regular expression: {error}"


def _in_mounts(mounts: Iterable[Mount]) -> Iterator[str]:
    targets: set[str] = set()
    for mount in mounts:
        target = mount.target.rstrip("/")
        if not _is_plain_absolute(mount.target) or not target:
            yield f"mount '{mount.target}': expected an absolute path in the container, and not its root"
        if target in targets:
            yield f"mount '{target}': another mount has the same target"
        targets.add(target)
        if f"{target}/".startswith(f"{OUTPUT}/") or f"{OUTPUT}/".startswith(f"{target}/"):
            yield f"mount '{target}': {OUTPUT} is the job's own volume, nothing may be mounted over or in it"
        if not mount.source.exists():
            yield f"mount '{target}': there is no {mount.source} on this machine"
        elif _gives_the_engine_away(mount.source):
            yield (
                f"mount '{target}': {mount.source} is, or holds, a socket: access to the engine's is equivalent to "
                "root on the machine; if this is intended, set docker-socket: true"
            )


def _gives_the_engine_away(source: Path) -> bool:
    """Return whether a mount's source is a socket, or a folder that contains the engine's socket."""
    resolved = source.resolve()
    if stat.S_ISSOCK(resolved.stat().st_mode):
        return True
    own = os.environ.get("DOCKER_HOST", "").removeprefix("unix://")
    sockets = [Path(place) for place in (*_ENGINE_SOCKETS, own) if place.startswith("/")]
    return any(resolved in (*place.parents, *place.resolve().parents) for place in sockets)


def _is_plain_absolute(path: str) -> bool:
    return path.startswith("/") and "\0" not in path and not {".", ".."} & set(path.split("/"))
