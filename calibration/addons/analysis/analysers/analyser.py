"""Base class of the analysers."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.finding import CodeFinding


class Analyser(ABC):
    """Analyser of files."""

    name: ClassVar[str]
    at_once: ClassVar[int] = 200
    """Limit of the number of files per process."""
    whole: ClassVar[bool] = False
    """Whether it compares files with each other, so that a change of one makes findings in others."""
    settings: ClassVar[tuple[str, ...]] = ()
    """Names of files with the team's settings for it."""

    @abstractmethod
    def wants(self, path: str, copy: Copy) -> bool:
        """Whether it analyses a file."""

    @abstractmethod
    def findings(self, copy: Copy, files: Sequence[str], seconds: float) -> list[CodeFinding]:
        """Analyse files.

        Args:
            copy: the folder of the files, with the team's settings.
            files: not empty, at most ``at_once``.
            seconds: time limit.

        Raises:
            InfrastructureError: the program is missing, fails or takes too long.
        """


def arguments(files: Sequence[str]) -> list[str]:
    """Return file names as arguments that are never parsed as options."""
    return [f"./{file}" for file in files]


def in_repository(path: str, copy: Copy) -> str:
    """Return the path in the repository of a file named in a program's output."""
    return path.removeprefix(f"{copy.root}/").removeprefix("./")
