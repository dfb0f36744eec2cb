"""Comparison of calibrations with a significance test: of two of the same robot, and of the robots of a fleet.

The difference d of two poses is a twist in the child frame of the first. For independent recordings its covariance is
``C = C_1 + C_2 - sum (m_1 m_2^T + m_2 m_1^T)``, where m are the effects of fixed parameters that both have in common:
their error is the same in both and moves both results alike. If nothing has moved, ``d^T C^-1 d`` is Hotelling's T^2,
as the C are estimated from collections: with k = 6 parameters and n degrees of freedom, those of the effective
collections of both, ``T^2 (n - k + 1) / (k n)`` is F-distributed (H. Hotelling, "The generalization of Student's
ratio", 1931). On the same data the result is deterministic, so every difference counts.

A fleet has robots of one kind, one of which may have a mount that is not like those of the others. A mount
varies from robot to robot by more than the error bars of one calibration. So each robot is compared with the mean and
the covariance S of all others that are no outliers, separately by the translation and the rotation of each
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
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.base.records import field, result
from calibration.engine.baseline.calibration_document import (
    POSITIONS_INPUT,
    CalibratedParameter,
    CalibratedPose,
    CalibrationDocument,
    significant_value,
)
from calibration.engine.geometry.transforms import local, retract
from calibration.engine.statistics import (
    FAMILY_WISE,
    MAD_TO_SIGMA,
    MOST_FREEDOM,
    score_of_f,
    squared_mahalanobis,
    t_squared_quantile,
    t_squared_tail,
)

Kind = Literal["pose", "parameter", "lens", "added", "removed"]


@result(kw_only=True)
class BaselineChange:
    """Difference of one calibrated transform or parameter from an earlier one."""

    name: str = field("The sensor, the transform or the parameter.")
    kind: Kind = field(
        "pose, parameter, lens (all parameters of a camera together); added and removed where only one of the two "
        "calibrations has it."
    )
    translation_mm: tuple[float, ...] = field("Translation, in the earlier child frame.", unit="mm", default=())
    rotation_deg: tuple[float, ...] = field("Rotation vector, in that frame.", unit="degrees", default=())
    value: float | None = field("Difference of a parameter.", default=None)
    unit: str | None = field("Of a parameter.", default=None)
    mm: float = field("Norm of the translation.", unit="mm", default=0.0)
    deg: float = field("Angle of the rotation.", unit="degrees", default=0.0)
    sigma_mm: float = field("Standard deviation of the translation, the norm of three axes.", unit="mm", default=0.0)
    sigma_deg: float = field("Standard deviation of the rotation, the norm of three axes.", unit="degrees", default=0.0)
    sigma: float | None = field("Standard deviation of the difference of a parameter.", default=None)
    sigmas: float = field("The difference in standard deviations: the root of T^2.", default=0.0)
    p: float = field("Probability of so large a difference if nothing has moved.", default=1.0)
    unseen_mm: float = field(
        "Largest displacement that would not be significant, in the worst direction.",
        unit="mm",
        default=0.0,
    )


@dataclass(frozen=True)
class BaselineComparison:
    """Comparison of two calibrations of one system."""

    before: CalibrationDocument
    now: CalibrationDocument
    changes: tuple[BaselineChange, ...]

    @property
    def same_data(self) -> bool:
        """Whether both are calibrated from the same labels."""
        return self.before.data == self.now.data

    @property
    def other_inputs(self) -> tuple[str, ...]:
        """Inputs other than the labels that differ."""
        before, now = self.before.inputs, self.now.inputs
        changed = [name for name in now if before.get(name, now[name]) != now[name]]
        if not self.same_data:
            changed = [name for name in changed if name != POSITIONS_INPUT]
        engines = [f"the engine ({self.before.engine} to {self.now.engine})"]
        return (*changed, *(engines if self.before.engine != self.now.engine else []))

    @property
    def significance(self) -> float:
        """Significance level of each single difference: family-wise over all of them (Bonferroni)."""
        return FAMILY_WISE / max(1, sum(each.kind in ("pose", "parameter", "lens") for each in self.changes))


def compare(before: CalibrationDocument, now: CalibrationDocument) -> BaselineComparison:
    """Compare an accepted calibration with another."""
    same = before.data == now.data
    earlier = {each.edge: each for each in before.poses}
    later = {each.edge: each for each in now.poses}
    values = {each.name: each for each in before.parameters}
    new_values = {each.name: each for each in now.parameters}
    lenses = [] if same else sorted(before.lens_correlations.keys() & now.lens_correlations.keys())
    count = len(earlier.keys() & later.keys()) + len(values.keys() & new_values.keys()) + len(lenses)
    freedom = _degrees_of_freedom(before, now)
    threshold = t_squared_quantile(FAMILY_WISE / max(1, count), freedom)
    changes = [_pose_change(earlier[edge], later[edge], same, threshold, freedom) for edge in earlier if edge in later]
    changes += [
        _parameter_change(values[name], new_values[name], same, freedom) for name in values if name in new_values
    ]
    changes += [each for name in lenses if (each := _lens_change(before, now, name, freedom))]
    changes += _unmatched_changes({each.name for each in earlier.values()}, {each.name for each in later.values()})
    changes += _unmatched_changes(values.keys(), new_values.keys())
    return BaselineComparison(before, now, tuple(changes))


def _degrees_of_freedom(before: CalibrationDocument, now: CalibrationDocument) -> float:
    """Degrees of freedom of the covariance of a difference; infinite if unknown."""
    known = [each.effective_collections for each in (before, now)]
    return sum(each - 1 if each is not None else math.inf for each in known)


def _unmatched_changes(before: Set[str], now: Set[str]) -> Iterator[BaselineChange]:
    for name in sorted(before - now):
        yield BaselineChange(name=name, kind="removed")
    for name in sorted(now - before):
        yield BaselineChange(name=name, kind="added")


def _pose_change(
    before: CalibratedPose, now: CalibratedPose, same: bool, threshold: float, freedom: float
) -> BaselineChange:
    d = local(before.matrix, now.matrix)
    C = _label_covariance(before) if same else covariance_of_difference(before, now)
    chi_squared, worst = (0.0, 0.0) if C is None else _chi_squared(d, C)
    sizes = (0.0, 0.0) if C is None else _twist_norms(np.sqrt(np.diagonal(C)))
    if C is None and np.abs(d).max() > 0:
        chi_squared = math.inf  # fixed in both: no standard deviation, and no noise
    mm, deg = _twist_norms(d)
    return BaselineChange(
        name=now.name,
        kind="pose",
        translation_mm=_round_values(1e3 * d[:3]),
        rotation_deg=_round_values(np.degrees(d[3:])),
        mm=round(mm, 6),
        deg=round(deg, 8),
        sigma_mm=round(sizes[0], 6),
        sigma_deg=round(sizes[1], 8),
        sigmas=_finite_number(math.sqrt(chi_squared)),
        p=t_squared_tail(chi_squared, 6, freedom),
        unseen_mm=round(min(1e3 * math.sqrt(threshold) * worst, 1e9), 4),
    )


def _parameter_change(
    before: CalibratedParameter, now: CalibratedParameter, same: bool, freedom: float
) -> BaselineChange:
    difference = now.value - before.value
    variances = [each.sigma**2 for each in (before, now)]
    if same:
        variances = [(before.label_sigma if before.label_sigma is not None else before.sigma) ** 2]
    sigma = math.sqrt(sum(variances))
    sigmas = abs(difference) / sigma if sigma > 0 else (math.inf if difference else 0.0)
    return BaselineChange(
        name=now.name,
        kind="parameter",
        value=difference,
        unit=now.unit,
        mm=1e3 * abs(difference) if now.unit == "m" else 0.0,
        deg=math.degrees(abs(difference)) if now.unit == "rad" else 0.0,
        sigma=sigma,
        sigma_mm=1e3 * sigma if now.unit == "m" else 0.0,
        sigma_deg=math.degrees(sigma) if now.unit == "rad" else 0.0,
        sigmas=_finite_number(sigmas),
        p=t_squared_tail(sigmas**2, 1, freedom),
    )


def _lens_change(
    before: CalibrationDocument, now: CalibrationDocument, camera: str, freedom: float
) -> BaselineChange | None:
    """Compare all parameters of a camera together, which make up for each other; None for another lens model.

    Of its covariance only a factor is estimated from the collections, by all k parameters of each, so that the squared
    distance over k is F-distributed with k and k n degrees of freedom.
    """
    earlier, later = before.lens(camera), now.lens(camera)
    if earlier is None or later is None or earlier[0] != later[0]:
        return None
    chi_squared, k = squared_mahalanobis(later[1] - earlier[1], earlier[2] + later[2]), len(earlier[0])
    score = float(score_of_f(chi_squared / k, k, k * min(max(freedom, 1.0), MOST_FREEDOM)))
    return BaselineChange(
        name=f"{camera}'s lens",
        kind="lens",
        sigmas=_finite_number(math.sqrt(chi_squared)),
        p=0.5 * math.erfc(score / math.sqrt(2)),
    )


def _label_covariance(pose: CalibratedPose) -> Array | None:
    """Covariance (6, 6) from the labels' noise alone, without that of fixed parameters; None for a fixed pose."""
    C = pose.covariance
    if C is None or pose.label_sigma_mm is None or pose.label_sigma_deg is None:
        return C
    scale = np.repeat([pose.label_sigma_mm, pose.label_sigma_deg], 3)
    scale = scale / np.repeat(np.maximum(_twist_norms(np.sqrt(np.diagonal(C))), 1e-300), 3)
    return C * np.outer(scale, scale)


def covariance_of_difference(before: CalibratedPose, now: CalibratedPose) -> Array | None:
    """Covariance (6, 6) of the difference of two poses from independent recordings; None if both are fixed."""
    parts = [each for each in (before.covariance, now.covariance) if each is not None]
    if not parts:
        return None
    alike = [before.moves(name).T @ now.moves(name) for name in before.held.keys() & now.held.keys()]
    return np.asarray(np.sum([*parts, *(-each - each.T for each in alike)], axis=0))


def _chi_squared(d: Array, C: Array) -> tuple[float, float]:
    """Return ``d^T C^-1 d``, and the largest standard deviation of a translation in any direction, m."""
    return squared_mahalanobis(d, C), float(np.sqrt(np.linalg.eigvalsh(C[:3, :3])[-1]))


def _twist_norms(d: Array) -> tuple[float, float]:
    """Return the norms of a twist (6,) in m and rad, as mm and degrees."""
    return 1e3 * float(np.linalg.norm(d[:3])), float(np.degrees(np.linalg.norm(d[3:])))


def _round_values(values: Array) -> tuple[float, ...]:
    return tuple(round(float(v), 8) + 0.0 for v in values)


def _finite_number(value: float) -> float:
    return round(min(value, 1e9), 4)


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
        fleet_sigma_mm=significant_value(1e3 * spreads[0], 4),
        fleet_sigma_deg=significant_value(math.degrees(spreads[1]), 4),
        robots=tuple(
            MountOfRobot(
                robot=robot,
                name=name,
                mm=significant_value(1e3 * sizes[i, 0], 4),
                deg=significant_value(math.degrees(sizes[i, 1]), 4),
                sigma_mm=significant_value(1e3 * own[i, 0], 4),
                sigma_deg=significant_value(math.degrees(own[i, 1]), 4),
                sigmas_translation=significant_value(math.sqrt(translations[i]), 4),
                sigmas_rotation=significant_value(math.sqrt(rotations[i]), 4),
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
