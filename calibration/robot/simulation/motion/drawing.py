"""Random poses of a pattern in front of the cameras, by a moved model or by joints.

With fewer than six joints between a camera and the pattern, as in a mobile base or a SCARA arm, nearly none of
these poses can be reached: then the joint positions are drawn, and those with the pattern in the camera's
view are kept.
"""

from collections.abc import Sequence

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.base.errors import InputError
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, inverse, transform
from calibration.robot.simulation.inverse_kinematics import joints_between, reach
from calibration.robot.simulation.motion.sequence import Motion, moving_joints, moving_model
from calibration.robot.simulation.robot import Joint, compose
from calibration.robot.simulation.system import MotionRanges, System

_REACH_ANY_POSE = 6  # joints between camera and pattern
_MAX_TRIES = 20  # drawn positions per requested pose, with fewer joints


def draw_motion(system: System, pattern: Pattern, count: int, random: np.random.Generator) -> Motion:
    """Draw a motion through random poses, about as many in front of each camera; with joints only some are reachable.

    Raises:
        InputError: nothing moves the pattern in front of a camera.
    """
    at_rest = system.robot.transforms({})
    each = -(-count // len(system.cameras))
    models: list[Array] = []
    joints: dict[str, list[Array]] = {name: [] for name in system.robot.movable}
    for name, sensor in system.cameras.items():
        link = system.configuration.sensors[name].link
        T_camera_pattern = draw_poses(sensor.camera, pattern, system.motion, each, random)
        if not pattern.fixed:
            T_parent_camera = compose(system.robot.tree, at_rest, pattern.parent_link, link)
            models.append(T_parent_camera @ T_camera_pattern @ inverse(system.T_model_pattern))
        elif between := joints_between(system.robot, link, pattern.link):
            if len(between) >= _REACH_ANY_POSE:
                positions, kept = reach(system.robot, link, pattern.link, T_camera_pattern, random)
            else:
                others = [joint for joint in system.robot.movable.values() if joint not in between]
                positions = _draw_positions([*between, *others], _MAX_TRIES * each, random)
                at = compose(system.robot.tree, system.robot.transforms(positions), link, pattern.link)
                kept = within_ranges(at, sensor.camera, pattern, system.motion)
            for joint, values in joints.items():
                rest = np.full(len(kept), system.robot.movable[joint].rest)
                values.append(positions.get(joint, rest)[kept])
    if models:
        return moving_model(np.concatenate(models))
    if not any(joints.values()):
        raise InputError(
            f"a motion of {system.name} cannot be generated: pattern '{pattern.name}' is fixed and no joint "
            "lies between it and a camera"
        )
    return moving_joints({name: np.concatenate(values) for name, values in joints.items()})


def _draw_positions(joints: Sequence[Joint], count: int, random: np.random.Generator) -> dict[str, Array]:
    """Draw positions (count,) of joints between their limits, at most half a turn.

    A prismatic joint without limits moves by as many metres.
    """
    bounded = {joint.name: joint.kind == "prismatic" and np.isfinite(joint.upper - joint.lower) for joint in joints}
    low = {joint.name: joint.lower if bounded[joint.name] else max(joint.lower, -np.pi) for joint in joints}
    high = {joint.name: joint.upper if bounded[joint.name] else min(joint.upper, np.pi) for joint in joints}
    return {name: low[name] + (high[name] - low[name]) * random.random(count) for name in low}


def within_ranges(T_camera_pattern: Array, camera: Camera, pattern: Pattern, ranges: MotionRanges) -> BoolArray:
    """Return a mask of the poses (N, 4, 4) within the ranges of `draw_poses`: image, distance, tilt and roll."""
    low, high = ranges.distance or filling_distances(camera, pattern)
    centre = apply(T_camera_pattern, pattern.centre[None])[:, 0]
    distance = np.linalg.norm(centre, axis=-1)
    pixels, ahead = camera.project_visible(centre)
    ahead &= camera.contains(pixels) & (distance >= low) & (distance <= high)
    sight = np.where(ahead[:, None], centre / np.maximum(distance, 1e-300)[:, None], [0.0, 0.0, 1.0])
    # tilt and roll, in this order: R = tilt about an axis in the image * roll about the line of sight
    R = np.swapaxes(_rotations_towards(sight), -1, -2) @ T_camera_pattern[:, :3, :3]
    tilt = np.arccos(np.clip(R[:, 2, 2], -1.0, 1.0))
    roll = np.arctan2(R[:, 1, 0] - R[:, 0, 1], R[:, 0, 0] + R[:, 1, 1])
    kept: BoolArray = ahead & (tilt <= ranges.tilt) & (np.abs(roll) <= ranges.roll)
    return kept


def draw_poses(
    camera: Camera, pattern: Pattern, ranges: MotionRanges, count: int, random: np.random.Generator
) -> Array:
    """Draw poses ``T_camera_pattern`` (count, 4, 4) with the centre in the image, facing the camera."""
    low, high = ranges.distance or filling_distances(camera, pattern)
    corner = np.array([camera.width, camera.height])
    sight = camera.rays(corner * random.random((count, 2)) - 0.5)
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    centre = sight * (low + (high - low) * random.random((count, 1)))
    about = 2 * np.pi * random.random(count)
    tilt = ranges.tilt * random.random(count)
    roll = ranges.roll * (2 * random.random(count) - 1)
    zero = np.zeros(count)
    axis = np.stack([np.cos(about), np.sin(about), zero], -1)
    R = (
        _rotations_towards(sight)
        @ rotations.exp(tilt[:, None] * axis)
        @ rotations.exp(np.stack([zero, zero, roll], -1))
    )
    return transform(R, centre - R @ pattern.centre)


def filling_distances(camera: Camera, pattern: Pattern) -> tuple[float, float]:
    """Return the distances at which the pattern's diagonal is nine tenths and one third of the image's shorter side."""
    diagonal = float(np.linalg.norm(pattern.outline[2] - pattern.outline[0]))
    full = max(camera.fx, camera.fy) * diagonal / min(camera.width, camera.height)
    return full / 0.9, full * 3


def _rotations_towards(sight: Array) -> Array:
    """Return the smallest rotations (N, 3, 3) that map the z axis to unit vectors (N, 3) in front of the camera."""
    x, y, z = sight.T
    angle = np.arctan2(np.hypot(x, y), z)
    length = np.maximum(np.hypot(x, y), 1e-300)
    axis = np.stack([-y / length, x / length, np.zeros_like(x)], -1)
    return rotations.exp(angle[:, None] * axis)
