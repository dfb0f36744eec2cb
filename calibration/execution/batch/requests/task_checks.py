"""What no job may have whose containers share one address and get their folders as volumes: in a task, or in a pod."""

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

from calibration.errors import InputError
from calibration.execution.batch.wire import JOB_FOLDER, MOUNTS_FOLDER, PREPARE, WATCH
from calibration.execution.globs import Glob
from calibration.execution.job import OUTPUT, Container, Job
from calibration.workflow.text import shorten

_IMAGE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.:/@-]{0,254}")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_OURS = (OUTPUT, JOB_FOLDER, MOUNTS_FOLDER)


def check_task(job: Job, place: str) -> None:
    """Refuse a job that makes sense, but not as a task.

    Args:
        job: the job.
        place: what messages say, such as ``on AWS Batch``.

    Raises:
        InputError: names the job, the container and what to do.
    """
    for problem in _in_job(job):
        raise InputError(f"job '{job.name}': {place} {problem}")
    for container in job.containers:
        for problem in _in_container(container):
            raise InputError(f"job '{job.name}', container '{container.name}': {place} {problem}")


def _in_job(job: Job) -> Iterator[str]:
    if job.network in ("internal", "none"):
        yield f"a task has to reach S3, so there is no network '{job.network}': say network: private"
    yield from _in_mounts(job)
    listening: dict[int, str] = {}
    for container in job.containers:
        port = ready_port(container)
        if port is None:
            continue
        if port in listening:
            yield (
                f"all containers of a task share one address, so '{listening[port]}' and '{container.name}' cannot "
                f"both listen on port {port}: give one another port"
            )
        listening[port] = container.name


def ready_port(container: Container) -> int | None:
    """The port that a container is known to listen on."""
    return None if container.readiness is None else container.readiness.port


def _in_mounts(job: Job) -> Iterator[str]:
    """What of its mounts cannot be a volume; a volume has one content, wherever it is mounted."""
    sources: dict[str, str] = {}
    for container in job.containers:
        for mount in container.mounts:
            target, source = mount.target.rstrip("/"), str(mount.source.resolve())
            if not mount.source.is_dir():
                yield f"only folders can be mounted, and {mount.source} (at {target}) is none: mount its folder"
            if sources.setdefault(target, source) != source:
                yield f"all containers have to mount the same folder at {target}: give one another place"
        targets = sorted(f"{mount.target.rstrip('/')}/" for mount in container.mounts)
        for one, other in [*pairwise(targets), *_with_ours(targets)]:
            if one.startswith(other) or other.startswith(one):
                yield f"no mount may lie in another: found {one.rstrip('/')} and {other.rstrip('/')}"


def _with_ours(targets: Sequence[str]) -> Iterator[tuple[str, str]]:
    return ((f"{own}/", target) for own in _OURS for target in targets)


def _in_container(container: Container) -> Iterator[str]:
    if container.name in (PREPARE, WATCH):
        yield "this is the name of one of our own containers: give it another"
    if not _NAME.fullmatch(container.name):
        yield "a container's name has letters, digits, _ and - only: give it another"
    if not _IMAGE.fullmatch(container.image):
        yield f"this is no name of an image: '{shorten(container.image)}': letters, digits, _ - : . / @, at most 255"
    if not container.command and not container.entrypoint:
        yield "nobody can ask an image for its own command: say command"
    for artifact in container.artifacts:
        if not f"{Glob(artifact.path).source}/".startswith(f"{OUTPUT}/"):
            yield f"only what lies in {OUTPUT} is brought out, so artifact '{artifact.path}' is not: write it there"
    if container.relaxations.docker_socket:
        yield "there is no engine to give away: drop docker-socket"
