"""One job on the engine: started, watched, stopped, brought out, removed."""

import shutil
import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from calibration.errors import CalibrationError, ExitCode, WorldError
from calibration.execution.docker.bringing_out import BringingOut, complete_or_not_at_all
from calibration.execution.docker.container_run import GRACE, ContainerRun
from calibration.execution.docker.copying import copy_in, open_output
from calibration.execution.docker.engine import Engine, EngineLostError, engine_errors
from calibration.execution.docker.labels import CONTAINER, JOB, new_run
from calibration.execution.docker.leftovers import Leftover, remove
from calibration.execution.docker.networks import Network, Networks
from calibration.execution.docker.settings import DEFAULT_BRIDGE, container_settings
from calibration.execution.extraction import Budget
from calibration.execution.job import Job
from calibration.execution.job_check import start_order
from calibration.execution.log_file import LogFile
from calibration.execution.manifest import FILE_NAME, write_manifest
from calibration.execution.outcome import BroughtOut, ContainerOutcome, End, JobOutcome
from calibration.workflow.masks import redact
from calibration.workflow.streams import LogDisplay
from calibration.workflow.text import one_line

if TYPE_CHECKING:
    from docker import APIClient

ARTIFACTS, LOGS = "artifacts", "logs"
"""Folders in a job's folder."""
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
        self._reasons: list[str] = []
        self._exit_code = ExitCode.PASS
        self._artifacts: list[BroughtOut] = []
        self._left_out: list[str] = []
        self._began = time.monotonic()
        self._stopped_for: dict[str, End] = {}
        """Why we stopped containers."""
        self._too_early: ContainerRun | None = None
        """One that others waited for, and that ended before it was ready."""
        self._lost = False
        """Whether the engine went away."""

    def run(self) -> JobOutcome:
        """Run it to its end; whatever goes wrong with it is its outcome, and nothing of it is left.

        Raises:
            Interrupted: the run is being stopped.
            WorldError: a file of ours cannot be written.
        """
        self._make_folder()
        client = self._run.engine.client()
        try:
            with ExitStack() as logs:
                self._prepare(logs)
                try:
                    self._to_its_end(client.api)
                except EngineLostError as error:
                    self._lost = True
                    self._fail(_with_advice(error, self._run), error.exit_code)
                except CalibrationError as error:
                    self._fail(str(error), error.exit_code)
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
            reasons=tuple(self._reasons),
            exit_code=self._exit_code,
            seconds=time.monotonic() - self._began,
        )
        write_manifest(outcome, self._run.name)
        return outcome

    # --- from beginning to end

    def _make_folder(self) -> None:
        """Make the job's folder; what an earlier run left there must not be taken for this one's."""
        try:
            for name in (ARTIFACTS, LOGS, FILE_NAME):
                place = self._folder / name
                if place.is_dir() and not place.is_symlink():
                    shutil.rmtree(place)
                else:
                    place.unlink(missing_ok=True)
            (self._folder / LOGS).mkdir(parents=True)
        except OSError as error:
            raise WorldError(f"{self._folder}: cannot be written: {error.strerror or error}") from error

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
        self._judge()
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
            ended = [c for c in self._containers if c.ended is not None]
            if any(c.container.essential for c in ended):
                return
            if self._ends_too_early(ended, waiting) or self._is_too_late(waiting):
                return
            unready = [c for c in self._containers if c.running and not c.ready]
            for container in unready:
                if container.is_ready():
                    break  # whoever waits for it starts at once
            else:
                self._wait(min([*self._times_left(), *([_LOOKING] if unready else [])], default=None))

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

    def _ends_too_early(self, ended: Iterable[ContainerRun], waiting: Sequence[ContainerRun]) -> bool:
        """Whether somebody waits for a container that has ended before it was ready."""
        needed = {name for container in waiting for name in container.container.after}
        for container in ended:
            if not container.ready and container.name in needed:
                self._too_early = container
                return True
        return False

    def _is_too_late(self, waiting: Sequence[ContainerRun]) -> bool:
        now = time.monotonic()
        if self._job.seconds is not None and now - self._began >= self._job.seconds:
            running = [c.name for c in self._containers if c.running]
            self._stopped_for |= dict.fromkeys(running, End.TIMED_OUT)
            still = f": still running were {', '.join(running)}" if running else ""
            never = f"; not started were {', '.join(c.name for c in waiting)}" if waiting else ""
            self._fail(f"the job ran longer than its {self._job.seconds:g} s{still}{never}", ExitCode.WORLD)
            return True
        for container in self._containers:
            if not container.running or container.started is None:
                continue
            limit, readiness = container.container.limits.seconds, container.container.readiness
            said = f": {container.log.last_line}" if container.log.last_line else ""
            if limit is not None and now - container.started >= limit:
                self._stopped_for[container.name] = End.TIMED_OUT
                self._fail(f"container '{container.name}' ran longer than its {limit:g} s{said}", ExitCode.WORLD)
                return True
            if readiness is not None and not container.ready and now - container.started >= readiness.seconds:
                self._stopped_for[container.name] = End.NOT_READY
                missing = container.not_ready_for()
                self._fail(
                    f"container '{container.name}' was not ready within {readiness.seconds:g} s ({missing}){said}",
                    ExitCode.FAIL,
                )
                return True
        return False

    def _times_left(self) -> list[float]:
        """Seconds until each limit that is nearest."""
        now = time.monotonic()
        left = [] if self._job.seconds is None else [self._began + self._job.seconds - now]
        for container in self._containers:
            if container.running and container.started is not None:
                limits = [container.container.limits.seconds]
                if container.container.readiness is not None and not container.ready:
                    limits.append(container.container.readiness.seconds)
                left += [container.started + limit - now for limit in limits if limit is not None]
        return left

    def _stop_all(self) -> None:
        """Ask all that run to end, at the same time, and wait until they have."""
        running = [c for c in self._containers if c.running]
        if self._run.stopping.is_set():
            return  # removing kills them
        for container in running:
            self._stopped_for.setdefault(container.name, End.STOPPED)
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
                container.read_end(api, self._stopped_for.get(container.name))

    def _judge(self) -> None:
        """Find out why the job has failed, if it has."""
        essential = [c for c in self._containers if c.container.essential]
        for container in essential:
            if container.failure is not None:
                self._fail(container.failure, ExitCode.FAIL)
        if self._too_early is not None and not self._reasons:
            early = self._too_early
            how = early.failure or f"container '{early.name}' ended with exit code {early.exit_code}"
            self._fail(f"{how}; it was not ready yet ({early.not_ready_for()})", ExitCode.FAIL)
        for container in essential:
            if container.end == End.NOT_STARTED and not self._reasons:
                self._fail(f"container '{container.name}' was never started: another ended the job", ExitCode.FAIL)
        if not self._reasons and not any(c.end == End.EXITED for c in essential):
            raise AssertionError("a job that nothing essential has ended has failed")
        if self._reasons:  # what else went wrong may be why
            others = [c for c in self._containers if not c.container.essential and c is not self._too_early]
            self._reasons += [self._clean(c.failure) for c in others if c.failure is not None]

    def _bring_out(self, api: "APIClient") -> None:
        began = [c for c in self._containers if c.started is not None]
        with complete_or_not_at_all(self._folder / ARTIFACTS) as folder:
            budget = Budget(self._job.artifact_bytes, self._job.artifact_files)
            found = BringingOut(api, folder, budget, self._go_on)
            for container in began:
                found.bring_out(container)
        self._artifacts, self._left_out = found.files, found.left_out
        if not self._reasons:  # else that is why
            for line in found.missing:
                self._fail(line, ExitCode.FAIL)

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

    def _fail(self, reason: str, code: ExitCode) -> None:
        if not self._reasons:
            self._exit_code = code
        self._reasons.append(self._clean(reason))

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
