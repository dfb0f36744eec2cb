"""What becomes of what was submitted, in few calls.

An array is asked as a whole, and of its children only those that may have ended, a hundred at once, the oldest first.
"""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, TypeVar

from calibration.aws_errors import aws_errors
from calibration.execution.batch.session import Aws
from calibration.workflow.text import one_line, shorten

Item = TypeVar("Item")

AT_ONCE = 100
"""Jobs that Batch describes in one call."""
_MOST_CALLS = 50
"""In which the ended jobs of an array are looked for at one look."""
_SHORTEST, _LONGEST = 1.0, 30.0
"""Seconds between two looks."""
_PART = 50
"""A look comes late by one part in so many of the time gone by, so that long runs need few."""
_SETTLING = 120.0
"""Seconds in which Batch gets to know what it has just taken, and tells of children what it tells of their array."""
_ENDED = ("SUCCEEDED", "FAILED")
_RUNNING = ("STARTING", "RUNNING")


@dataclass(frozen=True)
class Submitted:
    """What Batch runs under one id: an array of jobs of a group, or a single one."""

    id: str
    group: str
    first: int
    """The index in the group of its first job."""
    count: int


@dataclass(frozen=True)
class ContainerEnd:
    """How a container ended, as Batch has it."""

    name: str
    exit_code: int | None
    reason: str
    """``OutOfMemoryError: ...``, or nothing."""
    log_stream: str | None


@dataclass(frozen=True)
class Attempt:
    """One of the tries at a job."""

    status_reason: str
    started: int | None
    """In milliseconds; None where it never did."""
    stopped: int | None
    containers: tuple[ContainerEnd, ...]


@dataclass(frozen=True)
class Description:
    """What Batch says of a job."""

    id: str
    status: str
    status_reason: str
    attempts: tuple[Attempt, ...]
    """Those that have ended."""
    running: tuple[ContainerEnd, ...]
    """The containers of the attempt that goes on, or was the last."""
    terminated: bool
    """Whether somebody has ended it."""
    waiting: Mapping[str, int] = field(default_factory=dict)
    """Of an array: how many of its jobs are in each state."""

    @property
    def ended(self) -> bool:
        """Whether nothing more comes of it."""
        return self.status in _ENDED


@dataclass(frozen=True)
class JobEnd:
    """A job that has ended."""

    group: str
    index: int
    """In the group."""
    description: Description


@dataclass(frozen=True)
class Look:
    """What one look at Batch has shown."""

    ended: tuple[JobEnd, ...]
    running: tuple[JobEnd, ...]
    """Those that were looked at and run: all of them where there are few."""
    queued_count: int
    running_count: int
    more: bool
    """Whether there was no room for telling all: the next look needs not wait."""


class Following:
    """Knows of each job that was submitted whether its end has been told."""

    def __init__(self, aws: Aws) -> None:
        self._aws = aws
        self._open: dict[str, _Array] = {}
        self._told: set[str] = set()
        """Ids of which nothing more is to be heard."""
        self._began = time.monotonic()

    def add(self, submitted: Submitted) -> None:
        """Follow one more."""
        self._open[submitted.id] = _Array(submitted)

    @property
    def ids(self) -> tuple[str, ...]:
        """What is under way."""
        return tuple(self._open)

    def may_run(self, identifier: str) -> bool:
        """Whether something of an id may run: its end has not been told, or it has not been followed yet."""
        return identifier not in self._told

    @property
    def left(self) -> Iterator[tuple[str, int]]:
        """Group and index of every job whose end has not been told."""
        return ((array.of.group, array.of.first + child) for array in self._open.values() for child in array.open)

    @property
    def delay(self) -> float:
        """Seconds until the next look is due."""
        return min(_LONGEST, max(_SHORTEST, (time.monotonic() - self._began) / _PART))

    @property
    def oldest(self) -> tuple[str, ...]:
        """The ids of the oldest jobs whose end has not been told, at most a hundred."""
        ids = (array.id_of(child) for array in self._open.values() for child in array.open)
        return tuple(islice(ids, AT_ONCE))

    def look(self, most: int = 4 * AT_ONCE) -> Look:
        """Ask Batch; tells the end of each job once.

        Args:
            most: about so many of those that have ended are told now; the rest is told by the next look.

        Raises:
            InputError: the credentials do not do (any more).
            AwsLostError: AWS does not answer; nothing is lost, the next look tells it.
        """
        parents = describe(self._aws, self._open)
        ended: list[JobEnd] = []
        running: list[JobEnd] = []
        more = False
        for array in list(self._open.values()):
            parent = parents.get(array.of.id)
            array.see(parent)
            more |= len(ended) >= most
            for description in self._descriptions(array, parent, most - len(ended)):
                end = array.end_of(description)
                if description.ended:
                    ended.append(end)
                    array.told(end.index - array.of.first)
                elif description.status in _RUNNING:
                    running.append(end)
            if not array.open:
                del self._open[array.of.id]
                self._told.add(array.of.id)
        arrays = self._open.values()
        return Look(
            ended=tuple(ended),
            running=tuple(running),
            queued_count=sum(min(array.queued, len(array.open)) for array in arrays),
            running_count=sum(min(array.running, len(array.open)) for array in arrays),
            more=more,
        )

    def _descriptions(self, array: "_Array", parent: Description | None, most: int) -> Iterator[Description]:
        """What is known of jobs of an array; those that have ended are among them, most of the time."""
        if most <= 0:
            array.wait_on()
        elif array.is_lost:
            yield from (array.lost(child) for child in list(array.open)[:most])
        elif parent is not None and not array.has_children:
            yield parent
        elif parent is not None:
            yield from self._children(array, most)

    def _children(self, array: "_Array", most: int) -> Iterator[Description]:
        """Descriptions of children: those that run where there are few, else as long as ended ones are to be found."""
        few = len(array.open) <= AT_ONCE and array.running > 0
        calls = min(_MOST_CALLS, 2 + 2 * array.hidden // AT_ONCE) if array.hidden else int(few)
        for number, children in enumerate(islice(batches(array.in_turn(), AT_ONCE), calls)):
            described = describe(self._aws, map(array.id_of, children))
            array.turn(number, len(children))
            yield from described.values()
            most -= sum(description.ended for description in described.values())
            if most <= 0:
                array.wait_on()
            if most <= 0 or not (array.hidden or few):
                return


class _Array:
    """What is known of what runs under one id."""

    def __init__(self, of: Submitted) -> None:
        self.of = of
        self.open = dict.fromkeys(range(of.count))
        """Children whose end has not been told, in order."""
        self.queued = of.count
        self.running = 0
        self.has_children = of.count > 1
        self._ended_count = 0
        """Children that Batch says have ended."""
        self._at = 0
        """Where the next look begins, after the oldest."""
        self._unclear_since: float | None = None

    @property
    def hidden(self) -> int:
        """Children that have ended, and it is not known which."""
        return self._ended_count - (self.of.count - len(self.open))

    def see(self, parent: Description | None) -> None:
        """Take what Batch says of the whole; None where it does not know it: not yet, or not any more."""
        if parent is not None:
            states = parent.waiting if self.has_children else {parent.status: 1}
            self._ended_count = sum(states.get(state, 0) for state in _ENDED)
            self.running = sum(states.get(state, 0) for state in _RUNNING)
            if parent.ended:  # whatever the summary says, which may come later
                self._ended_count, self.running = self.of.count, 0
            self.queued = self.of.count - self._ended_count - self.running
        if parent is not None and not parent.ended:
            self._unclear_since = None
        elif self._unclear_since is None:
            self.wait_on()

    def told(self, child: int) -> None:
        """Take the end of a child."""
        self.open.pop(child, None)

    def wait_on(self) -> None:
        """Begin to wait for what Batch should know by now."""
        self._unclear_since = time.monotonic()

    @property
    def is_lost(self) -> bool:
        """Whether nothing more will be heard of those whose end is not known."""
        return self._unclear_since is not None and time.monotonic() - self._unclear_since > _SETTLING

    def in_turn(self) -> list[int]:
        """Children whose end is not known: the hundred oldest, and then the others from where the last look ended."""
        children = list(self.open)
        oldest, others = children[:AT_ONCE], children[AT_ONCE:]
        at = self._at % len(others) if others else 0
        return [*oldest, *others[at:], *others[:at]]

    def turn(self, number: int, count: int) -> None:
        """Note that the children of one call are looked at."""
        self._at += count if number else 0

    def id_of(self, child: int) -> str:
        """The id of a job."""
        return f"{self.of.id}:{child}" if self.has_children else self.of.id

    def end_of(self, description: Description) -> JobEnd:
        """Which job of the group a description is of."""
        child = int(description.id.rpartition(":")[2]) if self.has_children else 0
        return JobEnd(self.of.group, self.of.first + child, description)

    def lost(self, child: int) -> Description:
        """Of a child of which Batch says nothing, though it says that all have ended."""
        return Description(self.id_of(child), "FAILED", "AWS Batch does not know what became of it", (), (), False)


def batches(items: Iterable[Item], size: int) -> Iterator[list[Item]]:
    """Some at a time."""
    rest = iter(items)
    while some := list(islice(rest, size)):
        yield some


def describe(aws: Aws, ids: Iterable[str]) -> dict[str, Description]:
    """Ask Batch about jobs, a hundred in each call; what it does not know is left out.

    Raises:
        InputError: the credentials do not do.
        AwsLostError: AWS does not answer.
    """
    found: dict[str, Description] = {}
    for some in batches(ids, AT_ONCE):
        for record in records(aws, some):
            description = _description(record)
            found[description.id] = description
    return found


def records(aws: Aws, ids: Sequence[str]) -> list[dict[str, Any]]:
    """What Batch says of at most a hundred jobs, as it says it.

    Raises:
        InputError: the credentials do not do.
        AwsLostError: AWS does not answer.
    """
    with aws_errors("jobs"):
        found: list[dict[str, Any]] = aws.batch.describe_jobs(jobs=list(ids))["jobs"]
    return found


def _description(record: Mapping[str, Any]) -> Description:
    return Description(
        id=str(record["jobId"]),
        status=str(record["status"]),
        status_reason=_line(record.get("statusReason")),
        attempts=tuple(_attempt(attempt) for attempt in record.get("attempts", ())),
        running=_containers(record.get("ecsProperties", {}).get("taskProperties", ())),
        terminated=bool(record.get("isTerminated") or record.get("isCancelled")),
        waiting=record.get("arrayProperties", {}).get("statusSummary", {}),
    )


def _attempt(record: Mapping[str, Any]) -> Attempt:
    return Attempt(
        status_reason=_line(record.get("statusReason")),
        started=record.get("startedAt"),
        stopped=record.get("stoppedAt"),
        containers=_containers(record.get("taskProperties", ())),
    )


def _containers(tasks: Iterable[Mapping[str, Any]]) -> tuple[ContainerEnd, ...]:
    return tuple(
        ContainerEnd(
            name=str(container.get("name", "")),
            exit_code=container.get("exitCode"),
            reason=_line(container.get("reason")),
            log_stream=container.get("logStreamName"),
        )
        for task in tasks
        for container in task.get("containers", ())
    )


def _line(text: str | None) -> str:
    return shorten(one_line(text or ""), 300)
