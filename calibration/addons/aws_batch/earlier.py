"""Results of an earlier run of the same name in S3, so that only missing jobs are run."""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from calibration.addons.aws_batch.following import Submitted
from calibration.addons.aws_batch.session import AwsLostError
from calibration.addons.aws_batch.store import CloudRun, Store
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
from calibration.base.records import document_of, read
from calibration.ci.execution.job import Job


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


def find_results(run: CloudRun) -> dict[str, Result]:
    """Find jobs with results, by the `mark_of` the job.

    Raises:
        InputError: access is denied.
        InfrastructureError: a file of jobs is invalid.
        AwsLostError: AWS does not answer.
    """
    found: dict[str, Result] = {}
    store = run.store
    root = f"{run.settings.prefix}/runs/{run.name}/results/"
    for group in store.folders(root):
        place = run.location(group)
        attempts, ids = _latest_attempts(store, root, group), _ids_of_jobs(store, place)
        for first in sorted({index // JOBS_PER_FILE * JOBS_PER_FILE for index in attempts}):
            for number, entry in enumerate(_read_list(store, place.jobs_key(first))):
                index = first + number
                if index in attempts and isinstance(entry, dict):
                    mark = mark_of(group.partition("-")[0], entry)
                    found[mark] = Result(group, index, attempts[index], ids.get(index))
    return found


def has_verdict(run: CloudRun, result: Result, job: Job) -> bool:
    """Return whether a result is a verdict, pass or fail, as opposed to bad input or an infrastructure error.

    Args:
        run: the run.
        result: result from `find_results`.
        job: its job.

    Raises:
        InputError: access is denied.
        AwsLostError: AWS does not answer.
    """
    key = run.location(result.group).result_key(result.index, result.attempt, OUTCOME_FILE)
    data = run.store.get(key, max_outcome_bytes(job))
    try:
        return data is not None and read_outcome(data, job, result.attempt, key).exit_code <= ExitCode.FAIL
    except AwsLostError:
        raise
    except InfrastructureError:  # not an outcome of this job
        return False


def submitted_document(submitted: Iterable[Submitted]) -> bytes:
    """Return the file with the ids of a submitted group."""
    return json.dumps([document_of(each) for each in submitted]).encode()


def _ids_of_jobs(store: Store, location: Location) -> dict[int, str]:
    """Return the id of each job of a group; jobs with unknown ids are omitted."""
    key = location.submitted_key
    ids: dict[int, str] = {}
    for entry in _read_list(store, key):
        submission = read(Submitted, entry, key, error=InfrastructureError)
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


def _read_list(store: Store, key: str) -> list[Any]:
    """Return the list in a file; an empty one if there is no such file."""
    data = store.get(key, MAX_JOBS_BYTES)
    document = [] if data is None else parse_json(data, MAX_JOBS_BYTES, key)
    return document if isinstance(document, list) else []
