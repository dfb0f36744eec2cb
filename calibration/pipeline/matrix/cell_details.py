"""Statistics that a calibration states of itself, for the result of its cell."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.base import UndeterminedError
from calibration.base.arrays import Array
from calibration.engine.baseline.calibration_document import TaskDocument
from calibration.engine.dataset.model import Dataset, Edge
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.dataset.reading import FILE_NAME
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.precision import worst_false_accept
from calibration.engine.diagnosis.robot_tasks import place_in_words
from calibration.engine.estimation.covariance.lens_errors import LensSource
from calibration.engine.estimation.covariance.projection import Projection, given_lens, projection_of
from calibration.engine.estimation.covariance.result import CalibratedJoint, CalibratedLag, Calibration
from calibration.engine.estimation.problem.blocks import CalibratedIntrinsics
from calibration.engine.evaluation.truth import Truth, with_true_values
from calibration.engine.geometry.rotations import rpy_rates, to_quaternion, to_rpy
from calibration.engine.geometry.transforms import distance
from calibration.engine.tasks.placed_task import COLUMNS_OVER_IMAGE, UNIT_PER_SI
from calibration.engine.tasks.task_errors import TaskError, errors_of_robot
from calibration.pipeline.matrix import cell_result

MAX_CAUSES = 5
"""Limit of the reported contributions to the uncertainty."""


def described(
    result: cell_result.CellResult,
    calibration: Calibration,
    description: Dataset,
    limits: Limits,
    tasks: Sequence[TaskError] = (),
    truth: Truth | None = None,
) -> cell_result.CellResult:
    """Return the result with the calibration's own statistics, and the errors of the robot's tasks.

    Raises:
        InputError: the truth lacks a sensor or a joint.
    """
    true = None
    if tasks and truth is not None:
        cameras = {name: sensor.camera for name, sensor in description.sensors.items() if sensor.camera}
        true = with_true_values(calibration.solution.dataset, truth).with_cameras(cameras)
    details = cell_result.Details(
        transforms=tuple(
            _describe_transform(calibration, description, edge)
            for edge in calibration.transforms
            if not calibration.of_cameras_alone  # whose place is an origin, and nothing that was calibrated
        ),
        joints=tuple(row for joint in calibration.joints.values() for row in _describe_parameters(joint.name, joint)),
        intrinsics=tuple(
            row for name, camera in calibration.intrinsics.items() for row in _describe_parameters(name, camera)
        ),
        lags=tuple(_describe_lag(name, lag) for name, lag in calibration.lags.items()),
        projection=_projection_results(calibration) if calibration.converged else (),
        iterations=calibration.iterations,
        cost=calibration.cost,
        degrees_of_freedom=calibration.degrees_of_freedom,
        noise_levels=calibration.noise_levels,
        held=calibration.gauge,
        weak_directions=tuple(calibration.weak_directions),
        rejected_labels=tuple(calibration.rejected),
        dropped_views=calibration.dropped_views,
        effective_collections=round(bars.effective_collections, 2) if (bars := calibration.error_bars) else None,
        hangs_on=_largest_causes(bars.worth) if bars else (),
        task_maps=tuple(map(_map_of_task, tasks)),
        recording=_describe_recording(description),
    )
    return replace(
        result,
        converged=calibration.converged,
        sigma=_largest_deviation(calibration) if calibration.converged else None,
        label_sigma=_largest_deviation(calibration, labels_only=True) if calibration.converged else None,
        false_accept=worst_false_accept(calibration, limits) if calibration.converged else None,
        reasons=(calibration.reason,) if calibration.reason else (),
        tasks=tuple(_describe_task(each, calibration.solution.dataset, true) for each in tasks),
        details=details,
    )


def _describe_task(error: TaskError, used: Dataset, true: Dataset | None) -> cell_result.TaskResult:
    task = error.task
    off = None
    if true is not None:
        with np.errstate(all="ignore"):  # a point that the true camera does not see has no pixel
            off = UNIT_PER_SI[task.unit] * np.linalg.norm(errors_of_robot(error.placed, true, used), axis=1)
    return cell_result.TaskResult(
        name=task.name,
        unit=task.unit,
        limit=task.limit,
        median=_rounded(error.median[error.worst]),
        most=_rounded(error.most[error.worst]),
        typical=_rounded(np.median(error.most)),
        worst=place_in_words(error),
        parts=tuple(cell_result.TaskPart(kind, _rounded(sigma)) for kind, sigma in error.parts().items()),
        frame=error.placed.frame,
        truth=None if off is None or not np.isfinite(off).any() else _rounded(np.nanmax(off)),
        within=None if off is None else _rounded((off <= error.most).mean()),
    )


def _map_of_task(error: TaskError) -> cell_result.TaskMap:
    """Return a task's error at each of its points: over an image or carried by a frame in the worst pose, else all."""
    placed = error.placed
    if placed.pixels is None:
        points, most = placed.places, error.most
    else:
        points, most = placed.pixels, np.full(len(placed.pixels), np.nan)
        np.fmax.at(most, placed.at[1], error.most)
    return cell_result.TaskMap(
        name=error.task.name,
        columns=None if placed.pixels is None else COLUMNS_OVER_IMAGE,
        points=tuple(tuple(round(each, 4) for each in point) for point in points.tolist()),
        most=tuple(_rounded(each) if math.isfinite(each) else None for each in most.tolist()),
    )


def judged_tasks(
    tasks: Sequence[cell_result.TaskResult], findings: Sequence[Finding]
) -> tuple[cell_result.TaskResult, ...]:
    """Return tasks with the state of their limits: by a finding or against the truth, else by what is stated."""
    broken, unsure = (
        {name for each in findings if each.severity == severity for name in each.tasks}
        for severity in ("red", "undecided")
    )

    def judged(task: cell_result.TaskResult, limit: float) -> cell_result.TaskResult:
        if task.name in broken or (task.truth or 0.0) > limit:
            return replace(task, state="broken")
        return replace(task, state="undecided" if task.name in unsure or task.most > limit else "holds")

    return tuple(each if each.limit is None else judged(each, each.limit) for each in tasks)


def documents_of_tasks(tasks: Sequence[cell_result.TaskResult]) -> dict[str, TaskDocument]:
    """Return tasks as an accepted calibration keeps them, by name."""
    return {each.name: TaskDocument(each.median, each.most, each.unit, each.limit) for each in tasks}


def _rounded(value: float) -> float:
    """Round to four digits."""
    return float(f"{value:.4g}")


def _projection_results(calibration: Calibration) -> tuple[cell_result.ProjectionResult, ...]:
    return tuple(
        _projection_result(name, projection_of(calibration, name), camera.covariance)
        for name, camera in calibration.intrinsics.items()
    )


def given_projections(calibration: Calibration) -> tuple[cell_result.ProjectionResult, ...]:
    """Return the projections of cameras whose intrinsics are given, and have seen a pattern."""
    found = []
    for name in dict.fromkeys(group.sensor for group in calibration.solution.setup.problem.groups):
        camera, lens = calibration.dataset.sensors[name].camera, given_lens(calibration, name)
        if camera is not None and lens is not None:
            at = tuple(camera.parameters.index(parameter) for parameter in lens.parameters)
            projection = projection_of(calibration, name, at)
            found.append(_projection_result(name, projection, lens.root @ lens.root.T, lens.source))
    return tuple(found)


def _projection_result(
    name: str, found: Projection, covariance: Array, given: LensSource | None = None
) -> cell_result.ProjectionResult:
    near, far = found.sigmas(covariance, found.distance), found.sigmas(covariance)

    def seen(values: Array, of: Callable[[Array], float]) -> float:
        return round(float(of(values[found.seen])), 4)

    def cells(values: Array) -> tuple[float, ...]:
        return tuple(np.round(np.nan_to_num(values), 4).ravel().tolist())

    return cell_result.ProjectionResult(
        camera=name,
        model=found.camera.distortion.ros_name,
        width=found.camera.width,
        height=found.camera.height,
        distance_m=round(found.distance, 4),
        median_px=seen(near, np.nanmedian),
        most_px=round(found.most(near), 4),
        worst_px=seen(near, np.nanmax),
        far_median_px=seen(far, np.nanmedian),
        far_worst_px=seen(far, np.nanmax),
        seen=round(float(found.seen.mean()), 3),
        columns=near.shape[1],
        near_px=cells(near),
        far_px=cells(far),
        given=given,
    )


def _describe_recording(dataset: Dataset) -> cell_result.RecordingResult:
    """Describe a dataset; its path is relative to the working directory if it is below it."""
    folder = dataset.path.parent if dataset.path.name == FILE_NAME else dataset.path
    if folder.is_absolute() and folder.is_relative_to(Path.cwd()):
        folder = folder.relative_to(Path.cwd())
    return cell_result.RecordingResult(
        dataset=folder.as_posix(),
        collections=len(dataset.collections),
        sensors=tuple(dataset.sensors),
        patterns=tuple(map(_describe_pattern, dataset.patterns.values())),
    )


def _describe_pattern(pattern: Pattern) -> str:
    """Describe a pattern: "charuco, 77 corners, 60 mm apart"."""
    first, second = pattern.neighbours
    apart = np.linalg.norm(pattern.corners[first] - pattern.corners[second], axis=-1).mean()
    return f"{pattern.kind}, {len(pattern.corners)} corners, {1e3 * apart:.4g} mm apart"


def _describe_transform(calibration: Calibration, description: Dataset, edge: Edge) -> cell_result.TransformResult:
    """Return a calibrated transform with its standard deviations, and its distance from the robot's description.

    A twist in the child frame changes the translation by ``R`` times its own, and roll, pitch and yaw by `rpy_rates`.
    """
    T, C, described = calibration.transforms[edge], calibration.covariances.get(edge), description.transforms.get(edge)
    rpy = to_rpy(T[:3, :3])
    known = C is not None and calibration.converged
    of_trans = of_rpy = None
    if C is not None and known:
        J = np.zeros((6, 6))
        J[:3, :3], J[3:, 3:] = T[:3, :3], rpy_rates(rpy)
        sigmas = np.sqrt(np.diagonal(J @ C @ J.T))
        of_trans = tuple(sigmas[:3].tolist())
        of_rpy = tuple(sigmas[3:].tolist()) if np.isfinite(sigmas).all() else None
    moved = None
    if described is not None and np.isfinite(described[0]).all() and not np.array_equal(described[0], np.eye(4)):
        moved = distance(described[0], T)
    return cell_result.TransformResult(
        *edge,
        tuple(T[:3, 3].tolist()),
        tuple(to_quaternion(T[:3, :3]).tolist()),
        calibration.sigma_mm(edge) if C is not None else None,
        calibration.sigma_mrad(edge) if C is not None else None,
        tuple(rpy.tolist()),
        of_trans,
        of_rpy,
        None if moved is None else round(1e3 * float(moved[0]), 6),
        None if moved is None else round(float(np.degrees(moved[1])), 8),
    )


def _largest_causes(worth: Mapping[str, float]) -> tuple[cell_result.Worth, ...]:
    """Return the contributions to the uncertainty that matter, largest first."""
    largest = sorted(worth.items(), key=lambda each: -each[1])[:MAX_CAUSES]
    return tuple(cell_result.Worth(name, round(1e3 * metres, 4)) for name, metres in largest if metres > 0)


def _largest_deviation(calibration: Calibration, labels_only: bool = False) -> cell_result.Deviation | None:
    """Return the largest standard deviations of sensors, as norms of three axes, and of joints' parameters."""
    edges = {sensor.edge for sensor in calibration.dataset.sensors.values()} & calibration.covariances.keys()
    if not edges:
        return None
    mm, mrad = calibration.sigma_mm, calibration.sigma_mrad
    if labels_only:
        mm, mrad = calibration.label_sigma_mm, calibration.label_sigma_mrad
    joints = [] if labels_only else list(calibration.joints.values())
    sigmas = [each for joint in joints for each in zip(joint.units, joint.sigmas.tolist(), strict=True)]
    return finite_deviation(
        "the standard deviations",
        max(map(mm, edges)),
        float(np.degrees(max(map(mrad, edges)) / 1e3)),
        max((1e3 * sigma for unit, sigma in sigmas if unit == "m"), default=None),
        max((float(np.degrees(sigma)) for unit, sigma in sigmas if unit == "rad"), default=None),
    )


def finite_deviation(
    what: str,
    translation_mm: float,
    rotation_deg: float,
    joint_mm: float | None = None,
    joint_deg: float | None = None,
) -> cell_result.Deviation:
    """Round to a nanometre and a similarly small angle.

    Args:
        what: what deviates, for the message.
        translation_mm: of sensors.
        rotation_deg: of sensors.
        joint_mm: of joints, if there are any.
        joint_deg: likewise.

    Raises:
        UndeterminedError: a number is not finite, so that nothing could be compared with it or written of it.
    """
    if not all(math.isfinite(v) for v in (translation_mm, rotation_deg, joint_mm, joint_deg) if v is not None):
        raise UndeterminedError(
            f"{what}: found a number that is not finite, expected millimetres and degrees; look for a label, a "
            "transform or a lens that is far from the others"
        )
    return cell_result.Deviation(
        round(translation_mm, 6),
        round(rotation_deg, 8),
        None if joint_mm is None else round(joint_mm, 6),
        None if joint_deg is None else round(joint_deg, 8),
    )


def _describe_lag(sensor: str, lag: CalibratedLag) -> cell_result.ParameterResult:
    return cell_result.ParameterResult(sensor, "lag", lag.seconds, "s", lag.sigma if math.isfinite(lag.sigma) else None)


def _describe_parameters(
    name: str, calibrated: CalibratedJoint | CalibratedIntrinsics
) -> list[cell_result.ParameterResult]:
    """Return the parameters of a joint or a camera, one by one."""
    each = zip(
        calibrated.parameters, calibrated.values.tolist(), calibrated.units, calibrated.sigmas.tolist(), strict=True
    )
    return [
        cell_result.ParameterResult(name, parameter, value, unit, sigma if math.isfinite(sigma) else None)
        for parameter, value, unit, sigma in each
    ]
