"""Error of robot tasks at a calibration, by the delta method, split by what it comes from; and against a known world.

What the sensors measure of a point is given: pixels, ranges. Parameters that are off then put the point elsewhere. In
the frame F in which the error counts, the displacement ``dy`` of a point y follows from one equation for each
measurement, with the displacement ``c`` by the chain of transforms from F to the sensor (of its measured point, carried
along)::

    S (dy - c) + D dk = 0      a pixel, by its slopes S by the point, and its derivatives D by the intrinsics k
    u^T (dy - c) = 0           the known distance along the ray u of a single camera
    n^T dy = 0                 a point on a plane
    dy = c - d                 a point of a LiDAR or a depth camera, whose ranges and beams are off by d

solved by least squares where there are more than three. In the image of a camera whose frame is F the error is
``S dy + D dk``.

The error of a task at a point is ``e = J d``, with its derivatives J by all parameters (`task_jacobian`)
and the errors d of these, calibrated and held, as independent ones of one standard deviation each
(`covariance.error_bars.ErrorSource`). So its covariance is the sum over these sources, and what is held counts both by
what it does to the calibrated parameters and by what it does itself: a focal length that is off moves the camera, and
the two nearly cancel where the patterns were.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.estimation.covariance.error_bars import ErrorSource, SourceKind
from calibration.engine.estimation.covariance.fixed_inputs import Chain, chain_along
from calibration.engine.estimation.covariance.result import Calibration, Solution
from calibration.engine.estimation.problem.blocks import Pose
from calibration.engine.estimation.residuals.corner_residuals import ERRORS_BEYOND_LENS_MODEL
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import adjoint, apply, inverse, translation
from calibration.engine.statistics import quantile_of_norm, size_without_error
from calibration.engine.tasks.placed_task import UNIT_PER_SI, PlacedTask, at_work, place_task
from calibration.engine.tasks.robot_task import RobotTask


def task_jacobian(solution: Solution, placed: PlacedTask) -> Array:
    """Return the derivatives (n, m, C) of a task's error by the C columns of the linear model, in its unit.

    Args:
        solution: optimum of the calibration.
        placed: the task at it: n points that count; m is 2 in an image and on a plane, else 3.
    """
    task, y = placed.task, placed.places
    dataset = solution.dataset
    columns = TaskColumns(solution, placed)
    if task.of is not None:
        moved = columns.displacement(task.of)
    else:
        moved = _measured_displacement(columns, [dataset.sensors[name] for name in task.seen_by])
    if task.image is not None:
        camera = dataset.sensors[task.image]
        slopes, own = columns.slopes(camera), columns.of_intrinsics(camera)
        moved = slopes @ moved + own
    elif task.plane is not None:
        moved = moved[:, :2]
    elif task.unit == "deg":
        far = np.linalg.norm(y, axis=-1)[:, None, None]
        unit = y[..., None] / far
        moved = (moved - unit @ (np.swapaxes(unit, 1, 2) @ moved)) / far
    return np.asarray(UNIT_PER_SI[task.unit] * moved)


def _measured_displacement(columns: "TaskColumns", sensors: Sequence[Sensor]) -> Array:
    """Return the displacement (n, 3, C) in F of points that sensors measure, see the module."""
    placed = columns.placed
    first = sensors[0]
    if not first.modality.has_corners:
        return columns.displacement(first.frame) + columns.of_ranges(first)
    rows, sides = [], []
    for sensor in sensors:
        slopes = columns.slopes(sensor)
        rows.append(slopes)
        sides.append(slopes @ columns.displacement(sensor.frame) - columns.of_intrinsics(sensor))
    if len(sensors) == 1:
        scale = np.linalg.norm(rows[0], axis=(1, 2))[:, None, None]  # a row as large as those of the pixels
        if placed.task.plane is not None:
            rows.append(np.broadcast_to([0.0, 0.0, 1.0], (len(placed.places), 1, 3)) * scale)
            sides.append(np.zeros((len(placed.places), 1, columns.count)))
        else:
            along = scale * columns.rays(first)[:, None]
            rows.append(along)
            sides.append(along @ columns.displacement(first.frame))
    H = np.concatenate(rows, 1)
    back = np.swapaxes(H, 1, 2)
    return np.asarray((np.linalg.inv(back @ H) @ back) @ np.concatenate(sides, 1), float)


@dataclass(frozen=True, eq=False)
class TaskColumns:
    """Effects of each column of the linear model on the n points of a task: C columns, calibrated ones first."""

    solution: Solution
    placed: PlacedTask

    @property
    def count(self) -> int:
        """C."""
        model = self.solution.model
        return model.places[-1].stop if model.places else model.shared

    def displacement(self, end: str) -> Array:
        """Return the displacement (n, 3, C) in F of points that a frame carries, by the transforms between."""
        placed, work = self.placed, self.placed.work
        chain = chain_along(work, work.tree.path(placed.frame, end), np.arange(len(placed.collections)))
        elsewhere = None if placed.task.work_poses is None else work
        chain = replace(chain, collections=placed.collections, elsewhere=elsewhere)
        twists = np.zeros((len(placed.collections), 6, self.count))  # in the frame that carries them
        for at, columns in self._twists(chain):
            twists[:, :, at] += columns
        pose, _ = placed.at
        R = chain.T[pose, :3, :3]
        p = np.einsum("nji,nj->ni", R, placed.places - chain.T[pose, :3, 3])
        carried = np.concatenate([R, -R @ rotations.hat(p)], -1)  # (n, 3, 6): displacements by a twist
        if len(twists) == 1:  # one product for all points, which is faster
            return np.asarray((carried.reshape(-1, 6) @ twists[0]).reshape(len(pose), 3, -1))
        return np.asarray(carried @ twists[pose])

    def _twists(self, chain: Chain) -> Iterator[tuple[slice, Array]]:
        """Yield the twists (V, 6, k) of a chain's pose by the parameters of transforms, calibrated and held."""
        solution = self.solution
        problem, work = solution.setup.problem, self.placed.work
        joints = {joint.edge: joint for joint in work.joints.values()}
        centres = {pattern.edge: adjoint(translation(pattern.centre)) for pattern in work.patterns.values()}
        for block, at in problem.shared_parameters.items():
            edge, kind = problem.blocks[block].edge, problem.blocks[block]
            if edge is None:
                continue
            columns: Array | None = centres.get(edge)  # a pattern's block is at the centre of its corners
            if kind.joint is not None:
                joint = joints[edge]
                own = kind.joint.model.columns(solution.values[block])[:, kind.joint.at]
                columns = adjoint(inverse(joint.model.motion(joint.positions))) @ own
            elif not isinstance(kind.parameters, Pose):
                continue
            if (moved := chain.twist(edge, columns)) is not None:
                yield at, moved
        for cause, at in solution.model.placed():
            if callable(cause.effect) and (moved := cause.effect(chain)) is not None:
                yield at, moved

    def _in_sensor(self, sensor: Sensor) -> tuple[Array, Array]:
        """Return ``R_F_sensor`` (n, 3, 3), and the points (n, 3) in the sensor's frame."""
        placed, (pose, _) = self.placed, self.placed.at
        T = placed.work.transform(placed.frame, sensor.frame)[pose]
        R = T[:, :3, :3]
        return R, np.einsum("nji,nj->ni", R, placed.places - T[:, :3, 3])

    def rays(self, sensor: Sensor) -> Array:
        """Return the directions (n, 3) from a sensor to the points, in F."""
        R, p = self._in_sensor(sensor)
        return np.asarray(np.einsum("nij,nj->ni", R, p / np.linalg.norm(p, axis=-1, keepdims=True)))

    def slopes(self, sensor: Sensor) -> Array:
        """Return the derivatives (n, 2, 3) of the pixels by the points, in F."""
        R, p = self._in_sensor(sensor)
        return np.asarray(np.moveaxis(_known_camera(sensor).slopes(p.T), -1, 0) @ np.swapaxes(R, 1, 2))

    def of_intrinsics(self, sensor: Sensor) -> Array:
        """Return the derivatives (n, 2, C) of the pixels by a camera's intrinsics."""
        camera = _known_camera(sensor)
        _, p = self._in_sensor(sensor)
        x, y = camera.distortion.chart.coordinates(p.T, camera.distortion.sees)
        own = np.moveaxis(_derivatives_of_pixels(camera, x, y), -1, 0)  # (n, parameters, 2)
        return self._of_labels(sensor, (*camera.parameters, *ERRORS_BEYOND_LENS_MODEL), np.swapaxes(own, 1, 2))

    def of_ranges(self, sensor: Sensor) -> Array:
        """Return the displacement (n, 3, C) in F by the errors of a sensor's ranges and beams."""
        R, p = self._in_sensor(sensor)
        far, flat = np.linalg.norm(p, axis=-1), np.maximum(np.hypot(p[:, 0], p[:, 1]), 1e-9)
        lower = np.stack([p[:, 0] * p[:, 2] / flat, p[:, 1] * p[:, 2] / flat, -flat], -1)
        errors = np.stack([p / far[:, None], p, lower], -1)
        return self._of_labels(sensor, ("bias", "scale", "elevation"), -R @ errors)

    def _of_labels(self, sensor: Sensor, names: Sequence[str], effects: Array) -> Array:
        """Return effects (n, m, C) by effects (n, m, k) of a sensor's own parameters, by their names."""
        problem, model = self.solution.setup.problem, self.solution.model
        weights = np.zeros((len(names), self.count))
        rows = {(sensor.name, name): k for k, name in enumerate(names)}
        for block, at in problem.shared_parameters.items():
            if (free := problem.blocks[block].intrinsics) is not None and free.sensor == sensor.name:
                weights[[rows[sensor.name, name] for name in free.free], range(at.start, at.stop)] = 1.0
        for cause, at in model.placed():
            for column, combination in enumerate(() if callable(cause.effect) else cause.effect, at.start):
                for label, weight in combination.items():
                    if label in rows:
                        weights[rows[label], column] = weight
        n, m, _ = effects.shape
        return np.asarray((effects.reshape(n * m, -1) @ weights).reshape(n, m, -1))


def _known_camera(sensor: Sensor) -> Camera:
    if sensor.camera is None:
        raise AssertionError("a camera has intrinsics")
    return sensor.camera


def _derivatives_of_pixels(camera: Camera, x: Array, y: Array) -> Array:
    """Return the derivatives (k, 2, n) by the intrinsics, and by the errors beyond the lens's model."""
    xd, yd = camera.distortion.distort(x, y)
    none, r2 = np.zeros_like(x), xd * xd + yd * yd
    beyond = np.array([(camera.fx * yd, none), (camera.fx * r2, none), (none, camera.fy * r2)])
    return np.asarray(np.concatenate([camera.derivatives(x, y), beyond]))


MEDIAN, MOST = 0.5, 0.95
"""Probabilities of the quantiles that are stated."""


@dataclass(frozen=True, eq=False)
class TaskError:
    """Error of a task at its n points, in its unit."""

    placed: PlacedTask
    jacobian: Array
    """(n, m, C): derivatives by the columns of the linear model."""
    sources: tuple[ErrorSource, ...]

    @property
    def task(self) -> RobotTask:
        """The task."""
        return self.placed.task

    @cached_property
    def variances(self) -> Mapping[str, Array]:
        """By source, its part (n,) of the mean square error."""
        return {each.name: ((self.jacobian @ each.columns) ** 2).sum((1, 2)) for each in self.sources}

    @cached_property
    def covariance(self) -> Array:
        """(n, m, m)."""
        moved = self.jacobian @ np.concatenate([each.columns for each in self.sources], 1)
        return np.asarray(moved @ np.swapaxes(moved, 1, 2))

    @cached_property
    def median(self) -> Array:
        """(n,): the size that the error does not exceed with a probability of one half."""
        return quantile_of_norm(self.covariance, MEDIAN)

    @cached_property
    def most(self) -> Array:
        """(n,): the size that it does not exceed with a probability of 95 %."""
        return quantile_of_norm(self.covariance, MOST)

    @cached_property
    def worst(self) -> int:
        """Number of the point with the largest error."""
        return int(self.most.argmax())

    def parts(self) -> dict[SourceKind, float]:
        """Return by kind of source its standard deviation at the worst point, largest first."""
        sums: dict[SourceKind, float] = {}
        for each in self.sources:
            moved = self.jacobian[self.worst] @ each.columns
            sums[each.kind] = sums.get(each.kind, 0.0) + float((moved**2).sum())
        return {kind: part**0.5 for kind, part in sorted(sums.items(), key=lambda each: -each[1]) if part > 0}

    def largest_change(self, changes: Array, errors: Array | None = None) -> float:
        """Return how far changes (C,) of all parameters, calibrated and held, move it at the worst point for them.

        Without what their independent errors (C, r) make it longer, if they are given.
        """
        sizes = np.linalg.norm(self.jacobian @ changes, axis=1)
        J = self.jacobian[int(sizes.argmax())]
        return float(sizes.max()) if errors is None else size_without_error(J @ changes, J @ errors)


def task_errors(calibration: Calibration, tasks: Sequence[RobotTask]) -> list[TaskError]:
    """Return the errors of tasks at a calibration that has converged; none of one that has not.

    Raises:
        InputError: a task does not fit the dataset: frames that are not connected, points that no camera sees ...
    """
    bars = calibration.error_bars
    return [] if bars is None else [task_error(calibration.solution, task, bars.sources) for task in tasks]


def task_error(solution: Solution, task: RobotTask, sources: tuple[ErrorSource, ...]) -> TaskError:
    """Return the error of a task at an optimum, by the errors of its parameters.

    Raises:
        InputError: as `task_errors`.
    """
    placed = place_task(solution.dataset, task, solution.setup.gauge)
    found = TaskError(placed, task_jacobian(solution, placed), sources)
    if not found.jacobian.any():
        raise InputError(
            f"tasks.{task.name}: nothing that is calibrated or held lies between the frames, so that its error is 0 "
            "and a limit says nothing: expected a sensor or a frame that could be elsewhere"
        )
    return found


STEPS = 4
"""Steps of Gauss and Newton of a triangulation."""


def _camera_named(dataset: Dataset, name: str) -> Camera:
    camera = dataset.sensors[name].camera
    if camera is None:
        raise AssertionError("a task's camera has intrinsics")
    return camera


def errors_of_robot(placed: PlacedTask, true: Dataset, used: Dataset, ranges: Array | None = None) -> Array:
    """Return how far off it is at the n points of a task, (n, m), px or m (of a direction, rad).

    Args:
        placed: the task.
        true: dataset with the transforms and cameras of the world.
        used: the same as the robot knows them.
        ranges: (n, 3): by how much a LiDAR measures the points elsewhere, in its own frame.
    """
    task, (pose, _), y = placed.task, placed.at, placed.places
    true, used = (at_work(each, task, placed.collections) for each in (true, used))

    def to(dataset: Dataset, frame: str) -> Array:
        return np.asarray(dataset.transform(placed.frame, frame)[pose])

    def seen(dataset: Dataset, frame: str, points: Array) -> Array:
        return apply(inverse(to(dataset, frame)), points[:, None])[:, 0]

    def back(dataset: Dataset, frame: str, points: Array) -> Array:
        return apply(to(dataset, frame), points[:, None])[:, 0]

    if task.of is not None:
        found = back(used, task.of, seen(true, task.of, y))
    else:
        first = true.sensors[task.seen_by[0]]
        p = seen(true, first.frame, y)
        if not first.modality.has_corners:
            found = back(used, first.frame, p if ranges is None else p + ranges)
        elif len(task.seen_by) == 1:
            lens, known = _camera_named(true, task.seen_by[0]), _camera_named(used, task.seen_by[0])
            rays = known.rays(lens.project(p))
            rays *= (np.linalg.norm(p, axis=-1) / np.linalg.norm(rays, axis=-1))[:, None]
            found = back(used, first.frame, rays)
            if task.plane is not None:
                start = back(used, first.frame, np.zeros_like(rays))
                found = start + (found - start) * (-start[:, 2] / (found - start)[:, 2])[:, None]
        else:
            found = y.copy()
            for _ in range(STEPS):
                J, r = [], []
                for name in task.seen_by:
                    lens, frame = _camera_named(used, name), true.sensors[name].frame
                    q = seen(used, frame, found)
                    r.append(lens.project(q) - _camera_named(true, name).project(seen(true, frame, y)))
                    R = to(used, frame)[:, :3, :3]
                    J.append(np.moveaxis(lens.slopes(q.T), -1, 0) @ np.swapaxes(R, 1, 2))
                found = found - (np.linalg.pinv(np.concatenate(J, 1)) @ np.concatenate(r, 1)[..., None])[..., 0]
    if task.image is not None:
        return _camera_named(used, task.image).project(found) - _camera_named(true, task.image).project(y)
    if task.plane is not None:
        return np.asarray((found - y)[:, :2])
    if task.unit == "deg":
        unit = y / np.linalg.norm(y, axis=-1, keepdims=True)
        off = (found - y) / np.linalg.norm(y, axis=-1, keepdims=True)
        return np.asarray(off - unit * (off * unit).sum(-1, keepdims=True))
    return np.asarray(found - y)
