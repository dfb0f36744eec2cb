"""What is unknown, and how it makes up the pose of every view.

A *view* is one sensor seeing one pattern in one collection. All that its labels depend on is the
pose ``T_sensor_pattern``, a product of constants and of unknown transforms, the *blocks*. Views of
the same sensor and pattern share the same chain of blocks and form a *group*; all arrays of a
group have its views as their first axis.

The pattern frame of this module is the pattern's, moved to the centre of its corners: a twist about
the centre turns the pattern without moving it, which keeps rotation and translation apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from calibration.geometry.transforms import adjoint, inverse, retract
from calibration.geometry.types import Array, IntArray

NoiseKind = Literal["pixel", "range", "border", "depth_border"]
"""What a residual is measured in: corners in px, ranges of LiDARs and depth cameras in m, the pattern's border in rad,
which a depth camera finds more finely than a LiDAR."""


@dataclass(frozen=True)
class Block:
    """An unknown transform: six parameters, or six for each collection."""

    name: str
    per_collection: bool = False
    held: bool = False
    """Kept at its start: an anchored sensor, or the one that fixes a free gauge."""


Values = tuple[Array, ...]
"""One array for each block: (4, 4), or (N, 4, 4) when it is per collection."""


@dataclass(frozen=True, eq=False)
class Link:
    """A block in a chain, and the constant that follows it."""

    block: int
    inverted: bool
    after: Array | None = None
    """(4, 4), or (V, 4, 4) when it differs between collections; None for the identity."""


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
        adjoint of the chain up to the block; minus that, up to before it, when it is inverted.
        """
        T = _at(self.before, views)
        jacobians: dict[int, Array] = {}
        for link in self.links:
            before = T
            T = _times(T, self._link(link, values, collections))
            if not held[link.block]:
                prefix = before if link.inverted else T
                J = adjoint(np.eye(4)[None] if prefix is None else prefix.reshape(-1, 4, 4))
                J = -J if link.inverted else J
                jacobians[link.block] = jacobians[link.block] + J if link.block in jacobians else J
            T = _times(T, _at(link.after, views))
        return _broadcast(T, collections), list(jacobians.items())

    @staticmethod
    def _link(link: Link, values: Values, collections: IntArray) -> Array:
        value = values[link.block]
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

    def linearise(self, T: Array, views: slice, scale: float, huber: float | None) -> tuple[Array, Array, Array]:
        """Cost (v,), Hessian (v, 6, 6) and gradient (v, 6) for a twist in the sensor's frame.

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


@dataclass(frozen=True, eq=False)
class Problem:
    """Blocks and groups of views over N collections."""

    blocks: tuple[Block, ...]
    groups: tuple[ViewGroup, ...]
    collections: int

    @property
    def held(self) -> list[bool]:
        """For each block, whether it is held."""
        return [block.held for block in self.blocks]

    @property
    def shared(self) -> list[int]:
        """The free blocks that all collections share."""
        return [i for i, b in enumerate(self.blocks) if not b.held and not b.per_collection]

    @property
    def local(self) -> list[int]:
        """The free blocks that each collection has its own of."""
        return [i for i, b in enumerate(self.blocks) if not b.held and b.per_collection]

    @property
    def residuals(self) -> int:
        """How many residuals all labels make."""
        return sum(int(term.counts.sum()) * term.dimension for group in self.groups for term in group.terms)

    def poses(self, group: ViewGroup, values: Values) -> Array:
        """``T_sensor_pattern`` (V, 4, 4) of all views of a group."""
        return group.chain.poses(values, slice(None), group.collections)

    def moved(self, values: Values, shared: Array, local: Array) -> Values:
        """The values after a step: shared (S, 6) and local (N, P, 6) twists."""
        out = list(values)
        for k, block in enumerate(self.shared):
            out[block] = retract(values[block], shared[k])
        for k, block in enumerate(self.local):
            out[block] = retract(values[block], local[:, k])
        return tuple(out)


def _at(constant: Array | None, views: slice) -> Array | None:
    return constant[views] if constant is not None and constant.ndim == 3 else constant


def _times(A: Array | None, B: Array | None) -> Array | None:
    if A is None or B is None:
        return A if B is None else B
    product: Array = A @ B
    return product


def _broadcast(T: Array | None, collections: IntArray) -> Array:
    return np.ascontiguousarray(np.broadcast_to(np.eye(4) if T is None else T, (len(collections), 4, 4)))
