"""Why a job has ended without an outcome: what Batch says of it, in words for users."""

from collections.abc import Mapping
from dataclasses import dataclass

from calibration.errors import ExitCode
from calibration.execution.batch.service.following import Attempt, Description
from calibration.execution.batch.wire import PREPARE, WATCH
from calibration.execution.job import Job

_HOST_LOST = ("Host EC2", "Your Spot Task was interrupted")
_TIMEOUT = "Job attempt duration exceeded timeout"
_CANNOT_PULL = "CannotPull"
_NO_SUCH_IMAGE = ("not found", "manifest unknown", "does not exist", "repository does not exist", "invalid reference")
_NO_RESOURCE = "ResourceInitializationError"
_OURS = {PREPARE: "its inputs could not be brought in", WATCH: "its results could not be brought out"}


@dataclass(frozen=True)
class Why:
    """Why there is no outcome."""

    reason: str
    exit_code: ExitCode = ExitCode.WORLD


def host_lost(attempt: Attempt) -> bool:
    """Whether an attempt ended because its host went away."""
    return attempt.status_reason.startswith(_HOST_LOST)


def why_no_outcome(job: Job, description: Description, given_up: str, last_lines: Mapping[str, str]) -> Why:
    """Find out why a job has no outcome.

    Args:
        job: that ended.
        description: what Batch says of it.
        given_up: why we have ended all that was left; empty where we have not.
        last_lines: of the containers' logs, by name.
    """
    attempts = description.attempts
    if given_up and (description.terminated or not attempts or given_up[:100] in description.status_reason):
        return Why(given_up)
    containers = attempts[-1].containers if attempts else description.running
    said = description.status_reason or "it gives no reason"
    if description.terminated:
        return Why(f"somebody has ended it: {said}")
    if (lost := sum(map(host_lost, attempts))) and host_lost(attempts[-1]):
        times = "once" if lost == 1 else f"{lost} times"
        return Why(f"its host was lost {times}, in {len(attempts)} attempts: {attempts[-1].status_reason}")
    reasons = [(container.name, container.reason) for container in containers]
    for name, reason in [*reasons, ("", said)]:
        if reason.startswith(_CANNOT_PULL):
            image = next((c.image for c in job.containers if c.name == name), "")
            missing = any(sign in reason.lower() for sign in _NO_SUCH_IMAGE)
            which = f"container '{name}': the image {image}".rstrip() if name else "an image"
            return Why(f"{which} cannot be pulled: {reason}", ExitCode.BAD_INPUT if missing else ExitCode.WORLD)
        if reason.startswith(_NO_RESOURCE):
            return Why(f"its task could not be set up: check roles, secrets and the way to the network: {reason}")
    if description.status_reason.startswith(_TIMEOUT):
        return Why(f"AWS Batch has ended it before our own limit of {job.seconds or 0:g} s did: {said}")
    for container in containers:
        if container.name in _OURS and container.exit_code:
            last = f": {last_lines[container.name]}" if last_lines.get(container.name) else ""
            how = container.reason or f"{container.name} ended with exit code {container.exit_code}"
            return Why(f"{_OURS[container.name]}: {how}{last}")
    if description.status == "SUCCEEDED":
        return Why("AWS Batch says that it succeeded, but its task has left no outcome in S3")
    ends = [f"{c.name}: {c.reason or f'exit code {c.exit_code}'}" for c in containers if c.exit_code or c.reason]
    return Why(f"AWS Batch says that it failed: {'; '.join([said, *ends])}")
