"""Jobs that wait for a host and get none: when to give them up, and why it may be."""

import time
from collections.abc import Sequence
from typing import Any

from calibration.aws_errors import aws_errors
from calibration.errors import CalibrationError
from calibration.execution.batch.service.following import Look, records
from calibration.execution.batch.service.session import Aws
from calibration.execution.batch.settings import BatchSettings
from calibration.workflow.text import one_line, shorten


class Guard:
    """Notices that nothing of a run has run, or come to its end, for a time: what waits behind others is not stuck."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._since: float | None = None

    def is_stuck(self, look: Look, done: int) -> bool:
        """Take a look at the run.

        Args:
            look: what it showed.
            done: results that were brought home since the last.
        """
        now = time.monotonic()
        if self._since is None or look.running_count or look.ended or done or not look.queued_count:
            self._since = now
        return now - self._since >= self.seconds


def likely_reasons(aws: Aws, settings: BatchSettings, waiting: Sequence[str]) -> list[str]:
    """Why jobs get no host, the likeliest first; never empty.

    Args:
        aws: where.
        settings: name the queue.
        waiting: ids of jobs, at most a hundred.
    """
    reasons: list[str] = []
    try:
        jobs = records(aws, waiting)
        said = [_clean(job["statusReason"]) for job in jobs if job.get("statusReason")]
        reasons += [f"AWS Batch says: {line}" for line in dict.fromkeys(said)]
        reasons += _of_the_queue(aws, settings)
    except CalibrationError as error:
        reasons.append(f"it cannot be found out: {error}")
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
    reasons.append("jobs of others in the queue, or the account's quota of vCPUs")
    return reasons


def _of_the_queue(aws: Aws, settings: BatchSettings) -> list[str]:
    with aws_errors(f"queue '{settings.queue}'"):
        queue = aws.batch.describe_job_queues(jobQueues=[settings.queue])["jobQueues"][0]
        names = [entry["computeEnvironment"] for entry in queue.get("computeEnvironmentOrder", ())]
        environments = (
            aws.batch.describe_compute_environments(computeEnvironments=names)["computeEnvironments"] if names else []
        )
    reasons = [] if _is_fine(queue) else [f"the queue is {_state(queue)}"]
    for environment in environments:
        name = environment["computeEnvironmentName"]
        if not _is_fine(environment):
            reasons.append(f"compute environment '{name}' is {_state(environment)}")
        resources = environment.get("computeResources", {})
        if resources.get("maxvCpus") == 0:
            reasons.append(f"compute environment '{name}' may have no vCPUs (maxvCpus: 0)")
    return reasons


def _is_fine(record: dict[str, Any]) -> bool:
    return (record["state"], record["status"]) == ("ENABLED", "VALID")


def _state(record: dict[str, Any]) -> str:
    reason = record.get("statusReason")
    why = f" ({_clean(reason)})" if reason and record["status"] != "VALID" else ""
    return f"{record['state']} and {record['status']}{why}"


def _clean(text: str) -> str:
    return shorten(one_line(text), 200)
