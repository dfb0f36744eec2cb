"""Requests ``SubmitJob`` for the jobs of a group, without side effects.

Jobs are submitted as arrays of at most 10 000; a single job without an array.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from calibration.addons.aws_batch.settings import BatchSettings
from calibration.addons.aws_batch.wire import (
    ARRIVAL_SECONDS,
    FIRST_VARIABLE,
    LOCATION_VARIABLE,
    PREPARE_CONTAINER,
    REGION_VARIABLE,
    UPLOAD_SECONDS,
    WATCH_CONTAINER,
    Location,
)
from calibration.ci.execution.docker.labels import RUN_LABEL, Owner
from calibration.ci.execution.job import Job


def run_tags(run: str) -> dict[str, str]:
    """Return the tags of a run's jobs, including the process that starts them."""
    return {RUN_LABEL: run, **_without_brackets(Owner.this_process()).labels}


def owner_of(tags: Mapping[str, str]) -> Owner | None:
    """Return the process that started a job; None if the tags do not contain it."""
    owner = Owner.from_labels(tags)
    if owner is None:
        return None
    kind, colon, number = owner.namespace.partition(":")
    return replace(owner, namespace=f"{kind}:[{number}]" if colon else owner.namespace)


def _without_brackets(owner: Owner) -> Owner:
    """Remove the brackets in a namespace, which AWS does not allow in tags."""
    return replace(owner, namespace=owner.namespace.replace("[", "").replace("]", "") or "unknown")


MAX_CHILDREN = 10_000
"""Batch's limit of jobs in an array."""
AROUND_SECONDS = ARRIVAL_SECONDS + UPLOAD_SECONDS
"""Time of a task in addition to its job's. Batch's time limit is longer by this, so that our own limit ends the job
first, with a verdict; it is also above Batch's minimum of 60 s."""
_UNFIT_FOR_NAME = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Chunk:
    """Jobs of a group that are submitted together: ``first`` and its successors."""

    first: int
    """Index in the group."""
    count: int


def chunks(count: int) -> tuple[Chunk, ...]:
    """Split the jobs of a group into arrays of Batch's maximum size."""
    firsts = range(0, count, MAX_CHILDREN)
    return tuple(Chunk(first, min(MAX_CHILDREN, count - first)) for first in firsts)


def attempt_seconds(jobs: Iterable[Job]) -> int | None:
    """Return Batch's time limit for attempts at these jobs; None if a job has no limit."""
    times = [job.seconds for job in jobs]
    limited = [seconds for seconds in times if seconds is not None]
    if not limited or len(limited) < len(times):
        return None
    return math.ceil(max(limited) + AROUND_SECONDS)


def submission(
    chunk: Chunk,
    location: Location,
    definition: str,
    settings: BatchSettings,
    *,
    seconds: int | None,
    tags: Mapping[str, str],
) -> dict[str, Any]:
    """Return the request that submits a chunk.

    Args:
        chunk: jobs of the group.
        location: location of the group.
        definition: ARN of the job definition, with its revision.
        settings: settings with the queue, the share and the user's tags.
        seconds: time limit of an attempt, from `attempt_seconds`.
        tags: tags of the run.
    """
    variables = {LOCATION_VARIABLE: location.text, FIRST_VARIABLE: str(chunk.first), REGION_VARIABLE: settings.region}
    name = f"calibration-{location.run}-{location.group}-{chunk.first}"
    request: dict[str, Any] = {
        "jobName": _UNFIT_FOR_NAME.sub("-", name)[:128],
        "jobQueue": settings.queue,
        "jobDefinition": definition,
        "ecsPropertiesOverride": {
            "taskProperties": [
                {"containers": [_with_variables(each, variables) for each in (PREPARE_CONTAINER, WATCH_CONTAINER)]}
            ]
        },
        "propagateTags": True,
        "tags": {**settings.tags, **tags},
    }
    if chunk.count > 1:
        request["arrayProperties"] = {"size": chunk.count}
    if seconds is not None:
        request["timeout"] = {"attemptDurationSeconds": seconds}
    if settings.share is not None:
        request["shareIdentifier"] = settings.share
    if settings.priority is not None:
        request["schedulingPriorityOverride"] = settings.priority
    return request


def _with_variables(container: str, variables: Mapping[str, str]) -> dict[str, Any]:
    return {"name": container, "environment": [{"name": key, "value": value} for key, value in variables.items()]}
