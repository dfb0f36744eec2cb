"""Backend that runs concurrent jobs in containers of a Docker Engine, and removes everything afterwards.

Jobs start in order, as soon as the machine has free resources.
"""

import threading
import time
from collections.abc import Generator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Self

from calibration.base import CalibrationError, InfrastructureError
from calibration.ci.docker_engine import EngineLostError, engine_errors, find_engine, find_images, lost
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.execution.docker.job_run import Interrupted, JobRun, Run, lost_job
from calibration.ci.execution.docker.labels import RUN_LABEL, Owner, check_run_name, new_run
from calibration.ci.execution.docker.run_objects import Networks, counts_of, find_leftovers, remove, remove_of_dead_runs
from calibration.ci.execution.job import Job
from calibration.ci.execution.job_check import check_jobs
from calibration.ci.execution.outcome import JobOutcome
from calibration.ci.execution.supervision import BeginWatch
from calibration.ci.workflow.streams import LogDisplay


@dataclass(frozen=True)
class Need:
    """Resources that a job needs while it runs."""

    cores: float
    memory: int
    """Bytes; 0 if not specified."""

    @classmethod
    def of(cls, job: Job) -> Self:
        """Return the sum of a job's container limits; one core if no container has a limit."""
        limits = [container.limits for container in job.containers]
        return cls(sum(limit.cpus or 0.0 for limit in limits) or 1.0, sum(limit.memory or 0 for limit in limits))


class Admission:
    """Schedules the start of jobs. Thread-safe.

    A job that needs more than the whole machine starts when no other job runs: a limit is not its actual use.
    """

    def __init__(self, needs: Sequence[Need], cores: float, memory: int, workers: int | None = None) -> None:
        """Create a scheduler.

        Args:
            needs: needs of the jobs, in order.
            cores: cores of the machine; ignored if ``workers`` is given.
            memory: memory of the machine, bytes; 0 if unknown.
            workers: maximum number of concurrent jobs.
        """
        self._needs = needs
        self._cores = float("inf") if workers is not None else cores
        self._memory = memory or float("inf")
        self._most = workers or len(needs)
        self._next = 0
        self._running: set[int] = set()
        self._stopped = False
        self._changed = threading.Condition()

    def wait(self) -> int | None:
        """Wait for the next job that may start, and return its index; None after the last one, or when stopped."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or self._next >= len(self._needs) or self._next_job_fits())
            if self._stopped or self._next >= len(self._needs):
                return None
            index = self._next
            self._next += 1
            self._running.add(index)
            self._changed.notify_all()
            return index

    def release(self, index: int) -> None:
        """Report that a job has ended."""
        with self._changed:
            self._running.discard(index)
            self._changed.notify_all()

    def stop(self) -> None:
        """Prevent further jobs from starting."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def _next_job_fits(self) -> bool:
        if not self._running:
            return True
        needs = [self._needs[index] for index in (*self._running, self._next)]
        return (
            len(needs) <= self._most
            and sum(need.cores for need in needs) <= self._cores
            and sum(need.memory for need in needs) <= self._memory
        )


_MOST_THREADS = 64
_POLL_SECONDS = 5
"""Interval of checks whether the engine still answers, seconds."""
_SECONDS_WITHOUT_ANSWER = 15.0
"""Seconds without an answer of the engine after which jobs are given up."""
_SECONDS_TO_END_JOBS = 10.0
"""Seconds for the jobs of a stopped run to end."""


@dataclass(frozen=True)
class _Answer:
    """Result of a job, from its thread."""

    index: int
    outcome: JobOutcome | BaseException


class DockerBackend:
    """A Docker Engine as a backend; a context manager, which removes everything from it.

    Each job has its own thread and client. The thread that reads the outcomes can be
    interrupted at any time.
    """

    def __init__(self, run: str | None = None, show: LogDisplay | None = None, watch: BeginWatch | None = None) -> None:
        """Choose an engine, without a request.

        Args:
            run: name of the run, used in labels of everything that is started; None for a new one.
            show: display for the containers' logs.
            watch: watch of each job.

        Raises:
            InputError: the name is invalid in names of containers.
        """
        self.run_name = run if run is not None else new_run()
        check_run_name(self.run_name)
        self._show = show
        self._watch = watch
        self._labels = {RUN_LABEL: self.run_name, **Owner.this_process().labels}
        self._networks = Networks(self.run_name, self._labels)
        self._threads: list[threading.Thread] = []
        """Threads that run jobs."""

    def __enter__(self) -> Self:
        """Connect to the engine, and remove what killed runs of this machine have left on it.

        Raises:
            InfrastructureError: no engine answers.
        """
        self._engine = find_engine()
        self._client = self._engine.client()
        self._remove_leftovers()
        return self

    def _remove_leftovers(self) -> None:
        """Remove what killed runs have left; what cannot be removed is named, and no reason not to run."""
        try:
            removed = remove_of_dead_runs(self._client.api)
            said = f"{counts_of(removed)} of a killed run removed" if removed else ""
        except InfrastructureError as error:
            said = f"of a killed run: {error}"
        if said and self._show is not None:
            self._show.note(said)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Remove remaining objects, such as the networks.

        Raises:
            InfrastructureError: something cannot be removed, and there is no other error.
        """
        try:
            try:
                self._leave_nothing()
            except KeyboardInterrupt:  # further signals: SIGTERM is ignored from here
                self._leave_nothing()
                raise
        except CalibrationError as problem:
            if error is None and not isinstance(problem, EngineLostError):  # outcomes already report a lost engine
                raise
        finally:
            self._client.close()

    def run(self, jobs: Sequence[Job], folder: Path, workers: int | None = None) -> Generator[tuple[int, JobOutcome]]:
        """Run jobs; yield index and outcome of each, in the order of completion.

        Invalid jobs raise an error in this call; nothing is started before the first outcome is requested.
        Closing the iterator, or any exception, stops and removes everything.

        Args:
            jobs: started in order.
            folder: each job has a subfolder with its name: ``artifacts/``, ``logs/`` and ``manifest.json``;
                those of an earlier run are removed.
            workers: number of concurrent jobs, regardless of cores; None for as many as cores and memory allow.

        Raises:
            InputError: a job is invalid, or an image is missing.
            InfrastructureError: the engine or a registry cannot be reached.
        """
        check_jobs(jobs, workers)
        images = find_images(self._client.api, (c.image for job in jobs for c in job.containers))
        run = Run(
            name=self.run_name,
            engine=self._engine,
            labels=self._labels,
            images=images,
            networks=self._networks,
            alone=len(jobs) == 1,
            show=self._show,
            watch=self._watch,
        )
        return self._yield_outcomes(run, jobs, folder, workers)

    def _yield_outcomes(
        self, run: Run, jobs: Sequence[Job], folder: Path, workers: int | None
    ) -> Generator[tuple[int, JobOutcome]]:
        needs = [Need.of(job) for job in jobs]
        admission = Admission(needs, self._engine.cores, self._engine.memory, workers)
        # A queue, because a signal may interrupt waiting on it: no thread holds a lock meanwhile.
        answers: SimpleQueue[_Answer] = SimpleQueue()
        count = min(len(jobs), workers or _MOST_THREADS)
        threads = [
            threading.Thread(target=_run_admitted_jobs, args=(run, jobs, folder, admission, answers), daemon=True)
            for _ in range(count)
        ]
        self._threads = threads
        left = set(range(len(jobs)))
        try:
            for thread in threads:
                thread.start()
            while left:
                try:
                    answer = self._next_answer(answers)
                except EngineLostError as error:  # the threads wait for answers that will not come
                    admission.stop()
                    for index in sorted(left):
                        yield from self._yield_while_paused(index, lost_job(run, jobs[index], folder, error))
                    left.clear()
                    break
                if not isinstance(answer.outcome, JobOutcome):
                    raise answer.outcome
                left.discard(answer.index)
                yield from self._yield_while_paused(answer.index, answer.outcome)
        finally:
            admission.stop()
            if left:
                run.stopping.set()
                with suppress(CalibrationError):  # __exit__ tries again, and reports errors
                    self._leave_nothing()
                self._networks = Networks(self.run_name, self._labels)  # the old networks are removed

    def _yield_while_paused(self, index: int, outcome: JobOutcome) -> Generator[tuple[int, JobOutcome]]:
        """Yield an outcome while logs are paused, so that the consumer can print."""
        with self._show.paused() if self._show is not None else nullcontext():
            yield index, outcome

    def _next_answer(self, answers: "SimpleQueue[_Answer]") -> _Answer:
        """Wait for the next result while the engine answers.

        Raises:
            EngineLostError: it has not answered for a while.
        """
        silent_since: float | None = None
        while True:
            try:
                return answers.get(timeout=_POLL_SECONDS)
            except Empty:
                pass
            try:
                self._ping_engine()
            except EngineLostError as error:
                # the threads detect a lost engine themselves, unless it keeps connections open without answering
                silent_since = silent_since or time.monotonic()
                if time.monotonic() - silent_since > _SECONDS_WITHOUT_ANSWER:
                    raise error
            else:
                silent_since = None

    def _ping_engine(self) -> None:
        """Send a ping to the engine.

        Raises:
            EngineLostError: it does not answer.
        """
        client = self._engine.client(_POLL_SECONDS)
        try:
            with engine_errors():
                client.ping()
        except EngineLostError:
            raise
        except CalibrationError as error:
            raise lost(error) from None
        finally:
            client.close()

    def _stop_jobs(self, threads: Sequence[threading.Thread]) -> None:
        """End all jobs at once by removing their containers, for which their threads wait."""
        deadline = time.monotonic() + _SECONDS_TO_END_JOBS
        while any(thread.is_alive() for thread in threads) and time.monotonic() < deadline:
            try:
                self._remove_objects(containers_only=True)
            except EngineLostError:
                break
            except InfrastructureError:
                pass  # removed concurrently by a thread
            for thread in threads:
                thread.join(0.2 / len(threads))

    def _leave_nothing(self) -> None:
        """End remaining jobs, also after an interrupted clean-up, and remove everything.

        Raises:
            InfrastructureError: something cannot be removed, or the engine does not answer.
        """
        self._stop_jobs([thread for thread in self._threads if thread.is_alive()])
        self._remove_objects()

    def _remove_objects(self, containers_only: bool = False) -> None:
        """Remove all objects of the run from the engine.

        Raises:
            InfrastructureError: something cannot be removed, or the engine does not answer.
        """
        self._ping_engine()  # fail fast if the engine does not answer
        leftovers = find_leftovers(self._client.api, self.run_name)
        remove(self._client.api, [each for each in leftovers if not containers_only or each.kind == "container"])


def open_docker(target: ExecutionTarget) -> DockerBackend:
    """Create the backend of an execution target.

    Raises:
        InputError: the name of the run is invalid in names of containers.
    """
    return DockerBackend(target.run, target.show, target.watch)


def _run_admitted_jobs(
    run: Run, jobs: Sequence[Job], folder: Path, admission: Admission, answers: "SimpleQueue[_Answer]"
) -> None:
    """Run one job after the other, in a thread."""
    while (index := admission.wait()) is not None:
        try:
            answers.put(_Answer(index, JobRun(run, jobs[index], folder).run()))
        except Interrupted:
            return
        except BaseException as error:  # any exception is passed to the reader
            answers.put(_Answer(index, error))
            return
        finally:
            admission.release(index)
