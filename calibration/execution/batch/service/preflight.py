"""Whether the queue and the bucket can do what is about to be asked of them."""

from collections.abc import Mapping, Sequence
from typing import Any

from calibration.aws_errors import aws_errors
from calibration.errors import InputError
from calibration.execution.batch.requests.task_size import Resources
from calibration.execution.batch.service.session import Aws
from calibration.execution.batch.settings import BatchSettings
from calibration.workflow.text import one_line, shorten

_TYPES = {"fargate": ("FARGATE", "FARGATE_SPOT"), "ec2": ("EC2", "SPOT", "ECS_MANAGED_INSTANCES")}
_SPOT = ("SPOT", "FARGATE_SPOT")


def check_queue(aws: Aws, settings: BatchSettings, needs: Sequence[Resources]) -> None:
    """Refuse a queue that takes no jobs, or not these.

    Args:
        aws: where it is.
        settings: name it, and say what is expected of it.
        needs: what tasks ask for.

    Raises:
        InputError: there is no such queue, it is disabled or broken, or its hosts are of another kind or too small.
        AwsLostError: AWS does not answer.
    """
    where = f"queue '{settings.queue}'"
    with aws_errors(where):
        queues = aws.batch.describe_job_queues(jobQueues=[settings.queue])["jobQueues"]
    if not queues:
        raise InputError(f"{where}: there is none in {aws.region}: check its name and the region")
    queue = queues[0]
    if queue["state"] != "ENABLED" or queue["status"] != "VALID":
        raise InputError(f"{where}: it is {queue['state']} and {queue['status']}{_why(queue)}: no job would start")
    environments = _environments(aws, queue, where)
    usable = [each for each in environments if each["state"] == "ENABLED" and each["status"] == "VALID"]
    if not usable:
        states = "; ".join(
            f"{_name(each)} is {each['state']} and {each['status']}{_why(each)}" for each in environments
        )
        raise InputError(f"{where}: none of its compute environments takes jobs: {states or 'it has none'}")
    _check_kinds(usable, settings, where)
    _check_sizes(usable, needs, where)


def _environments(aws: Aws, queue: Mapping[str, Any], where: str) -> list[dict[str, Any]]:
    names = [entry["computeEnvironment"] for entry in queue.get("computeEnvironmentOrder", ())]
    if not names:
        return []
    with aws_errors(where):
        found: list[dict[str, Any]] = aws.batch.describe_compute_environments(computeEnvironments=names)[
            "computeEnvironments"
        ]
    return found


def _check_kinds(environments: Sequence[Mapping[str, Any]], settings: BatchSettings, where: str) -> None:
    for environment in environments:
        if environment.get("containerOrchestrationType") == "EKS":
            raise InputError(f"{where}: {_name(environment)} is of Kubernetes (EKS), expected one of ECS")
    kinds = {str(each.get("computeResources", {}).get("type", "EC2")) for each in environments}  # unmanaged: EC2
    if wrong := kinds - set(_TYPES[settings.platform]):
        other = "ec2" if settings.platform == "fargate" else "fargate"
        raise InputError(
            f"{where}: its hosts are {', '.join(sorted(wrong))}, but platform is {settings.platform}: say {other}, or "
            "name another queue"
        )
    if settings.spot and not kinds & set(_SPOT):
        raise InputError(
            f"{where}: spot is asked for, but its hosts are {', '.join(sorted(kinds))}: name another queue"
        )


def _check_sizes(environments: Sequence[Mapping[str, Any]], needs: Sequence[Resources], where: str) -> None:
    limits = [each.get("computeResources", {}).get("maxvCpus") for each in environments]
    known = [limit for limit in limits if limit is not None]
    most = max((need.cpus for need in needs), default=0.0)
    if known and len(known) == len(limits) and most > max(known):
        raise InputError(
            f"{where}: a job needs {most:g} vCPUs, but its compute environments have at most {max(known)} (maxvCpus): "
            "it would wait for ever"
        )


def _name(record: Mapping[str, Any]) -> str:
    return f"compute environment '{record['computeEnvironmentName']}'"


def _why(record: Mapping[str, Any]) -> str:
    reason = record.get("statusReason")
    return f" ({shorten(one_line(reason), 200)})" if reason and record["status"] != "VALID" else ""
