"""Results of an earlier run of the same name in S3, so that only missing jobs are run."""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

from calibration.addons.aws_batch.following import Submitted
from calibration.addons.aws_batch.session import AwsLostError
from calibration.addons.aws_batch.store import Store
from calibration.addons.aws_batch.wire import (
    JOBS_PER_FILE,
    MAX_JOBS_BYTES,
    OUTCOME_FILE,
    Location,
    max_outcome_bytes,
    parse_json,
    read_outcome,
)
from calibration.base.errors import ExitCode, InfrastructureError
from calibration.base.records import between, document_of, field, length, read, record
from calibration.ci.execution.job import Job

_MAX_ARRAY_SIZE = 10_000
"""Batch's limit of jobs in an array."""


@record(case="snake")
class _Submission:
    """Entry of ``submitted.json``: an array, or a single job."""

    id: Annotated[str, length(most=128)] = field()
    first: Annotated[int, between(0, 2**63 - 1)] = field()
    count: Annotated[int, between(1, _MAX_ARRAY_SIZE)] = field()


@dataclass(frozen=True)
class Result:
    """Location of a job's result."""

    group: str
    index: int
    attempt: int
    id: str | None
    """Id of the job in AWS Batch, if it is known."""


def mark_of(shape: str, entry: Mapping[str, Any]) -> str:
    """Return a hash of a job: equal for jobs of the same shape, command and inputs."""
    return hashlib.sha256(f"{shape} {json.dumps(entry, sort_keys=True)}".encode()).hexdigest()


def group_name(shape: str, token: str) -> str:
    """Return the name of a group of jobs in S3; the token distinguishes later submissions of the same shape."""
    return f"{shape}-{token}"


def find_results(store: Store, location: Location) -> dict[str, Result]:
    """Find jobs with results, by the `mark_of` the job.

    Args:
        store: bucket with the results.
        location: location of any group of the run.

    Raises:
        InputError: access is denied.
        InfrastructureError: a file of jobs is invalid.
        AwsLostError: AWS does not answer.
    """
    found: dict[str, Result] = {}
    root = f"{location.prefix}/runs/{location.run}/results/"
    for group in store.folders(root):
        place = replace(location, group=group)
        attempts, ids = _latest_attempts(store, root, group), _ids_of_jobs(store, place)
        for first in sorted({index // JOBS_PER_FILE * JOBS_PER_FILE for index in attempts}):
            for number, entry in enumerate(_read_entries(store, place, first)):
                index = first + number
                if index in attempts and isinstance(entry, dict):
                    mark = mark_of(group.partition("-")[0], entry)
                    found[mark] = Result(group, index, attempts[index], ids.get(index))
    return found


def has_verdict(store: Store, location: Location, result: Result, job: Job) -> bool:
    """Return whether a result is a verdict, pass or fail, as opposed to bad input or an infrastructure error.

    Args:
        store: bucket with the result.
        location: location of any group of the run.
        result: result from `find_results`.
        job: its job.

    Raises:
        InputError: access is denied.
        AwsLostError: AWS does not answer.
    """
    key = replace(location, group=result.group).result_key(result.index, result.attempt, OUTCOME_FILE)
    data = store.get(key, max_outcome_bytes(job))
    try:
        return data is not None and read_outcome(data, job, result.attempt, key).exit_code <= ExitCode.FAIL
    except AwsLostError:
        raise
    except InfrastructureError:  # not an outcome of this job
        return False


def submitted_document(submitted: Iterable[Submitted]) -> bytes:
    """Return the file with the ids of a submitted group."""
    return json.dumps([document_of(_Submission(each.id, each.first, each.count)) for each in submitted]).encode()


def _ids_of_jobs(store: Store, location: Location) -> dict[int, str]:
    """Return the id of each job of a group; jobs with unknown ids are omitted."""
    key = location.submitted_key
    data = store.get(key, MAX_JOBS_BYTES)
    ids: dict[int, str] = {}
    for entry in _parse_list(data, key):
        submission = read(_Submission, entry, key, error=InfrastructureError)
        for child in range(submission.count):
            ids[submission.first + child] = f"{submission.id}:{child}" if submission.count > 1 else submission.id
    return ids


def _latest_attempts(store: Store, root: str, group: str) -> dict[int, int]:
    """Return the latest complete attempt of each job of a group."""
    pattern = re.compile(rf"{re.escape(f'{root}{group}/')}([0-9]{{1,9}})/([0-9]{{1,9}})/{re.escape(OUTCOME_FILE)}")
    attempts: dict[int, int] = {}
    for key in store.keys(f"{root}{group}/"):
        if match := pattern.fullmatch(key):
            index, attempt = int(match[1]), int(match[2])
            attempts[index] = max(attempt, attempts.get(index, 0))
    return attempts


def _read_entries(store: Store, location: Location, first: int) -> list[Any]:
    key = location.jobs_key(first)
    return _parse_list(store.get(key, MAX_JOBS_BYTES), key)


def _parse_list(data: bytes | None, key: str) -> list[Any]:
    document = [] if data is None else parse_json(data, MAX_JOBS_BYTES, key)
    return document if isinstance(document, list) else []
