"""A container of a job on the engine: its settings, its readiness, and its run from the creation to the removal.

Privileges are dropped by default. Readiness is checked from outside where possible, so that images need no tools: ports
by a connection to the container's address. If it is unreachable (Docker Desktop, a remote engine, no network), the
kernel's list of listening ports is read by ``cat`` in the container, which is the only tool required in the image.

Files are copied into it before its start, and out of it, without tools in the image. The SDK's own functions for that
cannot stop early, and have no time-out for an engine that does not answer.
"""

import base64
import io
import json
import re
import socket
import struct
import tarfile
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from queue import SimpleQueue
from typing import Any, cast

import docker.errors
import requests
from docker import APIClient, DockerClient
from docker.types import DeviceRequest, LogConfig
from docker.types import Mount as EngineMount
from requests import Response

from calibration.base import CalibrationError, InputError
from calibration.ci.docker_engine import Engine, engine_errors, lost
from calibration.ci.execution.docker.labels import new_run
from calibration.ci.execution.docker.run_objects import Network
from calibration.ci.execution.job import OUTPUT, Container, Mount, Readiness
from calibration.ci.execution.outcome import Archive, End, NothingThereError, Opener
from calibration.ci.execution.supervision import Supervised, how_it_ended, unmet
from calibration.ci.workflow.streams import LogFile

_CHUNK_BYTES = 1024**2
# The engine tells only here, as JSON in base64, that the path is a link: the archive then has the link, not its target.
_STAT_HEADER = "X-Docker-Container-Path-Stat"
_IN_MEMORY = 16 * 1024**2
_CONNECT_SECONDS = 0.5
"""Seconds; local containers answer much faster."""
_LISTENING_SOCKET = re.compile(r"^\s*\d+: [0-9A-F]+:([0-9A-F]{4}) [0-9A-F]+:0000 0A ", re.MULTILINE)


def open_output(api: APIClient, container: str) -> None:
    """Make the job's volume writable for all users of the image; by default it belongs to root."""
    entry = tarfile.TarInfo(OUTPUT.strip("/"))
    entry.type, entry.mode = tarfile.DIRTYPE, 0o1777
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as archive:
        archive.addfile(entry)
    api.put_archive(container, "/", file.getvalue())


def copy_in(api: APIClient, container: str, mounts: Iterable[Mount]) -> None:
    """Copy mounts into a container, for an engine that cannot access our file system.

    Raises:
        InputError: a mount is writable, which a copy does not support, or cannot be read.
    """
    mounts = tuple(mounts)
    for mount in mounts:
        if mount.writable:
            raise InputError(
                f"mount '{mount.target}': the Docker Engine cannot access the files of this machine (it runs on "
                "another one, or this is a container); only read-only mounts can be copied to it"
            )
    if not mounts:
        return
    with tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY) as file:
        try:
            with tarfile.open(fileobj=file, mode="w") as archive:
                for mount in mounts:
                    archive.add(mount.source.resolve(), mount.target.strip("/"), filter=_as_readable)
        except OSError as error:
            raise InputError(f"mount '{mount.target}': {error.filename}: cannot be read: {error.strerror}") from None
        file.seek(0)
        api.put_archive(container, "/", cast("Any", file))


def _as_readable(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    """Make a tar entry readable for all users, without an owner."""
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    entry.mode |= 0o555 if entry.isdir() or entry.mode & 0o100 else 0o444
    return entry


@contextmanager
def open_archive(api: APIClient, container: str, path: str) -> Iterator[Archive]:
    """Open a file or folder as a tar stream.

    Raises:
        docker.errors.NotFound: it does not exist.
        docker.errors.APIError: the engine refuses the request.
    """
    headers = {"Accept-Encoding": "identity"}
    response = api.get(
        _archive_url(api, container), params={"path": path}, headers=headers, stream=True, timeout=api.timeout
    )
    try:
        try:
            response.raise_for_status()
        except requests.HTTPError as error:
            docker.errors.create_api_error_from_http_exception(error)
        facts = json.loads(base64.b64decode(response.headers.get(_STAT_HEADER, "e30=")))
        yield Archive(response.iter_content(_CHUNK_BYTES), str(facts.get("linkTarget") or ""))
    finally:
        response.close()


def opener_of(api: APIClient, container: str, name: str) -> Opener:
    """Return an opener for the files of a container, whose name is used in messages."""

    @contextmanager
    def opened(path: str) -> Iterator[Archive]:
        with engine_errors(f"container '{name}', artifact '{path}'"):  # the engine's errors are OSErrors too
            try:
                with open_archive(api, container, path) as archive:
                    yield archive
            except docker.errors.NotFound:
                raise NothingThereError from None

    return opened


def exists(api: APIClient, container: str, path: str) -> bool:
    """Return whether a file or folder exists."""
    with api.head(_archive_url(api, container), params={"path": path}, timeout=api.timeout) as response:
        return response.ok


def _archive_url(api: APIClient, container: str) -> str:
    return f"{api.base_url}/v{api.api_version}/containers/{container}/archive"


class Probe:
    """Repeated check of a container, until every condition has been met once."""

    def __init__(self, api: APIClient, container: str, readiness: Readiness, host_network: bool) -> None:
        self._api = api
        self._container = container
        self._readiness = readiness
        self._host_network = host_network
        self._by_address = True
        self._command: str | None = None
        """Id of the command that is currently running."""
        self._open = {
            name
            for name, asked in (("port", readiness.port), ("file", readiness.file), ("command", readiness.command))
            if asked
        }

    def holds(self, log_has_line: bool) -> bool:
        """Check the conditions; return whether all have been met. Takes less than a second."""
        checks = {"port": self._port_answers, "file": self._file_is_there, "command": self._command_answers}
        for name in sorted(self._open):
            if checks[name]():
                self._open.discard(name)
        return not self._open and (log_has_line or not self._readiness.log)

    def missing(self, log_has_line: bool) -> str:
        """Return the unmet conditions, for a message."""
        return unmet(self._readiness, self._open, log_has_line)

    def _port_answers(self) -> bool:
        port = self._readiness.port or 0
        address = "127.0.0.1" if self._host_network else address_of(self._api, self._container)
        if self._by_address and address:
            try:
                with socket.create_connection((address, port), _CONNECT_SECONDS):
                    return True
            except ConnectionError:
                return False
            except OSError:
                self._by_address = False  # unreachable from here
        return port in self._listening_ports()

    def _listening_ports(self) -> set[int]:
        command = ["cat", "/proc/net/tcp", "/proc/net/tcp6"]
        started = self._api.exec_create(self._container, command, stdin=False)
        listing = self._api.exec_start(started["Id"])
        return {int(port, 16) for port in _LISTENING_SOCKET.findall(listing.decode("ascii", "replace"))}

    def _file_is_there(self) -> bool:
        return exists(self._api, self._container, str(self._readiness.file))

    def _command_answers(self) -> bool:
        """Check the result of the running command, which may take long, or start it again."""
        if self._command is None:
            command = list(self._readiness.command)
            self._command = self._api.exec_create(self._container, command, stdout=False, stderr=False)["Id"]
            self._api.exec_start(self._command, detach=True)
            time.sleep(0.05)  # most commands end immediately
        state = self._api.exec_inspect(self._command)
        if state["Running"]:
            return False
        self._command = None
        return bool(state["ExitCode"] == 0)


def address_of(api: APIClient, container: str) -> str:
    """Return the address of a container by its id; empty if it has none of its own.

    Raises:
        docker.errors.APIError: the engine refuses the request.
    """
    networks = api.inspect_container(container)["NetworkSettings"]["Networks"] or {}
    return next((str(found["IPAddress"]) for found in networks.values() if found.get("IPAddress")), "")


DEFAULT_BRIDGE = "bridge"
"""Default network of the engine."""
_DOCKER_SOCKET = "/var/run/docker.sock"
STOP_SECONDS = 5
"""Seconds between SIGTERM and SIGKILL."""


def container_settings(
    api: APIClient, container: Container, network: Network | str, volume: str, labels: Mapping[str, str], binds: bool
) -> dict[str, Any]:
    """Return the arguments that create a container, except for name and image.

    Args:
        api: client, for parts that depend on the engine's version.
        container: the container.
        network: its network, or a network mode of the engine.
        volume: name of the job's volume.
        labels: labels of the run, the job and the container.
        binds: whether the engine can access our file system; otherwise mounts are copied later.
    """
    relaxed = container.relaxations
    mounts = [EngineMount(OUTPUT, volume, type="volume", no_copy=True)]
    if binds:
        mounts += [
            EngineMount(mount.target, str(mount.source.resolve()), type="bind", read_only=not mount.writable)
            for mount in container.mounts
        ]
    if relaxed.docker_socket:
        mounts.append(EngineMount(_DOCKER_SOCKET, _DOCKER_SOCKET, type="bind"))
    limits = container.limits
    host: dict[str, Any] = {
        "init": True,  # forwards signals and reaps zombies
        "network_mode": network if isinstance(network, str) else network.name,
        "mounts": mounts,
        "cap_add": list(relaxed.capabilities),
        "devices": list(relaxed.devices),
        "pids_limit": limits.processes,
        "log_config": LogConfig(type="none"),  # read while it runs; the engine stores nothing, because of secrets
        "privileged": relaxed.privileged,
    }
    if not relaxed.privileged:
        host["cap_drop"] = ["ALL"]
        if not relaxed.new_privileges:
            host["security_opt"] = ["no-new-privileges:true"]
    if limits.memory is not None:
        host |= {"mem_limit": limits.memory, "memswap_limit": limits.memory}
    if limits.cpus is not None:
        host["nano_cpus"] = round(limits.cpus * 1e9)
    if relaxed.gpus:
        host["device_requests"] = [DeviceRequest(count=-1, capabilities=[["gpu"]])]
    settings: dict[str, Any] = {
        "command": list(container.command) or None,
        "environment": dict(container.environment),
        "labels": dict(labels),
        "host_config": api.create_host_config(**host),
        "stop_timeout": STOP_SECONDS,
    }
    if container.entrypoint is not None:
        settings["entrypoint"] = list(container.entrypoint) or [""]  # the engine's notation for none
    if container.working_directory is not None:
        settings["working_dir"] = container.working_directory
    if container.user is not None:
        settings["user"] = container.user
    if network != "host":
        settings["hostname"] = container.name
    if isinstance(network, Network) and not network.shared:
        endpoint = api.create_endpoint_config(aliases=[container.name])
        settings["networking_config"] = {"EndpointsConfig": {network.name: endpoint}}
    return settings


_MAX_NAME_TRIES = 5
"""Attempts to find a free name: the engine answers 409 to one that another run has taken by chance."""
_FRAME_HEADER = struct.Struct(">BxxxL")
"""Header of a frame of output: stream, and number of bytes."""
_SECONDS_TO_REPORT_MEMORY = 0.25
"""Seconds; the engine may report lack of memory a little after the end of the container."""


class ContainerRun(Supervised):
    """A container before, during or after its run."""

    def __init__(self, container: Container, engine: Engine, image: str, log: LogFile) -> None:
        super().__init__(container)
        self.image = image
        self.log = log.path
        self.id = ""
        """Id on the engine; empty before its creation."""
        self._output = log
        self._engine = engine
        self._probe: Probe | None = None
        self._follower: threading.Thread | None = None
        self._problem: CalibrationError | None = None

    def create(self, api: APIClient, prefix: str, settings: Mapping[str, Any]) -> str:
        """Create the container with a unique name.

        Returns:
            Its id.

        Raises:
            docker.errors.APIError: the engine refuses the request.
        """
        tries = _MAX_NAME_TRIES
        while not self.id:
            try:
                self.id = api.create_container(self.image, name=f"{prefix}-{new_run()}", **settings)["Id"]
            except docker.errors.APIError as error:
                tries -= 1
                if error.status_code != 409 or not tries:
                    raise
        return self.id

    def start(self, api: APIClient, ends: "SimpleQueue[ContainerRun]", host_network: bool) -> None:
        """Start the container and follow its log; it is put into the queue when it has ended.

        Raises:
            docker.errors.APIError: the engine refuses the request.
        """
        with ExitStack() as opened:
            client = self._engine.client()
            opened.callback(client.close)
            # attach before the start, to miss none of its output
            stream = opened.enter_context(attach(client.api, self.id))
            api.start(self.id)
            opened.pop_all()  # the follower closes them
        self.started = time.monotonic()
        if self.container.readiness is not None:
            self._probe = Probe(api, self.id, self.container.readiness, host_network)
        self.ready = self._probe is None
        self._follower = threading.Thread(
            target=self._follow_output, args=(client, stream, ends), name=f"log of {self.name}", daemon=True
        )
        self._follower.start()

    def poll(self) -> None:
        """Update the readiness; a container that ends meanwhile is not ready.

        Raises:
            EngineLostError: the engine does not answer.
        """
        if not self.ready and self._probe is not None:
            with engine_errors():
                try:
                    self.ready = self._probe.holds(self._output.found)
                except docker.errors.APIError:
                    return  # it has ended, which the follower reports

    def not_ready_for(self) -> str:
        """Return the unmet conditions of its readiness, for a message."""
        return "" if self._probe is None else self._probe.missing(self._output.found)

    def join(self, seconds: float) -> None:
        """Wait until its log is complete.

        Raises:
            CalibrationError: the engine was lost, or the log could not be written.
        """
        if self._follower is not None:
            self._follower.join(seconds)
            if self._follower.is_alive():
                raise lost()
        if self._problem is not None:
            raise self._problem

    def read_end(self, api: APIClient, ours: End | None) -> None:
        """Ask the engine how it ended.

        Args:
            api: client of the engine.
            ours: reason why it was stopped; None if it ended by itself.

        Raises:
            EngineLostError: the engine does not answer.
        """
        with engine_errors(f"container '{self.name}'"):
            state = api.inspect_container(self.id)["State"]
            settled = time.monotonic() + (_SECONDS_TO_REPORT_MEMORY if self.container.limits.memory is not None else 0)
            while not state.get("OOMKilled") and time.monotonic() < settled:
                time.sleep(_SECONDS_TO_REPORT_MEMORY / 10)
                state = api.inspect_container(self.id)["State"]
        self.exit_code = int(state["ExitCode"])
        self.end, self.signal = how_it_ended(self.container, self.exit_code, bool(state.get("OOMKilled")), ours)

    @property
    def last_line(self) -> str:
        """Last line of its log."""
        return self._output.last_line

    def _follow_output(self, client: DockerClient, stream: Response, ends: "SimpleQueue[ContainerRun]") -> None:
        """Write its output to the log until it ends; runs in a thread."""
        try:
            with engine_errors(f"container '{self.name}'"):
                try:
                    for chunk in pieces(stream):
                        self._feed_log(chunk)
                except (OSError, ValueError) as error:  # exceptions of a broken connection that the SDK does not wrap
                    raise lost(error) from None
                client.api.wait(self.id, timeout=None)
        except CalibrationError as error:
            self._problem = self._problem or error
        finally:
            self.ended = time.monotonic()
            ends.put(self)
            stream.close()
            client.close()

    def _feed_log(self, chunk: bytes) -> None:
        """Write to the log; after a failure keep reading, because a full pipe would block the container."""
        if self._problem is None:
            try:
                self._output.feed(chunk)
            except CalibrationError as error:
                self._problem = error


def attach(api: APIClient, container: str) -> Response:
    """Attach to a container's output, without a gap from now on; the caller closes the response.

    Plain HTTP instead of the SDK's method, which reads the raw socket and leaks it.

    Raises:
        docker.errors.APIError: the engine refuses the request.
    """
    url = f"{api.base_url}/v{api.api_version}/containers/{container}/attach"
    asked = {"stream": 1, "stdout": 1, "stderr": 1}
    response = api.post(url, params=asked, stream=True, timeout=(api.timeout, None))  # None: it may be silent
    try:
        response.raise_for_status()
    except requests.HTTPError as error:
        response.close()
        docker.errors.create_api_error_from_http_exception(error)
    return response


def pieces(response: Response) -> Iterator[bytes]:
    """Yield the output, stdout and stderr in the order of arrival, until the container ends."""
    while len(header := response.raw.read(_FRAME_HEADER.size)) == _FRAME_HEADER.size:
        _, size = _FRAME_HEADER.unpack(header)
        yield response.raw.read(size)
