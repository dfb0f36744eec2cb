"""Logs of containers from CloudWatch, downloaded at the end of a job or shown while it runs."""

import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import botocore.exceptions

from calibration.addons.aws_batch.following import Description
from calibration.addons.aws_batch.session import Aws, AwsLostError, aws_errors, error_code
from calibration.addons.aws_batch.wire import PREPARE_CONTAINER, WATCH_CONTAINER
from calibration.base import CalibrationError
from calibration.base.text import redact
from calibration.ci.execution.job import Job
from calibration.ci.workflow.streams import MOST_BYTES, LogDisplay, LogFile, LogStream

_POLL_SECONDS = 2.0
"""Interval of polls of shown logs, seconds: CloudWatch allows about ten requests a second."""
_MAX_TRIES, _SECONDS_BETWEEN_TRIES = 3, 1.0
"""Attempts to read a missing log, and seconds between them: logs appear a little later than their containers."""


def write_log(aws: Aws, group: str, stream: str, path: Path, secrets: Iterable[str]) -> str:
    """Write a container's log to a file.

    Returns:
        Its last non-empty line, safe for messages.

    Raises:
        InfrastructureError: the file cannot be written.
        InputError: access is denied.
        AwsLostError: AWS does not answer.
    """
    with LogFile(path, secrets) as file:
        room = MOST_BYTES
        for lines, _ in _read_pages(aws, group, stream, None):
            for line in lines:
                data = line.encode("utf-8", "replace") + b"\n"
                file.feed(data)
                room -= len(data)
            if room < 0:
                break
    return file.last_line


@dataclass
class _Shown:
    """A log that is shown live."""

    stream: str
    to: LogStream
    secrets: tuple[str, ...]
    job: str
    token: str | None = None
    closed: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)
    """Held during a poll."""


class LiveLogs:
    """Shows the logs of running jobs, polled from CloudWatch in a thread."""

    def __init__(self, aws: Aws, group: str, show: LogDisplay) -> None:
        self._aws = aws
        self._group = group
        self._show = show
        self._lock = threading.Lock()
        self._logs: dict[str, _Shown] = {}
        self._seen: set[str] = set()
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

    def running(self, job: Job, description: Description) -> None:
        """Show the containers of a running job, from the beginning of their logs."""
        by_name = {container.name: container for container in job.containers}
        with self._lock:
            for container in description.running:
                stream, known = container.log_stream, by_name.get(container.name)
                if stream is None or known is None or stream in self._seen:
                    continue
                self._seen.add(stream)
                to = self._show.open(f"{job.name}/{container.name}", live=known.essential)
                self._logs[stream] = _Shown(stream, to, secrets_of(job), job.name)
            if self._thread is None and self._logs:
                self._thread = threading.Thread(target=self._poll_until_stopped, name="logs of AWS Batch", daemon=True)
                self._thread.start()

    def ended(self, job: Job, description: Description | None) -> None:
        """Show the rest of a job's logs, including containers that were not polled while they ran."""
        if description is not None:
            self.running(job, description)
        with self._lock:
            shown = [log for log in self._logs.values() if log.job == job.name]
        for log in shown:
            with suppress(CalibrationError):
                self._poll_log(log)
            self._close_log(log)

    def close(self) -> None:
        """Stop showing logs."""
        self._stopping.set()
        with self._lock:
            shown = list(self._logs.values())
        for log in shown:
            self._close_log(log)

    def _close_log(self, log: _Shown) -> None:
        with self._lock:
            known = self._logs.pop(log.stream, None)
        if known is not None:
            log.closed = True
            log.to.close()

    def _poll_until_stopped(self) -> None:
        while not self._stopping.wait(_POLL_SECONDS):
            with self._lock:
                shown = list(self._logs.values())
            for log in shown:
                if self._stopping.is_set():
                    return
                try:
                    self._poll_log(log)
                except AwsLostError:
                    break
                except CalibrationError as error:
                    log.to.line(f"(the log cannot be read: {error})")
                    self._close_log(log)

    def _poll_log(self, log: _Shown) -> None:
        """Show new lines of a log."""
        with log.lock:
            if log.closed:
                return
            for lines, token in _read_pages(self._aws, self._group, log.stream, log.token, tries=1):
                log.token = token
                for line in lines:
                    log.to.line(redact(line, log.secrets))


def secrets_of(job: Job) -> tuple[str, ...]:
    """Return the values of a job's secrets, to be redacted."""
    return tuple(c.environment[name] for c in job.containers for name in c.secrets)


def streams(description: Description, attempt: int) -> Mapping[str, str]:
    """Return the log streams of an attempt's containers by name, including our own containers."""
    tries = description.attempts
    containers = tries[attempt - 1].containers if 0 < attempt <= len(tries) else description.running
    return {c.name: c.log_stream for c in containers if c.log_stream is not None}


def is_ours(name: str) -> bool:
    """Return whether a container is one of ours, as opposed to the job's."""
    return name in (PREPARE_CONTAINER, WATCH_CONTAINER)


def _read_pages(
    aws: Aws, group: str, stream: str, token: str | None, tries: int = _MAX_TRIES
) -> Iterator[tuple[list[str], str | None]]:
    """Yield lines of a log after a token, and the next token; ends at the current end of the log."""
    while True:
        page = _read_page(aws, group, stream, token)
        if page is None:
            tries -= 1
            if tries <= 0:
                return
            time.sleep(_SECONDS_BETWEEN_TRIES)
            continue
        following = page.get("nextForwardToken")
        yield [str(event.get("message", "")) for event in page.get("events", ())], following
        if following == token or not following:
            return
        token = following


def _read_page(aws: Aws, group: str, stream: str, token: str | None) -> dict[str, Any] | None:
    """Return a page of a log; None if the stream does not exist (yet)."""
    settings = {} if token is None else {"nextToken": token}
    with aws_errors(f"log {group} {stream}"):
        try:
            page: dict[str, Any] = aws.logs.get_log_events(
                logGroupName=group, logStreamName=stream, startFromHead=True, **settings
            )
        except botocore.exceptions.ClientError as error:
            if error_code(error) == "ResourceNotFoundException":
                return None
            raise
    return page
