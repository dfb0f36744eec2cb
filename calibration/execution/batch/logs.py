"""Logs of containers, from CloudWatch: read whole when a job has ended, or shown while it runs."""

import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import botocore.exceptions

from calibration.aws_errors import AwsLostError, aws_errors, error_code
from calibration.errors import CalibrationError
from calibration.execution.batch.following import Description
from calibration.execution.batch.session import Aws
from calibration.execution.batch.wire import PREPARE, WATCH
from calibration.execution.job import Job
from calibration.execution.log_file import MOST_BYTES, LogFile
from calibration.workflow.masks import redact
from calibration.workflow.streams import LogDisplay, LogStream

_LOOKING = 2.0
"""Seconds between two looks at the logs that are shown: CloudWatch answers some ten calls a second."""
_TRIES, _COMING = 3, 1.0
"""How often a log is asked for that is not there, and the seconds between: it comes a little later than its container.
"""


def write_log(aws: Aws, group: str, stream: str, path: Path, secrets: Iterable[str]) -> str:
    """Write a container's log into a file.

    Returns:
        Its last line that is not empty, fit for a message.

    Raises:
        InfrastructureError: the file cannot be written.
        InputError: it is not allowed.
        AwsLostError: AWS does not answer.
    """
    with LogFile(path, secrets) as file:
        room = MOST_BYTES
        for lines, _ in _pages(aws, group, stream, None):
            for line in lines:
                data = line.encode("utf-8", "replace") + b"\n"
                file.feed(data)
                room -= len(data)
            if room < 0:
                break
    return file.last_line


@dataclass
class _Shown:
    """A log that is being shown."""

    stream: str
    to: LogStream
    secrets: tuple[str, ...]
    job: str
    token: str | None = None
    closed: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)
    """One look at a time."""


class LiveLogs:
    """Shows the logs of jobs that run; in a thread, as CloudWatch has to be asked."""

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
        """Show the containers of a job that runs, from their beginning."""
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
                self._thread = threading.Thread(target=self._run, name="logs of AWS Batch", daemon=True)
                self._thread.start()

    def ended(self, job: Job, description: Description | None) -> None:
        """Show the rest of a job's logs, also of containers that have not been seen while they ran."""
        if description is not None:
            self.running(job, description)
        with self._lock:
            shown = [log for log in self._logs.values() if log.job == job.name]
        for log in shown:
            with suppress(CalibrationError):
                self._look(log)
            self._close(log)

    def close(self) -> None:
        """Show nothing more."""
        self._stopping.set()
        with self._lock:
            shown = list(self._logs.values())
        for log in shown:
            self._close(log)

    def _close(self, log: _Shown) -> None:
        with self._lock:
            known = self._logs.pop(log.stream, None)
        if known is not None:
            log.closed = True
            log.to.close()

    def _run(self) -> None:
        while not self._stopping.wait(_LOOKING):
            with self._lock:
                shown = list(self._logs.values())
            for log in shown:
                if self._stopping.is_set():
                    return
                try:
                    self._look(log)
                except AwsLostError:
                    break
                except CalibrationError as error:
                    log.to.line(f"(the log cannot be read: {error})")
                    self._close(log)

    def _look(self, log: _Shown) -> None:
        """Show what is new in a log."""
        with log.lock:
            if log.closed:
                return
            for lines, token in _pages(self._aws, self._group, log.stream, log.token, tries=1):
                log.token = token
                for line in lines:
                    log.to.line(redact(line, log.secrets))


def secrets_of(job: Job) -> tuple[str, ...]:
    """Values that must not be seen."""
    return tuple(c.environment[name] for c in job.containers for name in c.secrets)


def streams(description: Description, attempt: int) -> Mapping[str, str]:
    """The log streams of the containers of an attempt, by their names, ours among them."""
    tries = description.attempts
    containers = tries[attempt - 1].containers if 0 < attempt <= len(tries) else description.running
    return {c.name: c.log_stream for c in containers if c.log_stream is not None}


def is_ours(name: str) -> bool:
    """Whether a container is one of those that we put beside those of the job."""
    return name in (PREPARE, WATCH)


def _pages(
    aws: Aws, group: str, stream: str, token: str | None, tries: int = _TRIES
) -> Iterator[tuple[list[str], str | None]]:
    """Lines of a log from a token on, and the token to go on from; ends where there are no more for now."""
    while True:
        page = _page(aws, group, stream, token)
        if page is None:
            tries -= 1
            if tries <= 0:
                return
            time.sleep(_COMING)
            continue
        following = page.get("nextForwardToken")
        yield [str(event.get("message", "")) for event in page.get("events", ())], following
        if following == token or not following:
            return
        token = following


def _page(aws: Aws, group: str, stream: str, token: str | None) -> dict[str, Any] | None:
    """Part of a log; None where there is no such stream (yet)."""
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
