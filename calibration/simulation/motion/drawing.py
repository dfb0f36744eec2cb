"""Random poses of a pattern in front of the cameras, reached by the model that moves or by the joints."""

import numpy as np

from calibration.dataset.pattern import Pattern
from calibration.errors import InputError
from calibration.geometry import rotations
from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import inverse, transform
from calibration.geometry.types import Array
from calibration.simulation.inverse_kinematics import joints_between, reach
from calibration.simulation.motion.sequence import Motion, moving_joints, moving_model
from calibration.simulation.robot import compose
from calibration.simulation.system import MotionRanges, System


def draw_motion(system: System, pattern: Pattern, count: int, random: np.random.Generator) -> Motion:
    """A motion through random poses, as many in front of each camera; those that joints do not reach are left out.

    Raises:
        InputError: nothing moves the pattern before a camera.
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
        elif joints_between(system.robot, link, pattern.link):
            positions, reached = reach(system.robot, link, pattern.link, T_camera_pattern, random)
            for joint, values in joints.items():
                rest = np.full(each, system.robot.movable[joint].rest)
                values.append(positions.get(joint, rest)[reached])
    if models:
        return moving_model(np.concatenate(models))
    if not any(joints.values()):
        raise InputError(
            f"a motion of {system.name} cannot be generated: pattern '{pattern.name}' is fixed and no joint "
            "lies between it and a camera"
        )
    return moving_joints({name: np.concatenate(values) for name, values in joints.items()})


def draw_poses(
    camera: Camera, pattern: Pattern, ranges: MotionRanges, count: int, random: np.random.Generator
) -> Array:
    """Poses ``T_camera_pattern`` (count, 4, 4) whose centre is on the image, turned towards the camera."""
    low, high = ranges.distance or filling_distances(camera, pattern)
    corner = np.array([camera.width, camera.height])
    rays = camera.normalise(corner * random.random((count, 2)) - 0.5)
    sight = np.concatenate([rays, np.ones((count, 1))], -1)
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    centre = sight * (low + (high - low) * random.random((count, 1)))
    about = 2 * np.pi * random.random(count)
    tilt = ranges.tilt * random.random(count)
    roll = ranges.roll * (2 * random.random(count) - 1)
    zero = np.zeros(count)
    axis = np.stack([np.cos(about), np.sin(about), zero], -1)
    R = _towards(sight) @ rotations.exp(tilt[:, None] * axis) @ rotations.exp(np.stack([zero, zero, roll], -1))
    return transform(R, centre - R @ pattern.centre)


def filling_distances(camera: Camera, pattern: Pattern) -> tuple[float, float]:
    """From where the pattern's diagonal is nine tenths of the image's shorter side to where it is a third."""
    diagonal = float(np.linalg.norm(pattern.outline[2] - pattern.outline[0]))
    full = max(camera.fx, camera.fy) * diagonal / min(camera.width, camera.height)
    return full / 0.9, full * 3


def _towards(sight: Array) -> Array:
    """The least rotations (N, 3, 3) that turn the z axis to unit vectors (N, 3) in front of the camera."""
    x, y, z = sight.T
    angle = np.arctan2(np.hypot(x, y), z)
    length = np.maximum(np.hypot(x, y), 1e-300)
    axis = np.stack([-y / length, x / length, np.zeros_like(x)], -1)
    return rotations.exp(angle[:, None] * axis)
