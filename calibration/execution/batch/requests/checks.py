"""Jobs that Docker runs and AWS Batch cannot: refused before anything is sent, with what to do instead."""

from collections.abc import Iterator, Sequence

from calibration.errors import InputError
from calibration.execution.batch.requests.definition import job_definition
from calibration.execution.batch.requests.shape import group_by_shape
from calibration.execution.batch.requests.task_checks import check_task, ready_port
from calibration.execution.batch.settings import BatchSettings
from calibration.execution.job import Job, Relaxations

MOST_CONTAINERS = 10
"""Of a task; two of them are ours."""
_PLACE = "on AWS Batch"
_CAPABILITIES = frozenset(
    {
        *("AUDIT_WRITE", "CHOWN", "DAC_OVERRIDE", "FOWNER", "FSETID", "KILL", "MKNOD", "NET_BIND_SERVICE", "NET_RAW"),
        *("SETFCAP", "SETGID", "SETPCAP", "SETUID", "SYS_CHROOT"),
    }
)
"""Those that containers on AWS Batch have, as none can be added or dropped."""


def check_for_batch(jobs: Sequence[Job], settings: BatchSettings) -> None:
    """Refuse jobs that make sense, as `check_jobs` says, but not on AWS Batch.

    Raises:
        InputError: names the job, the container and what to do.
    """
    for job in jobs:
        check_task(job, _PLACE)
        _check_job(job, settings)
    if settings.platform == "ec2" and settings.shared_hosts and len(jobs) > 1:
        _check_hosts(jobs)
    for group in group_by_shape(jobs, settings):
        try:
            job_definition(group.shape, settings)
        except InputError as error:
            raise InputError(f"job '{jobs[group.jobs[0]].name}': {error}") from None


def _check_job(job: Job, settings: BatchSettings) -> None:
    if len(job.containers) > MOST_CONTAINERS - 2:
        raise InputError(
            f"job '{job.name}': {_PLACE} a task has at most {MOST_CONTAINERS} containers, of which two are ours: "
            f"found {len(job.containers)}, expected at most {MOST_CONTAINERS - 2}"
        )
    if job.network == "host" and settings.platform == "fargate":
        raise InputError(
            f"job '{job.name}': {_PLACE} a task on Fargate has a network of its own, not a host's: say network: "
            "private, or platform: ec2"
        )
    for container in job.containers:
        for problem in _in_relaxations(container.relaxations, settings):
            raise InputError(f"job '{job.name}', container '{container.name}': {_PLACE} {problem}")


def _in_relaxations(relaxed: Relaxations, settings: BatchSettings) -> Iterator[str]:
    wanted = {"devices": relaxed.devices, "gpus": relaxed.gpus, "privileged": relaxed.privileged}
    for name in (name for name, value in wanted.items() if value and settings.platform == "fargate"):
        yield f"Fargate has no {name}: say platform: ec2, or drop it"
    missing = sorted(set(relaxed.capabilities) - _CAPABILITIES)
    if missing and not relaxed.privileged:
        yield f"no capability can be added, and {missing[0]} is none that every container has: drop it"


def _check_hosts(jobs: Sequence[Job]) -> None:
    """Refuse jobs whose ports or messages meet, where several may land on one instance, whose network they share."""
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
                "network: say platform: fargate, or shared-hosts: false if each instance holds one job"
            )
