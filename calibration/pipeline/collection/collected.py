"""A collection in simulation as one line of a pipeline's results."""

from calibration.records import computed, field, result
from calibration.report import Verdict, verdict_of
from calibration.report.outcome import ErrorCode

COLLECTED = "collected"
"""The folder of what was collected, in a pipeline's output folder."""


@result
class Collected:
    """Result of one entry of ``simulation`` in calibration.yml."""

    name: str = field("The entry in calibration.yml.")
    poses: int = field("Poses of the motion.", default=0)
    kept: int = field("Collections in the dataset.", default=0)
    corner_rms_px: float | None = field("Detected corners against the true ones.", unit="px", default=None)
    rms_px: float | None = field("Of the calibration of the dataset.", unit="px", default=None)
    translation_mm: float | None = field(
        "The worst error of a calibrated sensor against the truth.", unit="mm", default=None
    )
    rotation_deg: float | None = field("Likewise.", unit="deg", default=None)
    dataset: str | None = field("Its folder, relative to the output folder.", default=None)
    reasons: tuple[str, ...] = field("Why the verdict is fail.", default=())
    error: ErrorCode | None = field("Exit code of a collection that could not be made.", default=None)
    seconds: float = field("How long it took.", default=0.0)

    @property
    @computed()
    def verdict(self) -> Verdict:
        """Fail if there is a reason or an error."""
        return verdict_of(not self.reasons and self.error is None)
