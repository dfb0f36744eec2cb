"""One job on the engine: started, watched, stopped, brought out, removed."""

import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from calibration.docker.engine import Engine, EngineLostError, engine_errors
from calibration.errors import CalibrationError, ExitCode, WorldError
from calibration.execution.bringing_out import BringingOut, complete_or_not_at_all
from calibration.execution.docker.archive import opener_of
from calibration.execution.docker.container_run import GRACE, ContainerRun
from calibration.execution.docker.copying import copy_in, open_output
from calibration.execution.docker.labels import CONTAINER, JOB, new_run
from calibration.execution.docker.leftovers import Leftover, remove
from calibration.execution.docker.networks import Network, Networks
from calibration.execution.docker.settings import DEFAULT_BRIDGE, container_settings
from calibration.execution.extraction import Budget
from calibration.execution.job import Job
from calibration.execution.job_check import start_order
from calibration.execution.job_folder import ARTIFACTS, LOGS, make_job_folder
from calibration.execution.judging import Judge, is_running
from calibration.execution.log_file import LogFile
from calibration.execution.manifest import write_manifest
from calibration.execution.outcome import BroughtOut, ContainerOutcome, End, JobOutcome
from calibration.workflow.masks import redact
from calibration.workflow.streams import LogDisplay
from calibration.workflow.text import one_line

if TYPE_CHECKING:
    from docker import APIClient

_LOOKING = 0.25
"""Seconds between two looks at whether a container is ready."""
_SETTLING = GRACE + 15
"""Seconds in which a container that was stopped ends."""


class Interrupted(Exception):  # noqa: N818 (no error)
    """The run is being stopped: nothing more of the job matters."""


@dataclass(frozen=True)
class Run:
    """What the jobs of a run share."""

    name: str
    engine: Engine
    labels: dict[str, str]
    images: dict[str, str]
    """The id of each image."""
    networks: Networks
    alone: bool
    """Whether there is but one job."""
    show: LogDisplay | None = None
    stopping: threading.Event = field(default_factory=threading.Event)


class JobRun:
    """A job that runs, in a thread of its own."""

    def __init__(self, run: Run, job: Job, folder: Path) -> None:
        self._run = run
        self._job = job
        self._folder = folder / job.name
        self._secrets = [c.environment[name] for c in job.containers for name in c.secrets]
        self._containers: list[ContainerRun] = []
        self._ends: SimpleQueue[ContainerRun] = SimpleQueue()
        self._network: Network | None = None
        self._volume: str | None = None
        self._judge = Judge(job, self._clean)
        self._artifacts: list[BroughtOut] = []
        self._left_out: list[str] = []
        self._lost = False
        """Whether the engine went away."""

    def run(self) -> JobOutcome:
        """Run it to its end; whatever goes wrong with it is its outcome, and nothing of it is left.

        Raises:
            Interrupted: the run is being stopped.
            WorldError: a file of ours cannot be written.
        """
        make_job_folder(self._folder)
        client = self._run.engine.client()
        try:
            with ExitStack() as logs:
                self._prepare(logs)
                try:
                    self._to_its_end(client.api)
                except EngineLostError as error:
                    self._lost = True
                    self._judge.fail(_with_advice(error, self._run), error.exit_code)
                except CalibrationError as error:
                    self._judge.fail(str(error), error.exit_code)
                finally:
                    self._remove(client.api)
        finally:
            client.close()
        if self._run.stopping.is_set():
            raise Interrupted
        outcome = JobOutcome(
            job=self._job.name,
            folder=self._folder,
            containers=tuple(container.outcome() for container in self._containers),
            artifacts=tuple(self._artifacts),
            left_out=tuple(self._left_out),
            reasons=tuple(self._judge.reasons),
            exit_code=self._judge.exit_code,
            seconds=time.monotonic() - self._judge.began,
        )
        write_manifest(outcome, self._run.name)
        return outcome

    # --- from beginning to end

    def _prepare(self, logs: ExitStack) -> None:
        """Open the logs, in the order in which the containers start."""
        for container in start_order(self._job):
            show = None
            if self._run.show is not None:
                title = f"{self._job.name}/{container.name}"
                stream = self._run.show.open(title, live=container.essential)
                logs.callback(stream.close)
                show = stream.line
            pattern = container.readiness.log if container.readiness else None
            path = self._folder / LOGS / f"{container.name}.log"
            log = logs.enter_context(LogFile(path, self._secrets, show, pattern))
            image = self._run.images[container.image]
            self._containers.append(ContainerRun(container, self._run.engine, image, log))

    def _to_its_end(self, api: "APIClient") -> None:
        self._go_on()
        with engine_errors():
            self._volume = f"calibration-{self._run.name}-{new_run()}"
            api.create_volume(self._volume, labels=self._labels())
        self._network = self._choose_network(api)
        try:
            self._watch(api)
        finally:
            self._stop_all()
            self._go_on()
        self._read_ends(api)
        self._judge.judge(self._containers)
        self._bring_out(api)

    def _choose_network(self, api: "APIClient") -> Network | None:
        """The network that has to be made; None where the engine has it already."""
        internal = self._job.network == "internal"
        if self._network_mode != DEFAULT_BRIDGE:
            return None
        if len(self._job.containers) > 1 or self._job.own_network:
            return self._run.networks.take(api, internal)
        if self._run.alone and not internal:
            return None
        return self._run.networks.shared(api, internal)

    @property
    def _network_mode(self) -> str:
        """What the engine is told where no network is made."""
        return self._job.network if self._job.network in ("host", "none") else DEFAULT_BRIDGE

    def _watch(self, api: "APIClient") -> None:
        """Start the containers, and wait until one ends the job, or its time has run out."""
        waiting = list(self._containers)
        while True:
            self._go_on()
            self._start_those_that_may(api, waiting)
            if self._judge.is_over(self._containers, waiting):
                return
            unready = [c for c in self._containers if is_running(c) and not c.ready]
            for container in unready:
                if container.is_ready():
                    break  # whoever waits for it starts at once
            else:
                left = self._judge.seconds_left(self._containers)
                self._wait(min([*left, *([_LOOKING] if unready else [])], default=None))

    def _start_those_that_may(self, api: "APIClient", waiting: list[ContainerRun]) -> None:
        by_name = {c.name: c for c in self._containers}
        for container in list(waiting):
            if all(by_name[name].ready for name in container.container.after):
                self._go_on()
                self._start(api, container)
                waiting.remove(container)

    def _start(self, api: "APIClient", run: ContainerRun) -> None:
        labels = {**self._labels(), CONTAINER: run.name}
        binds = self._run.engine.local
        with engine_errors(f"container '{run.name}'"):
            network = self._network or self._network_mode
            settings = container_settings(api, run.container, network, str(self._volume), labels, binds)
            first = all(other.id is None for other in self._containers)
            identifier = run.create(api, self._prefix(run.name), settings)
            if first:
                open_output(api, identifier)
            if not binds:
                copy_in(api, identifier, run.container.mounts)
            self._go_on()
            run.start(api, self._ends, self._job.network == "host")

    def _wait(self, seconds: float | None) -> None:
        """Wait for the end of a container; the ends of all that have ended are known then."""
        with suppress(Empty):
            self._ends.get(timeout=None if seconds is None else max(0.0, seconds))

    # --- when it is over

    def _stop_all(self) -> None:
        """Ask all that run to end, at the same time, and wait until they have."""
        if self._run.stopping.is_set():
            return  # removing kills them
        running = [c for c in self._containers if is_running(c)]
        self._judge.stop(running)
        threads = [threading.Thread(target=self._stop, args=(c,), daemon=True) for c in running]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(_SETTLING)
        for container in self._containers:
            container.join(_SETTLING)

    def _stop(self, container: ContainerRun) -> None:
        client = self._run.engine.client(_SETTLING)
        try:
            with engine_errors():
                client.api.stop(container.identifier, timeout=GRACE)
        except CalibrationError:
            pass  # that the engine is gone is found out by whoever asks for the container's end
        finally:
            client.close()

    def _read_ends(self, api: "APIClient") -> None:
        for container in self._containers:
            if container.started is not None:
                container.read_end(api, self._judge.stopped_for.get(container.name))

    def _bring_out(self, api: "APIClient") -> None:
        began = [c for c in self._containers if c.started is not None]
        with complete_or_not_at_all(self._folder / ARTIFACTS) as folder:
            budget = Budget(self._job.artifact_bytes, self._job.artifact_files)
            found = BringingOut(folder, budget, self._go_on)
            for container in began:
                found.bring_out(container.container, opener_of(api, container.identifier, container.name))
        self._artifacts, self._left_out = found.files, found.left_out
        if not self._judge.reasons:  # else that is why
            for line in found.missing:
                self._judge.fail(line, ExitCode.FAIL)

    def _remove(self, api: "APIClient") -> None:
        """Remove everything of the job; what cannot be removed now, the run tries again at its end."""
        if self._lost:
            return
        with suppress(WorldError):
            remove(api, [Leftover.of("container", c.id) for c in self._containers if c.id is not None])
            for container in self._containers:
                container.join(_SETTLING)
            if self._network is not None:
                self._run.networks.give_back(self._network)
            if self._volume is not None:
                remove(api, [Leftover.of("volume", self._volume)])

    # --- small things

    def _go_on(self) -> None:
        if self._run.stopping.is_set():
            raise Interrupted

    def _clean(self, reason: str) -> str:
        return one_line(redact(reason, self._secrets))

    def _labels(self) -> dict[str, str]:
        return {**self._run.labels, JOB: self._job.name}

    def _prefix(self, container: str) -> str:
        safe = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "-" for c in self._job.name)
        return f"calibration-{self._run.name}-{safe[:60]}-{container}"


def lost_job(run: Run, job: Job, folder: Path, error: EngineLostError) -> JobOutcome:
    """The outcome of a job that has been given up, because the engine says nothing any more."""
    containers = tuple(ContainerOutcome(container.name, End.LOST) for container in job.containers)
    reasons = (_with_advice(error, run),)
    return JobOutcome(job.name, folder / job.name, containers, reasons=reasons, exit_code=error.exit_code)


def _with_advice(error: EngineLostError, run: Run) -> str:
    return f"{error}; what it still has of this run is removed by: calibration cleanup --run {run.name}"
