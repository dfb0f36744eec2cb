"""A collection in simulation as one line of a pipeline's results."""

from dataclasses import dataclass
from typing import Any, Literal

from calibration.errors import ExitCode

COLLECTED = "collected"
"""The folder of what was collected, in a pipeline's output folder."""


@dataclass(frozen=True)
class Collected:
    """What came of one entry of ``simulation`` in calibration.yml."""

    name: str
    poses: int = 0
    kept: int = 0
    corner_rms_px: float | None = None
    """Detected corners against the true ones."""
    rms_px: float | None = None
    """Of the calibration of the dataset."""
    translation_mm: float | None = None
    """The worst error of a calibrated sensor against the truth."""
    rotation_deg: float | None = None
    dataset: str | None = None
    """The folder, relative to the output folder; None where there is none."""
    reasons: tuple[str, ...] = ()
    """Why the verdict is fail; nothing where it is pass."""
    error: ExitCode | None = None
    """The exit code of a collection that could not be made."""
    seconds: float = 0.0

    @property
    def verdict(self) -> Literal["pass", "fail"]:
        """Pass when nothing speaks against it."""
        return "fail" if self.reasons or self.error is not None else "pass"

    @property
    def document(self) -> dict[str, Any]:
        """Its entry in ``results.json``."""
        return {**vars(self), "reasons": list(self.reasons), "verdict": self.verdict}

    @classmethod
    def of_document(cls, entry: dict[str, Any]) -> "Collected":
        """The result of an entry in ``results.json``.

        Raises:
            KeyError, TypeError, ValueError: it is none.
        """
        fields = {key: value for key, value in entry.items() if key != "verdict"}
        error = None if fields["error"] is None else ExitCode(fields["error"])
        return cls(**{**fields, "reasons": tuple(fields["reasons"]), "error": error})
