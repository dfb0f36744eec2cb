"""Checks of the job queue before submission, and likely reasons why jobs get no host."""

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import botocore.exceptions

from calibration.addons.aws_batch.aws_errors import aws_errors, error_code
from calibration.addons.aws_batch.definition import Resources
from calibration.addons.aws_batch.following import Poll, records
from calibration.addons.aws_batch.session import Aws
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.base.errors import CalibrationError, InputError
from calibration.base.text import one_line, shorten
from calibration.ci.registries.reference import ecr_host, parse_reference

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
