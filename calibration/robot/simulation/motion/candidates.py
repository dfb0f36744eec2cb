"""Candidate poses of a motion: visible to every sensor, and without collisions."""

import math
from dataclasses import dataclass, replace

import numpy as np

from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.pattern import UNMARKED_KINDS, Pattern
from calibration.engine.geometry.transforms import apply
from calibration.robot.simulation.motion.drawing import draw_motion
from calibration.robot.simulation.motion.sequence import Motion, joined
from calibration.robot.simulation.placement import Placement, place, views
from calibration.robot.simulation.random_streams import stream
from calibration.robot.simulation.robot import Joint, compose
from calibration.robot.simulation.system import System

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
    moving = {joint.edge: joint for joint in system.robot.joints if joint.is_movable}
    above_ground, at_rest = replace(system.scene, ground=None), system.robot.transforms({})
    for frame in tree.frames:
        joints = [moving[e] for step in tree.path(world, frame) if (e := (step.parent, step.child)) in moving]
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
    found: BoolArray = np.all(some, axis=0)
    return found


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
