"""Batches of views that are evaluated in one pass, because many calls on small arrays cost more than one on a large.

A batch is a part of a large group, or several small groups together, of any sensors and patterns, whose chains
have the same form: as many links, the same ones inverted, constants at the same positions. The transforms of all blocks
are in one table, and a link refers to one of its rows in each view.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.estimation.problem.blocks import Block, FreeJoint, Pose, Values
from calibration.engine.estimation.problem.intrinsics import FreeIntrinsics
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm, side_by_side
from calibration.engine.estimation.residuals.residuals import LABELS_PER_CHUNK
from calibration.engine.estimation.residuals.views import Link, Term, ViewGroup, per_view, times
from calibration.engine.geometry.transforms import inverse

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
