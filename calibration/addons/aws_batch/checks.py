"""Checks before a run: jobs that AWS Batch, which supports less than Docker, can run; images, and the queue.

Errors say what to do instead. Also likely reasons why jobs get no host.
"""

import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import botocore.exceptions

from calibration.addons.aws_batch.definition import Resources, group_by_shape, job_definition
from calibration.addons.aws_batch.following import Poll, records
from calibration.addons.aws_batch.session import Aws, aws_errors, error_code
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.addons.aws_batch.wire import JOB_FOLDER, MOUNTS_FOLDER, PREPARE_CONTAINER, WATCH_CONTAINER
from calibration.base import CalibrationError, InputError, one_line, shorten
from calibration.ci.execution.job import OUTPUT, Container, Job, Relaxations
from calibration.ci.execution.outcome import Glob
from calibration.ci.registries.reference import ecr_host, parse_reference

_IMAGE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.:/@-]{0,254}")
_CONTAINER_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_OUR_FOLDERS = (OUTPUT, JOB_FOLDER, MOUNTS_FOLDER)


def _in_job(job: Job, settings: BatchSettings) -> Iterator[str]:
    if job.network in ("internal", "none"):
        yield f"a task has to reach S3, so there is no network '{job.network}': set network: private"
    yield from _in_mounts(job)
    if len(job.containers) > MAX_CONTAINERS - 2:
        yield (
            f"a task has at most {MAX_CONTAINERS} containers, of which two are ours: found {len(job.containers)}, "
            f"expected at most {MAX_CONTAINERS - 2}"
        )
    if job.network == "host" and settings.platform == "fargate":
        yield "a task on Fargate has its own network, not a host's: set network: private, or platform: ec2"
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
        for one, other in [*pairwise(targets), *((f"{own}/", target) for own in _OUR_FOLDERS for target in targets)]:
            if one.startswith(other) or other.startswith(one):
                yield f"mounts must not be nested: found {one.rstrip('/')} and {other.rstrip('/')}"


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
        for problem in _in_job(job, settings):
            raise InputError(f"job '{job.name}': on AWS Batch {problem}")
        for container in job.containers:
            for problem in (*_in_container(container), *_in_relaxations(container.relaxations, settings)):
                raise InputError(f"job '{job.name}', container '{container.name}': on AWS Batch {problem}")
    if settings.platform == "ec2" and settings.shared_hosts and len(jobs) > 1:
        _check_hosts(jobs)
    for group in group_by_shape(jobs, settings):
        try:
            job_definition(group.shape, settings)
        except InputError as error:
            raise InputError(f"job '{jobs[group.jobs[0]].name}': {error}") from None


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


_CODES_OF_MISSING_IMAGE = ("RepositoryNotFoundException", "ImageNotFoundException")


def with_digests(aws: Aws, images: Iterable[str]) -> dict[str, str]:
    """Return images by digest if they are in ECR; those elsewhere, or with a digest, are unchanged.

    Raises:
        InputError: an image does not exist, or access is denied.
        AwsLostError: ECR does not answer.
    """
    return {image: _with_digest(aws, image) for image in dict.fromkeys(images)}


def _with_digest(aws: Aws, image: str) -> str:
    reference = parse_reference(image)
    host = ecr_host(reference.registry)
    if host is None or reference.digest is not None:
        return image
    with aws_errors(f"image {image}"):
        try:
            answer = aws.ecr(host.region).describe_images(
                registryId=host.account,
                repositoryName=reference.repository,
                imageIds=[{"imageTag": reference.tag or "latest"}],
            )
        except botocore.exceptions.ClientError as error:
            if error_code(error) not in _CODES_OF_MISSING_IMAGE:
                raise
            answer = {"imageDetails": []}
    if not answer["imageDetails"]:
        raise InputError(f"image {image}: it is not in ECR: push it (calibration build-image --push true)")
    return str(reference.with_digest(str(answer["imageDetails"][0]["imageDigest"])))


_TYPES_OF_PLATFORM = {"fargate": ("FARGATE", "FARGATE_SPOT"), "ec2": ("EC2", "SPOT", "ECS_MANAGED_INSTANCES")}
_SPOT_TYPES = ("SPOT", "FARGATE_SPOT")


def check_queue(aws: Aws, settings: BatchSettings, needs: Sequence[Resources]) -> None:
    """Refuse a queue that cannot run the jobs.

    Args:
        aws: session.
        settings: settings with the queue and the platform.
        needs: sizes of the tasks.

    Raises:
        InputError: the queue does not exist, is disabled or invalid, or its hosts have another type or are too small.
        AwsLostError: AWS does not answer.
    """
    where = f"queue '{settings.queue}'"
    queue, environments = _describe_queue(aws, settings.queue)
    if not _is_fine(queue):
        raise InputError(f"{where}: it is {_describe_state(queue)}: no job would start")
    usable = [each for each in environments if _is_fine(each)]
    if not usable:
        states = "; ".join(f"{_name_of_environment(each)} is {_describe_state(each)}" for each in environments)
        raise InputError(f"{where}: none of its compute environments accepts jobs: {states or 'it has none'}")
    _check_kinds(usable, settings, where)
    _check_sizes(usable, needs, where)


def _describe_queue(aws: Aws, name: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return Batch's descriptions of a queue and its compute environments."""
    where = f"queue '{name}'"
    with aws_errors(where):
        queues = aws.batch.describe_job_queues(jobQueues=[name])["jobQueues"]
        if not queues:
            raise InputError(f"{where}: there is none in {aws.region}: check its name and the region")
        names = [entry["computeEnvironment"] for entry in queues[0].get("computeEnvironmentOrder", ())]
        answer = aws.batch.describe_compute_environments(computeEnvironments=names) if names else {}
    return queues[0], answer.get("computeEnvironments", [])


def _check_kinds(environments: Sequence[Mapping[str, Any]], settings: BatchSettings, where: str) -> None:
    for environment in environments:
        if environment.get("containerOrchestrationType") == "EKS":
            raise InputError(
                f"{where}: {_name_of_environment(environment)} is of Kubernetes (EKS), expected one of ECS"
            )
    kinds = {str(each.get("computeResources", {}).get("type", "EC2")) for each in environments}  # unmanaged: EC2
    if wrong := kinds - set(_TYPES_OF_PLATFORM[settings.platform]):
        other = "ec2" if settings.platform == "fargate" else "fargate"
        raise InputError(
            f"{where}: its hosts are {', '.join(sorted(wrong))}, but platform is {settings.platform}: set {other}, or "
            "name another queue"
        )
    if settings.spot and not kinds & set(_SPOT_TYPES):
        raise InputError(f"{where}: spot is required, but its hosts are {', '.join(sorted(kinds))}: name another queue")


def _check_sizes(environments: Sequence[Mapping[str, Any]], needs: Sequence[Resources], where: str) -> None:
    limits = [each.get("computeResources", {}).get("maxvCpus") for each in environments]
    known = [limit for limit in limits if limit is not None]
    most = max((need.cpus for need in needs), default=0.0)
    if known and len(known) == len(limits) and most > max(known):
        raise InputError(
            f"{where}: a job needs {most:g} vCPUs, but its compute environments have at most {max(known)} (maxvCpus): "
            "it would never start"
        )


def _name_of_environment(record: Mapping[str, Any]) -> str:
    return f"compute environment '{record['computeEnvironmentName']}'"


def _is_fine(record: Mapping[str, Any]) -> bool:
    return (record["state"], record["status"]) == ("ENABLED", "VALID")


def _describe_state(record: Mapping[str, Any]) -> str:
    reason = record.get("statusReason")
    why = f" ({_shorten_text(reason)})" if reason and record["status"] != "VALID" else ""
    return f"{record['state']} and {record['status']}{why}"


def _shorten_text(text: str) -> str:
    return shorten(one_line(text), 200)


class Guard:
    """Detects that no job of a run has run or ended for a time."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._since: float | None = None

    def is_stuck(self, poll: Poll, done: int) -> bool:
        """Update from a poll, and return whether the run is stuck.

        Args:
            poll: result of the poll.
            done: number of downloaded results since the last poll.
        """
        now = time.monotonic()
        if self._since is None or poll.running_count or poll.ended or done or not poll.queued_count:
            self._since = now
        return now - self._since >= self.seconds


def likely_reasons(aws: Aws, settings: BatchSettings, waiting: Sequence[str]) -> list[str]:
    """Return likely reasons why jobs get no host, likeliest first; never empty.

    Args:
        aws: session.
        settings: settings with the queue.
        waiting: ids of jobs, at most a hundred.
    """
    reasons: list[str] = []
    try:
        jobs = records(aws, waiting)
        status_reasons = [_shorten_text(job["statusReason"]) for job in jobs if job.get("statusReason")]
        reasons += [f"AWS Batch reports: {line}" for line in dict.fromkeys(status_reasons)]
        reasons += _of_the_queue(aws, settings)
    except CalibrationError as error:
        reasons.append(f"the cause is unknown: {error}")
    if settings.platform == "fargate":
        no_way_out = " (public-ip is false: then the subnet needs NAT or endpoints of ECR, S3 and Logs)"
        reasons.append(
            "no capacity, or a subnet without free addresses or a way to pull images"
            + ("" if settings.public_ip else no_way_out)
        )
    else:
        reasons.append("instance types too small for a job, an instance role that may not join, or no capacity")
    if settings.spot:
        reasons.append("no Spot capacity at the moment")
    reasons.append("other jobs in the queue, or the account's quota of vCPUs")
    return reasons


def _of_the_queue(aws: Aws, settings: BatchSettings) -> list[str]:
    queue, environments = _describe_queue(aws, settings.queue)
    reasons = [] if _is_fine(queue) else [f"the queue is {_describe_state(queue)}"]
    for environment in environments:
        if not _is_fine(environment):
            reasons.append(f"{_name_of_environment(environment)} is {_describe_state(environment)}")
        if environment.get("computeResources", {}).get("maxvCpus") == 0:
            reasons.append(f"{_name_of_environment(environment)} may have no vCPUs (maxvCpus: 0)")
    return reasons
