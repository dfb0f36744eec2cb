"""Outliers of a fleet: robots of one kind, one of which has a mount that is not like those of the others.

A mount varies from robot to robot by more than the error bars of one calibration. So each robot is compared with the
mean and the covariance S of all others that are no outliers, separately by the translation and the rotation of each
mount: with the difference d, the others' number m and the mean C of their covariances,
``T^2 = d^T ((1 + 1/m) S + (C_i - C)_+)^-1 d`` is Hotelling's, with m - 1 degrees of freedom, as the robot is not among
those with which it is compared. S contains the usual error C, so only a robot with larger error bars than usual has its
own on top: the part of ``C_i - C`` without negative eigenvalues. Which are no outliers is found by repetition, from
those near the median in units of the median absolute deviation: a few outliers cannot hide each other.

`FLEET_WISE` is the probability that any robot of a fleet without outliers is named. It is larger than that of the
verdict, as a robot that is named is only looked at, and every robot more is two tests more of each mount. Of 100 robots
with two mounts, one that is off by four standard deviations of the fleet, norms of three axes as everywhere here, is
found with a probability of 0.97; one that is off by four of a single axis, with 0.16: as its own deviation comes on
top, no test of so many robots finds it reliably without naming others.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.base.records import field, result
from calibration.engine.baseline.calibration_document import CalibratedPose
from calibration.engine.baseline.comparison import MAD_TO_SIGMA, t_squared_tail
from calibration.engine.geometry.transforms import local, retract

FLEET_WISE = 0.05
MIN_ROBOTS = 8
"""Robots with a mount from which on they are compared: the test needs four degrees of freedom."""
MIN_SIGMA = 1e-6
"""Lower limit of a fleet's standard deviation on each axis: a micrometre, a microradian."""
MAX_START_DISTANCE = 11.3
"""Squared distance from the median of the first robots to compare with: 99 % of chi-squared with 3."""
MAX_REPETITIONS = 20
PARTS_OF_TWIST = (slice(3), slice(3, 6))
"""Translation and rotation."""


@result(kw_only=True)
class MountOfRobot:
    """Mount of one robot, compared with those of the others of its fleet."""

    robot: str = field("The robot.")
    name: str = field("The sensor or the transform, with its system.")
    mm: float = field("Distance from the fleet's median.", unit="mm")
    deg: float = field("Rotation from the fleet's median.", unit="degrees")
    sigma_mm: float = field("Standard deviation of its calibration, the norm of three axes.", unit="mm")
    sigma_deg: float = field("Standard deviation of its calibration, the norm of three axes.", unit="degrees")
    sigmas_translation: float = field("Distance from the mean of the others in their standard deviations: root of T^2.")
    sigmas_rotation: float = field("Rotation from the mean of the others, likewise.")
    outlier: bool = field("Whether it is significant, family-wise over the fleet.")


@result(kw_only=True)
class MountOfFleet:
    """Mount that all robots of a fleet have."""

    name: str = field("The sensor or the transform, with its system.")
    fleet_sigma_mm: float = field("Spread of the fleet without outliers, the norm of three axes.", unit="mm")
    fleet_sigma_deg: float = field("Spread of the fleet without outliers, the norm of three axes.", unit="degrees")
    robots: tuple[MountOfRobot, ...] = field("Each robot that has it.")


def compare_fleet(mounts: Mapping[str, Mapping[str, CalibratedPose]]) -> tuple[MountOfFleet, ...]:
    """Compare the robots of a fleet by each mount that at least `MIN_ROBOTS` of them have.

    Args:
        mounts: by the name of the mount and that of the robot.
    """
    compared = {name: poses for name, poses in mounts.items() if len(poses) >= MIN_ROBOTS}
    level = FLEET_WISE / max(1, 2 * sum(map(len, compared.values())))
    return tuple(_compare_mount(name, list(poses), list(poses.values()), level) for name, poses in compared.items())


def _compare_mount(name: str, robots: Sequence[str], poses: Sequence[CalibratedPose], level: float) -> MountOfFleet:
    T = np.array([pose.matrix for pose in poses])
    centre = T[0]
    for _ in range(MAX_REPETITIONS):
        step = np.median(local(centre, T), axis=0)
        centre = retract(centre, step)
        if np.abs(step).max() < MIN_SIGMA:
            break
    d = local(centre, T)
    C = np.array([np.zeros((6, 6)) if pose.covariance is None else pose.covariance for pose in poses])
    parts = [_squared_distances(d[:, at], C[:, at, at], level) for at in PARTS_OF_TWIST]
    spreads = [
        float(np.sqrt(np.var(d[usual, at], axis=0, ddof=1).sum()))
        for (_, usual), at in zip(parts, PARTS_OF_TWIST, strict=True)
    ]
    (translations, near), (rotations, turned_little) = parts
    sizes = np.linalg.norm(d.reshape(-1, 2, 3), axis=2)
    own = np.sqrt(np.diagonal(C, axis1=1, axis2=2).reshape(-1, 2, 3).sum(axis=2))
    return MountOfFleet(
        name=name,
        fleet_sigma_mm=_significant(1e3 * spreads[0]),
        fleet_sigma_deg=_significant(math.degrees(spreads[1])),
        robots=tuple(
            MountOfRobot(
                robot=robot,
                name=name,
                mm=_significant(1e3 * sizes[i, 0]),
                deg=_significant(math.degrees(sizes[i, 1])),
                sigma_mm=_significant(1e3 * own[i, 0]),
                sigma_deg=_significant(math.degrees(own[i, 1])),
                sigmas_translation=_significant(math.sqrt(translations[i])),
                sigmas_rotation=_significant(math.sqrt(rotations[i])),
                outlier=not (near[i] and turned_little[i]),
            )
            for i, robot in enumerate(robots)
        ),
    )


def _squared_distances(x: Array, C: Array, level: float) -> tuple[Array, BoolArray]:
    """Return T^2 of each robot against the others (n,), and which are no outliers (n,).

    Args:
        x: (n, 3), differences from any point.
        C: (n, 3, 3), covariances of the calibrations.
        level: of significance of each.
    """
    median = np.median(x, axis=0)
    scale = np.maximum(MAD_TO_SIGMA * np.median(np.abs(x - median), axis=0), MIN_SIGMA)
    distance = (((x - median) / scale) ** 2).sum(axis=1)
    usual = distance <= max(MAX_START_DISTANCE, float(np.median(distance)))
    for _ in range(MAX_REPETITIONS):
        squared, freedom = _distances_from_others(x, C, usual)
        now = np.array([t_squared_tail(T2, 3, m) >= level for T2, m in zip(squared, freedom, strict=True)])
        if (now == usual).all():
            break
        usual = now
    return squared, usual


def _distances_from_others(x: Array, C: Array, usual: BoolArray) -> tuple[Array, Array]:
    """Return T^2 of each robot against the usual others (n,), and its degrees of freedom (n,).

    Mean and covariance without one of M robots are those of all, of which its share is taken away.
    """
    M = int(usual.sum())
    if M < 4:
        return np.zeros(len(x)), np.zeros(len(x))
    S = np.cov(x[usual].T) + MIN_SIGMA**2 * np.eye(3)
    d = x - x[usual].mean(axis=0)
    outer = d[:, :, None] * d[:, None, :]
    without = ((M - 1) * S - M / (M - 1) * outer) / (M - 2)
    S_of_others = np.where(usual[:, None, None], without, S)
    C_of_others = (C[usual].sum(axis=0) - usual[:, None, None] * C) / (M - usual)[:, None, None]
    d = d * np.where(usual, M / (M - 1), 1.0)[:, None]
    values, vectors = np.linalg.eigh(C - C_of_others)
    larger = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    m = M - usual
    V = (1 + 1 / m)[:, None, None] * S_of_others + larger
    squared: Array = (d * np.linalg.solve(V, d[:, :, None])[:, :, 0]).sum(axis=1)
    return squared, np.asarray(m - 1.0, dtype=np.float64)


def _significant(value: float) -> float:
    return float(f"{value:.4g}")
