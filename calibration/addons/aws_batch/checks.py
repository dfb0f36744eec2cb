"""Validation of jobs for AWS Batch, which supports less than Docker; errors say what to do instead."""

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

from calibration.addons.aws_batch.definition import group_by_shape, job_definition
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.addons.aws_batch.wire import JOB_FOLDER, MOUNTS_FOLDER, PREPARE_CONTAINER, WATCH_CONTAINER
from calibration.base.errors import InputError
from calibration.base.text import shorten
from calibration.ci.execution.globs import Glob
from calibration.ci.execution.job import OUTPUT, Container, Job, Relaxations

_IMAGE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.:/@-]{0,254}")
_CONTAINER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_OUR_FOLDERS = (OUTPUT, JOB_FOLDER, MOUNTS_FOLDER)


def check_task(job: Job, place: str) -> None:
    """Refuse a valid job that cannot run as a task.

    Args:
        job: the job.
        place: backend in messages, such as ``on AWS Batch``.

    Raises:
        InputError: the message names the job, the container and what to do.
    """
    for problem in _in_job(job):
        raise InputError(f"job '{job.name}': {place} {problem}")
    for container in job.containers:
        for problem in _in_container(container):
            raise InputError(f"job '{job.name}', container '{container.name}': {place} {problem}")


def _in_job(job: Job) -> Iterator[str]:
    if job.network in ("internal", "none"):
        yield f"a task has to reach S3, so there is no network '{job.network}': set network: private"
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
    """Return the port in a container's readiness check, if it has one."""
    return None if container.readiness is None else container.readiness.port


def _in_mounts(job: Job) -> Iterator[str]:
    """Yield mounts that cannot be volumes; a volume has the same content in all containers."""
    sources: dict[str, str] = {}
    for container in job.containers:
        for mount in container.mounts:
            target, source = mount.target.rstrip("/"), str(mount.source.resolve())
            if not mount.source.is_dir():
                yield f"only folders can be mounted, and {mount.source} (at {target}) is not a folder: mount its folder"
            if sources.setdefault(target, source) != source:
                yield f"all containers have to mount the same folder at {target}: change one target"
        targets = sorted(f"{mount.target.rstrip('/')}/" for mount in container.mounts)
        for one, other in [*pairwise(targets), *_with_ours(targets)]:
            if one.startswith(other) or other.startswith(one):
                yield f"mounts must not be nested: found {one.rstrip('/')} and {other.rstrip('/')}"


def _with_ours(targets: Sequence[str]) -> Iterator[tuple[str, str]]:
    return ((f"{own}/", target) for own in _OUR_FOLDERS for target in targets)


def _in_container(container: Container) -> Iterator[str]:
    if container.name in (PREPARE_CONTAINER, WATCH_CONTAINER):
        yield "this is the name of one of our own containers: give it another"
    if not _CONTAINER_NAME.fullmatch(container.name):
        yield "a container's name has letters, digits, _ and - only: give it another"
    if not _IMAGE_NAME.fullmatch(container.image):
        yield f"this is no name of an image: '{shorten(container.image)}': letters, digits, _ - : . / @, at most 255"
    if not container.command and not container.entrypoint:
        yield "the image's default command is not known: set command"
    for artifact in container.artifacts:
        if not f"{Glob(artifact.path).source}/".startswith(f"{OUTPUT}/"):
            yield f"only files in {OUTPUT} are copied, so artifact '{artifact.path}' is not: write it there"
    if container.relaxations.docker_socket:
        yield "there is no Docker Engine: remove docker-socket"


MAX_CONTAINERS = 10
"""Limit of containers of a task; two of them are ours."""
_ON_BATCH = "on AWS Batch"
_DEFAULT_CAPABILITIES = frozenset(
    {
        *("AUDIT_WRITE", "CHOWN", "DAC_OVERRIDE", "FOWNER", "FSETID", "KILL", "MKNOD", "NET_BIND_SERVICE", "NET_RAW"),
        *("SETFCAP", "SETGID", "SETPCAP", "SETUID", "SYS_CHROOT"),
    }
)
"""Capabilities of every container on AWS Batch, where none can be added or dropped."""


def check_for_batch(jobs: Sequence[Job], settings: BatchSettings) -> None:
    """Refuse jobs that are valid, as `check_jobs` says, but cannot run on AWS Batch.

    Raises:
        InputError: the message names the job, the container and what to do.
    """
    for job in jobs:
        check_task(job, _ON_BATCH)
        _check_job(job, settings)
    if settings.platform == "ec2" and settings.shared_hosts and len(jobs) > 1:
        _check_hosts(jobs)
    for group in group_by_shape(jobs, settings):
        try:
            job_definition(group.shape, settings)
        except InputError as error:
            raise InputError(f"job '{jobs[group.jobs[0]].name}': {error}") from None


def _check_job(job: Job, settings: BatchSettings) -> None:
    if len(job.containers) > MAX_CONTAINERS - 2:
        raise InputError(
            f"job '{job.name}': {_ON_BATCH} a task has at most {MAX_CONTAINERS} containers, of which two are ours: "
            f"found {len(job.containers)}, expected at most {MAX_CONTAINERS - 2}"
        )
    if job.network == "host" and settings.platform == "fargate":
        raise InputError(
            f"job '{job.name}': {_ON_BATCH} a task on Fargate has its own network, not a host's: set network: "
            "private, or platform: ec2"
        )
    for container in job.containers:
        for problem in _in_relaxations(container.relaxations, settings):
            raise InputError(f"job '{job.name}', container '{container.name}': {_ON_BATCH} {problem}")


def _in_relaxations(relaxed: Relaxations, settings: BatchSettings) -> Iterator[str]:
    wanted = {"devices": relaxed.devices, "gpus": relaxed.gpus, "privileged": relaxed.privileged}
    for name in (name for name, value in wanted.items() if value and settings.platform == "fargate"):
        yield f"Fargate has no {name}: set platform: ec2, or remove it"
    missing = sorted(set(relaxed.capabilities) - _DEFAULT_CAPABILITIES)
    if missing and not relaxed.privileged:
        yield f"no capability can be added, and {missing[0]} is not among the default ones: remove it"


def _check_hosts(jobs: Sequence[Job]) -> None:
    """Refuse jobs with conflicting ports or messages, if several may share the network of an instance."""
    for job in jobs:
        for container in job.containers:
            if (port := ready_port(container)) is not None:
                what = f"container '{container.name}' listens on port {port}"
            elif job.own_network or "ROS_MASTER_URI" in container.environment:
                what = f"ROS in container '{container.name}' looks for others in the network"
            else:
                continue
            raise InputError(
                f"job '{job.name}': {what}, and of {len(jobs)} jobs on platform ec2 several may share an instance's "
                "network: set platform: fargate, or shared-hosts: false if each instance holds one job"
            )
