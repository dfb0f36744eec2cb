"""Tasks in real containers on this machine's engine, in one network namespace as on Fargate."""

import threading
import time
import uuid
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from .attempt import Attempt, ContainerEnd, Ended
from .jobs import now

if TYPE_CHECKING:
    from docker import DockerClient
    from docker.models.containers import Container

LABEL = "calibration-test.emulator"
OUT_OF_MEMORY = "OutOfMemoryError: Container killed due to memory usage"
START_TIMEOUT, STOP_TIMEOUT = 180, 30
"""Seconds, where a container says nothing: how long others wait for it, and how long it has between TERM and KILL."""
Log = Callable[[str, str, list[tuple[int, str]]], None]
"""Takes a group, a stream, and lines with their milliseconds."""


class Containers:
    """Runs attempts in containers; nothing of them is left."""

    def __init__(
        self,
        engine: "DockerClient",
        pause_image: str,
        log: Log,
        environment: Mapping[str, str],
        secrets: Mapping[str, str] | None = None,
    ) -> None:
        """Say where.

        Args:
            engine: the client, which the caller closes.
            pause_image: an image with ``sleep``; its container holds a task's network.
            log: takes what containers print.
            environment: what every container has, as ECS gives it: the region, and credentials of the job's role.
            secrets: values by their ARNs.
        """
        self.engine, self.pause_image, self.log = engine, pause_image, log
        self.environment, self.secrets = environment, dict(secrets or {})
        self.id = uuid.uuid4().hex[:12]

    def run(self, attempt: Attempt) -> Ended:
        """Run a task to its end."""
        task = _Task(self, attempt)
        try:
            return task.run()
        finally:
            task.remove()

    def close(self) -> None:
        """Nothing is left."""
        assert not self.engine.containers.list(all=True, ignore_removed=True, filters={"label": f"{LABEL}={self.id}"})


class _NoStartError(Exception):
    """The task cannot start."""


class _Task:
    def __init__(self, host: Containers, attempt: Attempt) -> None:
        self._host, self._attempt = host, attempt
        self._name = f"batch-{host.id}-{attempt.task_id[:12]}"
        self._labels = {LABEL: host.id}
        self._changed = threading.Condition()
        self._ends: dict[str, ContainerEnd] = {}
        self._started: dict[str, float] = {}
        self._made: dict[str, Container] = {}
        self._pause: Container | None = None
        self._volumes: list[Any] = []
        self._stopping = False
        self._reason = "Essential container in task exited"
        self._errors: list[Exception] = []

    def run(self) -> Ended:
        containers = self._attempt.containers
        try:
            self._prepare()
        except _NoStartError as error:
            ends = {each["name"]: ContainerEnd(None, str(error)) for each in containers}
            return Ended(ends, "Task failed to start", started=False)
        threads = [threading.Thread(target=self._guarded, args=(each,), daemon=True) for each in containers]
        for thread in threads:
            thread.start()
        self._wait(len(containers))
        for thread in threads:
            thread.join()
        if self._errors:
            raise self._errors[0]
        return Ended(dict(self._ends), self._reason)

    def _wait(self, count: int) -> None:
        """Wait for all ends; stops the others after that of an essential container, or where the attempt has to."""
        running = False
        essential = {each["name"] for each in self._attempt.containers if each.get("essential", True)}
        while True:
            with self._changed:
                self._changed.wait(0.05)
                if not running and essential <= self._started.keys() and not self._attempt.stop.is_set():
                    running = True
                    self._attempt.runs()
                done = len(self._ends) == count
                stop = bool(essential & self._ends.keys()) or self._attempt.stop.is_set()
            if done:
                return
            if stop and not self._stopping:
                self._stop()

    def _prepare(self) -> None:
        from docker.errors import APIError

        engine, task = self._host.engine, self._attempt.task
        for container in self._attempt.containers:
            for secret in container.get("secrets", []):
                if secret["valueFrom"] not in self._host.secrets:
                    raise _NoStartError(
                        "ResourceInitializationError: unable to pull secrets or registry auth: "
                        f"unable to retrieve secret {secret['valueFrom']}"
                    )
            try:
                if not _has(engine, container["image"]):
                    engine.images.pull(container["image"])
            except APIError as error:
                raise _NoStartError(f"CannotPullContainerError: {error.explanation}") from None
        for volume in task.get("volumes", []):
            if "host" not in volume or not volume["host"].get("sourcePath"):
                self._volumes.append(engine.volumes.create(f"{self._name}-{volume['name']}", labels=self._labels))
        self._pause = engine.containers.run(
            self._host.pause_image,
            ["sleep", "infinity"],
            entrypoint=[],
            name=f"{self._name}-pause",
            hostname="ip-10-0-0-7",
            ipc_mode="shareable",
            labels=self._labels,
            detach=True,
            stop_signal="KILL",
        )

    def _guarded(self, container: dict[str, Any]) -> None:
        """A mistake of ours ends the container, so that the task ends."""
        try:
            end = self._one(container)
        except Exception as error:
            self._errors.append(error)
            end = ContainerEnd(None, f"emulator: {error}")
        with self._changed:
            self._ends[container["name"]] = end
            self._changed.notify_all()

    def _one(self, container: dict[str, Any]) -> ContainerEnd:
        from docker.errors import APIError

        name = container["name"]
        problem = self._dependencies(container)
        if problem is not None:
            if container.get("essential", True) and not self._stopping:
                self._reason = "Task failed to start"
            return ContainerEnd(None, problem or None)
        with self._changed:
            if self._stopping:
                return ContainerEnd(None)
            made = self._host.engine.containers.create(container["image"], **self._options(container))
            self._made[name] = made
        stream = self._attempt.log_stream(name)
        self._host.log(*stream, [])
        try:
            made.start()
        except APIError as error:
            made.reload()
            return ContainerEnd(made.attrs["State"]["ExitCode"], f"CannotStartContainerError: {error.explanation}")
        self._attempt.starts(name)
        with self._changed:
            self._started[name] = time.monotonic()
            self._changed.notify_all()
        self._follow(made, *stream)
        return self._end(made)

    def _dependencies(self, container: dict[str, Any]) -> str | None:
        """Wait for the containers before; returns why it must not start (empty: the task ends), None where it may."""
        for dependency in container.get("dependsOn", []):
            other, condition = dependency["containerName"], dependency["condition"]
            before = self._attempt.container(other)
            limit = before.get("startTimeout", START_TIMEOUT) * self._attempt.time_scale
            with self._changed:
                while not (other in self._ends or (condition == "START" and other in self._started)):
                    if self._stopping:
                        return ""
                    if time.monotonic() > self._started.get(other, float("inf")) + limit:
                        return f"dependency graph: timed out while waiting for container {other} to reach {condition}"
                    self._changed.wait(0.05)
                end = self._ends.get(other)
            if other not in self._started or (condition == "SUCCESS" and end is not None and end.code != 0):
                return f"dependency graph: container {other} did not reach {condition}"
        return "" if self._stopping else None

    def _options(self, container: dict[str, Any]) -> dict[str, Any]:
        assert self._pause is not None
        task, linux = self._attempt.task, container.get("linuxParameters", {})
        resources = {each["type"]: each["value"] for each in container["resourceRequirements"]}
        memory = int(resources["MEMORY"]) * 1024**2
        sources = {each["name"]: each.get("host", {}).get("sourcePath") for each in task.get("volumes", [])}
        binds = []
        for mount in container.get("mountPoints", []):
            volume = mount["sourceVolume"]
            # Fargate's are empty folders: nothing of the image is copied into them.
            mode = ("ro" if mount.get("readOnly") else "rw") + ("" if sources[volume] else ",nocopy")
            binds.append(f"{sources[volume] or f'{self._name}-{volume}'}:{mount['containerPath']}:{mode}")
        variables = {**self._host.environment, **self._attempt.environment(container["name"])}
        variables |= {each["name"]: self._host.secrets[each["valueFrom"]] for each in container.get("secrets", [])}
        options: dict[str, Any] = {
            "command": container.get("command"),
            "name": f"{self._name}-{container['name']}",
            "labels": self._labels,
            "network_mode": f"container:{self._pause.id}",
            "environment": variables,
            "volumes": binds,
            "mem_limit": memory,
            "memswap_limit": memory,
            "cpu_shares": max(2, round(float(resources["VCPU"]) * 1024)),
            "user": container.get("user"),
            "privileged": container.get("privileged", False),
            "read_only": container.get("readonlyRootFilesystem", False),
            "init": linux.get("initProcessEnabled"),
            "devices": [each["hostPath"] + ":" + each["hostPath"] for each in linux.get("devices", [])],
            "tmpfs": {each["containerPath"]: f"size={each['size']}m" for each in linux.get("tmpfs", [])},
        }
        if "sharedMemorySize" in linux:
            options["shm_size"] = linux["sharedMemorySize"] * 1024**2
        if task.get("ipcMode") == "task":
            options["ipc_mode"] = f"container:{self._pause.id}"
        return options

    def _follow(self, container: "Container", group: str, stream: str) -> None:
        """Hand on what a container prints, line by line, until it has ended."""
        rest = b""
        for chunk in container.logs(stream=True, follow=True):
            *lines, rest = (rest + chunk).split(b"\n")
            self._host.log(group, stream, [(now(), line.decode(errors="replace").rstrip("\r")) for line in lines])
        if rest:
            self._host.log(group, stream, [(now(), rest.decode(errors="replace"))])

    def _end(self, container: "Container") -> ContainerEnd:
        """Say how it ended; nobody knows where the engine has none, as on a lost host."""
        from docker.errors import APIError

        try:
            container.wait()
            container.reload()
        except APIError:
            return ContainerEnd(None)
        state = container.attrs["State"]
        return ContainerEnd(state["ExitCode"], OUT_OF_MEMORY if state["OOMKilled"] else None)

    def _stop(self) -> None:
        """Stop all that runs: with TERM first, or at once where the host is lost."""
        from docker.errors import APIError

        with self._changed:
            self._stopping = True
            made = dict(self._made)
            self._changed.notify_all()
        cause = self._attempt.cause
        lost = cause is not None and cause.kind == "host"

        def end(name: str, container: "Container") -> None:
            seconds = self._attempt.container(name).get("stopTimeout", STOP_TIMEOUT)
            with suppress(APIError):  # it has ended
                if lost or (cause is not None and cause.kind == "closed"):
                    container.kill()
                else:
                    container.stop(timeout=seconds)

        threads = [threading.Thread(target=end, args=pair, daemon=True) for pair in made.items()]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def remove(self) -> None:
        """Remove containers and volumes."""
        from docker.errors import APIError, NotFound

        for container in [*self._made.values(), *([self._pause] if self._pause is not None else [])]:
            with suppress(NotFound):
                container.remove(force=True, v=True)
        for volume in self._volumes:
            with suppress(APIError):
                volume.remove(force=True)


def _has(engine: "DockerClient", image: str) -> bool:
    from docker.errors import APIError

    try:
        engine.images.get(image)
    except APIError:
        return False
    return True
