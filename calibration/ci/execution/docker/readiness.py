"""Readiness checks of containers, from outside where possible, so that images need no tools.

Ports are tested by a connection to the container's address. If it is unreachable (Docker Desktop,
a remote engine, no network), the kernel's list of listening ports is read by ``cat`` in the
container, which is the only tool required in the image.
"""

import re
import socket
import time

from docker import APIClient

from calibration.ci.execution.docker.copying import exists
from calibration.ci.execution.job import Readiness
from calibration.ci.execution.job_verdict import unmet

_CONNECT_SECONDS = 0.5
"""Seconds; local containers answer much faster."""
_LISTENING_SOCKET = re.compile(r"^\s*\d+: [0-9A-F]+:([0-9A-F]{4}) [0-9A-F]+:0000 0A ", re.MULTILINE)


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
        address = "127.0.0.1" if self._host_network else self._container_address()
        if self._by_address and address:
            try:
                with socket.create_connection((address, port), _CONNECT_SECONDS):
                    return True
            except ConnectionError:
                return False
            except OSError:
                self._by_address = False  # unreachable from here
        return port in self._listening_ports()

    def _container_address(self) -> str:
        networks = self._api.inspect_container(self._container)["NetworkSettings"]["Networks"] or {}
        return next((str(found["IPAddress"]) for found in networks.values() if found.get("IPAddress")), "")

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
