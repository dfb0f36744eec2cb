"""Which poses run into nothing: neither the pattern, nor a sensor, nor a link that moves."""

import numpy as np

from calibration.dataset.pattern import Pattern
from calibration.geometry.transforms import apply
from calibration.geometry.types import BoolArray
from calibration.simulation.placement import Placement
from calibration.simulation.robot import compose
from calibration.simulation.system import System

_PATTERN_CLEARANCE = 0.05  # m, from the pattern to the boxes and the ground
_LINK_CLEARANCE = 0.1  # m, from the origins of moving links: about the half width of an arm


def is_clear(system: System, pattern: Pattern, placement: Placement) -> BoolArray:
    """Which poses (N,) keep the pattern, the sensors and the links that move out of the boxes and the ground."""
    border = np.column_stack([pattern.outline, np.zeros(4)])
    board = apply(placement.patterns[pattern.name], np.concatenate([border, pattern.corners]))
    clear = placement.sensors_are_free(system.scene)
    clear &= ~system.scene.contains(board, _PATTERN_CLEARANCE).any(-1)
    world, tree = system.configuration.world_link, system.robot.tree
    moving = {joint.edge for joint in system.robot.movable.values()}
    for frame in tree.frames:
        if any((step.parent, step.child) in moving for step in tree.path(world, frame)):
            origin = compose(tree, placement.transforms, world, frame)[:, :3, 3]
            clear &= ~system.scene.contains(origin, _LINK_CLEARANCE)
    return clear
