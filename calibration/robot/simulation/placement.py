"""Poses of sensors and patterns while a motion is played, true and nominal."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry.transforms import inverse
from calibration.robot.simulation.motion.sequence import Motion
from calibration.robot.simulation.scene import Scene
from calibration.robot.simulation.sensors.sensor import Views
from calibration.robot.simulation.system import System
from calibration.robot.urdf import compose


@dataclass(frozen=True, eq=False)
class Placement:
    """True poses at each of N poses of a motion; arrays are (N, 4, 4) unless stated otherwise."""

    transforms: Mapping[Edge, Array]
    """Transforms of the robot, by (parent, child)."""
    sensors: Mapping[str, Array]
    """``T_world_sensor``, to the frame of the sensor's data."""
    patterns: Mapping[str, Array]
    """``T_world_pattern``."""
    joints: Mapping[str, Array]
    """Positions (N,) of the movable joints, by name, rad or m."""

    def pattern_in(self, sensor: str, pattern: str) -> Array:
        """Return ``T_sensor_pattern``."""
        return inverse(self.sensors[sensor]) @ self.patterns[pattern]

    def sensors_are_free(self, scene: Scene) -> BoolArray:
        """Return a mask (N,) of the poses at which no sensor is in a box or under the ground."""
        origins = np.stack([T_world_sensor[:, :3, 3] for T_world_sensor in self.sensors.values()], 1)
        free: BoolArray = ~np.any(scene.contains(origins), axis=-1)
        return free


def views(system: System, placement: Placement, sensor: str, pattern: str) -> Views:
    """Return the views of a pattern by a sensor, at the poses of a placement."""
    return Views(
        system.configuration.patterns[pattern],
        system.patterns[pattern],
        system.scene,
        placement.sensors[sensor],
        placement.patterns[pattern],
    )


def place(system: System, motion: Motion) -> Placement:
    """Play a motion.

    Raises:
        InputError: the motion lacks something that the system moves, or moves something unknown, or a joint
            is outside its limits.
    """
    moved = system.moved_pattern
    if moved is None and motion.positions is not None:
        raise InputError(
            f"{motion.source}: found positions and orientations, "
            f"but every pattern of {system.name} is fixed; expected joints"
        )
    if moved is not None and motion.positions is None:
        raise InputError(
            f"{motion.source}: found no position and orientation; pattern '{moved.name}' of {system.name} moves by them"
        )
    transforms = system.robot.transforms(motion.joints, count=len(motion))
    tree, world = system.robot.tree, system.configuration.world_link

    def pose(frame: str) -> Array:
        return compose(tree, transforms, world, frame)

    patterns = {name: pose(p.link) for name, p in system.patterns.items() if p.fixed}
    model_poses = motion.model_poses
    if moved is not None and model_poses is not None:
        patterns[moved.name] = pose(moved.parent_link) @ model_poses @ system.T_model_pattern
    sensors = {name: pose(sensor.link) for name, sensor in system.configuration.sensors.items()}
    positions = {
        name: np.asarray(motion.joints.get(name, np.full(len(motion), joint.rest)), float)
        for name, joint in system.robot.movable.items()
    }
    return Placement(transforms, sensors, patterns, positions)


@dataclass(frozen=True, eq=False)
class Play:
    """Played motion: all that a collection at any of its N poses depends on."""

    system: System
    motion: Motion
    seed: int
    true: Placement
    """True poses."""
    nominal: Placement
    """Poses of the nominal robot."""

    def __len__(self) -> int:
        return len(self.motion)


def play(system: System, motion: Motion, seed: int) -> Play:
    """Play a motion with a system.

    Raises:
        InputError: the motion does not fit the system (see `place`), or brings a sensor into a box
            or under the ground.
    """
    true = place(system, motion)
    free = true.sensors_are_free(system.scene)
    if not free.all():
        raise InputError(f"{motion.source}: a sensor is in a box or under the ground in pose {free.argmin() + 1}")
    nominal = true if system.nominal is system.robot else place(replace(system, robot=system.nominal), motion)
    return Play(system, motion, seed, true, nominal)
