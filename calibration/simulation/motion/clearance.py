"""Which poses run into nothing: neither the pattern, nor a sensor, nor a link that moves."""

from dataclasses import replace

import numpy as np

from calibration.dataset.pattern import Pattern
from calibration.geometry.transforms import apply
from calibration.geometry.types import Array, BoolArray
from calibration.simulation.placement import Placement
from calibration.simulation.robot import Joint, compose
from calibration.simulation.system import System

_PATTERN_CLEARANCE = 0.05  # m, from the pattern to the boxes and the ground
_LINK_CLEARANCE = 0.1  # m, from the origins of moving links: about the half width of an arm
_LEVEL = 1e-6  # of an axis of length 1


def is_clear(system: System, pattern: Pattern, placement: Placement) -> BoolArray:
    """Which poses (N,) keep the pattern, the sensors and the links that move out of the boxes and the ground.

    A link that keeps its height, as those of a base that drives, may be as near to the ground as it was built.
    """
    border = np.column_stack([pattern.outline, np.zeros(4)])
    board = apply(placement.patterns[pattern.name], np.concatenate([border, pattern.corners]))
    clear = placement.sensors_are_free(system.scene)
    clear &= ~system.scene.contains(board, _PATTERN_CLEARANCE).any(-1)
    world, tree = system.configuration.world_link, system.robot.tree
    moving = {joint.edge: joint for joint in system.robot.movable.values()}
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
    """Whether a joint with this axis (3,) in the world moves level, as those do that a base drives and turns by."""
    along = float(np.abs(axis[2]))
    return along < _LEVEL if joint.kind == "prismatic" else along > 1 - _LEVEL
