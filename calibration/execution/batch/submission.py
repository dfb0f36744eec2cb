"""The jobs of a group submitted: pure functions to the requests ``SubmitJob``.

They go as arrays of at most 10 000; one alone as a job without an array.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from calibration.execution.batch.settings import BatchSettings
from calibration.execution.batch.wire import (
    ARRIVAL_SECONDS,
    FIRST,
    LOCATION,
    PREPARE,
    REGION,
    UPLOAD_SECONDS,
    WATCH,
    Location,
)
from calibration.execution.docker.labels import RUN, Owner
from calibration.execution.job import Job


def run_tags(run: str) -> dict[str, str]:
    """The tags of the jobs of a run that this process starts."""
    return {RUN: run, **_plain(Owner.this_process()).labels}


def owner_of(tags: Mapping[str, str]) -> Owner | None:
    """Who started a job; None where the tags do not say."""
    owner = Owner.from_labels(tags)
    if owner is None:
        return None
    kind, colon, number = owner.namespace.partition(":")
    return replace(owner, namespace=f"{kind}:[{number}]" if colon else owner.namespace)


def _plain(owner: Owner) -> Owner:
    """Without the brackets around the number of a namespace, which no tag in AWS may have."""
    return replace(owner, namespace=owner.namespace.replace("[", "").replace("]", "") or "unknown")


MOST_CHILDREN = 10_000
"""Of an array."""
AROUND_SECONDS = ARRIVAL_SECONDS + UPLOAD_SECONDS
"""What a task has around the time of its job. Batch's own time is longer by this, so that ours ends the job first,
with a verdict; and it is never below the 60 s that are the least that Batch takes."""
_UNFIT_FOR_NAME = re.compile(r"[^A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Chunk:
    """Jobs of a group that are submitted together: ``first`` and those that follow it."""

    first: int
    """Index in the group."""
    count: int


def chunks(count: int) -> tuple[Chunk, ...]:
    """Divide the jobs of a group into arrays that are as long as Batch takes them."""
    firsts = range(0, count, MOST_CHILDREN)
    return tuple(Chunk(first, min(MOST_CHILDREN, count - first)) for first in firsts)


def attempt_seconds(jobs: Iterable[Job]) -> int | None:
    """How long Batch lets an attempt of any of the jobs run; None where one of them has no limit."""
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
    """The request that submits a chunk.

    Args:
        chunk: which jobs of the group.
        location: of the group.
        definition: the ARN of the job definition, with its revision.
        settings: name the queue, the share and tags of the user's.
        seconds: of an attempt, as `attempt_seconds` has it.
        tags: of the run.
    """
    variables = {LOCATION: location.text, FIRST: str(chunk.first), REGION: settings.region}
    name = f"calibration-{location.run}-{location.group}-{chunk.first}"
    request: dict[str, Any] = {
        "jobName": _UNFIT_FOR_NAME.sub("-", name)[:128],
        "jobQueue": settings.queue,
        "jobDefinition": definition,
        "ecsPropertiesOverride": {
            "taskProperties": [{"containers": [_with_variables(each, variables) for each in (PREPARE, WATCH)]}]
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
