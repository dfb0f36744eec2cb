"""One attempt of a job: what it is to run, when it has to stop, and how it ended."""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from .jobs import ACCOUNT, Job, Jobs, now


@dataclass(frozen=True)
class ContainerEnd:
    """How a container ended."""

    code: int | None
    """None where nobody knows, or it never started."""
    reason: str | None = None


@dataclass(frozen=True)
class Ended:
    """How an attempt ended."""

    containers: Mapping[str, ContainerEnd]
    reason: str = "Essential container in task exited"
    started: bool = True
    """Whether containers ran: else it failed in STARTING."""
    host_lost: bool = False
    seconds: float | None = None
    """How long it claims to have run; None for as long as it did."""


@dataclass(frozen=True)
class Cause:
    """Why an attempt has to stop."""

    kind: Literal["terminated", "timeout", "host", "closed"]
    reason: str


class Attempt:
    """One attempt of a job."""

    def __init__(
        self, jobs: Jobs, job: Job, number: int, lost: tuple[float, str | None] | None, time_scale: float
    ) -> None:
        self.job = job
        self.number = number
        """From 1, as ``AWS_BATCH_JOB_ATTEMPT``."""
        self.time_scale = time_scale
        """How long one of Batch's seconds is."""
        self.task_id = jobs.new_id().replace("-", "")
        self.stop = threading.Event()
        self.cause: Cause | None = None
        self.deadline: float | None = None
        self.lost_at: float | None = None
        self._jobs = jobs
        self.lost_after = lost[0] if lost else None
        """Seconds after its start at which it loses its host."""
        self.lost_reason = lost[1] if lost else None
        self.containers = [self._merged(container) for container in job.definition.task["containers"]]
        """As the definition has them, with what was overridden when the job was submitted."""

    def _merged(self, container: dict[str, Any]) -> dict[str, Any]:
        override = self.job.overrides.get(container["name"], {})
        merged = {**container, **{name: value for name, value in override.items() if name == "command"}}
        for key, name in (("environment", "name"), ("resourceRequirements", "type")):
            values = {each[name]: each for each in container.get(key, [])}
            values |= {each[name]: each for each in override.get(key, [])}
            merged[key] = list(values.values())
        return merged

    @property
    def index(self) -> int | None:
        """Of the child, where it is one: ``AWS_BATCH_JOB_ARRAY_INDEX``."""
        return self.job.index

    @property
    def task(self) -> dict[str, Any]:
        """The definition's task."""
        return self.job.definition.task

    def container(self, name: str) -> dict[str, Any]:
        """Return one of the containers."""
        return next(container for container in self.containers if container["name"] == name)

    def environment(self, name: str) -> dict[str, str]:
        """Return the variables of a container, Batch's own among them; those from secrets are not."""
        variables = {each["name"]: each.get("value", "") for each in self.container(name)["environment"]}
        variables |= {
            "AWS_BATCH_JOB_ID": self.job.id,
            "AWS_BATCH_JOB_ATTEMPT": str(self.number),
            "AWS_BATCH_JQ_NAME": self.job.queue.name,
            "AWS_BATCH_CE_NAME": self.job.queue.environment,
        }
        if self.job.parent is not None:
            variables["AWS_BATCH_JOB_ARRAY_INDEX"] = str(self.index)
            variables["AWS_BATCH_JOB_ARRAY_SIZE"] = str(len(self.job.parent.children))
        return variables

    def log_stream(self, name: str) -> tuple[str, str]:
        """Return the group and the stream of a container's log."""
        options = self.container(name).get("logConfiguration", {}).get("options", {})
        prefix = options.get("awslogs-stream-prefix", self.job.definition.name)
        return options.get("awslogs-group", "/aws/batch/job"), f"{prefix}/{name}/{self.task_id}"

    def starts(self, name: str) -> None:
        """A container has started: it has a log."""
        with self._jobs.lock:
            self.job.containers[name] = {"logStreamName": self.log_stream(name)[1]}

    def runs(self) -> None:
        """The essential containers have started: the job is RUNNING, and its time counts."""
        with self._jobs.lock:
            if self.job.timeout is not None:
                self.deadline = time.monotonic() + self.job.timeout * self.time_scale
            if self.lost_after is not None:
                self.lost_at = time.monotonic() + self.lost_after
            cluster = f"{self.job.queue.environment}_Batch"
            self.job.task_arn = f"arn:aws:ecs:{self._jobs.region}:{ACCOUNT}:task/{cluster}/{self.task_id}"
            self._jobs.move(self.job, "RUNNING")

    def end(self, cause: Cause) -> None:
        """Make it stop; the first cause counts."""
        with self._jobs.lock:
            if self.cause is None:
                self.cause = cause
                self.stop.set()

    def record(self, ended: Ended, reason: str) -> dict[str, Any]:
        """Return the attempt as DescribeJobs tells it, and write the same into the job."""
        job = self.job
        for name, end in ended.containers.items():
            told: dict[str, Any] = job.containers.setdefault(name, {})
            if end.code is not None and not ended.host_lost:
                told["exitCode"] = end.code
            if end.reason:
                told["reason"] = end.reason[:255]
        record: dict[str, Any] = {"container": {}, "statusReason": reason}
        if ended.started:
            assert job.started is not None
            job.stopped = now() if ended.seconds is None else job.started + round(ended.seconds * 1000)
            record |= {"startedAt": job.started, "stoppedAt": job.stopped}
        containers = [
            {"name": each["name"], "networkInterfaces": [], **job.containers.get(each["name"], {})}
            for each in self.containers
        ]
        record["taskProperties"] = [{"containers": containers}]
        if job.task_arn is not None:
            record["taskProperties"][0]["taskArn"] = job.task_arn
        return record


class Runner(Protocol):
    """What runs attempts."""

    def run(self, attempt: Attempt) -> Ended:
        """Run one to its end; calls ``attempt.runs`` when its containers run, and looks at ``attempt.stop``."""
        ...

    def close(self) -> None:
        """Remove what is left."""
        ...
