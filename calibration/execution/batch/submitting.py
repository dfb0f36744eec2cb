"""What is brought into a queue and ended in it: job definitions, jobs, and what earlier runs have left."""

import re
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from calibration.aws_errors import AwsLostError, aws_errors
from calibration.errors import CalibrationError, InfrastructureError
from calibration.execution.batch.definition import DIGEST_TAG
from calibration.execution.batch.following import AT_ONCE, Submitted, batches, describe, records
from calibration.execution.batch.session import Aws, Patience
from calibration.execution.batch.submission import owner_of
from calibration.execution.docker.labels import RUN, Owner


def ensure(aws: Aws, request: Mapping[str, Any]) -> str:
    """Register a definition, unless there is one that says the same.

    Args:
        aws: where.
        request: of RegisterJobDefinition, with its digest in the tags.

    Returns:
        The ARN, with the revision.

    Raises:
        InputError: it is not allowed, or AWS refuses what it says.
        AwsLostError: AWS does not answer.
    """
    name = str(request["jobDefinitionName"])
    digest = request["tags"][DIGEST_TAG]
    for definition in _active(aws, name):
        if definition.get("tags", {}).get(DIGEST_TAG) == digest:
            return str(definition["jobDefinitionArn"])
    with aws_errors(f"job definition '{name}'"):
        # done twice, because an answer was lost, it is another revision that says the same
        return str(aws.batch.register_job_definition(**request)["jobDefinitionArn"])


def find_old(aws: Aws) -> list[str]:
    """The ARNs of all revisions of definitions of ours but the newest of each.

    Raises:
        InputError: it is not allowed.
        AwsLostError: AWS does not answer.
    """
    revisions: dict[str, dict[int, str]] = {}
    for definition in _active(aws):
        if DIGEST_TAG in definition.get("tags", {}):
            of_name = revisions.setdefault(str(definition["jobDefinitionName"]), {})
            of_name[int(definition["revision"])] = str(definition["jobDefinitionArn"])
    return [arn for found in revisions.values() for revision, arn in sorted(found.items()) if revision != max(found)]


def deregister(aws: Aws, arns: Iterable[str]) -> None:
    """Deregister revisions of definitions.

    Raises:
        InputError: it is not allowed.
        AwsLostError: AWS does not answer.
    """
    for arn in arns:
        with aws_errors(f"job definition {arn}"):
            aws.batch.deregister_job_definition(jobDefinition=arn)


def _active(aws: Aws, name: str | None = None) -> Iterator[dict[str, Any]]:
    """Definitions of a name, or all, that jobs can be submitted with."""
    chosen = {} if name is None else {"jobDefinitionName": name}
    token: dict[str, str] = {}
    while True:
        with aws_errors("job definitions" if name is None else f"job definition '{name}'"):
            page = aws.batch.describe_job_definitions(status="ACTIVE", **chosen, **token)
        yield from page["jobDefinitions"]
        if not page.get("nextToken"):
            return
        token = {"nextToken": page["nextToken"]}


_ENDED = ("SUCCEEDED", "FAILED")
_UNFIT_FOR_NAME = re.compile(r"[^A-Za-z0-9_-]+")
_SETTLING = 60.0
"""Seconds in which Batch takes note of a request to end a job."""
_TAKING_NOTE = 0.5
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

    @property
    def row(self) -> tuple[str, ...]:
        """What a table says of it."""
        return (self.id, self.name, self.run, str(self.jobs), self.status)


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
        InfrastructureError: it does not take note; names how many.
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
            raise InfrastructureError(f"{len(left)} jobs in AWS Batch do not end, such as {next(iter(left))}")
        if left:
            time.sleep(_TAKING_NOTE)


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


STOPPED = "the run was stopped"
"""The reason that Batch is given."""
_TRIES = 3
_LOOKING = 1.0


class Submitting:
    """Submits, and knows what it has submitted."""

    def __init__(self, aws: Aws, queue: str) -> None:
        self.submitted: list[Submitted] = []
        self._aws = aws
        self._queue = queue
        self._unclear: str = ""
        """The name of a job that may have been submitted: its answer has not come."""

    def submit(self, request: Mapping[str, Any], group: str, first: int) -> Submitted:
        """Submit a job or an array of a name that nothing else has.

        Where an answer is lost, the queue is searched for the name before it is tried again.

        Raises:
            InputError: Batch refuses it, or it is not allowed.
            AwsLostError: AWS does not answer, or throttles for too long.
        """
        self._unclear = name = str(request["jobName"])
        patience = Patience()
        answers_lost = False
        while True:
            try:
                ids = find_by_name(self._aws, self._queue, name) if answers_lost else []
                identifier = ids[0] if ids else self._send(request)
                break
            except AwsLostError as error:
                answers_lost = True
                time.sleep(patience.failed(error))
        count = int(request.get("arrayProperties", {}).get("size", 1))
        self.submitted.append(Submitted(identifier, group, first, count))
        self._unclear = ""
        if answers_lost:
            self._end_doubles(name, identifier)
        return self.submitted[-1]

    def stop(self, ids: list[str], reason: str = STOPPED) -> None:
        """End jobs, and what may have been submitted without our knowing.

        Raises:
            InfrastructureError: something may go on.
            InputError: it is not allowed, or the credentials are expired.
            AwsLostError: AWS does not answer.
        """
        terminate(self._aws, ids, reason)
        for _ in range(_TRIES if self._unclear else 0):
            if found := find_by_name(self._aws, self._queue, self._unclear):
                terminate(self._aws, found, reason)
                break
            time.sleep(_LOOKING)  # the list of jobs is a little behind
        self._unclear = ""

    def _send(self, request: Mapping[str, Any]) -> str:
        with aws_errors(f"queue '{self._queue}'"):
            answer = self._aws.submitting.submit_job(**request)
        if not answer.get("jobId"):
            raise InfrastructureError(f"queue '{self._queue}': AWS Batch answers without the id of the job")
        return str(answer["jobId"])

    def _end_doubles(self, name: str, keep: str) -> None:
        """End what a request whose answer was lost has made after all."""
        doubles = [each for each in find_by_name(self._aws, self._queue, name) if each != keep]
        if doubles:
            terminate(self._aws, doubles, "submitted twice")
