"""A container of a job on the engine, from its creation to its removal."""

import struct
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from queue import SimpleQueue
from typing import Any

import docker.errors
import requests
from docker import APIClient, DockerClient
from requests import Response

from calibration.base.errors import CalibrationError
from calibration.ci.docker.engine import Engine, engine_errors, lost
from calibration.ci.execution.docker.readiness import Probe
from calibration.ci.execution.job import Container
from calibration.ci.execution.job_verdict import how_it_ended
from calibration.ci.execution.log_file import LogFile
from calibration.ci.execution.outcome import End
from calibration.ci.execution.run_names import new_run
from calibration.ci.execution.supervision import Supervised

STOP_SECONDS = 5
"""Seconds between SIGTERM and SIGKILL."""
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
