"""Limits of the errors of a result, with or without ground truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from calibration.base.arrays import Array
from calibration.base.records import at_least, between, field, one_of, record
from calibration.engine.estimation.covariance.result import Calibration

Limit = Annotated[float, at_least(0)]
_LIMIT_NAMES = ("rms-px", "translation-mm", "rotation-deg", "joint-mm", "joint-deg", "projection-px")
DEFAULT_LIMIT_SIGMAS = 3.0
"""Default limit, in standard deviations of a good robot of this kind (`covariance.nominal_covariance`),"""
MIN_DEFAULT_LIMIT = (1.0, 0.05)
"""but at least this, mm and degrees,"""
MAX_DEFAULT_LIMIT = (6.0, 0.5)
"""and at most this: mm for each metre between sensor and pattern (and for less than one), and degrees."""
MAX_DEFAULT_LIMIT_OF_POSES = 10.0
"""The same of measured poses, mm for each metre: those of a pattern by a camera of its own are no better."""
MAX_DEFAULT_LIMIT_WITH_LENS = 2.0
"""Degrees at most where the camera's intrinsics are calibrated too: its principal point is as good as a rotation."""
SENSOR_UNITS = ("m", "rad")
TWIST_UNITS = ("m",) * 3 + ("rad",) * 3
"""Units of a transform's parameters."""


@record(rules=(one_of(*_LIMIT_NAMES, why=f"expected a limit: {', '.join(_LIMIT_NAMES)}"),))
class Limits:
    """Limits that every cell must meet; None for no limit."""

    rms_px: Limit | None = field("Root mean square of the table's errors.", default=None, unit="px")
    translation_mm: Limit | None = field(
        "Error of a sensor: against the truth, or what something that does not fit moves it by.",
        default=None,
        unit="mm",
    )
    rotation_deg: Limit | None = field("Rotation error of a sensor, likewise.", default=None, unit="degrees")
    joint_mm: Limit | None = field("Error of a joint's length, likewise.", default=None, unit="mm")
    joint_deg: Limit | None = field("Error of a joint's angle, likewise.", default=None, unit="degrees")
    projection_px: Limit | None = field(
        "Error of the projection of a camera whose intrinsics are calibrated, in nine tenths of the image where the "
        "pattern was seen, at its distance. By default 0.4 % of the image's longer side, of a camera alone.",
        default=None,
        unit="px",
    )
    guard_band: Annotated[float, between(0, 10)] | None = field(
        "Guard band of the limits without a truth, in standard deviations (2).", default=None
    )
    by_tasks: bool = False
    """Whether tasks of the robot have limits: then those of sensors and joints that are not set ask nothing."""

    @property
    def any_set(self) -> bool:
        """Whether any limit of a sensor, a joint or a task is set: then those that are not ask nothing."""
        return self.by_tasks or any(
            each is not None for each in (self.translation_mm, self.rotation_deg, self.joint_mm, self.joint_deg)
        )

    @property
    def sensor(self) -> tuple[float, float]:
        """Limits of a sensor's displacement (mm) and rotation (degrees), set or default."""
        return _limit_or_least(self.translation_mm, MIN_DEFAULT_LIMIT[0]), _limit_or_least(
            self.rotation_deg, MIN_DEFAULT_LIMIT[1]
        )

    @property
    def joint(self) -> tuple[float, float]:
        """Limits of a joint's length (mm) and angle (degrees), set or default."""
        return _limit_or_least(self.joint_mm, MIN_DEFAULT_LIMIT[0]), _limit_or_least(
            self.joint_deg, MIN_DEFAULT_LIMIT[1]
        )

    @property
    def guard(self) -> float:
        """Width of the guard band, in standard deviations."""
        return 2.0 if self.guard_band is None else self.guard_band


def _limit_or_least(limit: float | None, least: float) -> float:
    return least if limit is None else limit


@dataclass(frozen=True)
class Allowed:
    """Allowed displacement and rotation of a sensor or a joint; infinite where nothing is asked."""

    translation_mm: float
    rotation_deg: float
    set: bool
    """Whether the user has set any of the limits."""

    def exceeded(self, translation_mm: float, rotation_deg: float) -> bool:
        """Whether a displacement or a rotation exceeds the limits."""
        return translation_mm > self.translation_mm or rotation_deg > self.rotation_deg

    def share(self, translation_mm: float, rotation_deg: float) -> float:
        """Return a displacement or a rotation as a share of its limit, the larger of both."""
        least = 1e-9  # a limit may be zero
        return max(translation_mm / max(self.translation_mm, least), rotation_deg / max(self.rotation_deg, least))

    def __str__(self) -> str:
        each = ((self.translation_mm, "mm", ".3g"), (self.rotation_deg, "deg", ".2g"))
        limits = ", ".join(
            f"{limit:{form}} {unit}" if limit < np.inf else f"none in {unit}" for limit, unit, form in each
        )
        return limits if self.set else f"{limits}, as none is set"


def allowed(calibration: Calibration, limits: Limits, name: str) -> Allowed:
    """Return the allowed error of a calibrated sensor or joint: the user's limits, or defaults if none is set.

    A default is what a good robot of this kind could state (`covariance.nominal_covariance`): nothing that is wrong
    with this one widens it.
    """
    given = limits_of(calibration, limits, name)
    if limits.any_set:
        mm, degrees = (float("inf") if limit is None else limit for limit in given)
        return Allowed(mm, degrees, True)
    joint, dataset = calibration.joints.get(name), calibration.dataset
    sigma = of_a_good_robot(calibration, name)
    far = 1.0 if joint else max(1.0, _median_distance(calibration, name))
    poses = not joint and dataset.sensors[name].modality.has_poses
    most = (
        (MAX_DEFAULT_LIMIT_OF_POSES if poses else MAX_DEFAULT_LIMIT[0]) * far,
        MAX_DEFAULT_LIMIT_WITH_LENS if name in calibration.intrinsics else MAX_DEFAULT_LIMIT[1],
    )
    mm, degrees = (
        float(min(max(least, DEFAULT_LIMIT_SIGMAS * one), greatest))
        for one, least, greatest in zip(sigma, MIN_DEFAULT_LIMIT, most, strict=True)
    )
    return Allowed(mm, degrees, False)


def of_a_good_robot(calibration: Calibration, name: str) -> tuple[float, float]:
    """Return the standard deviations that a good robot would have with these views, mm and degrees; 0 if unknown.

    Args:
        calibration: a calibration that has converged.
        name: a calibrated sensor or joint.
    """
    return _sigmas_of(calibration, name, calibration.solution.nominal) if calibration.error_bars else (0.0, 0.0)


def of_the_labels(calibration: Calibration, name: str) -> tuple[float, float]:
    """Return the standard deviations of a sensor or joint by the noise of the labels alone, likewise."""
    return _sigmas_of(calibration, name, calibration.error_bars.labels) if calibration.error_bars else (0.0, 0.0)


def _sigmas_of(calibration: Calibration, name: str, covariances: Mapping[int, Array]) -> tuple[float, float]:
    block, units = block_of(calibration, name)
    C = covariances.get(block)
    return (0.0, 0.0) if C is None else sizes(np.sqrt(np.diagonal(C)), units)


def block_of(calibration: Calibration, name: str) -> tuple[int, Sequence[str]]:
    """Return the block of a sensor or joint, and the units of its parameters."""
    joint, dataset = calibration.joints.get(name), calibration.dataset
    edge = dataset.joints[name].edge if joint else dataset.sensors[name].edge
    return calibration.solution.setup.block(edge), joint.units if joint else TWIST_UNITS


def _median_distance(calibration: Calibration, sensor: str) -> float:
    """Return the median distance of a sensor from what it sees, m; 0 if it sees nothing."""
    problem, values = calibration.solution.setup.problem, calibration.solution.values
    seen = [problem.poses(group, values)[:, :3, 3] for group in problem.groups if group.sensor == sensor]
    return float(np.median(np.linalg.norm(np.concatenate(seen), axis=-1))) if seen else 0.0


def limit_in_labels(calibration: Calibration, limits: Limits, sensor: str) -> float:
    """Return how far a sensor's labels are off if it is displaced sideways by its limit, m, or px of a camera."""
    limit = 1e-3 * allowed(calibration, limits, sensor).translation_mm
    camera = calibration.dataset.sensors[sensor].camera
    return limit * camera.fx / max(_median_distance(calibration, sensor), 1e-3) if camera else limit


def limits_of(calibration: Calibration, limits: Limits, name: str) -> tuple[float | None, float | None]:
    """Return the limits that the user has set for a sensor or a joint, mm and degrees."""
    if name in calibration.joints:
        return limits.joint_mm, limits.joint_deg
    return limits.translation_mm, limits.rotation_deg


def sizes(parameters: Array, units: Sequence[str]) -> tuple[float, float]:
    """Return the norms of the parameters (k,) that are lengths, mm, and that are angles, degrees."""
    m, rad = (
        np.linalg.norm([v for v, each in zip(parameters, units, strict=True) if each == unit]) for unit in SENSOR_UNITS
    )
    return 1e3 * float(m), float(np.degrees(rad))


def stated(calibration: Calibration) -> dict[str, tuple[float, float]]:
    """Return the total standard deviations of each calibrated sensor and joint: norms in mm and degrees."""
    sensors = {
        sensor.name: (calibration.sigma_mm(sensor.edge), float(np.degrees(calibration.sigma_mrad(sensor.edge) / 1e3)))
        for sensor in calibration.dataset.sensors.values()
        if sensor.edge in calibration.covariances
    }
    return sensors | {name: sizes(joint.sigmas, joint.units) for name, joint in calibration.joints.items()}
