"""Least-squares problem: blocks of unknowns, and groups of views over N collections."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.estimation.problem.batches import Batch, batches
from calibration.engine.estimation.problem.blocks import Block, Pose, Values
from calibration.engine.estimation.residuals.views import Term, ViewGroup
from calibration.engine.geometry.transforms import retract


@dataclass(frozen=True, eq=False)
class Problem:
    """Blocks and groups of views over N collections."""

    blocks: tuple[Block, ...]
    """Blocks of transforms first, then those of intrinsics."""
    groups: tuple[ViewGroup, ...]
    collections: int

    @cached_property
    def shared(self) -> list[int]:
        """Free blocks that all collections share."""
        return [i for i, b in enumerate(self.blocks) if not b.held and not b.per_collection]

    @cached_property
    def local(self) -> list[int]:
        """Free blocks with a value per collection."""
        return [i for i, b in enumerate(self.blocks) if not b.held and b.per_collection]

    @cached_property
    def shared_parameters(self) -> dict[int, slice]:
        """Parameters of each shared block among those of all shared blocks."""
        return self._place_parameters(self.shared)

    @cached_property
    def local_parameters(self) -> dict[int, slice]:
        """Parameters of each local block among those of all local blocks of a collection."""
        return self._place_parameters(self.local)

    def _place_parameters(self, blocks: list[int]) -> dict[int, slice]:
        ends = np.cumsum([0, *(self.blocks[i].dimension for i in blocks)]).tolist()
        return {block: slice(*ends[k : k + 2]) for k, block in enumerate(blocks)}

    @cached_property
    def sizes(self) -> tuple[int, int]:
        """S and P: numbers of shared parameters, and of local parameters per collection."""
        dimensions = [[self.blocks[i].dimension for i in blocks] for blocks in (self.shared, self.local)]
        return sum(dimensions[0]), sum(dimensions[1])

    def units(self, size: float) -> Array:
        """Unit (S,) of each shared parameter: ``size`` (m) for lengths, 1 rad for angles."""
        motions = (motion for i in self.shared for motion in self.blocks[i].parameters.motions(size))
        return np.concatenate([np.full(motion.length, motion.unit) for motion in motions])

    @cached_property
    def batches(self) -> tuple[Batch, ...]:
        """Batches in which all views are evaluated."""
        return batches(self.blocks, self.groups, self.collections, self.shared_parameters, self.local_parameters)

    @property
    def residuals(self) -> int:
        """Number of residuals of all labels."""
        return sum(int(term.counts.sum()) * term.dimension for group in self.groups for term in group.terms)

    def seen_in(self, which: BoolArray) -> "Problem":
        """Return the problem with only the views of some of its collections (N,)."""
        if which.all():
            return self
        groups = (group.take(np.flatnonzero(which[group.collections])) for group in self.groups)
        return replace(self, groups=tuple(group for group in groups if len(group.collections)))

    def repeating(self, which: IntArray) -> "Problem":
        """Return the problem of some of its collections (n,), each as often as it occurs, in this order."""
        groups = []
        for group in self.groups:
            place = np.full(self.collections, -1)
            place[group.collections] = np.arange(len(group.collections))
            seen = np.flatnonzero(place[which] >= 0)
            if len(seen):
                groups.append(replace(group.take(place[which[seen]]), collections=seen))
        return Problem(self.blocks, tuple(groups), len(which))

    def collections_with(self, block: int) -> BoolArray:
        """Return a mask (N,) of the collections with a view that depends on the transform of a block."""
        seen = np.zeros(self.collections, bool)
        for group in self.groups:
            if any(link.block == block for link in group.chain.links):
                seen[group.collections] = True
        return seen

    @property
    def has_priors(self) -> bool:
        """Whether any free parameter has a prior."""
        return any(b.intrinsics is not None and b.intrinsics.prior is not None and not b.held for b in self.blocks)

    def terms(self, views: ViewGroup | Batch, values: Values) -> tuple[Term, ...]:
        """Return the terms of a group or a batch with its camera's intrinsics at given values."""
        block = views.intrinsics
        if block is None or self.blocks[block].held or (intrinsics := self.blocks[block].intrinsics) is None:
            return views.terms
        camera = intrinsics.camera.with_intrinsics(values[block])
        return tuple(term.seen_with(camera, intrinsics.at) for term in views.terms)

    def intrinsics_at(self, batch: Batch) -> slice:
        """Return the free intrinsics of a batch among the shared parameters; empty without any."""
        return slice(0, 0) if batch.intrinsics is None else self.shared_parameters[batch.intrinsics]

    def poses(self, group: ViewGroup, values: Values) -> Array:
        """Return ``T_sensor_pattern`` (V, 4, 4) of all views of a group."""
        return group.chain.poses(self.transforms(values), group.collections)

    def transforms(self, values: Sequence[Array]) -> list[Array]:
        """Return the transform of each block, (4, 4) or (N, 4, 4), including those of joints."""
        return [block.pose(value) for block, value in zip(self.blocks, values, strict=True)]

    def moved(self, values: Values, shared: Array, local: Array) -> Values:
        """Return the values after a step of the shared parameters (S,) and the local ones of each collection (N, P)."""
        out = list(values)
        steps = [(i, values[i][None], shared[None, at]) for i, at in self.shared_parameters.items()]
        steps += [(i, values[i], local[:, at]) for i, at in self.local_parameters.items()]
        poses = [step for step in steps if isinstance(self.blocks[step[0]].parameters, Pose)]
        for i, value, step in steps:
            if not isinstance(self.blocks[i].parameters, Pose):
                out[i] = self.blocks[i].parameters.moved(value[0], step[0])
        if poses:  # all at once: they are small arrays
            moved = retract(np.concatenate([T for _, T, _ in poses]), np.concatenate([step for _, _, step in poses]))
            start = 0
            for i, T, _ in poses:
                out[i] = moved[start : start + len(T)].reshape(values[i].shape)
                start += len(T)
        return tuple(out)
