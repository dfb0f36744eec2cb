"""What runs have in a queue, found by its tags, and ended."""

import re
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from calibration.aws_errors import aws_errors
from calibration.errors import CalibrationError, WorldError
from calibration.execution.batch.requests.tags import owner_of
from calibration.execution.batch.service.following import AT_ONCE, batches, describe, records
from calibration.execution.batch.service.session import Aws
from calibration.execution.docker.labels import RUN, Owner

_ENDED = ("SUCCEEDED", "FAILED")
_UNFIT_FOR_NAME = re.compile(r"[^A-Za-z0-9_-]+")
_SETTLING = 60.0
"""Seconds in which Batch takes note of a request to end a job."""
_LOOKING = 0.5
_MOST_PROBLEMS = 3
"""Jobs that cannot be ended before the rest is not tried."""


@dataclass(frozen=True)
class CloudLeftover:
    """A job in the queue that has not ended."""

    id: str
    name: str
    run: str
    status: str
    jobs: int
    """Its children, where it is an array; else 1."""
    owner: Owner | None
    """None where the tags do not say."""


def find_in_queue(aws: Aws, queue: str, run: str | None = None) -> list[CloudLeftover]:
    """Find what a run, or every run, has in a queue and has not ended.

    Raises:
        InputError: there is no such queue, or it is not allowed.
        AwsLostError: AWS does not answer.
    """
    prefix = "calibration-" if run is None else _UNFIT_FOR_NAME.sub("-", f"calibration-{run}-")
    ids = (entry["jobId"] for entry in _named(aws, queue, f"{prefix}*") if entry["status"] not in _ENDED)
    found = [_leftover(record) for some in batches(ids, AT_ONCE) for record in records(aws, some)]
    return [each for each in found if each.run and each.status not in _ENDED and run in (None, each.run)]


def find_by_name(aws: Aws, queue: str, name: str) -> list[str]:
    """The ids of jobs of exactly this name, whatever has become of them; the newest first.

    Raises:
        InputError: there is no such queue, or it is not allowed.
        AwsLostError: AWS does not answer.
    """
    return [str(entry["jobId"]) for entry in _named(aws, queue, name) if entry["jobName"] == name]


def terminate(aws: Aws, ids: Sequence[str], reason: str) -> None:
    """End jobs, whatever they are doing, and see that Batch has taken note of each.

    Raises:
        WorldError: it does not take note; names how many.
        InputError: it is not allowed, or the credentials are expired.
        AwsLostError: AWS does not answer.
    """
    problems: list[CalibrationError] = []
    for identifier in ids:  # all first: who is being stopped himself has little time
        try:
            with aws_errors(f"job {identifier}"):
                aws.batch.terminate_job(jobId=identifier, reason=reason)
        except CalibrationError as error:
            problems.append(error)
            if len(problems) > _MOST_PROBLEMS:
                break
    if problems:
        raise problems[0]
    deadline = time.monotonic() + _SETTLING
    left: Collection[str] = ids
    while left:
        seen = describe(aws, left)
        left = [each for each in left if each in seen and not (seen[each].ended or seen[each].terminated)]
        if left and time.monotonic() > deadline:
            raise WorldError(f"{len(left)} jobs in AWS Batch do not end, such as {next(iter(left))}")
        if left:
            time.sleep(_LOOKING)


def _named(aws: Aws, queue: str, name: str) -> Iterator[dict[str, Any]]:
    """Summaries of jobs by their name, which may end with a ``*``."""
    token: dict[str, str] = {}
    while True:
        with aws_errors(f"queue '{queue}'"):
            page = aws.batch.list_jobs(jobQueue=queue, filters=[{"name": "JOB_NAME", "values": [name]}], **token)
        yield from page["jobSummaryList"]
        if not page.get("nextToken"):
            return
        token = {"nextToken": page["nextToken"]}


def _leftover(record: dict[str, Any]) -> CloudLeftover:
    tags = record.get("tags", {})
    return CloudLeftover(
        id=str(record["jobId"]),
        name=str(record["jobName"]),
        run=str(tags.get(RUN, "")),
        status=str(record["status"]),
        jobs=int(record.get("arrayProperties", {}).get("size", 1)),
        owner=owner_of(tags),
    )
