"""How far a calibration may be moved before it matters."""

from dataclasses import dataclass

LEAST_MM, LEAST_DEG = 1.0, 0.05
"""Where no limit is set: less than this matters to no robot."""


@dataclass(frozen=True)
class Tolerance:
    """The limits of a system, each None where it is not set."""

    translation_mm: float | None = None
    """Of a sensor."""
    rotation_deg: float | None = None
    """Of a sensor."""
    joint_mm: float | None = None
    """Of a joint's parameter that is a length."""
    joint_deg: float | None = None
    """Of a joint's parameter that is an angle."""

    @property
    def sensor(self) -> tuple[float, float]:
        """The largest displacement (mm) and turn (degrees) of a sensor, set or not."""
        return _or(self.translation_mm, LEAST_MM), _or(self.rotation_deg, LEAST_DEG)

    @property
    def joint(self) -> tuple[float, float]:
        """The largest change of a joint's length (mm) and angle (degrees), set or not."""
        return _or(self.joint_mm, LEAST_MM), _or(self.joint_deg, LEAST_DEG)


def _or(limit: float | None, least: float) -> float:
    return least if limit is None else limit
