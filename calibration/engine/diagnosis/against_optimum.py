"""Comparison of another software's calibration with the optimum of the same labels.

Both explain the same labels, so the noise of the labels does not explain a difference: two programs that minimise the
same errors agree to a small fraction of a standard deviation. The distance is reported in three ways:

- the cost of the labels at the other calibration, minimised over the patterns' poses, minus the cost at the optimum.
  Near the optimum it is ``d^T S d``, with d the difference of the shared parameters and S their information (the Schur
  complement of the normal equations), so its root is the Mahalanobis distance (1936), in standard deviations by
  the noise of the labels alone. Directions that labels do not determine, the gauge, add no cost;
- mm and degrees of each sensor, or of each pair if only relative poses are determined;
- the parameters of joints.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base import CalibrationError, UndeterminedError
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import prepare
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.guesses import cost_of
from calibration.engine.estimation.start.wrong_views import without
from calibration.engine.evaluation.truth import PoseError, TruthError, error_against
from calibration.engine.geometry.cameras import Camera
from calibration.engine.statistics import score_of_tail

MAX_UNCHANGED_DISTANCE = 1e-3
"""mm, degrees: a result closer than this to its initial guess is unchanged."""
SAME_INTRINSICS = 1e-6
"""Relative or absolute tolerance of intrinsics: smaller differences are due to rounding."""
SIGNIFICANCE_LEVEL = 1e-3
"""Significance level: a distance from the optimum that the labels' noise exceeds less often than this is noticeable."""
MAX_NAMED_SENSORS = 3
"""Number of sensors that a message names."""


@dataclass(frozen=True, eq=False)
class OurOptimum:
    """Optimum of a dataset, the reference for other calibrations."""

    given: Dataset
    """The dataset that was calibrated."""
    options: Options
    calibration: Calibration
    relative: bool
    """Whether the labels determine only the relative poses of the sensors."""
    parameters: int
    """Number of shared parameters that the labels determine."""

    @property
    def noticeable(self) -> float:
        """Cost above the optimum that is significant: a quantile of chi-squared.

        By the approximation of E. B. Wilson and M. M. Hilferty ("The distribution of chi-square", 1931).
        """
        ninth = 2 / (9 * self.parameters)
        return float(self.parameters * (1 - ninth + score_of_tail(SIGNIFICANCE_LEVEL) * np.sqrt(ninth)) ** 3)

    @cached_property
    def cost(self) -> float:
        """Cost of the labels at the optimum."""
        return self.cost_of(self.calibration.dataset)

    def cost_of(self, dataset: Dataset) -> float:
        """Return the cost at other transforms, with the same labels (but rejected views) and weights."""
        kept = without(dataset, self.calibration.dropped_views)
        return cost_of(kept, self.options, self.calibration.noise_levels)


def find_optimum(dataset: Dataset, options: Options) -> OurOptimum:
    """Calibrate a dataset from the linear initial guess and return the optimum.

    Raises:
        UndeterminedError: the data do not determine the parameters, or there is no optimum.
        InputError: the labels cannot be used.
    """
    calibration = prepare(dataset, options).optimum
    if not calibration.converged:
        raise UndeterminedError(f"{dataset.path}: {calibration.reason}")
    names = {each for sensor in dataset.sensors.values() for each in (sensor.name, "-".join(sensor.edge))}
    kept = without(dataset, calibration.dropped_views)
    setup = build(kept, [name for name in options.hold if name not in names])
    return OurOptimum(dataset, options, calibration, setup.gauge is not None, setup.problem.sizes[0])


def optimum_for(optimum: OurOptimum, found: Dataset) -> OurOptimum:
    """Return the optimum with the intrinsics of a calibrated dataset, if the labels fit better with these.

    Software may calibrate intrinsics too: then it is compared with the optimum for its intrinsics.

    Args:
        optimum: of the same labels.
        found: the calibrated dataset.
    """
    cameras = _other_cameras(found, optimum.given)
    if not cameras or optimum.cost_of(found) >= optimum.cost:
        return optimum
    options = replace(optimum.options, intrinsics=(), intrinsics_covariance=None)
    try:
        return find_optimum(optimum.given.with_cameras(cameras), options)
    except CalibrationError:
        return optimum


def against_optimum(optimum: OurOptimum, found: Dataset, start: Dataset, limits: Limits) -> tuple[Finding, ...]:
    """Report the distance of a calibrated dataset from the optimum; a failure if it exceeds the limits.

    Args:
        optimum: of the same labels.
        found: the calibrated dataset.
        start: the initial guess of the calibration.
        limits: of the system.

    Raises:
        InputError: something in the dataset is missing.
    """
    excess = optimum.cost_of(found) - optimum.cost
    error = error_against(found, optimum.calibration.dataset, optimum.relative)
    far = sorted(
        _distances_beyond_limits(optimum, error, limits, abs(excess) > optimum.noticeable), key=lambda each: -each[0]
    )
    mm, deg = error.translation_mm, error.rotation_deg
    away = float(np.sqrt(max(excess, 0.0))) if np.isfinite(excess) else None
    numbers = Finding("against-optimum", "note", "", value=away, unit="1", moves_mm=mm, moves_deg=deg)
    cost = _describe_cost(away, excess)
    if not far:
        distance = f"{max(mm, 0.01):.2g} mm and {max(deg, 0.001):.2g} deg"
        text = f"the software's calibration is within {distance} of our optimum on the same labels"
        return (replace(numbers, text=f"{text}; {cost}" if excess > optimum.noticeable else text),)
    what = "; ".join(text for _, text, _ in far[:MAX_NAMED_SENSORS])
    more = f"; and {len(far) - MAX_NAMED_SENSORS} more" if len(far) > MAX_NAMED_SENSORS else ""
    names = tuple(dict.fromkeys(name for _, _, sensors in far for name in sensors))
    hint = _hint_to_cause(optimum, found, start)
    text = f"the software's calibration is far from our optimum on the same labels: {what}{more}; {cost}{hint}"
    return (replace(numbers, severity="red", text=text, sensors=names),)


def _distances_beyond_limits(
    optimum: OurOptimum, error: TruthError, limits: Limits, noticeable: bool
) -> Iterator[tuple[float, str, tuple[str, ...]]]:
    """Yield each distance beyond its limit: the ratio to the limit, a description, and the sensors.

    A limit that the user has not set counts only if the distance is significant.
    """
    mm, deg = limits.sensor
    count_mm, count_deg = (
        noticeable or limits.translation_mm is not None,
        noticeable or limits.rotation_deg is not None,
    )
    is_set = "" if limits.translation_mm is not None and limits.rotation_deg is not None else ", as none is set"
    for pose in error.poses:
        times = max(
            _ratio_to_limit(pose.translation_mm, mm) * count_mm, _ratio_to_limit(pose.rotation_deg, deg) * count_deg
        )
        if not times <= 1:
            sensors = _sensors_of_error(optimum.given, pose)
            where = " to ".join(f"'{name}'" for name in sensors)
            limit = f"limit {mm:.3g} mm, {deg:.2g} deg{is_set}"
            yield times, f"{where} by {_format_motion(pose.translation_mm, pose.rotation_deg)} ({limit})", sensors
    for joint in error.joints:
        calibrated = optimum.calibration.joints.get(joint.joint)
        length = joint.unit == "m"
        if calibrated is None or joint.parameter not in calibrated.parameters:
            continue  # fixed in the optimum
        if not noticeable and (limits.joint_mm if length else limits.joint_deg) is None:
            continue
        off, limit_of_joint = (
            1e3 * joint.error if length else float(np.degrees(joint.error)),
            limits.joint[not length],
        )
        if not _ratio_to_limit(off, limit_of_joint) <= 1:
            unit = "mm" if length else "deg"
            text = (
                f"'{joint.parameter}' of joint '{joint.joint}' by {off:.3g} {unit} (limit {limit_of_joint:.3g} {unit})"
            )
            yield _ratio_to_limit(off, limit_of_joint), text, ()


def _format_motion(mm: float, deg: float) -> str:
    """Format a displacement and a rotation, rounded to the micrometre and similarly small angles."""
    return f"{round(mm, 3 if mm < 1 else 2):g} mm and {round(deg, 4 if deg < 0.1 else 2):g} deg"


def _ratio_to_limit(off: float, limit: float) -> float:
    return off / limit if limit > 0 else float("inf") if off > 0 else 0.0


def _sensors_of_error(dataset: Dataset, pose: PoseError) -> tuple[str, ...]:
    """Return the sensors of an error: one, or the two of a pair."""
    pairs = {f"{a}/{b}": (a, b) for a in dataset.sensors for b in dataset.sensors}
    return (pose.name,) if pose.name in dataset.sensors else pairs[pose.name]


def _other_cameras(found: Dataset, given: Dataset) -> dict[str, Camera]:
    """Return the cameras whose intrinsics differ from those of the given dataset."""
    other = {}
    for name, sensor in found.sensors.items():
        one, two = sensor.camera, given.sensors[name].camera
        if one is not None and two is not None:
            same = one.parameters == two.parameters and np.allclose(
                one.intrinsics, two.intrinsics, rtol=SAME_INTRINSICS, atol=SAME_INTRINSICS
            )
            if not same:
                other[name] = one
    return other


def _describe_cost(away: float | None, excess: float) -> str:
    """Describe the cost above the optimum."""
    if away is None:
        return "no pose of the pattern fits the labels there"
    return f"{away:.3g} standard deviations of the labels' noise away (cost {max(excess, 0.0):.3g} above the optimum)"


def _hint_to_cause(optimum: OurOptimum, found: Dataset, start: Dataset) -> str:
    """Return a hint to the cause of the distance."""
    for guess in (start, optimum.given):  # software that adds its own noise starts at the given dataset
        moved = error_against(found, guess, optimum.relative)
        joints = max(moved.joint_mm or 0.0, moved.joint_deg or 0.0)
        if max(moved.translation_mm, moved.rotation_deg, joints) < MAX_UNCHANGED_DISTANCE:
            return ". It has returned its start unchanged: does it write what it has calibrated?"
    if cameras := list(_other_cameras(found, optimum.given)):
        return f". It has other intrinsics of {_list_names(cameras)}, with which the labels fit no better"
    return ". Has it stopped early, or does it minimise something else?"


def _list_names(names: list[str]) -> str:
    return ", ".join(f"'{name}'" for name in names[:MAX_NAMED_SENSORS]) + (
        ", ..." if len(names) > MAX_NAMED_SENSORS else ""
    )
