"""Result of a stage of an add-on, as a run has it."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

from calibration.base.records import computed, field, result
from calibration.base.verdict import Verdict, verdict_of


@result(kw_only=True)
class StageResult(ABC):
    """Result of a stage of an add-on, which is part of the verdict of a run."""

    heading: ClassVar[str]
    """What the stage did, for the report."""

    folder: str = field("The folder with its own files, relative to the output folder.")
    reasons: tuple[str, ...] = field("Reasons of a fail verdict.", default=())

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Fail if there is a reason."""
        return verdict_of(not self.reasons)

    @property
    @abstractmethod
    def sentence(self) -> str:
        """Return the result in a few words, for the verdict's line."""

    def line(self, output: Path) -> str:
        """Return its line of the report: where its own summary is in the output folder."""
        return f"{self.heading}: {output / self.folder / 'summary.md'}"
