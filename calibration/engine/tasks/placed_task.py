"""Points of a robot task at a calibration: where they are, at which poses of the robot, and who sees them."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.base import InputError, did_you_mean
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.model import Dataset, Edge, Sensor
from calibration.engine.estimation.covariance.fixed_inputs import STILL_TOLERANCE, joint_axis
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply
from calibration.engine.tasks.robot_task import RobotTask, TaskUnit, WorkPoses

COLUMNS_OVER_IMAGE, ROWS_OVER_IMAGE = 9, 7
"""Points of a task all over an image; those of the outer ones are on its border."""
POINTS_ALONG_BOX = 4
"""Points of a box along each of its sides that have a length."""
MAX_POSES = 12
"""Poses of the recording at which a task of a robot that moves is looked at."""
UNIT_PER_SI: dict[TaskUnit, float] = {"mm": 1e3, "px": 1.0, "deg": 180 / np.pi}


@dataclass(frozen=True, eq=False)
class PlacedTask:
    """Points of a task, at poses of the recording."""

    task: RobotTask
    frame: str
    """F, in which the error counts."""
    collections: IntArray
    """(V,): the poses, by the indices of their collections,"""
    work: Dataset
    """and the dataset at these, see `at_work`."""
    points: Array
    """(V, P, 3): in F, m."""
    seen: BoolArray
    """(V, P): whether the sensors see them; the others do not count."""
    pixels: Array | None
    """(P, 2): in the image over which they are spread; None if they are in a space."""
    spread_over: str = ""
    """The camera of that image."""

    @cached_property
    def at(self) -> tuple[IntArray, IntArray]:
        """Pose and number of each of the n points that count."""
        pose, number = np.nonzero(self.seen)
        return pose, number

    @cached_property
    def places(self) -> Array:
        """(n, 3): the points that count, in F, m."""
        return np.asarray(self.points[self.at])


@dataclass(frozen=True, eq=False)
class TaskFrames:
    """Sensors and frames of a task, of a dataset that has them."""

    cameras: tuple[Sensor, ...]
    """That see the points; the one in whose image they are spread, or the error counts, first."""
    frame: str
    """F, in which the error counts."""
    points_in: str
    """Of the points."""
    ends: tuple[str, ...]
    """All frames of which it has to be known where they are in F."""
    collections: IntArray
    """(V,): the poses at which the robot is looked at, one if nothing moves between these frames, see `at_work`."""


def at_work(dataset: Dataset, task: RobotTask, collections: IntArray) -> Dataset:
    """Return a dataset at the V poses at which the robot is looked at: collections (V,) of it, with the task's joints.

    Joints that the task gives no positions of, and all else, stay where they are in these collections.
    """
    found = dataset.with_collections(collections.tolist())
    return found if task.work_poses is None else task.work_poses.taken_by(found)


def frames_of_task(dataset: Dataset, task: RobotTask) -> TaskFrames:
    """Return the frames of a task; whether its points are seen depends on the calibration.

    Raises:
        InputError: a sensor, a frame or a collection is unknown, frames are not connected, or a camera has no
            intrinsics.
    """
    sensors = [_known_sensor(dataset, task, "seen-by", name) for name in task.seen_by]
    image = _known_sensor(dataset, task, "in-image-of", task.image) if task.image else None
    cameras = [each for each in (image, *sensors) if each and _camera_of(each)]
    for key, each in (*((("in-image-of", image),) if image else ()), *(("seen-by", sensor) for sensor in sensors)):
        must = key == "in-image-of" or len(sensors) > 1 or task.plane is not None or each.modality.has_corners
        if must and _camera_of(each) is None:
            raise _fault(task, key, f"'{each.name}' has no intrinsics, which this task needs: expected a camera")
    frame = image.frame if image else task.plane or task.frame or sensors[0].frame
    points_in = task.points_in or task.of or frame
    if task.plane is not None and task.points and any(point[2] for point in task.points) and points_in == frame:
        raise _fault(task, "points", f"found a point off the plane z = 0 of {frame}, expected points on it")
    if task.distance is not None:
        if not cameras:
            raise _fault(task, "distance", "found no camera over whose image the points could be; give points or a box")
        points_in = cameras[0].frame
    ends = dict.fromkeys((*(each.frame for each in (*cameras, *sensors)), points_in, *([task.of] if task.of else [])))
    return TaskFrames(tuple(cameras), frame, points_in, tuple(ends), _poses_of_robot(dataset, task, frame, ends))


def place_task(dataset: Dataset, task: RobotTask, gauge: str | None = None) -> PlacedTask:
    """Return the points of a task at a calibration.

    Args:
        dataset: with the transforms and cameras of the calibration.
        task: the task.
        gauge: the sensor that was fixed because the data determine only where the others are relative to it.

    Raises:
        InputError: as `frames_of_task`; or no sensor sees a point, an arm cannot reach it, or nothing lies between the
            frames that could err.
    """
    found = frames_of_task(dataset, task)
    cameras, frame, points_in, collections = found.cameras, found.frame, found.points_in, found.collections
    if gauge is not None:
        _refuse_unknown_place(dataset, task, frame, found.ends, gauge)
    work = at_work(dataset, task, collections)
    pixels = None
    if task.distance is not None:
        pixels, points = _over_image(cameras[0], task.distance)
    else:
        points = _given_points(task)
    placed = apply(work.transform(frame, points_in), np.broadcast_to(points, (len(collections), *points.shape)))
    seen: BoolArray = np.asarray(np.isfinite(placed).all(-1))
    for each in cameras[pixels is not None :]:  # the first one sees what its own pixels are of
        seen = seen & _sees(each, apply(work.transform(each.frame, frame), placed))
    _refuse_unreachable(dataset, work, task, frame, placed)
    if not seen.any() or (task.points is not None and not seen.any(0).all()):
        number = 0 if not seen.any() else int((~seen.any(0)).argmax())
        names = " and ".join(each.name for each in cameras)
        x, y, z = apply(work.transform(cameras[0].frame, frame)[:1], placed[:1])[0, number].tolist()
        behind = "behind it" if z <= 0 else "beside its image"
        raise _fault(
            task,
            "points" if task.points else "box" if task.box else "distance",
            f"{names} cannot see ({x:.4g}, {y:.4g}, {z:.4g}) m in {cameras[0].frame}: it is {behind}; expected points "
            "that the camera sees, x right, y down, z forward in its own frame",
        )
    spread_over = "" if pixels is None else cameras[0].name
    return PlacedTask(task, frame, collections, work, placed, seen, pixels, spread_over)


def _fault(task: RobotTask, key: str, text: str) -> InputError:
    return InputError(f"tasks.{task.name}.{key}: {text}")


def _known_sensor(dataset: Dataset, task: RobotTask, key: str, name: str) -> Sensor:
    if name not in dataset.sensors:
        known = ", ".join(dataset.sensors)
        raise _fault(
            task,
            key,
            f"found '{name}', expected a sensor of the dataset{did_you_mean(name, dataset.sensors)} ({known})",
        )
    return dataset.sensors[name]


def _camera_of(sensor: Sensor) -> Camera | None:
    """Return the camera of a sensor whose labels are corners; a depth camera measures points."""
    return sensor.camera if sensor.modality.has_corners else None


def _poses_of_robot(dataset: Dataset, task: RobotTask, frame: str, ends: Iterable[str]) -> IntArray:
    """Return the collections (V,) at which the robot is looked at: one if nothing moves between the frames.

    For joint positions that the task gives, the same one for each of them.
    """
    edges: dict[Edge, None] = {}
    for end in ends:
        try:
            edges |= dict.fromkeys((step.parent, step.child) for step in dataset.tree.path(frame, end))
        except InputError as error:
            raise _fault(task, "in" if task.frame else "of" if task.of else "points-in", str(error)) from None
    calibrated = {
        pattern.edge for pattern in dataset.patterns.values() if not pattern.fixed
    } | dataset.moving_transforms
    if free := next((edge for edge in edges if edge in calibrated), None):
        raise _fault(
            task,
            "in",
            f"between the frames is '{'-'.join(free)}', which has another place in each collection and is calibrated "
            "there; expected frames of the robot",
        )
    if (poses := task.work_poses) is not None:
        _refuse_other_joints(dataset, task, poses, edges)
        edges = {edge: None for edge in edges if edge not in poses.transforms}
    if task.collections is not None:
        if missing := next((key for key in task.collections if key not in dataset.keys), None):
            raise _fault(
                task, "collections", f"found '{missing}', expected the key of a collection, such as {dataset.keys[0]}"
            )
        chosen = np.array([dataset.keys.index(key) for key in task.collections])
    else:
        chosen = np.arange(len(dataset.keys))
    known = np.all(
        [np.isfinite(dataset.transforms[edge][chosen, 0, 0]) for edge in edges] or [np.ones(len(chosen), bool)], 0
    )
    chosen = chosen[known]
    if not len(chosen):
        raise _fault(task, "collections", "no collection has all transforms between the frames")
    if poses is not None:
        return np.full(poses.count, chosen[0])
    moving = any(np.abs(T - T[0]).max() > STILL_TOLERANCE for T in (dataset.transforms[edge][chosen] for edge in edges))
    if not moving:
        return chosen[:1]
    return np.asarray(
        chosen[np.unique(np.linspace(0, len(chosen) - 1, min(MAX_POSES, len(chosen))).round().astype(int))]
    )


def _refuse_other_joints(dataset: Dataset, task: RobotTask, poses: WorkPoses, edges: Iterable[Edge]) -> None:
    """Refuse joint positions that do not say where everything between the frames is, or say nothing of it.

    Raises:
        InputError: so it is.
    """
    if not any(edge in poses.transforms for edge in edges):
        raise _fault(task, "joints", "found no joint between the frames of this task, expected one that moves them")
    for edge in edges:
        if edge not in poses.transforms and _moves(dataset, edge):
            joints = ", ".join(poses.others.get(edge, ()))
            what = f"a position of {joints}" if joints else "frames between which only joints of its description move"
            raise _fault(task, "joints", f"between the frames '{'-'.join(edge)}' moves too, expected {what}")


def _refuse_unknown_place(dataset: Dataset, task: RobotTask, frame: str, ends: Iterable[str], gauge: str) -> None:
    """Refuse frames between which there is one sensor whose place on the robot the data do not tell.

    Raises:
        InputError: there is one.
    """
    edges = {sensor.edge for sensor in dataset.sensors.values()}
    for end in ends:
        if sum((step.parent, step.child) in edges for step in dataset.tree.path(frame, end)) == 1:
            raise _fault(
                task,
                "seen-by",
                f"between {frame} and {end} is a sensor whose place on the robot this recording does not tell, only "
                f"where it is relative to the others ('{gauge}' is held): expected frames of sensors",
            )


def _over_image(sensor: Sensor, distance: float) -> tuple[Array, Array]:
    """Return pixels (P, 2) all over an image, and points (P, 3) that are seen there, in the camera's frame."""
    camera = _camera_of(sensor)
    if camera is None:
        raise AssertionError("a camera has intrinsics")
    u = np.linspace(0, camera.width - 1, COLUMNS_OVER_IMAGE)
    v = np.linspace(0, camera.height - 1, ROWS_OVER_IMAGE)
    pixels = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    rays = camera.rays(pixels)
    return pixels, distance * rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def _given_points(task: RobotTask) -> Array:
    if task.box is None:
        return np.array(task.points, float)
    ends = zip(task.box.low, task.box.high, strict=True)
    axes = [np.unique(np.linspace(low, high, POINTS_ALONG_BOX)) for low, high in ends]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def _sees(sensor: Sensor, points: Array) -> BoolArray:
    camera = _camera_of(sensor)
    if camera is None:
        raise AssertionError("a camera has intrinsics")
    pixels, visible = camera.project_visible(points)
    return visible & camera.contains(np.where(np.isfinite(pixels), np.rint(pixels), -1e9))


def _refuse_unreachable(dataset: Dataset, work: Dataset, task: RobotTask, frame: str, placed: Array) -> None:
    """Refuse points that the arm between them and the frame in which the error counts is too short to reach.

    The links' lengths in all are the limit. An arm that is one transform from base to flange does not tell its own.

    Args:
        dataset: the recording, which tells what moves.
        work: the same at the poses at which the robot is looked at.
        task: the task.
        frame: in which the error counts.
        placed: (V, P, 3): its points there.

    Raises:
        InputError: there is one.
    """
    if task.points_in is None:
        return
    path = dataset.tree.path(task.points_in, frame)
    moving = [k for k, step in enumerate(path) if _moves(dataset, (step.parent, step.child))]
    if not moving or any(joint_axis(dataset.transforms[path[k].parent, path[k].child]) is None for k in moving):
        return
    first = path[moving[0]]
    base = first.child if first.inverted else first.parent
    edges = [(step.parent, step.child) for step in path[moving[0] :]]
    reach = sum(float(np.linalg.norm(dataset.transforms[edge][:, :3, 3], axis=1).max()) for edge in edges)
    far = np.linalg.norm(apply(work.transform(base, frame), placed), axis=-1).max()
    if far > reach:
        raise _fault(
            task,
            "box" if task.box else "points",
            f"found a point {far:.3g} m from {base}, beyond the reach of {frame}: its links are {reach:.3g} m long",
        )


def _moves(dataset: Dataset, edge: Edge) -> bool:
    T = dataset.transforms[edge]
    return bool(np.nanmax(np.abs(T - T[0])) > STILL_TOLERANCE)
