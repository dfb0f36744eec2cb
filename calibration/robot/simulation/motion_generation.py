"""Generation of motions that calibrate well, from a seed: every sensor sees every pose, and the images are covered.

Poses are drawn in front of the cameras, by a moved model or by joints; those that every sensor sees without collisions
are candidates. With fewer than six joints between a camera and the pattern, as in a mobile base or a SCARA arm, nearly
none of these poses can be reached: then the joint positions are drawn, and those with the pattern in the camera's
view are kept.

The motion is chosen greedily: the next pose is the candidate that reduces the uncertainty of the calibrated
transforms most, by the engine's own covariance. A motion is written with few digits and
played from these, so that rounding errors of the arithmetic have no effect.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.pattern import UNMARKED_KINDS, Pattern
from calibration.engine.estimation.least_squares.observability import choose
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, inverse, transform
from calibration.robot.simulation.kinematics import Placement, joints_between, place, reach, stream, views
from calibration.robot.simulation.motion import (
    GENERATED_PREFIX,
    Motion,
    joined,
    moving_joints,
    moving_model,
    pose_count,
    read_motion,
)
from calibration.robot.simulation.motion_information import information
from calibration.robot.simulation.system import MotionRanges, System
from calibration.robot.urdf import Joint, compose

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
    return ahead & (tilt <= ranges.tilt) & (np.abs(roll) <= ranges.roll)


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


_PATTERN_CLEARANCE = 0.05  # m, between the pattern and the boxes or the ground
_LINK_CLEARANCE = 0.1  # m, from the origins of moving links: about half the width of an arm
_LEVEL = 1e-6  # tolerance of an axis of length 1


def is_clear(system: System, pattern: Pattern, placement: Placement) -> BoolArray:
    """Return a mask (N,) of the poses at which pattern, sensors and moving links are clear of the boxes and the ground.

    A link that keeps its height, as those of a mobile base, may be as close to the ground as in the description.
    """
    border = np.column_stack([pattern.outline, np.zeros(4)])
    board = apply(placement.patterns[pattern.name], np.concatenate([border, pattern.corners]))
    clear = placement.sensors_are_free(system.scene)
    clear &= ~system.scene.contains(board, _PATTERN_CLEARANCE).any(-1)
    world, tree = system.configuration.world_link, system.robot.tree
    above_ground, at_rest = replace(system.scene, ground=None), system.robot.transforms({})
    for frame in tree.frames:
        way = (system.robot.by_edge[step.parent, step.child] for step in tree.path(world, frame))
        joints = [joint for joint in way if joint.is_movable]
        if joints:
            axes = [compose(tree, at_rest, world, joint.child)[0, :3, :3] @ joint.axis for joint in joints]
            level = all(_keeps_height(joint, axis) for joint, axis in zip(joints, axes, strict=True))
            origin = compose(tree, placement.transforms, world, frame)[:, :3, 3]
            clear &= ~(above_ground if level else system.scene).contains(origin, _LINK_CLEARANCE)
    return clear


def _keeps_height(joint: Joint, axis: Array) -> bool:
    """Whether a joint with this axis (3,) in the world moves horizontally, like the drive and turn of a mobile base."""
    along = float(np.abs(axis[2]))
    return along < _LEVEL if joint.kind == "prismatic" else along > 1 - _LEVEL


_FOR_EACH = 12  # candidates per pose of the motion
_AT_LEAST = 120  # minimum of candidates, for a short motion
_DRAWN = 20  # drawn poses in a round per pose of the motion; most are not visible to some sensor
_MAX_ROUNDS = 20  # limit of rounds; then fewer candidates have to do


@dataclass(frozen=True, eq=False)
class Candidates:
    """N candidate poses, with their visibility in the cameras."""

    motion: Motion
    """The motion through all of them."""
    partial: Array
    """(N,): share of the cameras with only a partial view of a pattern."""
    cells: BoolArray
    """(N, C): mask of the cells of all cameras' images, concatenated, that have corners."""

    def __len__(self) -> int:
        return len(self.partial)


def find_candidates(system: System, count: int, seed: int) -> Candidates:
    """Find candidates for a motion of this many poses, with enough complete and enough partial views.

    Poses are drawn in rounds until there are enough. There may be fewer, or none.

    Raises:
        InputError: nothing moves the pattern in front of a camera.
    """
    wanted = max(_FOR_EACH * count, _AT_LEAST)
    whole = all(pattern.kind in UNMARKED_KINDS for pattern in system.patterns.values())  # or not detected at all
    share = 0.0 if whole else system.motion.partial
    found: list[Candidates] = []
    missing = {True: math.ceil(share * wanted), False: math.ceil((1 - share) * wanted)}  # partial views, or not
    for number in range(_MAX_ROUNDS):
        seen = _usable_poses(system, _draw_round(system, max(_DRAWN * count, _AT_LEAST), seed, number))
        kept: list[int] = []
        for in_part in missing:
            some = np.flatnonzero((seen.partial > 0) == in_part)[: missing[in_part]]
            missing[in_part] -= len(some)
            kept += some.tolist()
        found.append(_take_candidates(seen, sorted(kept)))
        if not any(missing.values()):
            break
    return Candidates(
        joined([each.motion for each in found]),
        np.concatenate([each.partial for each in found]),
        np.concatenate([each.cells for each in found]),
    )


def _draw_round(system: System, count: int, seed: int, number: int) -> Motion:
    """Draw a round of poses, equally many in front of the cameras of each pattern: the moved one, or all."""
    patterns = [system.moved_pattern] if system.moved_pattern else list(system.patterns.values())
    each = -(-count // len(patterns))
    streams = [stream(seed, "motion", number, *([pattern.name] if k else [])) for k, pattern in enumerate(patterns)]
    return joined([draw_motion(system, pattern, each, r) for pattern, r in zip(patterns, streams, strict=True)])


def _usable_poses(system: System, motion: Motion) -> Candidates:
    """Return the poses of a motion at which every sensor sees a pattern and nothing collides.

    The fastest checks come first.
    """
    motion, placement = _subset_of_motion(system, motion, _has_pattern_in_every_image(system, place(system, motion)))
    for pattern in system.patterns.values():
        motion, placement = _subset_of_motion(system, motion, is_clear(system, pattern, placement))
    for name, sensor in system.by_modality:
        if name not in system.cameras:
            some = [sensor.detects(views(system, placement, name, pattern)) for pattern in system.patterns]
            motion, placement = _subset_of_motion(system, motion, np.any(some, axis=0))
    seen, partial, cells = zip(*(_camera_detections(system, name, placement) for name in system.cameras), strict=True)
    candidates = Candidates(motion, np.mean(partial, axis=0), np.concatenate(cells, -1))
    return _take_candidates(candidates, np.flatnonzero(np.all(seen, axis=0)).tolist())


def _has_pattern_in_every_image(system: System, placement: Placement) -> BoolArray:
    """Return a mask (N,) of poses with a pattern's centre in every image, facing the camera: others are rarely seen."""

    def shown(name: str, pattern: str) -> BoolArray:
        return system.cameras[name].shows_centre(views(system, placement, name, pattern))

    some = [np.any([shown(name, pattern) for pattern in system.patterns], axis=0) for name in system.cameras]
    return np.asarray(np.all(some, axis=0))


def _camera_detections(system: System, camera: str, placement: Placement) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Return masks (N,) of the poses with a detection in a camera, and with a partial view; and the cells (N, C)."""
    sensor = system.cameras[camera]
    seen = [sensor.corner_views(views(system, placement, camera, pattern)) for pattern in system.patterns]
    detected = np.stack([view.detectable for view in seen])
    partial = detected & np.stack([view.partial for view in seen])
    cells = detected[..., None] & np.stack([view.cells(sensor.camera) for view in seen])
    return np.any(detected, axis=0), np.any(partial, axis=0), np.any(cells, axis=0)


def _subset_of_motion(system: System, motion: Motion, which: BoolArray) -> tuple[Motion, Placement]:
    """Return a subset of the poses of a motion, and their placement."""
    some = motion.take(np.flatnonzero(which))
    return some, place(system, some)


def _take_candidates(candidates: Candidates, index: list[int]) -> Candidates:
    return Candidates(candidates.motion.take(index), candidates.partial[index], candidates.cells[index])


def generate_motion(system: System, count: int, seed: int) -> Motion:
    """Generate a motion of this many poses, each seen by every sensor.

    Raises:
        InputError: the system has no camera, nothing in it moves, or too few poses were found.
    """
    if not system.cameras:
        raise InputError(f"a motion of {system.name} cannot be generated: it has no camera")
    candidates = find_candidates(system, count, seed)
    best = _best_candidates(system, candidates, count) if len(candidates) >= count else range(len(candidates))
    if len(best) < count:
        raise InputError(
            f"found {len(best)} poses of {system.name} that every sensor sees, expected {count}; "
            "widen distance_m, tilt_deg or roll_deg under motion in its simulation.yml"
        )
    return candidates.motion.take(best)


def _best_candidates(system: System, candidates: Candidates, count: int) -> list[int]:
    """Return the indices of the candidates that make the motion.

    If the engine can calibrate nothing of the system, they cover the images and are random otherwise.
    """
    placement = place(system, candidates.motion)
    try:
        found = information(system, placement)
    except UndeterminedError:
        nothing = np.zeros((len(candidates), 1, 1))
        return choose(nothing, 1, candidates.partial, system.motion.partial, candidates.cells, count)
    unit = found.units(_mean_pattern_distance(system, placement))
    chosen = choose(
        unit[:, None] * found.each * unit,
        found.calibrated,
        candidates.partial[found.poses],
        system.motion.partial,
        candidates.cells[found.poses],
        count,
    )
    best: list[int] = found.poses[chosen].tolist()
    return best


def _mean_pattern_distance(system: System, placement: Placement) -> float:
    """Return the mean distance of patterns from the cameras, m: it relates rotations to translations."""
    distances: list[Array] = [
        np.linalg.norm(placement.pattern_in(camera, pattern)[:, :3, 3], axis=-1)
        for pattern in system.patterns
        for camera in system.cameras
    ]
    return float(np.mean(distances))


def named_motion(name: str, system: System | None, seed: int) -> Motion:
    """Read a motion from a file, or generate one if the name is ``generate:N`` and there is a system.

    Raises:
        InputError: the file cannot be read, or too few poses are seen by every sensor.
    """
    if system is None or not name.startswith(GENERATED_PREFIX):
        return read_motion(Path(name))
    return generate_motion(system, pose_count(name), seed)
