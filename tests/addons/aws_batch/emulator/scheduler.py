"""Gives jobs a host, one attempt after the other, and says how they ended."""

import threading
import time
from collections import deque
from typing import Any

from .attempt import Attempt, Cause, ContainerEnd, Ended, Runner
from .faults import Faults
from .jobs import Job, Jobs

TIMED_OUT = "Job attempt duration exceeded timeout"


class Scheduler:
    """So many hosts, each with one task at a time."""

    def __init__(self, jobs: Jobs, faults: Faults, runner: Runner, hosts: int, time_scale: float) -> None:
        self.runner = runner
        self.most_at_once = 0
        self._jobs, self._faults, self._time_scale = jobs, faults, time_scale
        self._waiting: deque[Job] = deque()
        self._running: dict[Job, Attempt] = {}
        self._closing = False
        self.errors: list[str] = []
        """Exceptions in the emulator's own code, or in the test's function."""
        self._threads = [threading.Thread(target=self._host, daemon=True) for _ in range(hosts)]
        self._threads.append(threading.Thread(target=self._clock, daemon=True))
        for thread in self._threads:
            thread.start()

    def add(self, job: Job) -> None:
        """Let a job, or the children of an array, wait for hosts."""
        with self._jobs.lock:
            self._waiting.extend(job.children or [job])
            self._jobs.lock.notify_all()

    def terminate(self, job: Job, reason: str) -> None:
        """End a job, wherever it is; an array with all its children."""
        with self._jobs.lock:
            for each in job.children or [job]:
                if each.ended:
                    continue
                each.terminated = each.terminated or reason
                if each in self._running:
                    self._running[each].end(Cause("terminated", each.terminated))
                else:
                    self._jobs.move(each, "FAILED", each.terminated)
            if job.children and not job.ended:
                job.terminated = job.terminated or reason

    def cancel(self, job: Job, reason: str) -> None:
        """End a job that has not begun to start."""
        with self._jobs.lock:
            for each in job.children or [job]:
                if each.status in ("SUBMITTED", "PENDING", "RUNNABLE"):
                    each.cancelled = True
                    self._jobs.move(each, "FAILED", reason)

    def close(self) -> None:
        """End all that runs; nothing runs afterwards."""
        with self._jobs.lock:
            self._closing = True
            for attempt in self._running.values():
                attempt.end(Cause("closed", "the emulator is closed"))
            self._jobs.lock.notify_all()
        for thread in self._threads:
            thread.join(60)
        self.runner.close()

    def _next(self) -> Attempt | None:
        """Wait for a job that may start; None at the end."""
        with self._jobs.lock:
            while not self._closing:
                for _ in range(len(self._waiting)):
                    job = self._waiting.popleft()
                    if job.status != "RUNNABLE":
                        continue
                    stuck, job.reason = self._faults.stuck(job)
                    if stuck:
                        self._waiting.append(job)
                        continue
                    number = len(job.attempts) + 1
                    attempt = Attempt(self._jobs, job, number, self._faults.host_lost(job, number), self._time_scale)
                    self._running[job] = attempt
                    self.most_at_once = max(self.most_at_once, len(self._running))
                    self._jobs.move(job, "STARTING")
                    return attempt
                self._jobs.lock.wait(0.1 if self._waiting else None)
        return None

    def _host(self) -> None:
        while (attempt := self._next()) is not None:
            try:
                ended = self.runner.run(attempt)
            except Exception as error:  # a mistake in the test's function, or in the emulator: the test has to see it
                self.errors.append(f"{type(error).__name__}: {error}")
                ended = Ended({}, started=attempt.job.status == "RUNNING", reason=f"emulator: {error}")
            self._settle(attempt, ended)

    def _clock(self) -> None:
        """End attempts whose time is over, or whose host is."""
        while not self._closing:
            with self._jobs.lock:
                current = time.monotonic()
                for attempt in self._running.values():
                    if attempt.deadline is not None and current > attempt.deadline:
                        attempt.end(Cause("timeout", TIMED_OUT))
                    if attempt.lost_at is not None and current > attempt.lost_at:
                        attempt.end(self._lost(attempt))
            time.sleep(0.02)

    def _lost(self, attempt: Attempt) -> Cause:
        return Cause("host", attempt.lost_reason or f"Host EC2 (instance {self._jobs.new_instance()}) terminated.")

    def _settle(self, attempt: Attempt, ended: Ended) -> None:
        job = attempt.job
        with self._jobs.lock:
            del self._running[job]
            if ended.host_lost:
                attempt.end(self._lost(attempt))
            cause = attempt.cause
            if cause is not None and cause.kind == "host":
                ended = Ended(
                    {each["name"]: ContainerEnd(None) for each in attempt.containers},
                    cause.reason,
                    host_lost=True,
                    seconds=ended.seconds,
                )
            reason = cause.reason if cause is not None else ended.reason
            if job.status == "STARTING" and ended.started:
                ended = Ended(ended.containers, ended.reason, started=False, host_lost=ended.host_lost)
            job.attempts.append(attempt.record(ended, reason))
            if cause is None and ended.started and self._succeeded(attempt, ended):
                self._jobs.move(job, "SUCCEEDED", reason)
            elif (cause is None or cause.kind == "host") and job.terminated is None and retried(job, ended, reason):
                job.containers, job.task_arn = {}, None
                self._jobs.move(job, "RUNNABLE")
                self._waiting.append(job)
            else:
                self._jobs.move(job, "FAILED", reason)

    def _succeeded(self, attempt: Attempt, ended: Ended) -> bool:
        essential = [each["name"] for each in attempt.containers if each.get("essential", True)]
        return all(ended.containers.get(name, ContainerEnd(None)).code == 0 for name in essential)


def retried(job: Job, ended: Ended, reason: str) -> bool:
    """Whether a failed attempt is followed by another: the first condition that fits decides; none fits: it is."""
    if len(job.attempts) >= int(job.retry.get("attempts", 1)):
        return False
    essential = [each["name"] for each in job.definition.task["containers"] if each.get("essential", True)]
    ends = [ended.containers.get(name, ContainerEnd(None)) for name in essential]
    failed = next((end for end in ends if end.code), ends[0])
    told = {
        "onStatusReason": reason,
        "onReason": failed.reason or "",
        "onExitCode": "" if failed.code is None else str(failed.code),
    }
    for condition in job.retry.get("evaluateOnExit", []):
        if all(_fits(condition[key], told[key]) for key in told if key in condition):
            return bool(condition["action"].upper() == "RETRY")
    return True


def _fits(pattern: Any, text: str) -> bool:
    """Whether a text is what a pattern says; a star may stand at its end only."""
    if pattern.endswith("*"):
        return text.startswith(pattern[:-1])
    return bool(text == pattern)
