"""What came of one scenario."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class ScenarioResult:
    """What came of one world. Numbers are None where there are none."""

    id: str
    hash: str
    """Of its content (`content_hash`): equal worlds have equal hashes."""
    values: Mapping[str, float]
    """Its parameters."""
    poses: int = 0
    """Of its motion; 0 where none was found."""
    lost: Mapping[str, tuple[str, ...]] | None = None
    """The poses that gave no collection, by key, and why."""
    detection: Mapping[str, float] | None = None
    """The share of the poses at which each sensor detects a pattern."""
    corner_rms_px: float | None = None
    """Detected corners against the true ones."""
    converged: bool = False
    rms_px: float | None = None
    """Of the reprojected corners."""
    translation_mm: float | None = None
    """The worst error of a calibrated sensor against the truth."""
    rotation_deg: float | None = None
    joint_mm: float | None = None
    """The worst error of a calibrated joint against the truth, of those that are lengths, and of the angles."""
    joint_deg: float | None = None
    sigma_mm: float | None = None
    """The standard deviation that the calibration states, of the sensor of which it is least sure."""
    sigma_deg: float | None = None
    reasons: tuple[str, ...] = ()
    """Why there is no calibration; empty where there is one."""

    @property
    def kept(self) -> int:
        """How many poses gave a collection."""
        return self.poses - len(self.lost or {})
