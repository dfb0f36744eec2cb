"""What is unknown: blocks, each a pose, a joint or a camera's intrinsics, and what their parameters do."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from calibration.dataset.model import Edge
from calibration.estimation.intrinsics import FreeIntrinsics
from calibration.estimation.motion import Motion
from calibration.geometry.joints import JOINT_PARAMETERS, JointModel, JointParameter
from calibration.geometry.transforms import adjoint, moved_twists, retract
from calibration.geometry.types import Array


@dataclass(frozen=True)
class Pose:
    """A transform ``T_parent_child`` (4, 4), moved by a twist in its child frame: translation, rotation (m, rad)."""

    free: ClassVar[tuple[str, ...]] = ()
    """Parameters that have names of their own, by which they can be held: none."""
    dimension: ClassVar[int] = 6

    def moved(self, value: Array, step: Array) -> Array:
        """The transform (..., 4, 4) after a twist (..., 6)."""
        return retract(value, step)

    def jacobian(self, T_sensor_child: Array, value: Array) -> Array:
        """(v, 6, 6): the twist in the sensor's frame that each parameter makes, from the child frame's pose there."""
        return adjoint(T_sensor_child)

    def motions(self, size: float) -> list[Motion]:
        """What the parameters move, in their order; ``size`` is the pattern's, m."""
        return [Motion("translation", 3, unit=size, extent=size), Motion("rotation", 3)]


@dataclass(frozen=True)
class FreeJoint:
    """A joint some of whose parameters are unknown; its value are all of them, (7,)."""

    model: JointModel
    free: tuple[JointParameter, ...]
    """In the order of `JOINT_PARAMETERS`."""

    @property
    def dimension(self) -> int:
        """How many parameters are free."""
        return len(self.free)

    @cached_property
    def at(self) -> list[int]:
        """Where the free parameters stand among all."""
        return [JOINT_PARAMETERS.index(parameter) for parameter in self.free]

    def without(self, parameter: str) -> "FreeJoint":
        """The same with one parameter fewer free."""
        return FreeJoint(self.model, tuple(each for each in self.free if each != parameter))

    def moved(self, value: Array, step: Array) -> Array:
        """All parameters (7,) after a step (k,) of the free ones."""
        out = value.copy()
        out[self.at] += step
        return out

    def jacobian(self, T_sensor_child: Array, value: Array) -> Array:
        """(v, 6, k): as that of a pose."""
        return moved_twists(T_sensor_child, self.model.columns(value)[:, self.at])

    def motions(self, size: float) -> list[Motion]:
        """As those of a pose."""
        lengths = [self.model.unit(parameter) == "m" for parameter in self.free]
        return [
            Motion("translation", 1, name, size, size) if is_length else Motion("rotation", 1, name)
            for name, is_length in zip(self.free, lengths, strict=True)
        ]


@dataclass(frozen=True)
class Block:
    """An unknown, and which parameters it has."""

    name: str
    per_collection: bool = False
    """Whether each collection has its own; only poses do."""
    held: bool = False
    """Kept at its start: an anchored sensor, one that fixes a free gauge, or what the user holds."""
    parameters: Pose | FreeJoint | FreeIntrinsics = Pose()
    edge: Edge | None = None
    """Parent and child of the transform; None for intrinsics."""

    @property
    def dimension(self) -> int:
        """How many parameters are free, in each collection if it is per collection."""
        return self.parameters.dimension

    @property
    def joint(self) -> FreeJoint | None:
        """Its parameters where they are those of a joint."""
        return self.parameters if isinstance(self.parameters, FreeJoint) else None

    @property
    def intrinsics(self) -> FreeIntrinsics | None:
        """Its parameters where they are intrinsics of a camera."""
        return self.parameters if isinstance(self.parameters, FreeIntrinsics) else None

    def pose(self, value: Array) -> Array:
        """The transform at a value: (4, 4), or (N, 4, 4) where it is per collection."""
        return value if self.joint is None else self.joint.model.pose(value)


Values = tuple[Array, ...]
"""One array for each block: (4, 4), or (N, 4, 4) when it is per collection; all parameters of a joint (7,) or of a
camera (4 + n,)."""
