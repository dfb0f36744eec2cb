"""Labels on everything that is started, and who started it: so that it can be found, and removed when he is dead."""

import os
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

PREFIX = "ci.calibration."
RUN, JOB, CONTAINER = f"{PREFIX}run", f"{PREFIX}job", f"{PREFIX}container"
_OWNER = f"{PREFIX}owner."


@dataclass(frozen=True)
class Owner:
    """A process, so that it is not taken for another of the same number."""

    host: str
    boot: str
    """Changes when the machine starts."""
    namespace: str
    """Of process numbers: those of a container are its own."""
    process: str
    started: str
    """When, in the machine's clock ticks."""

    @classmethod
    def this_process(cls) -> Self:
        """The one that runs this."""
        process = os.getpid()
        return cls(socket.gethostname(), _boot(), _namespace(), str(process), started(process))

    @classmethod
    def from_labels(cls, labels: Mapping[str, str]) -> Self | None:
        """Read it from labels; None where something is missing, as on what another version made."""
        found = {name: labels.get(_OWNER + name, "") for name in cls.__dataclass_fields__}
        return cls(**found) if all(found.values()) and found["process"].isdecimal() else None

    @property
    def labels(self) -> dict[str, str]:
        """The labels that say it."""
        return {_OWNER + name: getattr(self, name) for name in self.__dataclass_fields__}

    @property
    def is_dead(self) -> bool:
        """Whether it certainly does not run any more: it ran on this machine, where we would see it."""
        here = type(self).this_process()
        if self.host != here.host or not self.boot:
            return False
        if self.boot != here.boot:
            return True  # the machine has been started anew
        return self.namespace == here.namespace and started(int(self.process)) != self.started


def new_run() -> str:
    """A name for a run that no other has."""
    return secrets.token_hex(4)


def started(process: int) -> str:
    """When a process started; nothing where there is none."""
    try:
        # after the name, which is in brackets and may hold anything
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""


def _boot() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


def _namespace() -> str:
    try:
        return str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        return ""
