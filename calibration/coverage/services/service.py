"""What a service is to us: requests that tell it the coverage of a commit, and a reading of its answers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from calibration.coverage.lines import FileCoverage


@dataclass(frozen=True)
class Upload:
    """What a service is to be told."""

    commit: str
    files: Mapping[str, FileCoverage]
    """By path in the repository."""
    partial: bool = False
    """Other jobs tell more of this commit."""
    final: bool = False
    """Nothing more is told of this commit."""


@dataclass(frozen=True)
class Request:
    """One request of HTTP, a POST of JSON."""

    what: str
    """In a few words, for the log."""
    url: str
    body: bytes
    headers: Mapping[str, str] = field(repr=False)
    """With the token."""


class Service(Protocol):
    """A service; another one is a module with a class like this, and a name in the command's ``--service``."""

    def requests(self, upload: Upload) -> Sequence[Request]:
        """Everything that is to be sent, in order."""

    def send(self, requests: Sequence[Request]) -> None:
        """Send it.

        Raises:
            WorldError: the service did not take something; says what to do.
        """
