"""Jobs, arrays and job definitions, and the states that they go through."""

import itertools
import threading
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

ACCOUNT = "123456789012"
STATES = ("SUBMITTED", "PENDING", "RUNNABLE", "STARTING", "RUNNING", "SUCCEEDED", "FAILED")
ENDED = ("SUCCEEDED", "FAILED")


def now() -> int:
    """Milliseconds, as AWS counts them."""
    return time.time_ns() // 1_000_000


@dataclass
class Definition:
    """A revision of a job definition."""

    arn: str
    name: str
    revision: int
    request: dict[str, Any]
    """As it was registered."""
    tags: dict[str, str]
    active: bool = True

    @property
    def task(self) -> dict[str, Any]:
        """Its one task."""
        properties: dict[str, Any] = self.request["ecsProperties"]["taskProperties"][0]
        return properties


@dataclass
class Queue:
    """A job queue with one compute environment."""

    name: str
    arn: str
    environment: str
    kind: str
    """Of the compute environment: EC2, SPOT, FARGATE, FARGATE_SPOT."""
    state: str = "ENABLED"
    status: str = "VALID"
    environment_state: str = "ENABLED"
    environment_status: str = "VALID"
    max_cpus: int = 256
    scheduling_policy: str | None = None
    tags: dict[str, str] = field(default_factory=dict)


@dataclass(eq=False)
class Job:
    """A job, an array of them, or a child of one."""

    id: str
    name: str
    queue: Queue
    definition: Definition
    arn: str
    overrides: dict[str, dict[str, Any]]
    """Of containers, by their names."""
    retry: dict[str, Any]
    timeout: int | None
    tags: dict[str, str]
    request: dict[str, Any]
    """As it was submitted."""
    created: int = field(default_factory=now)
    status: str = "SUBMITTED"
    reason: str | None = None
    started: int | None = None
    stopped: int | None = None
    parent: "Job | None" = None
    index: int | None = None
    children: "list[Job]" = field(default_factory=list)
    counts: "Counter[str]" = field(default_factory=Counter)
    """Of an array: how many of its children are in which state."""
    counted: int | None = None
    attempts: list[dict[str, Any]] = field(default_factory=list)
    containers: dict[str, dict[str, Any]] = field(default_factory=dict)
    """What the newest attempt's containers told: exitCode, reason, logStreamName."""
    task_arn: str | None = None
    terminated: str | None = None
    """Why, where someone wants it to end."""
    cancelled: bool = False
    unseen: int = 0
    """How many times DescribeJobs does not know it yet."""

    @property
    def ended(self) -> bool:
        return self.status in ENDED


class Jobs:
    """All that the service remembers; whoever touches it holds `lock`."""

    def __init__(self, region: str) -> None:
        self.region = region
        self.lock = threading.Condition(threading.RLock())
        self.queues: dict[str, Queue] = {}
        self.definitions: dict[str, list[Definition]] = {}
        self.jobs: dict[str, Job] = {}
        """Arrays and single jobs, in the order of their submission."""
        self._instances = itertools.count(1)

    def arn(self, kind: str, name: str) -> str:
        """Of something of this account and region."""
        return f"arn:aws:batch:{self.region}:{ACCOUNT}:{kind}/{name}"

    def find(self, job_id: str) -> Job | None:
        """Return a job, an array or a child."""
        parent_id, _, index = job_id.partition(":")
        job = self.jobs.get(parent_id)
        if job is None or not index:
            return job
        return job.children[int(index)] if index.isdigit() and int(index) < len(job.children) else None

    def queue(self, name: str) -> Queue | None:
        """Return a queue by its name or ARN."""
        return self.queues.get(name.removeprefix(self.arn("job-queue", "")))

    def definition(self, name: str) -> Definition | None:
        """Return a definition by ``name``, ``name:revision`` or an ARN of either; the newest active one of a name."""
        name = name.removeprefix(self.arn("job-definition", ""))
        name, _, revision = name.partition(":")
        for found in reversed(self.definitions.get(name, [])):
            if (str(found.revision) == revision) if revision else found.active:
                return found
        return None

    def every(self) -> Iterator[Job]:
        """Give each single job and child, without the arrays."""
        for job in list(self.jobs.values()):
            yield from job.children or [job]

    def add(self, job: Job, size: int | None) -> None:
        """Remember a job that was submitted, with as many children as it has; they may run."""
        with self.lock:
            self.jobs[job.id] = job
            if size is None:
                self.move(job, "RUNNABLE")
                return
            shared = {name: getattr(job, name) for name in ("name", "queue", "definition", "overrides", "retry")}
            shared |= {"timeout": job.timeout, "request": job.request, "tags": {}, "created": job.created}
            for index in range(size):
                own = f"{job.id}:{index}"
                child = Job(id=own, arn=self.arn("job", own), parent=job, index=index, **shared)
                child.status = "PENDING"
                job.children.append(child)
            job.counts["PENDING"] = size
            for child in job.children:
                self.move(child, "RUNNABLE")

    def move(self, job: Job, status: str, reason: str | None = None) -> None:
        """Bring a job into another state, and with it the array that it is of."""
        with self.lock:
            before, job.status = job.status, status
            if reason is not None:
                job.reason = reason
            if status == "RUNNING":
                job.started, job.stopped = now(), None
            elif status in ENDED and job.stopped is None:
                job.stopped = now()
            parent = job.parent
            if parent is not None:
                parent.counts[before] -= 1
                parent.counts[status] += 1
                parent.counted = now()
                if sum(parent.counts[state] for state in ENDED) == len(parent.children):
                    failed = parent.counts["FAILED"] > 0
                    self.move(parent, "FAILED" if failed else "SUCCEEDED", "Array Child Job failed" if failed else None)
                elif parent.status == "SUBMITTED":
                    parent.status = "PENDING"
            self.lock.notify_all()

    def new_id(self) -> str:
        """Return an id of a job."""
        return str(uuid.uuid4())

    def new_instance(self) -> str:
        """Return an id of a host."""
        return f"i-{next(self._instances):017x}"
