"""Polling of submitted jobs with few requests.

An array is polled as a whole; of its children only those that may have ended, a hundred in each request, oldest first.
"""

import dataclasses
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Annotated, Any, TypeVar

from calibration.addons.aws_batch.session import Aws, aws_errors
from calibration.base import one_line, shorten
from calibration.base.records import between, field, length, record

Item = TypeVar("Item")

MAX_CHILDREN = 10_000
"""Batch's limit of jobs in an array."""
JOBS_PER_CALL = 100
"""Batch's limit of jobs in one DescribeJobs request."""
_MAX_CALLS = 50
"""Limit of requests per poll to find the ended jobs of an array."""
_MIN_POLL_SECONDS, _MAX_POLL_SECONDS = 1.0, 30.0
"""Shortest and longest interval of polls, seconds."""
_POLLS_PER_RUN = 50
"""The interval of polls is this fraction (1/50) of the elapsed time, so that long runs need few."""
_SETTLING_SECONDS = 120.0
"""Seconds until Batch's data are consistent: a new job is known, and children agree with their array."""
_ENDED_STATES = ("SUCCEEDED", "FAILED")
_RUNNING_STATES = ("STARTING", "RUNNING")


@record(case="snake")
class Submitted:
    """A job id in Batch: an array of jobs of a group, or a single one."""

    id: Annotated[str, length(most=128)] = field()
    first: Annotated[int, between(0, 2**63 - 1)] = field("Index in the group of its first job.")
    count: Annotated[int, between(1, MAX_CHILDREN)] = field("Number of its jobs.")
    group: str = ""


@dataclass(frozen=True)
class ContainerEnd:
    """End of a container, as reported by Batch."""

    name: str
    exit_code: int | None
    reason: str
    """``OutOfMemoryError: ...``, or empty."""
    log_stream: str | None


@dataclass(frozen=True)
class Attempt:
    """Attempt at a job."""

    status_reason: str
    started: int | None
    """Start time, milliseconds since 1970; None if it never started."""
    stopped: int | None
    containers: tuple[ContainerEnd, ...]


@dataclass(frozen=True)
class Description:
    """Batch's description of a job."""

    id: str
    status: str
    status_reason: str
    attempts: tuple[Attempt, ...]
    """Ended attempts."""
    running: tuple[ContainerEnd, ...]
    """Containers of the current or last attempt."""
    terminated: bool
    """Whether it was terminated or cancelled by a request."""
    waiting: Mapping[str, int] = dataclasses.field(default_factory=dict)
    """Number of jobs of an array by state."""

    @property
    def ended(self) -> bool:
        """Whether the state is final."""
        return self.status in _ENDED_STATES


@dataclass(frozen=True)
class JobEnd:
    """A job with its description."""

    group: str
    index: int
    """Index in the group."""
    description: Description


@dataclass(frozen=True)
class Poll:
    """Result of one poll."""

    ended: tuple[JobEnd, ...]
    running: tuple[JobEnd, ...]
    """Polled jobs that run: all of them if there are few."""
    queued_count: int
    running_count: int
    more: bool
    """Whether more ended jobs are known than requested: the next poll need not wait."""


class Following:
    """Tracks submitted jobs, and reports the end of each once."""

    def __init__(self, aws: Aws) -> None:
        self._aws = aws
        self._open: dict[str, _Array] = {}
        self._told: set[str] = set()
        """Ids whose jobs have all been reported."""
        self._began = time.monotonic()

    def add(self, submitted: Submitted) -> None:
        """Track a submission."""
        self._open[submitted.id] = _Array(submitted)

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids that have not ended."""
        return tuple(self._open)

    def may_run(self, identifier: str) -> bool:
        """Return whether jobs of an id may still run: their ends have not been reported, or it is not tracked yet."""
        return identifier not in self._told

    @property
    def left(self) -> Iterator[tuple[str, int]]:
        """Group and index of every job whose end has not been reported."""
        return ((array.of.group, array.of.first + child) for array in self._open.values() for child in array.open)

    @property
    def delay(self) -> float:
        """Seconds until the next poll."""
        return min(_MAX_POLL_SECONDS, max(_MIN_POLL_SECONDS, (time.monotonic() - self._began) / _POLLS_PER_RUN))

    @property
    def oldest(self) -> tuple[str, ...]:
        """Ids of the oldest jobs whose end has not been reported, at most a hundred."""
        ids = (array.id_of(child) for array in self._open.values() for child in array.open)
        return tuple(islice(ids, JOBS_PER_CALL))

    def poll(self, most: int = 4 * JOBS_PER_CALL) -> Poll:
        """Poll Batch; report the end of each job once.

        Args:
            most: approximate limit of reported jobs; the remaining ones are reported by the next poll.

        Raises:
            InputError: the credentials are not valid (any more).
            AwsLostError: AWS does not answer; the next poll reports everything.
        """
        parents = describe(self._aws, self._open)
        ended: list[JobEnd] = []
        running: list[JobEnd] = []
        more = False
        for array in list(self._open.values()):
            parent = parents.get(array.of.id)
            array.see(parent)
            more |= len(ended) >= most
            for description in self._describe_array(array, parent, most - len(ended)):
                end = array.end_of(description)
                if description.ended:
                    ended.append(end)
                    array.reported(end.index - array.of.first)
                elif description.status in _RUNNING_STATES:
                    running.append(end)
            if not array.open:
                del self._open[array.of.id]
                self._told.add(array.of.id)
        arrays = self._open.values()
        return Poll(
            ended=tuple(ended),
            running=tuple(running),
            queued_count=sum(min(array.queued, len(array.open)) for array in arrays),
            running_count=sum(min(array.running, len(array.open)) for array in arrays),
            more=more,
        )

    def _describe_array(self, array: "_Array", parent: Description | None, most: int) -> Iterator[Description]:
        """Yield known descriptions of an array's jobs, usually including those that have ended."""
        if most <= 0:
            array.wait_on()
        elif array.is_lost:
            yield from (array.lost(child) for child in list(array.open)[:most])
        elif parent is not None and not array.has_children:
            yield parent
        elif parent is not None:
            yield from self._describe_children(array, most)

    def _describe_children(self, array: "_Array", most: int) -> Iterator[Description]:
        """Yield descriptions of children: running ones if there are few, otherwise until all ended ones are found."""
        few = len(array.open) <= JOBS_PER_CALL and array.running > 0
        calls = min(_MAX_CALLS, 2 + 2 * array.hidden // JOBS_PER_CALL) if array.hidden else int(few)
        for number, children in enumerate(islice(batches(array.in_turn(), JOBS_PER_CALL), calls)):
            described = describe(self._aws, map(array.id_of, children))
            array.turn(number, len(children))
            yield from described.values()
            most -= sum(description.ended for description in described.values())
            if most <= 0:
                array.wait_on()
            if most <= 0 or not (array.hidden or few):
                return


class _Array:
    """State of one submission."""

    def __init__(self, of: Submitted) -> None:
        self.of = of
        self.open = dict.fromkeys(range(of.count))
        """Children whose end has not been reported, in order."""
        self.queued = of.count
        self.running = 0
        self.has_children = of.count > 1
        self._ended_count = 0
        """Number of ended children according to Batch."""
        self._at = 0
        """Offset of the next poll, after the oldest children."""
        self._unclear_since: float | None = None

    @property
    def hidden(self) -> int:
        """Number of ended children that have not been identified yet."""
        return self._ended_count - (self.of.count - len(self.open))

    def see(self, parent: Description | None) -> None:
        """Update from Batch's description of the array; None if Batch does not know it, not yet or no more."""
        if parent is not None:
            states = parent.waiting if self.has_children else {parent.status: 1}
            self._ended_count = sum(states.get(state, 0) for state in _ENDED_STATES)
            self.running = sum(states.get(state, 0) for state in _RUNNING_STATES)
            if parent.ended:  # the status is authoritative: the summary may lag behind
                self._ended_count, self.running = self.of.count, 0
            self.queued = self.of.count - self._ended_count - self.running
        if parent is not None and not parent.ended:
            self._unclear_since = None
        elif self._unclear_since is None:
            self.wait_on()

    def reported(self, child: int) -> None:
        """Record that the end of a child was reported."""
        self.open.pop(child, None)

    def wait_on(self) -> None:
        """Start the time-out for Batch's data to become consistent."""
        self._unclear_since = time.monotonic()

    @property
    def is_lost(self) -> bool:
        """Whether the time-out has passed, so that Batch will not report the remaining children."""
        return self._unclear_since is not None and time.monotonic() - self._unclear_since > _SETTLING_SECONDS

    def in_turn(self) -> list[int]:
        """Return the unreported children: the hundred oldest, then the others from the end of the last poll."""
        children = list(self.open)
        oldest, others = children[:JOBS_PER_CALL], children[JOBS_PER_CALL:]
        at = self._at % len(others) if others else 0
        return [*oldest, *others[at:], *others[:at]]

    def turn(self, number: int, count: int) -> None:
        """Advance the offset by the children of one request."""
        self._at += count if number else 0

    def id_of(self, child: int) -> str:
        """Return the id of a child in Batch."""
        return f"{self.of.id}:{child}" if self.has_children else self.of.id

    def end_of(self, description: Description) -> JobEnd:
        """Combine a description with the index of its job in the group."""
        child = int(description.id.rpartition(":")[2]) if self.has_children else 0
        return JobEnd(self.of.group, self.of.first + child, description)

    def lost(self, child: int) -> Description:
        """Return a description for a child that Batch does not know, although the array has ended."""
        return Description(self.id_of(child), "FAILED", "AWS Batch does not know what became of it", (), (), False)


def batches(items: Iterable[Item], size: int) -> Iterator[list[Item]]:
    """Split items into lists of a size."""
    rest = iter(items)
    while some := list(islice(rest, size)):
        yield some


def describe(aws: Aws, ids: Iterable[str]) -> dict[str, Description]:
    """Describe jobs in Batch, a hundred per request; unknown ones are omitted.

    Raises:
        InputError: the credentials are not valid.
        AwsLostError: AWS does not answer.
    """
    found: dict[str, Description] = {}
    for some in batches(ids, JOBS_PER_CALL):
        found |= {each.id: each for each in map(_read_description, records(aws, some))}
    return found


def records(aws: Aws, ids: Sequence[str]) -> list[dict[str, Any]]:
    """Return Batch's unparsed descriptions of at most a hundred jobs.

    Raises:
        InputError: the credentials are not valid.
        AwsLostError: AWS does not answer.
    """
    with aws_errors("jobs"):
        found: list[dict[str, Any]] = aws.batch.describe_jobs(jobs=list(ids))["jobs"]
    return found


def _read_description(record: Mapping[str, Any]) -> Description:
    return Description(
        id=str(record["jobId"]),
        status=str(record["status"]),
        status_reason=_shorten_line(record.get("statusReason")),
        attempts=tuple(_read_attempt(attempt) for attempt in record.get("attempts", ())),
        running=_read_containers(record.get("ecsProperties", {}).get("taskProperties", ())),
        terminated=bool(record.get("isTerminated") or record.get("isCancelled")),
        waiting=record.get("arrayProperties", {}).get("statusSummary", {}),
    )


def _read_attempt(record: Mapping[str, Any]) -> Attempt:
    return Attempt(
        status_reason=_shorten_line(record.get("statusReason")),
        started=record.get("startedAt"),
        stopped=record.get("stoppedAt"),
        containers=_read_containers(record.get("taskProperties", ())),
    )


def _read_containers(tasks: Iterable[Mapping[str, Any]]) -> tuple[ContainerEnd, ...]:
    return tuple(
        ContainerEnd(
            name=str(container.get("name", "")),
            exit_code=container.get("exitCode"),
            reason=_shorten_line(container.get("reason")),
            log_stream=container.get("logStreamName"),
        )
        for task in tasks
        for container in task.get("containers", ())
    )


def _shorten_line(text: str | None) -> str:
    return shorten(one_line(text or ""), 300)
