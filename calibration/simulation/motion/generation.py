"""Motions that show every sensor the pattern: well spread, some views partial, from a seed.

Poses are drawn in front of the cameras; those that every sensor sees and that run into nothing are
candidates; of them the motion takes one after the other the one that differs most from all that it
has already. A motion is written with few digits and played from those, so that the last bits of a
machine's arithmetic do not show.
"""

import numpy as np

from calibration.dataset.pattern import Pattern
from calibration.errors import InputError
from calibration.geometry import rotations
from calibration.geometry.cameras import Camera
from calibration.geometry.transforms import apply, inverse, transform
from calibration.geometry.types import Array, BoolArray
from calibration.simulation.collection.camera_labels import MAX_VIEW_ANGLE, corners_in_image, facing
from calibration.simulation.inverse_kinematics import joints_between, reach
from calibration.simulation.motion.sequence import Motion, moving_joints, moving_model
from calibration.simulation.placement import Placement, place
from calibration.simulation.random_streams import stream
from calibration.simulation.robot import compose
from calibration.simulation.sensors import SimulatedCamera, SimulatedLidar
from calibration.simulation.system import MotionRanges, System

_CANDIDATES = 100  # drawn for each pose of the motion
_LEAST_SHARE = 0.5  # of the corners: a view of fewer says little
_LEAST_RINGS = 4  # of a LiDAR that cross the pattern
_PATTERN_CLEARANCE = 0.05  # m, from the pattern to the boxes and the ground
_LINK_CLEARANCE = 0.1  # m, from the origins of moving links: about the half width of an arm


def generate_motion(system: System, count: int, seed: int) -> Motion:
    """A motion of so many poses, each seen by every sensor.

    Raises:
        InputError: the system has no camera, nothing in it moves, or too few poses were found.
    """
    if not system.cameras:
        raise InputError(f"a motion of {system.name} cannot be generated: it has no camera")
    pattern = system.moved_pattern or next(iter(system.patterns.values()))
    drawn = _draw(system, pattern, max(_CANDIDATES * count, 1000), stream(seed, "motion"))
    placement = place(system, drawn)
    usable, partial, features = _look(system, pattern, placement)
    chosen = _spread(usable, partial / len(system.cameras), features, count, system.motion.partial)
    if len(chosen) < count:
        raise InputError(
            f"found {len(chosen)} poses of {system.name} that every sensor sees, expected {count}; "
            "widen distance_m, tilt_deg or roll_deg under motion in its simulation.yml"
        )
    return drawn.take(chosen)


def _draw(system: System, pattern: Pattern, count: int, random: np.random.Generator) -> Motion:
    """Random poses of the pattern in front of each camera in turn, reached by the model or by the joints."""
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


def _look(system: System, pattern: Pattern, placement: Placement) -> tuple[BoolArray, Array, Array]:
    """What the sensors see at each of N poses.

    Returns:
        Which poses every sensor sees and that run into nothing, (N,); how many cameras see
        only a part of the pattern, (N,); and what a pose looks like, (N, F), each feature about -1 to 1.
    """
    T_world_pattern = placement.patterns[pattern.name]
    corners = apply(T_world_pattern, pattern.corners)
    usable = ~_collides(system, pattern, placement)
    partial = np.zeros(len(usable))
    features = []
    for name, sensor in system.sensors.items():
        T_sensor_pattern = placement.pattern_in(name, pattern.name)
        hidden = system.scene.hides(placement.sensors[name][:, :3, 3], corners)
        if isinstance(sensor, SimulatedLidar):
            usable &= _crossed(sensor, T_sensor_pattern, pattern, hidden)
            continue
        _, visible = corners_in_image(sensor.camera, apply(T_sensor_pattern, pattern.corners))
        share = (visible & ~hidden).mean(-1)
        usable &= facing(T_sensor_pattern, pattern.centre) & (share >= _LEAST_SHARE)
        partial += share < 1
        features.append(_features(sensor, T_sensor_pattern, pattern, system.motion))
    return usable, partial, np.concatenate(features, -1)


def _collides(system: System, pattern: Pattern, placement: Placement) -> BoolArray:
    """Which poses put the pattern, a sensor, or a link that moves into a box or the ground."""
    border = np.column_stack([pattern.outline, np.zeros(4)])
    board = apply(placement.patterns[pattern.name], np.concatenate([border, pattern.corners]))
    collides = ~placement.sensors_are_free(system.scene)
    collides |= system.scene.contains(board, _PATTERN_CLEARANCE).any(-1)
    world, tree = system.configuration.world_link, system.robot.tree
    moving = {joint.edge for joint in system.robot.movable.values()}
    for frame in tree.frames:
        if any((step.parent, step.child) in moving for step in tree.path(world, frame)):
            origin = compose(tree, placement.transforms, world, frame)[:, :3, 3]
            collides |= system.scene.contains(origin, _LINK_CLEARANCE)
    return collides


def _crossed(lidar: SimulatedLidar, T_lidar_pattern: Array, pattern: Pattern, hidden: BoolArray) -> BoolArray:
    """Which poses (N,) the rings cross well, judged by the pattern's corners."""
    corners = apply(T_lidar_pattern, pattern.corners)
    distance = np.linalg.norm(corners, axis=-1)
    elevation = np.arcsin(corners[..., 2] / distance)
    rings = np.array(lidar.elevations)
    between = (rings > elevation.min(-1, keepdims=True)) & (rings < elevation.max(-1, keepdims=True))
    normal = T_lidar_pattern[:, :3, 2]
    sight = corners.mean(-2) / np.linalg.norm(corners.mean(-2), axis=-1, keepdims=True)
    crossed: BoolArray = (
        (between.sum(-1) >= _LEAST_RINGS)
        & (distance.min(-1) > lidar.least_range)
        & (distance.max(-1) < lidar.most_range)
        & (np.abs((normal * sight).sum(-1)) > np.cos(MAX_VIEW_ANGLE))
        & (hidden.mean(-1) < 1 - _LEAST_SHARE)
    )
    return crossed


def _features(sensor: SimulatedCamera, T_camera_pattern: Array, pattern: Pattern, ranges: MotionRanges) -> Array:
    """Where on the image, how far, how tilted and how turned a camera sees the pattern: (N, 7)."""
    camera = sensor.camera
    centre = apply(T_camera_pattern, pattern.centre[None])[:, 0]
    pixel, _ = corners_in_image(camera, centre)
    half = np.array([camera.width, camera.height]) / 2
    place = np.clip(np.nan_to_num(pixel) / half - 1, -2, 2)
    low, high = ranges.distance or filling_distances(camera, pattern)
    distance = np.linalg.norm(centre, axis=-1, keepdims=True)
    depth = (2 * distance - low - high) / max(high - low, 1e-9)
    normal = T_camera_pattern[:, :2, 2] / max(np.sin(ranges.tilt), 1e-3)
    turn = T_camera_pattern[:, :2, 0] / max(np.sin(min(ranges.roll, np.pi / 2)), 1e-3)
    return np.concatenate([place, depth, normal, turn], -1)


def _spread(usable: BoolArray, partial: Array, features: Array, count: int, share: float) -> list[int]:
    """The indices of poses that differ, as many as asked for if there are so many.

    Each next one is the farthest from all before it (T. Gonzalez, "Clustering to minimize the
    maximum intercluster distance", 1985), among those with partial views or those without, as the
    share of partial views so far asks for.
    """
    chosen: list[int] = []
    distance = np.where(usable, np.inf, -np.inf)
    while len(chosen) < min(count, int(usable.sum())):
        wanted = partial[chosen].sum() < share * len(chosen)
        pool = np.where((partial > 0) == wanted, distance, -np.inf)
        if not np.isfinite(distance[usable]).any():  # the first one: the nearest to the middle
            pool = np.where(pool > 0, -np.abs(features).max(-1), -np.inf)
        best = int(pool.argmax() if pool.max() > -np.inf else distance.argmax())
        chosen.append(best)
        distance = np.minimum(distance, np.linalg.norm(features - features[best], axis=-1))
        distance[best] = -np.inf
    return chosen
