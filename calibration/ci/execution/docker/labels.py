"""Unique names of runs and of what they create, and labels of run and process, to find what dead processes left."""

import os
import re
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from calibration.base import InputError


def new_run() -> str:
    """Return a unique name for a run."""
    return os.urandom(4).hex()


_RUN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,60}")


def check_run_name(name: str) -> None:
    """Refuse a name of a run that is invalid in keys and other names.

    Raises:
        InputError: it is invalid.
    """
    if not _RUN_NAME.fullmatch(name):
        raise InputError(f"run '{name}': expected letters, digits, _ . and -, at most 61")


LABEL_PREFIX = "ci.calibration."
RUN_LABEL, JOB_LABEL, CONTAINER_LABEL = f"{LABEL_PREFIX}run", f"{LABEL_PREFIX}job", f"{LABEL_PREFIX}container"
_OWNER_PREFIX = f"{LABEL_PREFIX}owner."


@dataclass(frozen=True)
class Owner:
    """Identity of a process, which distinguishes it from a later one with the same pid."""

    host: str
    boot: str
    """Changes with every boot of the machine."""
    namespace: str
    """PID namespace: containers have their own."""
    process: str
    started: str
    """Start time in clock ticks."""

    @classmethod
    def this_process(cls) -> Self:
        """Return the identity of the current process."""
        process = os.getpid()
        return cls(socket.gethostname(), _read_boot_id(), _read_pid_namespace(), str(process), started(process))

    @classmethod
    def from_labels(cls, labels: Mapping[str, str]) -> Self | None:
        """Read it from labels; None if one is missing, for example in objects of another version."""
        found = {name: labels.get(_OWNER_PREFIX + name, "") for name in cls.__dataclass_fields__}
        return cls(**found) if all(found.values()) and found["process"].isdecimal() else None

    @property
    def labels(self) -> dict[str, str]:
        """Labels of the engine's objects that encode it."""
        return {_OWNER_PREFIX + name: getattr(self, name) for name in self.__dataclass_fields__}

    @property
    def is_dead(self) -> bool:
        """Whether the process has certainly ended: it ran on this machine, and would be visible."""
        here = type(self).this_process()
        if self.host != here.host or not self.boot:
            return False
        if self.boot != here.boot:
            return True  # the machine has rebooted
        return self.namespace == here.namespace and started(int(self.process)) != self.started

    @property
    def where(self) -> str:
        """Description of where the process runs, or may run if its end is not proven; for messages."""
        here = type(self).this_process()
        if self.host != here.host:
            return f"may be active on {self.host}"
        if self.namespace != here.namespace:
            return "may be active in another container of this machine"
        return f"active, process {self.process}"


def started(process: int) -> str:
    """Return the start time of a process; empty if it does not exist."""
    try:
        # fields after the name, which is in brackets and may contain anything
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""


def _read_boot_id() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


def _read_pid_namespace() -> str:
    try:
        return str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        return ""
