"""Requests that change a queue: registration of job definitions, submission, termination, and search for leftovers.

Jobs are submitted as arrays of at most 10 000; a single job without an array.
"""

import math
import re
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from calibration.addons.aws_batch.definition import DIGEST_TAG
from calibration.addons.aws_batch.following import JOBS_PER_CALL, MAX_CHILDREN, Submitted, batches, describe, records
from calibration.addons.aws_batch.session import Aws, AwsLostError, Backoff, aws_errors, pages
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
from calibration.base import CalibrationError, InfrastructureError
from calibration.ci.execution.docker.labels import RUN_LABEL, Owner
from calibration.ci.execution.job import Job


def run_tags(run: str) -> dict[str, str]:
    """Return the tags of a run's jobs, including the process that starts them."""
    owner = Owner.this_process()
    bare = owner.namespace.replace("[", "").replace("]", "")  # AWS does not allow brackets in tags
    return {RUN_LABEL: run, **replace(owner, namespace=bare or "unknown").labels}


def owner_of(tags: Mapping[str, str]) -> Owner | None:
    """Return the process that started a job; None if the tags do not contain it."""
    owner = Owner.from_labels(tags)
    if owner is None:
        return None
    kind, colon, number = owner.namespace.partition(":")
    return replace(owner, namespace=f"{kind}:[{number}]" if colon else owner.namespace)


AROUND_SECONDS = ARRIVAL_SECONDS + UPLOAD_SECONDS
"""Time of a task in addition to its job's. Batch's time limit is longer by this, so that our own limit ends the job
first, with a verdict; it is also above Batch's minimum of 60 s."""
_UNFIT_FOR_NAME = re.compile(r"[^A-Za-z0-9_-]+")


def chunks(count: int) -> list[range]:
    """Split the indices of a group's jobs into arrays of Batch's maximum size."""
    return [range(count)[first : first + MAX_CHILDREN] for first in range(0, count, MAX_CHILDREN)]


def attempt_seconds(jobs: Iterable[Job]) -> int | None:
    """Return Batch's time limit for attempts at these jobs; None if a job has no limit."""
    times = [job.seconds for job in jobs]
    limited = [seconds for seconds in times if seconds is not None]
    if not limited or len(limited) < len(times):
        return None
    return math.ceil(max(limited) + AROUND_SECONDS)


def submission(
    chunk: range,
    location: Location,
    definition: str,
    settings: BatchSettings,
    *,
    seconds: int | None,
    tags: Mapping[str, str],
) -> dict[str, Any]:
    """Return the request that submits a chunk.

    Args:
        chunk: indices of jobs in the group, which follow each other.
        location: location of the group.
        definition: ARN of the job definition, with its revision.
        settings: settings with the queue, the share and the user's tags.
        seconds: time limit of an attempt, from `attempt_seconds`.
        tags: tags of the run.
    """
    variables = {LOCATION_VARIABLE: location.text, FIRST_VARIABLE: str(chunk.start), REGION_VARIABLE: settings.region}
    name = f"calibration-{location.run}-{location.group}-{chunk.start}"
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
    if len(chunk) > 1:
        request["arrayProperties"] = {"size": len(chunk)}
    if seconds is not None:
        request["timeout"] = {"attemptDurationSeconds": seconds}
    if settings.share is not None:
        request["shareIdentifier"] = settings.share
    if settings.priority is not None:
        request["schedulingPriorityOverride"] = settings.priority
    return request


def _with_variables(container: str, variables: Mapping[str, str]) -> dict[str, Any]:
    return {"name": container, "environment": [{"name": key, "value": value} for key, value in variables.items()]}


def ensure(aws: Aws, request: Mapping[str, Any]) -> str:
    """Register a definition, unless an equal one exists.

    Args:
        aws: session.
        request: request RegisterJobDefinition, with its digest in the tags.

    Returns:
        ARN with the revision.

    Raises:
        InputError: access is denied, or AWS refuses the definition.
        AwsLostError: AWS does not answer.
    """
    name = str(request["jobDefinitionName"])
    digest = request["tags"][DIGEST_TAG]
    for definition in _active_definitions(aws, name):
        if definition.get("tags", {}).get(DIGEST_TAG) == digest:
            return str(definition["jobDefinitionArn"])
    with aws_errors(f"job definition '{name}'"):
        # not idempotent, but a repeated registration is only one more equal revision
        return str(aws.batch.register_job_definition(**request)["jobDefinitionArn"])


def find_old(aws: Aws) -> list[str]:
    """Return the ARNs of all revisions of our definitions but the latest of each.

    Raises:
        InputError: access is denied.
        AwsLostError: AWS does not answer.
    """
    revisions: dict[str, dict[int, str]] = {}
    for definition in _active_definitions(aws):
        if DIGEST_TAG in definition.get("tags", {}):
            of_name = revisions.setdefault(str(definition["jobDefinitionName"]), {})
            of_name[int(definition["revision"])] = str(definition["jobDefinitionArn"])
    return [arn for found in revisions.values() for revision, arn in sorted(found.items()) if revision != max(found)]


def deregister(aws: Aws, arns: Iterable[str]) -> None:
    """Deregister revisions of definitions.

    Raises:
        InputError: access is denied.
        AwsLostError: AWS does not answer.
    """
    for arn in arns:
        with aws_errors(f"job definition {arn}"):
            aws.batch.deregister_job_definition(jobDefinition=arn)


def _active_definitions(aws: Aws, name: str | None = None) -> Iterator[dict[str, Any]]:
    """Yield active definitions, of a name or all."""
    chosen, where = ({}, "s") if name is None else ({"jobDefinitionName": name}, f" '{name}'")
    for page in pages(aws.batch, "describe_job_definitions", f"job definition{where}", status="ACTIVE", **chosen):
        yield from page["jobDefinitions"]


_ENDED_STATES = ("SUCCEEDED", "FAILED")
_SETTLING_SECONDS = 60.0
"""Seconds until Batch's data show a requested termination."""
_TAKING_NOTE = 0.5
_MAX_PROBLEMS = 3
"""Limit of failed terminations, after which the remaining ones are not tried."""


@dataclass(frozen=True)
class CloudLeftover:
    """An unfinished job in the queue."""

    id: str
    name: str
    run: str
    status: str
    jobs: int
    """Number of children of an array; 1 for a single job."""
    owner: Owner | None
    """Owner by the tags; None if the tags do not contain one."""

    @property
    def row(self) -> tuple[str, ...]:
        """Cells of a table's row."""
        return (self.id, self.name, self.run, str(self.jobs), self.status)


def find_in_queue(aws: Aws, queue: str, run: str | None = None) -> list[CloudLeftover]:
    """Find unfinished jobs of a run, or of all runs, in a queue.

    Raises:
        InputError: the queue does not exist, or access is denied.
        AwsLostError: AWS does not answer.
    """
    prefix = "calibration-" if run is None else _UNFIT_FOR_NAME.sub("-", f"calibration-{run}-")
    ids = (entry["jobId"] for entry in _jobs_of_name(aws, queue, f"{prefix}*") if entry["status"] not in _ENDED_STATES)
    found = [_read_leftover(record) for some in batches(ids, JOBS_PER_CALL) for record in records(aws, some)]
    return [each for each in found if each.run and each.status not in _ENDED_STATES and run in (None, each.run)]


def find_by_name(aws: Aws, queue: str, name: str) -> list[str]:
    """Return the ids of all jobs with a name, in any state, the latest first.

    Raises:
        InputError: the queue does not exist, or access is denied.
        AwsLostError: AWS does not answer.
    """
    return [str(entry["jobId"]) for entry in _jobs_of_name(aws, queue, name) if entry["jobName"] == name]


def terminate(aws: Aws, ids: Sequence[str], reason: str) -> None:
    """Terminate jobs in any state, and wait until Batch's data show it.

    Raises:
        InfrastructureError: jobs are not terminated; the message contains their number.
        InputError: access is denied, or the credentials are expired.
        AwsLostError: AWS does not answer.
    """
    problems: list[CalibrationError] = []
    for identifier in ids:  # all requests first, because a runner that cancels leaves little time
        try:
            with aws_errors(f"job {identifier}"):
                aws.batch.terminate_job(jobId=identifier, reason=reason)
        except CalibrationError as error:
            problems.append(error)
            if len(problems) > _MAX_PROBLEMS:
                break
    if problems:
        raise problems[0]
    deadline = time.monotonic() + _SETTLING_SECONDS
    left: Collection[str] = ids
    while left:
        seen = describe(aws, left)
        left = [each for each in left if each in seen and not (seen[each].ended or seen[each].terminated)]
        if left and time.monotonic() > deadline:
            raise InfrastructureError(f"{len(left)} jobs in AWS Batch are not terminated, such as {next(iter(left))}")
        if left:
            time.sleep(_TAKING_NOTE)


def _jobs_of_name(aws: Aws, queue: str, name: str) -> Iterator[dict[str, Any]]:
    """Yield summaries of jobs by name, which may end with ``*``."""
    names = [{"name": "JOB_NAME", "values": [name]}]
    for page in pages(aws.batch, "list_jobs", f"queue '{queue}'", jobQueue=queue, filters=names):
        yield from page["jobSummaryList"]


def _read_leftover(record: dict[str, Any]) -> CloudLeftover:
    tags = record.get("tags", {})
    return CloudLeftover(
        id=str(record["jobId"]),
        name=str(record["jobName"]),
        run=str(tags.get(RUN_LABEL, "")),
        status=str(record["status"]),
        jobs=int(record.get("arrayProperties", {}).get("size", 1)),
        owner=owner_of(tags),
    )


STOPPED_REASON = "the run was stopped"
"""Reason of the termination, reported to Batch."""
_MAX_TRIES = 3
_POLL_SECONDS = 1.0


class Submitting:
    """Submits jobs, and tracks what it has submitted."""

    def __init__(self, aws: Aws, queue: str) -> None:
        self.submitted: list[Submitted] = []
        self._aws = aws
        self._queue = queue
        self._unclear: str = ""
        """Name of a job that may have been submitted, because the answer is missing."""

    def submit(self, request: Mapping[str, Any], group: str, first: int) -> Submitted:
        """Submit a job or an array with a unique name.

        If the answer is lost, the queue is searched for the name before the next attempt.

        Raises:
            InputError: Batch refuses it, or access is denied.
            AwsLostError: AWS does not answer, or throttles for too long.
        """
        self._unclear = name = str(request["jobName"])
        backoff = Backoff()
        answers_lost = False
        while True:
            try:
                ids = find_by_name(self._aws, self._queue, name) if answers_lost else []
                identifier = ids[0] if ids else self._send_request(request)
                break
            except AwsLostError as error:
                answers_lost = True
                time.sleep(backoff.failed(error))
        count = int(request.get("arrayProperties", {}).get("size", 1))
        self.submitted.append(Submitted(identifier, first, count, group))
        self._unclear = ""
        if answers_lost:
            self._end_doubles(name, identifier)
        return self.submitted[-1]

    def stop(self, ids: list[str], reason: str = STOPPED_REASON) -> None:
        """Terminate jobs, including one that may have been submitted without an answer.

        Raises:
            InfrastructureError: jobs may still run.
            InputError: access is denied, or the credentials are expired.
            AwsLostError: AWS does not answer.
        """
        terminate(self._aws, ids, reason)
        for _ in range(_MAX_TRIES if self._unclear else 0):
            if found := find_by_name(self._aws, self._queue, self._unclear):
                terminate(self._aws, found, reason)
                break
            time.sleep(_POLL_SECONDS)  # new jobs appear in the list with a delay
        self._unclear = ""

    def _send_request(self, request: Mapping[str, Any]) -> str:
        with aws_errors(f"queue '{self._queue}'"):
            answer = self._aws.submitting.submit_job(**request)
        if not answer.get("jobId"):
            raise InfrastructureError(f"queue '{self._queue}': AWS Batch answers without the id of the job")
        return str(answer["jobId"])

    def _end_doubles(self, name: str, keep: str) -> None:
        """Terminate duplicates submitted by requests whose answer was lost."""
        doubles = [each for each in find_by_name(self._aws, self._queue, name) if each != keep]
        if doubles:
            terminate(self._aws, doubles, "submitted twice")
