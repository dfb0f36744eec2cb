"""What is unknown, and how it makes up the pose of every view.

A *view* is one sensor seeing one pattern in one collection. All that its labels depend on is the
pose ``T_sensor_pattern``, a product of constants and of unknown transforms, the *blocks*. A block is
a pose with its six parameters, or a joint of which some parameters are free. Where the intrinsics
of a camera are unknown too, they are a block that stands in no chain: its views depend on the pose and on
them. Views of the same sensor and pattern share the same chain of blocks and form a *group*; all arrays of a
group have its views as their first axis.

The pattern frame of this module is the pattern's, moved to the centre of its corners: a twist about
the centre turns the pattern without moving it, which keeps rotation and translation apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

from calibration.estimation.intrinsics import FreeIntrinsics
from calibration.geometry.cameras import Camera
from calibration.geometry.joints import JOINT_PARAMETERS, JointModel, JointParameter
from calibration.geometry.transforms import adjoint, inverse, moved_twists, retract
from calibration.geometry.types import Array, BoolArray, IntArray

NoiseKind = Literal["pixel", "range", "border", "depth_border", "lidar2d_range", "lidar2d_border"]
"""What a residual is measured in: corners in px, ranges of LiDARs and depth cameras in m, the pattern's border in rad,
which a depth camera finds more finely than a LiDAR. A 2D LiDAR has its own: it is another device with another step."""
BORDERS: frozenset[NoiseKind] = frozenset({"border", "depth_border", "lidar2d_border"})


@dataclass(frozen=True)
class FreeJoint:
    """A joint some of whose parameters are unknown."""

    model: JointModel
    free: tuple[JointParameter, ...]
    """In the order of `JOINT_PARAMETERS`."""

    @cached_property
    def at(self) -> list[int]:
        """Where the free parameters stand among all."""
        return [JOINT_PARAMETERS.index(parameter) for parameter in self.free]

    def without(self, parameter: str) -> "FreeJoint":
        """The same with one parameter fewer free."""
        return FreeJoint(self.model, tuple(each for each in self.free if each != parameter))

    def columns(self, value: Array) -> Array:
        """(6, k): how each free parameter moves the joint's pose, as a twist in its child frame."""
        columns: Array = self.model.columns(value)[:, self.at]
        return columns

    def moved(self, value: Array, step: Array) -> Array:
        """The parameters (7,) after a step (k,)."""
        out = value.copy()
        out[self.at] += step
        return out


@dataclass(frozen=True)
class Block:
    """An unknown transform: six parameters, or six for each collection; or free parameters of a joint or a camera."""

    name: str
    per_collection: bool = False
    held: bool = False
    """Kept at its start: an anchored sensor, or the one that fixes a free gauge."""
    joint: FreeJoint | None = None
    intrinsics: FreeIntrinsics | None = None

    @property
    def vector(self) -> FreeJoint | FreeIntrinsics | None:
        """What has parameters of its own, in the place of a twist's."""
        return self.joint or self.intrinsics

    @property
    def dimension(self) -> int:
        """How many parameters it has, in each collection if it is per collection."""
        return len(self.vector.free) if self.vector else 6


Values = tuple[Array, ...]
"""One array for each block: (4, 4), or (N, 4, 4) when it is per collection; all parameters of a joint (7,) or of a
camera (4 + n,)."""


@dataclass(frozen=True, eq=False)
class Link:
    """A block in a chain, and the constant that follows it."""

    block: int
    inverted: bool
    after: Array | None = None
    """(4, 4), or (V, 4, 4) when it differs between collections; None for the identity."""
    joint: FreeJoint | None = None
    """The block's, where it is one."""


@dataclass(frozen=True, eq=False)
class Chain:
    """``T_sensor_pattern`` as ``before * link * link ...``, each link a block and a constant."""

    before: Array | None
    links: tuple[Link, ...]

    def poses(self, values: Values, views: slice, collections: IntArray) -> Array:
        """``T_sensor_pattern`` of some views, (v, 4, 4)."""
        T = _at(self.before, views)
        for link in self.links:
            T = _times(T, self._link(link, values, collections))
            T = _times(T, _at(link.after, views))
        return _broadcast(T, collections)

    def jacobians(
        self, values: Values, views: slice, collections: IntArray, held: Sequence[bool]
    ) -> tuple[Array, list[tuple[int, Array]]]:
        """The poses, and for each free block how its twist moves them.

        The Jacobian of a block maps its twist (in its child frame) to the twist of the pose in the
        sensor's frame: (1, 6, 6) where it is the same for all views, else (v, 6, 6). It is the
        adjoint of the chain up to the block; minus that, up to before it, when it is inverted. A
        joint's, (1 or v, 6, k), is that of the twists which its k free parameters make.
        """
        T = _at(self.before, views)
        jacobians: dict[int, Array] = {}
        for link in self.links:
            before = T
            T = _times(T, self._link(link, values, collections))
            if not held[link.block]:
                prefix = before if link.inverted else T
                prefix = np.eye(4)[None] if prefix is None else prefix.reshape(-1, 4, 4)
                J = moved_twists(prefix, link.joint.columns(values[link.block])) if link.joint else adjoint(prefix)
                J = -J if link.inverted else J
                jacobians[link.block] = jacobians[link.block] + J if link.block in jacobians else J
            T = _times(T, _at(link.after, views))
        return _broadcast(T, collections), list(jacobians.items())

    def take(self, views: IntArray) -> "Chain":
        """That of only some of the views."""
        links = tuple(replace(link, after=_at(link.after, views)) for link in self.links)
        return Chain(_at(self.before, views), links)

    @staticmethod
    def _link(link: Link, values: Values, collections: IntArray) -> Array:
        value = values[link.block]
        if link.joint:
            value = link.joint.model.pose(value)
        T = value[collections] if value.ndim == 3 else value
        return inverse(T) if link.inverted else T


class Term(Protocol):
    """The labels of a group's views, of one kind; see `calibration.estimation.residuals`."""

    @property
    def kind(self) -> NoiseKind:
        """What its residuals are measured in."""

    @property
    def dimension(self) -> int:
        """Residuals per label: 2 for a corner (its two axes go together), 1 for a distance."""

    @property
    def counts(self) -> IntArray:
        """(V,): the labels of each view."""

    def take(self, views: IntArray | slice) -> "Term":
        """Only some of the views."""

    def seen_with(self, camera: Camera, free: Sequence[int]) -> "Term":
        """The same labels of a camera with other intrinsics, m of which (by their places among all) are free."""

    def linearise(self, T: Array, views: slice, scale: float, huber: float | None) -> tuple[Array, Array, Array]:
        """Cost (v,), Hessian (v, 6 + m, 6 + m) and gradient (v, 6 + m) for a twist in the sensor's frame.

        The m free intrinsics come after the six of the twist.

        ``scale`` is the standard deviation that divides the residuals, ``huber`` the threshold in
        standard deviations beyond which the loss grows linearly. A view that cannot be (a pattern
        behind its camera) costs infinity.
        """

    def magnitudes(self, T: Array) -> Array:
        """(V, L): the norm of each label's residual in px, m or rad; NaN where there is no label."""


@dataclass(frozen=True, eq=False)
class ViewGroup:
    """The views of one sensor and one pattern."""

    sensor: str
    pattern: str
    collections: IntArray
    """(V,): the collection of each view, ascending, each once."""
    chain: Chain
    terms: tuple[Term, ...]
    """With the nominal intrinsics of a camera; see `Problem.terms`."""
    intrinsics: int | None = None
    """The block of the camera's intrinsics, where it has one."""

    def take(self, views: IntArray) -> "ViewGroup":
        """Only some of the views."""
        terms = tuple(term.take(views) for term in self.terms)
        return replace(self, collections=self.collections[views], chain=self.chain.take(views), terms=terms)


@dataclass(frozen=True, eq=False)
class Problem:
    """Blocks and groups of views over N collections."""

    blocks: tuple[Block, ...]
    groups: tuple[ViewGroup, ...]
    collections: int

    @cached_property
    def held(self) -> list[bool]:
        """For each block, whether it is held."""
        return [block.held for block in self.blocks]

    @cached_property
    def shared(self) -> list[int]:
        """The free blocks that all collections share."""
        return [i for i, b in enumerate(self.blocks) if not b.held and not b.per_collection]

    @cached_property
    def local(self) -> list[int]:
        """The free blocks that each collection has its own of."""
        return [i for i, b in enumerate(self.blocks) if not b.held and b.per_collection]

    @cached_property
    def shared_parameters(self) -> dict[int, slice]:
        """Where the parameters of each shared block stand among those of all shared blocks."""
        return self._placed(self.shared)

    @cached_property
    def local_parameters(self) -> dict[int, slice]:
        """Where the parameters of each local block stand among those of all local blocks of a collection."""
        return self._placed(self.local)

    def _placed(self, blocks: list[int]) -> dict[int, slice]:
        ends = np.cumsum([0, *(self.blocks[i].dimension for i in blocks)]).tolist()
        return {block: slice(*ends[k : k + 2]) for k, block in enumerate(blocks)}

    @property
    def residuals(self) -> int:
        """How many residuals all labels make."""
        return sum(int(term.counts.sum()) * term.dimension for group in self.groups for term in group.terms)

    def seen_in(self, which: BoolArray) -> "Problem":
        """The problem with only the views of some of its collections (N,)."""
        groups = (group.take(np.flatnonzero(which[group.collections])) for group in self.groups)
        return replace(self, groups=tuple(group for group in groups if len(group.collections)))

    @property
    def has_vectors(self) -> bool:
        """Whether parameters of a joint or a camera are free."""
        return any(self.blocks[i].vector for i in self.shared)

    @property
    def has_priors(self) -> bool:
        """Whether anything is known beforehand of what is free."""
        return any(b.intrinsics is not None and b.intrinsics.prior is not None and not b.held for b in self.blocks)

    def free_intrinsics(self, group: ViewGroup) -> tuple[int, FreeIntrinsics] | None:
        """The block of intrinsics that a group's views depend on, where it is free."""
        if group.intrinsics is None or self.held[group.intrinsics]:
            return None
        intrinsics = self.blocks[group.intrinsics].intrinsics
        return (group.intrinsics, intrinsics) if intrinsics else None

    def terms(self, group: ViewGroup, values: Values) -> tuple[Term, ...]:
        """A group's terms with the intrinsics that its camera has at some values."""
        free = self.free_intrinsics(group)
        if free is None:
            return group.terms
        block, intrinsics = free
        camera = intrinsics.camera.with_intrinsics(values[block])
        return tuple(term.seen_with(camera, intrinsics.at) for term in group.terms)

    def poses(self, group: ViewGroup, values: Values) -> Array:
        """``T_sensor_pattern`` (V, 4, 4) of all views of a group."""
        return group.chain.poses(values, slice(None), group.collections)

    def moved(self, values: Values, shared: Array, local: Array) -> Values:
        """The values after a step of all S shared parameters (S,) and the P local ones of each collection (N, P)."""
        out = list(values)
        for block, at in self.shared_parameters.items():
            vector = self.blocks[block].vector
            out[block] = vector.moved(values[block], shared[at]) if vector else retract(values[block], shared[at])
        for block, at in self.local_parameters.items():
            out[block] = retract(values[block], local[:, at])
        return tuple(out)


def _at(constant: Array | None, views: slice | IntArray) -> Array | None:
    return constant[views] if constant is not None and constant.ndim == 3 else constant


def _times(A: Array | None, B: Array | None) -> Array | None:
    if A is None or B is None:
        return A if B is None else B
    product: Array = A @ B
    return product


def _broadcast(T: Array | None, collections: IntArray) -> Array:
    if T is not None and T.shape == (len(collections), 4, 4):
        return np.ascontiguousarray(T)  # the usual case, at a fraction of the cost
    return np.ascontiguousarray(np.broadcast_to(np.eye(4) if T is None else T, (len(collections), 4, 4)))
