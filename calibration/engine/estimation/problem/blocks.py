"""Blocks of unknowns: a pose, a joint or a camera's intrinsics, each with its parametrisation."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Edge
from calibration.engine.estimation.problem.intrinsics import FreeIntrinsics
from calibration.engine.estimation.problem.motion import Motion
from calibration.engine.geometry.joints import JOINT_PARAMETERS, JointModel, JointParameter
from calibration.engine.geometry.transforms import inverse_adjoint, retract, twists_in_child


@dataclass(frozen=True)
class Pose:
    """Transform ``T_parent_child`` (4, 4), moved by a twist in its child frame: translation, rotation (m, rad)."""

    free: ClassVar[tuple[str, ...]] = ()
    """Parameters that can be fixed by name: none."""
    dimension: ClassVar[int] = 6

    def moved(self, value: Array, step: Array) -> Array:
        """Return the transform (..., 4, 4) after a twist (..., 6)."""
        return retract(value, step)

    def jacobian(self, T_child_pattern: Array, value: Array) -> Array:
        """Jacobian (v, 6, 6) of the twist in the pattern's frame by the parameters, with the pattern at (v, 4, 4)."""
        return inverse_adjoint(T_child_pattern)

    def motions(self, size: float) -> list[Motion]:
        """Return the motions of the parameters, in order; ``size`` is the pattern's, m."""
        return [Motion("translation", 3, unit=size, extent=size), Motion("rotation", 3)]


@dataclass(frozen=True)
class FreeJoint:
    """Joint with some unknown parameters; its value is the array of all parameters, (7,)."""

    model: JointModel
    free: tuple[JointParameter, ...]
    """Free parameters, in the order of `JOINT_PARAMETERS`."""

    @property
    def dimension(self) -> int:
        """Number of free parameters."""
        return len(self.free)

    @cached_property
    def at(self) -> list[int]:
        """Indices of the free parameters among all."""
        return [JOINT_PARAMETERS.index(parameter) for parameter in self.free]

    def without(self, parameter: str) -> "FreeJoint":
        """Return the joint with one parameter fewer free."""
        return FreeJoint(self.model, tuple(each for each in self.free if each != parameter))

    def moved(self, value: Array, step: Array) -> Array:
        """Return all parameters (7,) after a step (k,) of the free ones."""
        out = value.copy()
        out[self.at] += step
        return out

    def jacobian(self, T_child_pattern: Array, value: Array) -> Array:
        """Jacobian (v, 6, k), like that of a pose."""
        return twists_in_child(T_child_pattern, self.model.columns(value)[:, self.at])

    def motions(self, size: float) -> list[Motion]:
        """Return the motions of the parameters, like those of a pose."""
        lengths = [self.model.unit(parameter) == "m" for parameter in self.free]
        return [
            Motion("translation", 1, name, size, size) if is_length else Motion("rotation", 1, name)
            for name, is_length in zip(self.free, lengths, strict=True)
        ]


@dataclass(frozen=True)
class Block:
    """Unknown, with its parametrisation."""

    name: str
    per_collection: bool = False
    """Whether each collection has a value of its own; only for poses."""
    held: bool = False
    """Fixed at the initial guess: an anchored sensor, one that fixes a free gauge, or one fixed by the user."""
    parameters: Pose | FreeJoint | FreeIntrinsics = Pose()
    edge: Edge | None = None
    """Parent and child of the transform; None for intrinsics."""

    @property
    def dimension(self) -> int:
        """Number of free parameters, per collection if it is per collection."""
        return self.parameters.dimension

    @property
    def joint(self) -> FreeJoint | None:
        """Parametrisation of a joint; None for others."""
        return self.parameters if isinstance(self.parameters, FreeJoint) else None

    @property
    def intrinsics(self) -> FreeIntrinsics | None:
        """Parametrisation of intrinsics; None for others."""
        return self.parameters if isinstance(self.parameters, FreeIntrinsics) else None

    def pose(self, value: Array) -> Array:
        """Return the transform at a value: (4, 4), or (N, 4, 4) if it is per collection."""
        return value if self.joint is None else self.joint.model.pose(value)


Values = tuple[Array, ...]
"""One array for each block: (4, 4), or (N, 4, 4) if it is per collection; all parameters of a joint (7,) or of a
camera (4 + n,).
"""
