"""Joints of a robot: the transform from parent to child, and what each of its parameters does to it."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from calibration.geometry import rotations
from calibration.geometry.transforms import adjoint, from_xyz_rpy, inverse, transform, translation
from calibration.geometry.types import Array, ArrayLike

JointParameter = Literal[
    "origin_x", "origin_y", "origin_z", "origin_roll", "origin_pitch", "origin_yaw", "position_bias"
]
JOINT_PARAMETERS: tuple[JointParameter, ...] = get_args(JointParameter)


@dataclass(frozen=True)
class JointModel:
    """A revolute or prismatic joint, ``T_parent_child = origin * motion(position + bias)``, as URDF has it.

    Motions along one axis commute, so ``T = (origin * motion(bias)) * motion(position)``: what is
    unknown stands before what the encoder tells, and is the same for every position.
    """

    prismatic: bool
    axis: tuple[float, float, float]
    """Of unit length, in the frame of the origin."""

    def unit(self, parameter: JointParameter) -> Literal["m", "rad"]:
        """What a parameter is measured in."""
        lengths = ("origin_x", "origin_y", "origin_z", *(("position_bias",) if self.prismatic else ()))
        return "m" if parameter in lengths else "rad"

    def motion(self, positions: ArrayLike) -> Array:
        """What positions (...), m or rad, add to the origin: (..., 4, 4)."""
        steps = np.asarray(positions, float)[..., None] * np.array(self.axis)
        return translation(steps) if self.prismatic else transform(rotations.exp(steps), np.zeros(3))

    def pose(self, parameters: Array) -> Array:
        """The joint at position 0, (4, 4), from all its parameters (7,) in the order of `JOINT_PARAMETERS`."""
        origin = from_xyz_rpy(parameters[:3], parameters[3:6])
        posed: Array = origin @ self.motion(parameters[6])
        return posed

    def columns(self, parameters: Array) -> Array:
        """(6, 7): how each parameter moves `pose`, as a twist in its child frame."""
        roll, pitch, _ = parameters[3:6]
        Rx, Ry = rotations.exp([roll, 0.0, 0.0]), rotations.exp([0.0, pitch, 0.0])
        columns = np.zeros((6, 7))  # in the frame of the origin
        columns[:3, :3] = rotations.from_rpy(parameters[3:6]).T
        columns[3:, 3] = (1.0, 0.0, 0.0)
        columns[3:, 4] = Rx.T[:, 1]
        columns[3:, 5] = (Ry @ Rx).T[:, 2]
        columns[slice(0, 3) if self.prismatic else slice(3, 6), 6] = self.axis
        moved: Array = adjoint(inverse(self.motion(parameters[6]))) @ columns
        return moved
