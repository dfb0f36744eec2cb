"""Kinematics: joints of a robot with their derivatives, and trees of frames with the path between any two."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, sin
from typing import Literal, get_args

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, ArrayLike
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import adjoint, inverse, transform, translation

JointParameter = Literal[
    "origin_x", "origin_y", "origin_z", "origin_roll", "origin_pitch", "origin_yaw", "position_bias"
]
JOINT_PARAMETERS: tuple[JointParameter, ...] = get_args(JointParameter)


@dataclass(frozen=True)
class JointModel:
    """A revolute or prismatic joint, ``T_parent_child = origin * motion(position + bias)``, as URDF has it.

    Motions about one axis commute, so ``T = (origin * motion(bias)) * motion(position)``: the unknown
    part is a constant on the left of the measured position.
    """

    prismatic: bool
    axis: tuple[float, float, float]
    """Unit vector (3,), in the frame of the origin."""

    def unit(self, parameter: JointParameter) -> Literal["m", "rad"]:
        """Unit of a parameter."""
        lengths = ("origin_x", "origin_y", "origin_z", *(("position_bias",) if self.prismatic else ()))
        return "m" if parameter in lengths else "rad"

    def motion(self, positions: ArrayLike) -> Array:
        """Return the motions (..., 4, 4) of the joint at positions (...), m or rad."""
        steps = np.asarray(positions, float)[..., None] * np.array(self.axis)
        return translation(steps) if self.prismatic else transform(rotations.exp(steps), np.zeros(3))

    def pose(self, parameters: Array) -> Array:
        """Return the transform (4, 4) at position 0 from the parameters (7,) in the order of `JOINT_PARAMETERS`."""
        *xyz, roll, pitch, yaw, bias = parameters.tolist()
        T = np.eye(4)
        T[:3, :3] = _from_rpy(roll, pitch, yaw)
        T[:3, 3] = xyz
        if bias != 0.0:
            T = T @ self.motion(bias)
        return T

    def columns(self, parameters: Array) -> Array:
        """Return the Jacobian (6, 7) of `pose` with respect to the parameters, as twists in the child frame."""
        _, _, _, roll, pitch, yaw, bias = parameters.tolist()
        cos_roll, sin_roll, cos_pitch, sin_pitch = cos(roll), sin(roll), cos(pitch), sin(pitch)
        columns = np.zeros((6, 7))  # in the frame of the origin
        columns[:3, :3] = _from_rpy(roll, pitch, yaw).T
        columns[3:, 3:6] = (
            (1.0, 0.0, -sin_pitch),
            (0.0, cos_roll, cos_pitch * sin_roll),
            (0.0, -sin_roll, cos_pitch * cos_roll),
        )
        columns[slice(0, 3) if self.prismatic else slice(3, 6), 6] = self.axis
        if bias != 0.0:
            columns = adjoint(inverse(self.motion(bias))) @ columns
        return columns


def _from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Scalar version of `calibration.engine.geometry.rotations.from_rpy`, ten times as fast for one rotation."""
    a, b, c, d, e, f = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    return np.array(
        [
            [e * c, e * d * b - f * a, e * d * a + f * b],
            [f * c, f * d * b + e * a, f * d * a - e * b],
            [-d, c * b, c * a],
        ]
    )


@dataclass(frozen=True)
class Step:
    """Edge of a path: the transform ``T_parent_child``, or its inverse if ``inverted``."""

    parent: str
    child: str
    inverted: bool


class FrameTree:
    """Frames of a robot, connected by edges parent -> child.

    Raises:
        InputError: a frame has two parents, or the edges form a loop.
    """

    def __init__(self, edges: Iterable[tuple[str, str]]) -> None:
        self._parent: dict[str, str] = {}
        self._frames: dict[str, None] = {}  # in order of appearance
        for parent, child in edges:
            known = self._parent.setdefault(child, parent)
            if known != parent:
                raise InputError(f"frame '{child}' has two parents, '{known}' and '{parent}'; a tree needs one")
            self._frames.setdefault(parent)
            self._frames.setdefault(child)
        self._refuse_loops()

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames, in order of appearance."""
        return tuple(self._frames)

    def __contains__(self, frame: str) -> bool:
        return frame in self._frames

    def path(self, start: str, end: str) -> tuple[Step, ...]:
        """Return the steps whose product is ``T_start_end``.

        Raises:
            InputError: a frame is not in the tree, or the two are not connected.
        """
        for frame in (start, end):
            if frame not in self._frames:
                raise InputError(f"frame '{frame}' is not in the tree (frames: {', '.join(self._frames)})")
        up, down = self._ancestors(start), self._ancestors(end)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            raise InputError(f"frames '{start}' and '{end}' are not connected")
        ascent = [Step(self._parent[f], f, inverted=True) for f in list(up)[: up[common]]]
        descent = [Step(self._parent[f], f, inverted=False) for f in list(down)[: down[common]]]
        return (*ascent, *reversed(descent))

    def _ancestors(self, frame: str) -> dict[str, int]:
        """Return the frame and its ancestors up to the root, each with its depth."""
        chain = {frame: 0}
        while (parent := self._parent.get(frame)) is not None:
            frame = parent
            chain[frame] = len(chain)
        return chain

    def _refuse_loops(self) -> None:
        """Raise if following the parents leads to a loop; each edge is visited once.

        A parent appears before its children do, so a loop is entered at one of its own frames.
        """
        safe: set[str] = set()
        for start in self._frames:
            chain: dict[str, None] = {}
            frame: str | None = start
            while frame is not None and frame not in safe:
                if frame in chain:
                    raise InputError(f"frames form a loop: {' -> '.join([frame, *reversed(chain)])}")
                chain[frame] = None
                frame = self._parent.get(frame)
            safe.update(chain)
