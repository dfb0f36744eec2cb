"""What a recording says of one sensor's place, the same for every method: moved or not, by what, since when."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from calibration.base.arrays import Array
from calibration.base.records import computed, field, result
from calibration.engine.statistics import t_squared_tail

Placement = Literal["unmoved", "moved", "lens-changed", "cannot-tell"]
MAX_FALSE_ALARM = 5e-4
"""Probability that a sensor that has not moved is called moved."""
SCORE_OF_POWER = 2.326
"""Standard score of 99 %: a displacement of the smallest size that is stated is found with this probability."""
CAMERA_AXES = (("down", "up"), ("to the left", "to the right"), ("counter-clockwise", "clockwise"))
"""Whereto a camera (x right, y down, z forward) turns by a rotation about x, y, z: a negative, a positive one."""


@result(kw_only=True)
class SensorCheck:
    """What a recording says of one sensor against its accepted calibration.

    Rotation and translation are the twist ``local(T_accepted, T_now)``: of the sensor now, in the axes that it had when
    it was accepted.
    """

    sensor: str = field("The sensor, as the baseline names it.")
    method: str = field("Against what it was held: the reference, the arm's motion, another sensor.")
    outcome: Placement = field(
        "moved, lens-changed (focal length or focus) and unmoved are significant or powerful; else cannot-tell."
    )
    reason: str = field("Why, in one sentence.")
    since: float | None = field(
        "From when on, after the recording's first image; null if all along.", unit="s", default=None
    )
    rotation_deg: tuple[float, ...] | None = field("Rotation vector, three numbers.", unit="degrees", default=None)
    rotation_sigma_deg: tuple[float, ...] | None = field("Its standard deviations.", unit="degrees", default=None)
    translation_mm: tuple[float, ...] | None = field("Null where parallax does not tell it.", unit="mm", default=None)
    translation_sigma_mm: tuple[float, ...] | None = field("Its standard deviations.", unit="mm", default=None)
    translation_percent: tuple[float, ...] | None = field(
        "Of a fixed camera, in percent of the distance of the scene, which one camera does not tell.", default=None
    )
    focal_percent: float | None = field("Change of the focal length.", unit="%", default=None)
    p: float | None = field("Probability of so large a difference if nothing has moved.", default=None)
    unseen_deg: float | None = field("Smallest rotation that is found in 99 %.", unit="degrees", default=None)
    unseen_mm: float | None = field("Smallest translation that is found in 99 %.", unit="mm", default=None)
    images: int = field("Images that were looked at.", default=0)

    @property
    @computed()
    def red(self) -> bool:
        """Whether it fails the check."""
        return self.outcome in ("moved", "lens-changed")

    def __str__(self) -> str:
        return f"{self.sensor}: {self.outcome.replace('-', ' ')}: {self.reason}"


def t_squared_limit(parameters: int, freedom: float, probability: float = MAX_FALSE_ALARM) -> float:
    """Return what Hotelling's T^2 exceeds with a probability if nothing has moved; infinite with too few clusters.

    Args:
        parameters: number of parameters.
        freedom: clusters, less the parameters.
        probability: that of the tail.
    """
    if freedom - parameters + 1 < 1:
        return math.inf
    low, high = 0.0, 1.0
    while t_squared_tail(high, parameters, freedom) > probability and high < 1e9:
        high *= 2
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if t_squared_tail(middle, parameters, freedom) > probability else (low, middle)
    return high


def smallest_seen(covariance: Array, part: slice, limit: float) -> float:
    """Return the smallest displacement that a T^2 test finds in 99 %, in the worst direction.

    A displacement of d standard deviations along a unit vector u is found if ``|z + d u|`` exceeds the root of the
    limit, which it does at least where ``z u + d`` does; so ``root + 2.33`` deviations suffice.

    Args:
        covariance: (k, k) of the estimate.
        part: of the parameters, the rotation or the translation.
        limit: of T^2, see `t_squared_limit`.
    """
    worst = float(np.linalg.eigvalsh(covariance[part, part])[-1])
    return (math.sqrt(limit) + SCORE_OF_POWER) * math.sqrt(max(worst, 0.0))


def direction_in_words(rotation_deg: Sequence[float], *, is_camera: bool) -> str:
    """Return the main axis of a rotation, and its sense: ``about y (to the right)``."""
    axis = int(np.argmax(np.abs(rotation_deg)))
    sense = CAMERA_AXES[axis]
    if not is_camera:
        return f"about {'xyz'[axis]}"
    return f"about {'xyz'[axis]} ({sense[int(rotation_deg[axis] > 0)]})"
