"""What goes wrong, on demand."""

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from .jobs import Job

Which = Callable[[Job], bool]


def child(index: int) -> Which:
    """Choose the child of every array that has this index."""
    return lambda job: job.index == index


def named(name: str) -> Which:
    """Choose the jobs of a name."""
    return lambda job: job.name == name


@dataclass
class Reply:
    """A fault in the place of an answer, or beside it."""

    operation: str
    """Of Batch: ``SubmitJob``. Of another service: its operation (``GetLogEvents``), or ``s3:GET`` and the like.
    ``*`` for any."""
    times: int
    after: int = 0
    """So many calls are answered before."""
    status: int = 0
    code: str = ""
    message: str = ""
    drop: str = ""
    """before: the connection ends without the request having had an effect. after: it had one."""
    seconds: float = 0.0
    """How late the answer is."""
    match: str = ""
    """Only requests whose path or body has this in it."""


@dataclass
class _Host:
    which: Which
    attempts: tuple[int, ...]
    seconds: float
    reason: str | None


class Faults:
    """What is to go wrong; every method may be called at any time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._replies: list[Reply] = []
        self._hosts: list[_Host] = []
        self._stuck: list[tuple[Which, str | None]] = []
        self.had: Counter[str] = Counter()
        """How often each operation met a fault."""

    def refuse(
        self, operation: str, status: int, code: str, message: str, times: int = 1, after: int = 0, match: str = ""
    ) -> None:
        """Answer calls with an error."""
        self._add(Reply(operation, times, after, status, code, message, match=match))

    def throttle(self, operation: str = "*", times: int = 1, after: int = 0) -> None:
        """Too many requests: what a client waits for, and asks again."""
        self.refuse(operation, 429, "TooManyRequestsException", "Too Many Requests", times, after)

    def server_error(self, operation: str = "*", times: int = 1, after: int = 0) -> None:
        """An error within AWS."""
        self.refuse(operation, 500, "ServerException", "An internal error has occurred", times, after)

    def expire(self, operation: str = "*", times: int = 1_000_000, after: int = 0) -> None:
        """The credentials are no longer valid."""
        message = "The security token included in the request is expired"
        self.refuse(operation, 403, "ExpiredTokenException", message, times, after)

    def deny(self, operation: str, times: int = 1_000_000) -> None:
        """The caller may not."""
        message = (
            "User: arn:aws:sts::123456789012:assumed-role/ci/session is not authorized to perform: "
            f"batch:{operation} on resource: arn:aws:batch:eu-west-1:123456789012:* because no identity-based policy "
            f"allows the batch:{operation} action"
        )
        self.refuse(operation, 403, "AccessDeniedException", message, times)

    def drop(self, operation: str = "*", times: int = 1, after: int = 0, answered: bool = False) -> None:
        """Break the connection without an answer; with ``answered``, after the request had its effect."""
        self._add(Reply(operation, times, after, drop="after" if answered else "before"))

    def slow(self, operation: str, seconds: float, times: int = 1, after: int = 0) -> None:
        """Answer, but late."""
        self._add(Reply(operation, times, after, seconds=seconds))

    def lose_host(
        self, which: Which, attempts: tuple[int, ...] = (1,), seconds: float = 0.0, reason: str | None = None
    ) -> None:
        """Take the host from these attempts of jobs, so long after they have started to run.

        Batch says ``Host EC2 (instance i-...) terminated.`` unless another reason is given: ``Your Spot Task was
        interrupted.`` on Fargate.
        """
        with self._lock:
            self._hosts.append(_Host(which, attempts, seconds, reason))

    def stick(self, which: Which, reason: str | None = None) -> None:
        """Give jobs no host: they stay RUNNABLE, with a reason where AWS has found one."""
        with self._lock:
            self._stuck.append((which, reason))

    def clear(self) -> None:
        """Nothing goes wrong from now on."""
        with self._lock:
            self._replies, self._hosts, self._stuck = [], [], []

    def _add(self, reply: Reply) -> None:
        with self._lock:
            self._replies.append(reply)

    def reply(self, operation: str, text: str = "") -> Reply | None:
        """Return the fault of a call, once for each; waits where the answer is to be late."""
        with self._lock:
            found = None
            for reply in self._replies:
                if reply.operation in ("*", operation) and reply.match in text and reply.times:
                    if reply.after:
                        reply.after -= 1
                        continue
                    reply.times -= 1
                    self.had[operation] += 1
                    found = reply
                    break
        if found is not None and found.seconds:
            time.sleep(found.seconds)
        return found

    def host_lost(self, job: Job, attempt: int) -> tuple[float, str | None] | None:
        """Return after how many seconds an attempt loses its host, and what Batch says then; None where it does not."""
        for host in self._hosts:
            if attempt in host.attempts and host.which(job):
                return host.seconds, host.reason
        return None

    def stuck(self, job: Job) -> tuple[bool, str | None]:
        """Return whether a job gets no host, and why."""
        for which, reason in self._stuck:
            if which(job):
                return True, reason
        return False, None
