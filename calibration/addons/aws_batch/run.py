"""A run of jobs on AWS Batch, from the upload of inputs to the download of results; resumed, of jobs without one."""

import hashlib
import json
import re
import time
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any

from calibration.addons.aws_batch import wire
from calibration.addons.aws_batch.checks import Guard, likely_reasons
from calibration.addons.aws_batch.definition import ShapeGroup, Usage, billed, estimate, job_definition, total_size
from calibration.addons.aws_batch.following import JOBS_PER_CALL, Following, JobEnd, Poll, Submitted, batches, describe
from calibration.addons.aws_batch.logs import LiveLogs
from calibration.addons.aws_batch.results import Downloader, ResultLocation, host_lost
from calibration.addons.aws_batch.session import AwsLostError, Backoff, with_retries
from calibration.addons.aws_batch.store import CloudRun, InputUploader, Store, Workers, in_threads, upload_jobs
from calibration.addons.aws_batch.submitting import (
    Submitting,
    attempt_seconds,
    chunks,
    ensure,
    run_tags,
    submission,
    terminate,
)
from calibration.base import CalibrationError, ExitCode, InfrastructureError
from calibration.base.records import document_of, read
from calibration.ci.execution.docker.labels import new_run
from calibration.ci.execution.job import Job
from calibration.ci.execution.outcome import JobOutcome
from calibration.ci.workflow.streams import LogDisplay

MAX_JOBS_WITH_LOGS = 16
"""Up to this number of jobs, all logs are shown and downloaded; with more, only those of failed jobs."""
_DOWNLOAD_WORKERS = 12
_MAX_DOWNLOADS = 200
"""Limit of concurrent downloads of results, to bound the memory."""
_SECONDS_BETWEEN_LINES = 30.0
"""Interval of lines about the progress, seconds."""
_ENDING_SECONDS = 5.0

Answer = tuple[int, JobOutcome]


@dataclass(frozen=True)
class Result:
    """Location of a job's result."""

    group: str
    index: int
    attempt: int
    id: str | None
    """Id of the job in AWS Batch, if it is known."""


class BatchRun:
    """Runs jobs in the thread that requests the outcomes; transfers from and to S3 run in other threads."""

    def __init__(
        self, run: CloudRun, jobs: Sequence[Job], groups: Sequence[ShapeGroup], show: LogDisplay | None
    ) -> None:
        self.usage = Usage()
        """Billed resources, as far as they are known."""
        self._run = run
        self._name, self._aws, self._settings = run.name, run.aws, run.settings
        self._jobs = jobs
        self._shapes = {group.name: group for group in groups}
        self._show = show
        self._token = new_run()
        self._places: dict[str, list[int]] = {}
        """Index in `jobs` for each index of each group in S3."""
        self._submitting = Submitting(run.aws, run.settings.queue)
        self._following = Following(run.aws)
        self._downloads: Workers[Answer] = Workers(_DOWNLOAD_WORKERS)
        few = len(jobs) <= MAX_JOBS_WITH_LOGS
        self._live = LiveLogs(run.aws, run.settings.log_group, show) if show is not None and few else None
        self._guard = Guard(run.settings.stuck)
        self._given_up = ""
        """Reason why the remaining jobs were terminated."""
        self._told_to_end = False
        self._began = time.monotonic()
        self._counts = {"done": 0, "failed": 0}
        self._said: tuple[float, str] = (0.0, "")
        self._stopping = False
        self._ended = False
        """Whether all jobs have ended, or cannot be terminated."""
        self._downloader = Downloader(run, all_logs=few, go_on=lambda: not self._stopping)

    def outcomes(self, resume: bool) -> Generator[Answer]:
        """Run the jobs, and yield their outcomes.

        Raises:
            InputError: AWS refuses a request.
            InfrastructureError: AWS cannot be reached, or a file cannot be written.
        """
        inputs = InputUploader(self._run)
        inputs.upload(self._jobs, _DOWNLOAD_WORKERS)
        missing, earlier = (
            self._find_missing(inputs)
            if resume
            else ({name: list(group.jobs) for name, group in self._shapes.items()}, {})
        )
        for some in batches(earlier.items(), JOBS_PER_CALL):
            described = describe(self._aws, [result.id for _, result in some if result.id is not None])
            for place, result in some:
                found = described.get(result.id or "")
                self._start_download(
                    place, ResultLocation(self._run.location(result.group), result.index, found, result.attempt)
                )
            yield from self._take_answers(None)
        self._say_estimate(missing)
        self._submit_jobs(inputs, missing)
        yield from self._follow_jobs()
        self._say_end()

    def end(self, error: BaseException | None) -> None:
        """Terminate the remaining jobs; idempotent.

        Args:
            error: previous error, if any.

        Raises:
            CalibrationError: jobs cannot be terminated; the message includes the previous error.
        """
        if self._ended:
            return
        self._stopping = True
        self._downloads.stop()
        if self._live is not None:
            self._live.close()
        ids = [each.id for each in self._submitting.submitted if self._following.may_run(each.id)]
        try:
            self._submitting.stop(ids)
        except CalibrationError as problem:
            self._ended = True
            advice = f"to end jobs that may still run in AWS Batch: calibration cleanup --cloud --run {self._name}"
            if isinstance(error, CalibrationError):
                raise type(error)(f"{error}; {advice}") from None
            raise type(problem)(f"{problem}; {advice}") from error
        self._ended = True
        self._downloads.join(_ENDING_SECONDS)

    # --- before the run

    def _find_missing(self, inputs: InputUploader) -> tuple[dict[str, list[int]], dict[int, Result]]:
        """Return the jobs without a verdict, by shape; and the results of the others, by job."""
        results = find_results(self._run)
        found: dict[int, Result] = {}
        for shape, group in self._shapes.items():
            for place in group.jobs:
                if (result := results.get(mark_of(shape, inputs.entry(self._jobs[place])))) is not None:
                    found[place] = result

        def judged(place: int) -> tuple[int, bool]:
            ask = partial(has_verdict, self._run, found[place], self._jobs[place])
            return place, with_retries(ask)

        final = dict(in_threads(_DOWNLOAD_WORKERS, (partial(judged, place) for place in found)))
        missing = {
            shape: places
            for shape, group in self._shapes.items()
            if (places := [place for place in group.jobs if not final.get(place)])
        }
        earlier = {place: result for place, result in found.items() if final[place]}
        self._show_note(f"run {self._name} is resumed: {len(earlier)} of {len(self._jobs)} jobs have a verdict already")
        return missing, earlier

    def _submit_jobs(self, inputs: InputUploader, missing: dict[str, list[int]]) -> None:
        tags = run_tags(self._name)
        for shape, places in missing.items():
            group = group_name(shape, self._token)
            location = self._run.location(group)
            jobs = [self._jobs[place] for place in places]
            definition = ensure(self._aws, job_definition(self._shapes[shape].shape, self._settings))
            upload_jobs(self._run.store, location, jobs, inputs.entry, _DOWNLOAD_WORKERS)
            self._places[group] = places
            seconds = attempt_seconds(jobs)
            submitted = []
            for chunk in chunks(len(places)):
                request = submission(chunk, location, definition, self._settings, seconds=seconds, tags=tags)
                submitted.append(self._submitting.submit(request, group, chunk.start))
                self._following.add(submitted[-1])
            with_retries(partial(self._run.store.put, location.submitted_key, submitted_document(submitted)))

    # --- during the run

    def _follow_jobs(self) -> Iterator[Answer]:
        backoff = Backoff()
        next_poll = 0.0
        self._began = time.monotonic()
        while self._following.ids or self._downloads.waiting:
            done = 0
            for answer in self._take_answers(max(0.0, next_poll - time.monotonic()) if self._following.ids else None):
                done += 1
                yield answer
            if not self._following.ids or time.monotonic() < next_poll:
                continue
            room = _MAX_DOWNLOADS - self._downloads.waiting
            if room <= 0:  # Batch keeps descriptions of ended jobs
                yield from self._take_answers(None)
                continue
            try:
                poll = self._following.poll(room)
                self._take_poll(poll)
                self._watch_time(poll, done)
            except AwsLostError as error:
                next_poll = time.monotonic() + backoff.failed(error)
                continue
            backoff.answered()
            next_poll = time.monotonic() + (0.0 if poll.more else self._following.delay)

    def _take_poll(self, poll: Poll) -> None:
        """Download the results of ended jobs; show the logs of running ones."""
        if self._live is not None:
            for end in poll.running:
                self._live.running(self._job_of(end), end.description)
        for end in poll.ended:
            self._count_usage(end)
            place = ResultLocation(self._run.location(end.group), end.index, end.description, given_up=self._given_up)
            self._start_download(self._places[end.group][end.index], place)
        self._say_state(poll)

    def _watch_time(self, poll: Poll, done: int) -> None:
        """Terminate the remaining jobs if the run takes too long, or gets no hosts."""
        if not self._following.ids or self._told_to_end:
            return
        if not self._given_up and (reason := self._too_late(poll, done)):
            self._given_up = reason
            self._show_note(f"{sum(1 for _ in self._following.left)} jobs are given up: {reason}")
        if self._given_up:
            terminate(self._aws, self._following.ids, self._given_up[:1000])
            self._told_to_end = True

    def _too_late(self, poll: Poll, done: int) -> str:
        """Return the reason to terminate the remaining jobs; empty if there is none."""
        settings = self._settings
        if settings.deadline is not None and time.monotonic() - self._began >= settings.deadline:
            return f"the run took longer than its {settings.deadline:g} s (deadline)"
        if not self._guard.is_stuck(poll, done):
            return ""
        why = "; ".join(likely_reasons(self._aws, settings, self._following.oldest))
        return f"it got no host within {settings.stuck:g} s in queue '{settings.queue}' (stuck); likely reasons: {why}"

    def _start_download(self, place: int, found: ResultLocation) -> None:
        self._downloads.give(partial(self._download_result, place, found))

    def _download_result(self, place: int, found: ResultLocation) -> Answer:
        """Download a result; called in a separate thread."""
        job = self._jobs[place]
        if self._live is not None:
            self._live.ended(job, found.description)
        return place, self._downloader.download(job, found)

    def _take_answers(self, seconds: float | None) -> Iterator[Answer]:
        for place, outcome in self._downloads.take(seconds):
            self._counts["done" if outcome.verdict == "pass" else "failed"] += 1
            with self._show.paused() if self._show is not None else nullcontext():
                yield place, outcome

    def _job_of(self, end: JobEnd) -> Job:
        return self._jobs[self._places[end.group][end.index]]

    def _count_usage(self, end: JobEnd) -> None:
        """Add the billed resources of a job, and report lost hosts."""
        attempts = end.description.attempts
        shape = self._shapes[end.group.partition("-")[0]].shape
        size = total_size(shape, self._settings.platform)
        self.usage += billed(((a.started, a.stopped) for a in attempts), size, self._settings.platform)
        for number, attempt in enumerate(attempts, 1):
            if host_lost(attempt):
                name = self._job_of(end).name
                self._show_note(
                    f"job '{name}': attempt {number} of {len(attempts)} lost its host: {attempt.status_reason}"
                )

    # --- messages

    def _show_note(self, text: str) -> None:
        if self._show is not None:
            self._show.note(text)

    def _say_estimate(self, missing: dict[str, list[int]]) -> None:
        jobs = [(self._jobs[place], self._shapes[shape].shape) for shape, places in missing.items() for place in places]
        if jobs:
            cost = estimate(jobs, self._settings).text(self._settings)
            self._show_note(f"run {self._name}: {len(jobs)} jobs go to queue '{self._settings.queue}': {cost}")

    def _say_state(self, poll: Poll) -> None:
        done, failed = self._counts["done"], self._counts["failed"]
        line = f"{poll.queued_count} queued, {poll.running_count} running, {done} done, {failed} failed"
        if line != self._said[1] and time.monotonic() - self._said[0] >= _SECONDS_BETWEEN_LINES:
            self._said = (time.monotonic(), line)
            self._show_note(f"run {self._name}: {line}")

    def _say_end(self) -> None:
        progress = f"{self._counts['done']} done, {self._counts['failed']} failed"
        if self.usage.seconds:
            progress += f"; billed: {self.usage.seconds:g} s, {self.usage.text(self._settings.prices)}"
        self._show_note(f"run {self._name}: {progress}; {sum(self._aws.calls.values())} calls to AWS")


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
        for first in sorted({index // wire.JOBS_PER_FILE * wire.JOBS_PER_FILE for index in attempts}):
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
    key = run.location(result.group).result_key(result.index, result.attempt, wire.OUTCOME_FILE)
    data = run.store.get(key, wire.max_outcome_bytes(job))
    try:
        return data is not None and wire.read_outcome(data, job, result.attempt, key).exit_code <= ExitCode.FAIL
    except AwsLostError:
        raise
    except InfrastructureError:  # not an outcome of this job
        return False


def submitted_document(submitted: Iterable[Submitted]) -> bytes:
    """Return the file with the ids of a submitted group."""
    return json.dumps([document_of(each) for each in submitted]).encode()


def _ids_of_jobs(store: Store, location: wire.Location) -> dict[int, str]:
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
    pattern = re.compile(rf"{re.escape(f'{root}{group}/')}([0-9]{{1,9}})/([0-9]{{1,9}})/{re.escape(wire.OUTCOME_FILE)}")
    attempts: dict[int, int] = {}
    for key in store.keys(f"{root}{group}/"):
        if match := pattern.fullmatch(key):
            index, attempt = int(match[1]), int(match[2])
            attempts[index] = max(attempt, attempts.get(index, 0))
    return attempts


def _read_list(store: Store, key: str) -> list[Any]:
    """Return the list in a file; an empty one if there is no such file."""
    data = store.get(key, wire.MAX_JOBS_BYTES)
    document = [] if data is None else wire.parse_json(data, wire.MAX_JOBS_BYTES, key)
    return document if isinstance(document, list) else []
