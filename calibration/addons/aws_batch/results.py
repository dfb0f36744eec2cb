"""Download of results: verified outcomes, and the files that they name."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from calibration.addons.aws_batch.following import Attempt, ContainerEnd, Description
from calibration.addons.aws_batch.logs import is_ours, secrets_of, streams, write_log
from calibration.addons.aws_batch.session import AwsLostError, with_retries
from calibration.addons.aws_batch.store import CloudRun
from calibration.addons.aws_batch.wire import (
    FILES_FOLDER,
    OUTCOME_FILE,
    PREPARE_CONTAINER,
    WATCH_CONTAINER,
    Location,
    TaskOutcome,
    max_outcome_bytes,
    read_outcome,
)
from calibration.base import CalibrationError, ExitCode, InfrastructureError, one_line, shorten, write_atomically
from calibration.base.text import redact
from calibration.ci.execution.job import Container, Job
from calibration.ci.execution.outcome import (
    ARTIFACTS_FOLDER,
    LOGS_FOLDER,
    ArtifactFile,
    ContainerOutcome,
    End,
    JobOutcome,
    complete_or_not_at_all,
    make_job_folder,
    write_manifest,
)
from calibration.ci.execution.supervision import failure_of, how_it_ended

_HOST_LOST = ("Host EC2", "Your Spot Task was interrupted")
_TIMEOUT_REASON = "Job attempt duration exceeded timeout"
_CANNOT_PULL = "CannotPull"
_NO_SUCH_IMAGE = ("not found", "manifest unknown", "does not exist", "repository does not exist", "invalid reference")
_NO_RESOURCE = "ResourceInitializationError"
_FAILURE_OF_TOOLS = {
    PREPARE_CONTAINER: "its inputs could not be downloaded",
    WATCH_CONTAINER: "its results could not be uploaded",
}


@dataclass(frozen=True)
class Why:
    """Reason why there is no outcome."""

    reason: str
    exit_code: ExitCode = ExitCode.INFRASTRUCTURE


def host_lost(attempt: Attempt) -> bool:
    """Return whether an attempt ended because its host was lost."""
    return attempt.status_reason.startswith(_HOST_LOST)


def why_no_outcome(job: Job, description: Description, given_up: str, last_lines: Mapping[str, str]) -> Why:
    """Determine why a job has no outcome.

    Args:
        job: ended job.
        description: Batch's description of it.
        given_up: reason why we have terminated the remaining jobs; empty if we have not.
        last_lines: last lines of the containers' logs, by name.
    """
    attempts = description.attempts
    if given_up and (description.terminated or not attempts or given_up[:100] in description.status_reason):
        return Why(given_up)
    containers = attempts[-1].containers if attempts else description.running
    status = description.status_reason or "it gives no reason"
    if description.terminated:
        return Why(f"it was terminated by another process: {status}")
    if (lost := sum(map(host_lost, attempts))) and host_lost(attempts[-1]):
        times = "once" if lost == 1 else f"{lost} times"
        return Why(f"its host was lost {times}, in {len(attempts)} attempts: {attempts[-1].status_reason}")
    reasons = [(container.name, container.reason) for container in containers]
    for name, reason in [*reasons, ("", status)]:
        if reason.startswith(_CANNOT_PULL):
            image = next((c.image for c in job.containers if c.name == name), "")
            missing = any(sign in reason.lower() for sign in _NO_SUCH_IMAGE)
            which = f"container '{name}': the image {image}".rstrip() if name else "an image"
            return Why(
                f"{which} cannot be pulled: {reason}", ExitCode.BAD_INPUT if missing else ExitCode.INFRASTRUCTURE
            )
        if reason.startswith(_NO_RESOURCE):
            return Why(f"its task could not be set up: check roles, secrets and network: {reason}")
    if description.status_reason.startswith(_TIMEOUT_REASON):
        return Why(f"AWS Batch has terminated it before our own limit of {job.seconds or 0:g} s did: {status}")
    for container in containers:
        if container.name in _FAILURE_OF_TOOLS and container.exit_code:
            last = f": {last_lines[container.name]}" if last_lines.get(container.name) else ""
            how = container.reason or f"{container.name} ended with exit code {container.exit_code}"
            return Why(f"{_FAILURE_OF_TOOLS[container.name]}: {how}{last}")
    if description.status == "SUCCEEDED":
        return Why("AWS Batch reports success, but its task has left no outcome in S3")
    ends = [f"{c.name}: {c.reason or f'exit code {c.exit_code}'}" for c in containers if c.exit_code or c.reason]
    return Why(f"AWS Batch reports a failure: {'; '.join([status, *ends])}")


_OUT_OF_MEMORY = "OutOfMemory"
_LAST_CODE = 255


def with_ends(
    outcome: TaskOutcome, job: Job, ends: Iterable[ContainerEnd], last_lines: Mapping[str, str]
) -> TaskOutcome:
    """Add information to an outcome that its task did not have.

    A reason of the task about the end of a container is replaced if Batch knows more, in the same words as
    in other backends.

    Args:
        outcome: outcome that the task has written.
        job: job with the memory limits of its containers.
        ends: Batch's information about the containers of this attempt.
        last_lines: last lines of their logs, by name.
    """
    known = {end.name: end for end in ends}
    asked = {container.name: container for container in job.containers}
    reasons = list(outcome.reasons)
    containers = []
    for before in outcome.containers:
        container = asked[before.name]
        after = _known_better(before, container, known.get(before.name))
        containers.append(after)
        old, new = _failure_of_container(before, container), _failure_of_container(after, container)
        position = next((i for i, reason in enumerate(reasons) if old is not None and reason.startswith(old)), None)
        if new is not None and position is not None:
            rest = reasons[position].removeprefix(old or "")  # such as why it was not ready
            reasons[position] = f"{new}{rest}" if rest else _failure_of_container(after, container, last_lines) or new
        elif new is not None and after.end != before.end and (container.essential or reasons):
            reasons.append(_failure_of_container(after, container, last_lines) or new)
    failed = ExitCode.FAIL if reasons else ExitCode.PASS
    exit_code = outcome.exit_code if outcome.exit_code != ExitCode.PASS else failed
    return replace(outcome, exit_code=exit_code, reasons=tuple(reasons), containers=tuple(containers))


def ends_alone(job: Job, ends: Iterable[ContainerEnd]) -> tuple[ContainerOutcome, ...]:
    """Return how the containers of a job ended, according to Batch only."""
    known = {end.name: end for end in ends}
    return tuple(
        _known_better(ContainerOutcome(container.name, End.LOST), container, known.get(container.name))
        for container in job.containers
    )


def _known_better(before: ContainerOutcome, container: Container, end: ContainerEnd | None) -> ContainerOutcome:
    if end is None:
        return before
    code = before.exit_code if before.exit_code is not None else _exit_code_of(end)
    if end.reason.startswith(_OUT_OF_MEMORY):
        _, signal = how_it_ended(container, code or 0, True, None)
        return replace(before, end=End.OUT_OF_MEMORY, exit_code=code, signal=signal)
    if before.end != End.LOST or code is None:
        return before
    how, signal = how_it_ended(container, code, False, None)
    return replace(before, end=how, exit_code=code, signal=signal)


def _exit_code_of(end: ContainerEnd) -> int | None:
    return end.exit_code if end.exit_code is not None and 0 <= end.exit_code <= _LAST_CODE else None


def _failure_of_container(
    outcome: ContainerOutcome, container: Container, last_lines: Mapping[str, str] | None = None
) -> str | None:
    return failure_of(container, outcome, (last_lines or {}).get(container.name, ""))


T = TypeVar("T")


@dataclass(frozen=True)
class ResultLocation:
    """Location of a job's result, and Batch's description of its end."""

    location: Location
    index: int
    description: Description | None
    """Batch's description of the job's end; None for the result of an earlier run."""
    attempt: int | None = None
    """Attempt that is known to have a result."""
    given_up: str = ""
    """Reason why we have terminated the remaining jobs, if we have."""


class _WrongFileError(InfrastructureError):
    """A file in S3 differs from the outcome."""


class Downloader:
    """Downloads results into folders. Thread-safe."""

    def __init__(self, run: CloudRun, all_logs: bool, go_on: Callable[[], bool]) -> None:
        """Create the downloader.

        Args:
            run: where the results are, and where they go to.
            all_logs: whether logs of successful jobs are downloaded too.
            go_on: returns whether failed requests are retried.
        """
        self._run = run
        self._all_logs = all_logs
        self._go_on = go_on

    def download(self, job: Job, result: ResultLocation) -> JobOutcome:
        """Download the result of an ended job.

        Raises:
            InfrastructureError: a file cannot be written.
            InputError: access is denied.
            AwsLostError: AWS has not answered for a long time.
        """
        folder = self._run.folder / job.name
        make_job_folder(folder)
        asked = _with_memory(job, self._run.settings.memory)
        try:
            found = self._find_outcome(asked, result)
        except AwsLostError:
            raise
        except InfrastructureError as error:  # not an outcome of this job
            found = _failed_outcome(asked, result.description, str(error), ExitCode.INFRASTRUCTURE)
        attempt = 0 if found is None else found.attempt
        lines: dict[str, str] = {}
        if self._all_logs or found is None or found.exit_code != ExitCode.PASS:
            lines = self._download_logs(job, result.description, attempt, folder / LOGS_FOLDER, ours=attempt == 0)
        if found is None and result.description is not None:
            why = why_no_outcome(job, result.description, result.given_up, lines)
            found = _failed_outcome(asked, result.description, why.reason, why.exit_code)
        elif found is None:
            found = _failed_outcome(asked, None, "its result is missing in S3", ExitCode.INFRASTRUCTURE)
        elif attempt:
            found = with_ends(found, asked, _ends_of_attempt(result.description, attempt), lines)
        found = self._download_files(found, result, attempt, folder / ARTIFACTS_FOLDER)
        outcome = self._job_outcome(job, found, folder, lines)
        write_manifest(outcome, result.location.run)
        return outcome

    def _find_outcome(self, job: Job, result: ResultLocation) -> TaskOutcome | None:
        """Return the latest complete outcome; None if there is none.

        Raises:
            InfrastructureError: it is not an outcome of this job.
        """
        expected = result.attempt or (len(result.description.attempts) if result.description else 0)
        found = self._read_outcome(job, result, expected) if expected else None
        if found is None:
            there = self._ask_with_retries(
                lambda: list(self._run.store.folders(result.location.attempts_key(result.index)))
            )
            for attempt in sorted({int(name) for name in there if name.isdecimal()} - {0, expected}, reverse=True):
                if (found := self._read_outcome(job, result, attempt)) is not None:
                    break
        return found

    def _read_outcome(self, job: Job, result: ResultLocation, attempt: int) -> TaskOutcome | None:
        key = result.location.result_key(result.index, attempt, OUTCOME_FILE)
        data = self._ask_with_retries(lambda: self._run.store.get(key, max_outcome_bytes(job)))
        return None if data is None else read_outcome(data, job, attempt, key)

    def _download_logs(
        self, job: Job, description: Description | None, attempt: int, folder: Path, ours: bool
    ) -> dict[str, str]:
        """Download the logs of an attempt; return the last line of each."""
        if description is None:
            return {}
        attempt = attempt or len(description.attempts)
        known = {container.name for container in job.containers}
        lines: dict[str, str] = {}
        for name, stream in streams(description, attempt).items():
            if name in known or (ours and is_ours(name)):
                path = folder / f"{name}.log"
                write = partial(write_log, self._run.aws, self._run.settings.log_group, stream, path, secrets_of(job))
                try:
                    lines[name] = self._ask_with_retries(write)
                except CalibrationError as error:  # a missing log must not lose the result
                    write_atomically(path, f"(the log cannot be read: {error})\n")
                    lines[name] = ""
        return lines

    def _download_files(self, found: TaskOutcome, result: ResultLocation, attempt: int, folder: Path) -> TaskOutcome:
        """Download the files of an outcome: all of them, or none."""
        try:
            with complete_or_not_at_all(folder) as fresh:
                for file in found.artifacts:
                    self._download_file(file, result.location.result_key(result.index, attempt, FILES_FOLDER), fresh)
        except _WrongFileError as error:
            code = found.exit_code or ExitCode.INFRASTRUCTURE
            return replace(found, artifacts=(), exit_code=code, reasons=(*found.reasons, str(error)))
        return found

    def _download_file(self, file: ArtifactFile, folder: str, fresh: Path) -> None:
        path = fresh / file.path
        path.parent.mkdir(parents=True, exist_ok=True)

        def download() -> str:
            path.unlink(missing_ok=True)
            return self._run.store.download(f"{folder}/{file.path}", path, file.size)

        if self._ask_with_retries(download) != file.sha256:
            raise _WrongFileError(f"artifact '{shorten(file.path)}' in S3 differs from the outcome of the task")

    def _job_outcome(self, job: Job, found: TaskOutcome, folder: Path, lines: Mapping[str, str]) -> JobOutcome:
        secrets = secrets_of(job)
        images = {container.name: container.image for container in job.containers}
        return JobOutcome(
            job=job.name,
            folder=folder,
            containers=tuple(
                replace(
                    each,
                    image=images[each.name],
                    log=folder / LOGS_FOLDER / f"{each.name}.log" if each.name in lines else None,
                )
                for each in found.containers
            ),
            artifacts=found.artifacts,
            left_out=found.left_out,
            reasons=tuple(one_line(redact(reason, secrets)) for reason in found.reasons),
            exit_code=found.exit_code,
            seconds=found.seconds,
        )

    def _ask_with_retries(self, ask: Callable[[], T]) -> T:
        return with_retries(ask, self._go_on)


def _ends_of_attempt(description: Description | None, attempt: int) -> Iterable[ContainerEnd]:
    """Return Batch's information about the containers of an attempt."""
    if description is None:
        return ()
    tries = description.attempts
    return tries[attempt - 1].containers if attempt <= len(tries) else description.running


def _failed_outcome(job: Job, description: Description | None, reason: str, code: ExitCode) -> TaskOutcome:
    """Return the outcome of a job whose task has left no valid one."""
    ends = () if description is None else _ends_of_attempt(description, max(1, len(description.attempts)))
    return TaskOutcome(job.name, 0, code, (reason,), containers=ends_alone(job, ends))


def _with_memory(job: Job, memory: int) -> Job:
    """Return the job with the memory limits of its containers on Batch."""

    def with_limit(container: Container) -> Container:
        limits = container.limits
        return replace(container, limits=replace(limits, memory=limits.memory or memory))

    return replace(job, containers=tuple(map(with_limit, job.containers)))
