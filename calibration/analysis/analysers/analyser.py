"""What an analyser is."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from calibration.analysis.copies import Copy
from calibration.analysis.finding import Finding


class Analyser(ABC):
    """One analyser."""

    name: ClassVar[str]
    at_once: ClassVar[int] = 200
    """Files that one process is given."""
    settings: ClassVar[tuple[str, ...]] = ()
    """Names of files with the team's settings of it."""

    @abstractmethod
    def wants(self, path: str, copy: Copy) -> bool:
        """Whether it looks at a file."""

    @abstractmethod
    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[Finding]:
        """Look at files.

        Args:
            copy: the folder that the files are in, with the team's settings.
            files: not empty, at most ``at_once``.
            seconds: that it may take.

        Raises:
            InfrastructureError: the program is missing, fails or takes too long.
        """


def arguments(files: Sequence[str]) -> list[str]:
    """Files as arguments that no program takes for options."""
    return [f"./{file}" for file in files]


def in_repository(path: str, copy: Copy) -> str:
    """The path in the repository of a file that a program names."""
    return path.removeprefix(f"{copy.root}/").removeprefix("./")
