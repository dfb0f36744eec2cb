"""A robot that carries out a task with one calibration, while the world is as another one says."""

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, inverse
from calibration.engine.tasks.placed_task import PlacedTask, at_work

STEPS = 4
"""Steps of Gauss and Newton of a triangulation."""


def _camera_of(dataset: Dataset, name: str) -> Camera:
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
            lens, known = _camera_of(true, task.seen_by[0]), _camera_of(used, task.seen_by[0])
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
                    lens, frame = _camera_of(used, name), true.sensors[name].frame
                    q = seen(used, frame, found)
                    r.append(lens.project(q) - _camera_of(true, name).project(seen(true, frame, y)))
                    R = to(used, frame)[:, :3, :3]
                    J.append(np.moveaxis(lens.slopes(q.T), -1, 0) @ np.swapaxes(R, 1, 2))
                found = found - (np.linalg.pinv(np.concatenate(J, 1)) @ np.concatenate(r, 1)[..., None])[..., 0]
    if task.image is not None:
        return _camera_of(used, task.image).project(found) - _camera_of(true, task.image).project(y)
    if task.plane is not None:
        return np.asarray((found - y)[:, :2])
    if task.unit == "deg":
        unit = y / np.linalg.norm(y, axis=-1, keepdims=True)
        off = (found - y) / np.linalg.norm(y, axis=-1, keepdims=True)
        return np.asarray(off - unit * (off * unit).sum(-1, keepdims=True))
    return np.asarray(found - y)
