"""Least-squares problem: blocks of unknowns, and groups of views over N collections, evaluated in batches.

Batches are evaluated in one pass, because many calls on small arrays cost more than one on a large. A batch is a part
of a large group, or several small groups together, of any sensors and patterns, whose chains have the same form: as
many links, the same ones inverted, constants at the same positions. The transforms of all blocks are in one table, and
a link refers to one of its rows in each view.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.estimation.problem.blocks import Block, FreeIntrinsics, FreeJoint, Pose, Values
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm, side_by_side
from calibration.engine.estimation.residuals.views import LABELS_PER_CHUNK, Link, Term, ViewGroup, per_view, times
from calibration.engine.geometry.transforms import inverse, retract

VIEWS_AT_A_TIME = 1024
"""Most views of a batch, to limit the temporaries: 1024 views of 50 corners take about 10 MB."""
VIEWS_OF_SEVERAL_CAMERAS = 128
"""Most views of a batch with several cameras: intrinsics that differ from view to view cost more for each view, so that
saved calls matter less."""
Columns = slice | IntArray
_IDENTITY_POSE = np.eye(4)


@dataclass(frozen=True, eq=False)
class Part:
    """Views of one group in a batch, with the parameters of the columns of the batch's Jacobian."""

    views: slice
    collections: IntArray
    """(v,)."""
    shared: Columns
    """Columns of shared blocks."""
    shared_at: Columns
    """Their parameters among those of all shared blocks."""
    local: Columns
    """Columns of local blocks."""
    local_at: Columns
    """Their parameters among those of a collection."""
    is_own_twist: bool
    """Whether the local parameters are the twist of the view's pose itself, as a moving pattern's are: then
    their Jacobian is the identity."""

    @cached_property
    def at(self) -> Columns:
        """Its collections, as a slice if they follow each other."""
        first, last = int(self.collections[0]), int(self.collections[-1])
        return slice(first, last + 1) if last - first + 1 == len(self.collections) else self.collections

    @cached_property
    def has_shared(self) -> bool:
        """Whether the poses of its views depend on shared blocks."""
        return _has_columns(self.shared)

    @cached_property
    def has_local(self) -> bool:
        """Whether the poses of its views depend on local blocks."""
        return _has_columns(self.local)

    @cached_property
    def in_shared(self) -> tuple[Columns, ...]:
        """Index of its shared parameters' rows and columns in a matrix (S, S)."""
        return index_of(self.shared_at, self.shared_at)

    @cached_property
    def in_mixed(self) -> tuple[Columns, ...]:
        """Index of its shared and local parameters in (N, S, P)."""
        return index_of(self.at, self.shared_at, self.local_at)

    @cached_property
    def in_local(self) -> tuple[Columns, ...]:
        """Index of its local parameters in (N, P, P)."""
        return index_of(self.at, self.local_at, self.local_at)

    @cached_property
    def in_gradient(self) -> tuple[Columns, ...]:
        """Index of its local parameters in (N, P)."""
        return index_of(self.at, self.local_at)


@dataclass(frozen=True, eq=False)
class _Step:
    """A link at the same position in the chains of all views of a batch."""

    rows: IntArray
    """(V,), or (1,) if all views have the same: rows of the table of transforms."""
    inverted: bool
    after: Array | None
    """(4, 4) or (V, 4, 4); None for the identity."""
    block: int
    """Block of the first view; of all views if it is a joint."""
    parameters: Pose | FreeJoint | None
    """Parametrisation of the block; None if it is fixed."""
    columns: slice
    """Its columns in the Jacobian."""
    is_own_twist: bool
    """Whether its parameters are the twist of the view's pose itself, as a moving pattern's are."""


@dataclass(frozen=True, eq=False)
class Batch:
    """V views of one or more groups."""

    before: Array | None
    """(4, 4) or (V, 4, 4): constant before the first link; None for the identity."""
    steps: tuple[_Step, ...]
    terms: tuple[Term, ...]
    """Each of all V views; with the nominal intrinsics of a camera."""
    parts: tuple[Part, ...]
    intrinsics: int | None
    """Block of free intrinsics that all views depend on; None without one."""

    @cached_property
    def views(self) -> int:
        """Number of views V."""
        return sum(len(part.collections) for part in self.parts)

    def linearise(self, table: Array, values: Values) -> tuple[Array, Array]:
        """Compute the poses of the views, and their Jacobians.

        A block's columns map its parameters to the twist of the pose in the pattern's frame: the adjoint of the block's
        child frame, seen from the pattern, by the chain after the block; minus that, with the block itself, when it is
        inverted. A joint's are those of the twists by its k free parameters.

        Args:
            table: (R, 4, 4), see `table_of`.
            values: of all blocks.

        Returns:
            ``T_sensor_pattern`` (V, 4, 4) and the Jacobian (V, 6, C), the steps' columns side by side.
        """
        J = self._own_twists.copy()
        T: Array | None = None  # from the frame after a step to the pattern
        for step in reversed(self.steps):
            X, after = table.take(step.rows, 0), times(step.after, T)
            T = times(inverse(X) if step.inverted else X, after)
            if step.parameters is not None and not step.is_own_twist:
                T_child_pattern = T if step.inverted else after
                there = _IDENTITY_POSE if T_child_pattern is None else T_child_pattern
                columns = step.parameters.jacobian(there.reshape(-1, 4, 4), values[step.block])
                J[:, :, step.columns] = -columns if step.inverted else columns
        return per_view(times(self.before, T), self.views), J

    @cached_property
    def _own_twists(self) -> Array:
        """(V, 6, C): Jacobian of the parameters that are the twist of the view's own pose, which is constant."""
        J = np.zeros((self.views, 6, self.steps[-1].columns.stop))
        for step in self.steps:
            if step.is_own_twist:
                J[:, :, step.columns] = np.eye(6)
        return J

    @property
    def collections(self) -> IntArray:
        """(V,): collection of each view."""
        return np.concatenate([part.collections for part in self.parts])

    def spread(self, J: Array, sizes: tuple[int, int], intrinsics: slice) -> tuple[Array, Array]:
        """Scatter the Jacobian (V, 6, C) to all parameters: S shared ones, and P local ones.

        The m free intrinsics have rows of their own below the twist's: (V, 6 + m, S) and (V, 6 + m, P).

        Args:
            J: from `linearise`.
            sizes: S and P.
            intrinsics: those of this batch among the shared parameters.
        """
        m = intrinsics.stop - intrinsics.start
        J_shared, J_local = (np.zeros((len(J), 6 + m, size)) for size in sizes)
        J_shared[:, 6:, intrinsics] = np.eye(m)
        for part in self.parts:
            J_shared[part.views, :6, part.shared_at] = J[part.views, :, part.shared]
            J_local[part.views, :6, part.local_at] = J[part.views, :, part.local]
        return J_shared, J_local


def table_of(blocks: Sequence[Block], values: Values) -> Array:
    """Return the transforms of all blocks (R, 4, 4), one row each, or N rows for one that is per collection."""
    transforms = (block.pose(value) for block, value in zip(blocks, values, strict=True) if not block.intrinsics)
    return np.concatenate([T.reshape(-1, 4, 4) for T in transforms])


def batches(
    blocks: Sequence[Block],
    groups: Sequence[ViewGroup],
    collections: int,
    shared: Mapping[int, slice],
    local: Mapping[int, slice],
) -> tuple[Batch, ...]:
    """Arrange all views in batches.

    Args:
        blocks: all blocks.
        groups: all views.
        collections: N.
        shared: the parameters of each free shared block among those of all of them.
        local: the parameters of each free local block among those of a collection.
    """
    gathered: dict[object, list[list[ViewGroup]]] = {}
    for group in sorted(groups, key=lambda each: each.sensor):  # views of one camera share most of their arrays
        for start in range(0, len(group.collections), VIEWS_AT_A_TIME):
            small = len(group.collections) <= VIEWS_AT_A_TIME
            piece = group if small else group.take(slice(start, start + VIEWS_AT_A_TIME))
            alike = gathered.setdefault(_form_of_group(piece, blocks), [])
            if (fitting := next((each for each in alike if _fit_into_one_pass([*each, piece])), None)) is not None:
                fitting.append(piece)
            else:
                alike.append([piece])
    rows = [0 if block.intrinsics else collections if block.per_collection else 1 for block in blocks]
    starts = np.cumsum([0, *rows])
    return tuple(_batch_of_groups(each, blocks, starts, shared, local) for alike in gathered.values() for each in alike)


def _form_of_group(group: ViewGroup, blocks: Sequence[Block]) -> object:
    """Return the key that the groups of a batch have in common."""
    term = group.terms[0]
    if len(group.terms) > 1 or not isinstance(term, CornerTerm):
        return id(group)
    links = ((link.inverted, link.after is None, blocks[link.block].joint and link.block) for link in group.chain.links)
    return group.chain.before is None, *links, type(term.camera.distortion), _free_intrinsics(group, blocks)


def _free_intrinsics(group: ViewGroup, blocks: Sequence[Block]) -> int | None:
    return None if group.intrinsics is None or blocks[group.intrinsics].held else group.intrinsics


def _fit_into_one_pass(groups: Sequence[ViewGroup]) -> bool:
    """Whether groups fit into one pass: few labels, about as many corners each, few views of different cameras."""
    terms = [term for group in groups for term in group.terms if isinstance(term, CornerTerm)]
    corners, views = [term.pixels.shape[-1] for term in terms], sum(len(group.collections) for group in groups)
    few = views <= VIEWS_OF_SEVERAL_CAMERAS or len({id(term.camera) for term in terms}) == 1
    return few and max(corners) <= 2 * min(corners) and max(corners) * views <= LABELS_PER_CHUNK


def _batch_of_groups(
    groups: list[ViewGroup],
    blocks: Sequence[Block],
    rows: IntArray,
    shared: Mapping[int, slice],
    local: Mapping[int, slice],
) -> Batch:
    """Return the batch of groups of the same form; see `batches`.

    Args:
        groups: its groups.
        blocks: all blocks.
        rows: the first row of each block in the table of transforms.
        shared: as in `batches`.
        local: likewise.
    """
    counts = [len(group.collections) for group in groups]
    ends = np.cumsum([0, *counts]).tolist()
    steps = _steps_of_chains(groups, blocks, rows)
    parts = [_part_of_batch(group, slice(*ends[i : i + 2]), steps, shared, local) for i, group in enumerate(groups)]
    corners = [term for group in groups for term in group.terms if isinstance(term, CornerTerm)]
    terms = groups[0].terms if len(groups) == 1 else (side_by_side(corners),)
    before = _concatenate_constants([group.chain.before for group in groups], counts)
    return Batch(before, tuple(steps), terms, tuple(parts), _free_intrinsics(groups[0], blocks))


def _steps_of_chains(groups: Sequence[ViewGroup], blocks: Sequence[Block], rows: IntArray) -> list[_Step]:
    """Return the links of groups' chains, each as one of all their views."""
    counts = [len(group.collections) for group in groups]
    steps: list[_Step] = []
    for links in zip(*(group.chain.links for group in groups), strict=True):
        width = steps[-1].columns.stop if steps else 0
        free = [blocks[link.block].parameters for link in links if not blocks[link.block].held]
        parameters = next((each for each in free if not isinstance(each, FreeIntrinsics)), None)
        is_last = len(steps) + 1 == len(groups[0].chain.links) and not links[0].inverted and links[0].after is None
        steps.append(
            _Step(
                rows=_rows_of_link(links, groups, blocks, rows),
                inverted=links[0].inverted,
                after=_concatenate_constants([link.after for link in links], counts),
                block=links[0].block,
                parameters=parameters,
                columns=slice(width, width + (parameters.dimension if parameters else 0)),
                is_own_twist=is_last and isinstance(parameters, Pose),
            )
        )
    return steps


def _part_of_batch(
    group: ViewGroup,
    views: slice,
    steps: Sequence[_Step],
    shared: Mapping[int, slice],
    local: Mapping[int, slice],
) -> Part:
    """Return a group's part of a batch, at ``views``, whose parameters are at ``shared`` and ``local``."""
    links = group.chain.links
    of_shared, of_local = ([k for k, link in enumerate(links) if link.block in of] for of in (shared, local))
    return Part(
        views=views,
        collections=group.collections,
        shared=_merge_slices([steps[k].columns for k in of_shared]),
        shared_at=_merge_slices([shared[links[k].block] for k in of_shared]),
        local=_merge_slices([steps[k].columns for k in of_local]),
        local_at=_merge_slices([local[links[k].block] for k in of_local]),
        is_own_twist=of_local == [len(steps) - 1] and steps[-1].is_own_twist,
    )


def _rows_of_link(
    links: Sequence[Link], groups: Sequence[ViewGroup], blocks: Sequence[Block], rows: IntArray
) -> IntArray:
    """Return the table's rows (V,) of a link; (1,) if it is the same in all views."""
    if len({link.block for link in links}) == 1 and not blocks[links[0].block].per_collection:
        return rows[[links[0].block]]
    moves = [blocks[link.block].per_collection for link in links]
    parts = zip(links, groups, moves, strict=True)
    return np.concatenate([rows[link.block] + moving * group.collections for link, group, moving in parts])


def _concatenate_constants(constants: Sequence[Array | None], counts: Sequence[int]) -> Array | None:
    """Concatenate the constants of several groups; either all or none have one."""
    if len(constants) == 1 or constants[0] is None:
        return constants[0]
    return np.concatenate([per_view(constant, count) for constant, count in zip(constants, counts, strict=True)])


def _merge_slices(slices: Sequence[slice]) -> Columns:
    """Merge slices into one if they are contiguous, else into indices."""
    if all(a.stop == b.start for a, b in pairwise(slices)):
        return slice(slices[0].start, slices[-1].stop) if slices else slice(0, 0)
    return np.concatenate([np.arange(each.start, each.stop) for each in slices])


def _has_columns(columns: Columns) -> bool:
    return not isinstance(columns, slice) or columns.stop > columns.start


def index_of(*axes: Columns) -> tuple[Columns, ...]:
    """Return the index of a block of rows and columns: slices, which are fast, if the parameters are contiguous."""
    if sum(not isinstance(each, slice) for each in axes) < 2:
        return axes
    return np.ix_(*(np.arange(each.start, each.stop) if isinstance(each, slice) else each for each in axes))


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
