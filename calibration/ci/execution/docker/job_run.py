"""A job on the engine: started, supervised, stopped, its artifacts copied, and removed."""

import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue

from calibration.base import CalibrationError, InfrastructureError, one_line
from calibration.base.text import redact
from calibration.ci.docker_engine import Engine, EngineLostError, engine_errors
from calibration.ci.execution.docker.container_run import (
    DEFAULT_BRIDGE,
    STOP_SECONDS,
    ContainerRun,
    address_of,
    container_settings,
    copy_in,
    open_output,
    opener_of,
)
from calibration.ci.execution.docker.labels import CONTAINER_LABEL, JOB_LABEL, new_run
from calibration.ci.execution.docker.run_objects import Leftover, Network, Networks, remove
from calibration.ci.execution.job import Job
from calibration.ci.execution.job_check import start_order
from calibration.ci.execution.outcome import (
    ARTIFACTS_FOLDER,
    LOGS_FOLDER,
    ContainerOutcome,
    End,
    JobOutcome,
    Opener,
    make_job_folder,
    write_manifest,
)
from calibration.ci.execution.supervision import BeginWatch, Supervisor, is_running
from calibration.ci.workflow.streams import LogDisplay, LogFile

WATCH_LOG_NAME = "live_watch"
"""Name of the watch's log among those of the containers; no application has one with an underscore."""
_SECONDS_TO_STOP = STOP_SECONDS + 15
"""Seconds for a stopped container to end."""


class Interrupted(Exception):  # noqa: N818 (no error)
    """The run is being stopped, so the job's result is not needed."""


@dataclass(frozen=True)
class Run:
    """State shared by the jobs of a run."""

    name: str
    engine: Engine
    labels: dict[str, str]
    images: dict[str, str]
    """Image ids by name."""
    networks: Networks
    alone: bool
    """Whether the run has a single job."""
    show: LogDisplay | None = None
    watch: BeginWatch | None = None
    stopping: threading.Event = field(default_factory=threading.Event)


class JobRun(Supervisor[ContainerRun]):
    """Supervisor of a job, in its own thread."""

    def __init__(self, run: Run, job: Job, folder: Path) -> None:
        super().__init__(job, self._redact_reason)
        self._run = run
        self._folder = folder / job.name
        self._secrets = [c.environment[name] for c in job.containers for name in c.secrets]
        self._ends: SimpleQueue[ContainerRun] = SimpleQueue()
        self._network: Network | None = None
        self._volume: str | None = None
        self._lost = False
        """Whether the connection to the engine was lost."""

    def run(self) -> JobOutcome:
        """Run the job until it ends, and remove it; failures of the job are part of its outcome.

        Raises:
            Interrupted: the run is being stopped.
            InfrastructureError: a file cannot be written.
        """
        make_job_folder(self._folder)
        client = self._run.engine.client()
        self._api = client.api
        try:
            with ExitStack() as logs:
                self._open_logs(logs)
                try:
                    self._to_its_end()
                except EngineLostError as error:
                    self._lost = True
                    self.judge.fail(_with_advice(error, self._run), error.exit_code)
                except CalibrationError as error:
                    self.judge.fail(str(error), error.exit_code)
                finally:
                    self._remove_objects()
        finally:
            client.close()
        if self._run.stopping.is_set():
            raise Interrupted
        outcome = JobOutcome(
            job=self.job.name,
            folder=self._folder,
            containers=tuple(container.outcome() for container in self.containers),
            artifacts=tuple(self.artifacts),
            left_out=tuple(self.left_out),
            reasons=tuple(self.judge.reasons),
            exit_code=self.judge.exit_code,
            seconds=time.monotonic() - self.judge.began,
        )
        write_manifest(outcome, self._run.name)
        return outcome

    # --- from start to end

    def _open_logs(self, logs: ExitStack) -> None:
        """Open the logs, in the order in which the containers start."""
        for container in start_order(self.job):
            pattern = container.readiness.log if container.readiness else None
            log = self._open_log(logs, container.name, container.essential, pattern)
            image = self._run.images[container.image]
            self.containers.append(ContainerRun(container, self._run.engine, image, log))
        if self._run.watch is not None:
            self._watch_log = self._open_log(logs, WATCH_LOG_NAME, True)

    def _open_log(self, logs: ExitStack, name: str, live: bool, pattern: str | None = None) -> LogFile:
        show = None
        if self._run.show is not None:
            stream = self._run.show.open(f"{self.job.name}/{name}", live=live)
            logs.callback(stream.close)
            show = stream.line
        path = self._folder / LOGS_FOLDER / f"{name}.log"
        return logs.enter_context(LogFile(path, self._secrets, show, pattern))

    def _to_its_end(self) -> None:
        self._go_on()
        with engine_errors():
            self._volume = f"calibration-{self._run.name}-{new_run()}"
            self._api.create_volume(self._volume, labels=self._labels_of_job())
        self._network = self._choose_network()
        if self._run.watch is not None:
            self.watch = self._run.watch(self._addresses, self._note_of_watch)
        self.supervise(self._folder / ARTIFACTS_FOLDER)

    def _choose_network(self) -> Network | None:
        """Create or choose the network; None for a network that the engine already has."""
        internal = self.job.network == "internal"
        if self._network_mode != DEFAULT_BRIDGE:
            return None
        if len(self.job.containers) > 1 or self.job.own_network:
            return self._run.networks.take(self._api, internal)
        if self._run.alone and not internal:
            return None
        return self._run.networks.shared(self._api, internal)

    @property
    def _network_mode(self) -> str:
        """Network mode of the engine, if no network is created."""
        return self.job.network if self.job.network in ("host", "none") else DEFAULT_BRIDGE

    def _start(self, container: ContainerRun) -> None:
        api, run = self._api, container
        labels = {**self._labels_of_job(), CONTAINER_LABEL: run.name}
        binds = self._run.engine.local
        with engine_errors(f"container '{run.name}'"):
            network = self._network or self._network_mode
            settings = container_settings(api, run.container, network, str(self._volume), labels, binds)
            first = all(not other.id for other in self.containers)
            identifier = run.create(api, self._container_name(run.name), settings)
            if first:
                open_output(api, identifier)
            if not binds:
                copy_in(api, identifier, run.container.mounts)
            self._go_on()
            run.start(api, self._ends, self.job.network == "host")

    def _wait(self, seconds: float | None) -> None:
        """Wait for the end of a container; afterwards the ends of all ended containers are known."""
        with suppress(Empty):
            self._ends.get(timeout=seconds)

    # --- after the end

    def _stop(self, running: Sequence[ContainerRun]) -> None:
        """Stop running containers concurrently, and wait until they have ended."""
        if self._run.stopping.is_set():
            return  # removing the containers kills them
        threads = [threading.Thread(target=self._stop_one, args=(c,), daemon=True) for c in running]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(_SECONDS_TO_STOP)
        for container in self.containers:
            container.join(_SECONDS_TO_STOP)

    def _stop_one(self, container: ContainerRun) -> None:
        client = self._run.engine.client(_SECONDS_TO_STOP)
        try:
            with engine_errors():
                client.api.stop(container.id, timeout=STOP_SECONDS)
        except CalibrationError:
            pass  # a lost engine is reported when the container's end is read
        finally:
            client.close()

    def _read_end(self, container: ContainerRun, ours: End | None) -> None:
        container.read_end(self._api, ours)

    def _opener(self, container: ContainerRun) -> Opener:
        return opener_of(self._api, container.id, container.name)

    def _remove_objects(self) -> None:
        """Remove all objects of the job; the run retries failed removals at its end."""
        if self._lost:
            return
        with suppress(InfrastructureError):
            remove(self._api, [Leftover.of("container", c.id) for c in self.containers if c.id])
            for container in self.containers:
                container.join(_SECONDS_TO_STOP)
            if self._network is not None:
                self._run.networks.give_back(self._network)
            if self._volume is not None:
                remove(self._api, [Leftover.of("volume", self._volume)])

    # --- helpers

    def _go_on(self) -> None:
        if self._run.stopping.is_set():
            raise Interrupted

    def _redact_reason(self, reason: str) -> str:
        return one_line(redact(reason, self._secrets))

    def _note_of_watch(self, line: str) -> None:
        with suppress(InfrastructureError):  # a full disk, which the containers' own logs report
            self._watch_log.feed(f"{one_line(line)}\n".encode())

    def _addresses(self) -> list[str]:
        """Return the addresses of the running containers; called in the watch's thread, so with its own client."""
        if self.job.network == "host":
            return ["127.0.0.1"]
        client = self._run.engine.client()
        try:
            with engine_errors():
                found = [address_of(client.api, c.id) for c in self.containers if is_running(c)]
        except CalibrationError:
            return []  # one has just ended, or the engine is lost, which the job's thread reports
        finally:
            client.close()
        return list(filter(None, found))

    def _labels_of_job(self) -> dict[str, str]:
        return {**self._run.labels, JOB_LABEL: self.job.name}

    def _container_name(self, container: str) -> str:
        safe = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "-" for c in self.job.name)
        return f"calibration-{self._run.name}-{safe[:60]}-{container}"


def lost_job(run: Run, job: Job, folder: Path, error: EngineLostError) -> JobOutcome:
    """Return the outcome of a job that was given up because the engine is lost."""
    containers = tuple(ContainerOutcome(container.name, End.LOST) for container in job.containers)
    reasons = (_with_advice(error, run),)
    return JobOutcome(job.name, folder / job.name, containers, reasons=reasons, exit_code=error.exit_code)


def _with_advice(error: EngineLostError, run: Run) -> str:
    return f"{error}; to remove what is left of this run: calibration cleanup --run {run.name}"
