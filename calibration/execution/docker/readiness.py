"""Whether a container is ready: looked at from outside as far as that goes, so that images need no tools for it.

A port is tried from here, at the container's address. Where that is out of reach (Docker Desktop,
an engine on another machine, no network), the kernel's list of listening ports is read in the
container by ``cat``, the one tool that has to be there then.
"""

import re
import socket
import time

from docker import APIClient

from calibration.execution.docker.copying import exists
from calibration.execution.job import Readiness
from calibration.execution.judging import unmet

_CONNECTING = 0.5
"""Seconds; a container of this machine answers in far less."""
_LISTENING = re.compile(r"^\s*\d+: [0-9A-F]+:([0-9A-F]{4}) [0-9A-F]+:0000 0A ", re.MULTILINE)


class Probe:
    """Asks one container, again and again, until everything has held once."""

    def __init__(self, api: APIClient, container: str, readiness: Readiness, host_network: bool) -> None:
        self._api = api
        self._container = container
        self._readiness = readiness
        self._host_network = host_network
        self._by_address = True
        self._command: str | None = None
        """The command that runs now."""
        self._open = {
            name
            for name, asked in (("port", readiness.port), ("file", readiness.file), ("command", readiness.command))
            if asked
        }

    def holds(self, log_has_line: bool) -> bool:
        """Whether all that is asked for has held by now; takes less than a second."""
        checks = {"port": self._port_answers, "file": self._file_is_there, "command": self._command_answers}
        for name in sorted(self._open):
            if checks[name]():
                self._open.discard(name)
        return not self._open and (log_has_line or not self._readiness.log)

    def missing(self, log_has_line: bool) -> str:
        """What has not held, for a message."""
        return unmet(self._readiness, self._open, log_has_line)

    def _port_answers(self) -> bool:
        port = self._readiness.port or 0
        address = "127.0.0.1" if self._host_network else self._address()
        if self._by_address and address:
            try:
                with socket.create_connection((address, port), _CONNECTING):
                    return True
            except ConnectionError:
                return False
            except OSError:
                self._by_address = False  # out of reach from here
        return port in self._listening()

    def _address(self) -> str:
        networks = self._api.inspect_container(self._container)["NetworkSettings"]["Networks"] or {}
        return next((str(found["IPAddress"]) for found in networks.values() if found.get("IPAddress")), "")

    def _listening(self) -> set[int]:
        command = ["cat", "/proc/net/tcp", "/proc/net/tcp6"]
        started = self._api.exec_create(self._container, command, stdin=False)
        listing = self._api.exec_start(started["Id"])
        return {int(port, 16) for port in _LISTENING.findall(listing.decode("ascii", "replace"))}

    def _file_is_there(self) -> bool:
        return exists(self._api, self._container, str(self._readiness.file))

    def _command_answers(self) -> bool:
        """Look at the run of the command, which may take its time, or begin the next."""
        if self._command is None:
            command = list(self._readiness.command)
            self._command = self._api.exec_create(self._container, command, stdout=False, stderr=False)["Id"]
            self._api.exec_start(self._command, detach=True)
            time.sleep(0.05)  # most answer at once
        state = self._api.exec_inspect(self._command)
        if state["Running"]:
            return False
        self._command = None
        return bool(state["ExitCode"] == 0)
