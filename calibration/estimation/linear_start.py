"""A start for the least squares that needs no guess.

Every camera view gives the pose of its pattern by itself (`planar_pose`), every view of a LiDAR or a
depth camera the plane it lies on, every view of a 2D LiDAR a line in that plane. Seen through a chain
``T_sensor_pattern = ... X ... Y ...`` these are equations for the unknown transforms, linear ones: a chain
with one unknown gives it directly, once for each view, to be averaged; one with two, such as a camera's
mount and a pattern on an arm, is a robot-world problem.
So the unknowns are found one after the other, like a spanning tree: always the one that most views
speak for. Where the equations leave something open, the given guess is taken and it is said. Joints
and intrinsics start from their nominal parameters: they are small corrections, and no equation is linear in them.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from calibration.dataset.modalities import LIDAR2D
from calibration.errors import InputError, UndeterminedError
from calibration.estimation.build import Setup
from calibration.estimation.planar_pose import mean_pose
from calibration.estimation.plane_alignment import align_planes, fit_planes
from calibration.estimation.problem import Chain, Values, ViewGroup
from calibration.estimation.residuals import CornerTerm, RangeTerm
from calibration.estimation.robot_world import RobotWorld, solve_robot_world_robustly
from calibration.estimation.scan_alignment import align_scans, scan_equations
from calibration.estimation.single_views import robust_poses
from calibration.geometry.transforms import inverse
from calibration.geometry.types import Array, BoolArray

SINGLE_AXIS = 0.002
"""Rotations of a robot that tilt every direction by less than this (rad) about all but one axis are too poor."""


@dataclass(frozen=True, eq=False)
class LinearStart:
    """Where to start, and what had to be taken from the guess."""

    values: Values
    guessed: tuple[str, ...]
    """The blocks that no equation gave."""


def linear_start(setup: Setup, guess: Values) -> LinearStart:
    """Start values for all blocks.

    Args:
        setup: the problem.
        guess: a value for each block; of these only the held ones are used, and those that no
            equation gives.

    Raises:
        UndeterminedError: a robot's motion is too poor to tell a sensor's mount from the pattern's.
    """
    search = _Search(setup, [np.array(value) for value in guess])
    search.know([i for i, block in enumerate(setup.problem.blocks) if block.held or block.vector])
    while search.find() or search.take_guess():
        pass
    search.require_all()
    return LinearStart(tuple(search.values), tuple(search.guessed))


def pattern_poses(setup: Setup, values: Values) -> Values:
    """The values with the patterns' poses put where the cameras see them, all other blocks being right.

    Raises:
        InputError: no camera sees a fixed pattern.
    """
    search = _Search(setup, [np.array(value) for value in values])
    patterns = free_patterns(setup)
    search.know([i for i in range(len(values)) if i not in patterns])
    while search.find():
        pass
    search.require_all()
    return tuple(search.values)


def free_patterns(setup: Setup) -> set[int]:
    """The blocks of the patterns that are not held."""
    patterns = {setup.block(setup.pattern_edge(pattern)) for pattern in setup.dataset.patterns}
    return {i for i in patterns if not setup.problem.blocks[i].held}


def place_gauge_patterns(setup: Setup, values: Values) -> Values:
    """The values with the patterns that are held as the origin where the cameras see them, all else being right."""
    held = {setup.block(setup.pattern_edge(pattern)) for pattern in setup.gauge_patterns}
    if not held:
        return values
    blocks = tuple(replace(b, held=b.held and i not in held) for i, b in enumerate(setup.problem.blocks))
    placed = pattern_poses(replace(setup, problem=replace(setup.problem, blocks=blocks)), values)
    return tuple(placed[i] if i in held else value for i, value in enumerate(values))


@dataclass
class _Search:
    """The unknowns that are left, and the views that speak for them."""

    setup: Setup
    values: list[Array]
    guessed: list[str] = field(default_factory=list)
    poses: dict[int, Array] = field(default_factory=dict)
    """By group: ``T_sensor_pattern`` (V, 4, 4) of a camera's views; NaN where a view gives none."""
    known: dict[int, BoolArray] = field(default_factory=dict)
    """By block: in which collections its value is known, (N,)."""
    too_poor: list[str] = field(default_factory=list)
    """Why the robot-world problems that are left tell nothing."""

    def know(self, blocks: list[int]) -> None:
        """Begin: with these blocks known, and with what the cameras see."""
        problem = self.setup.problem
        for i in range(len(problem.blocks)):
            self.known[i] = np.full(problem.collections, i in blocks)
        for i, group in enumerate(problem.groups):
            if isinstance(group.terms[0], CornerTerm):
                self.poses[i] = robust_poses(group.terms[0])

    def find(self) -> bool:
        """Find one more unknown by linear algebra; False when nothing follows any more.

        Raises:
            UndeterminedError: all that is left is a robot whose motion is too poor.
        """
        found = (
            self._moving()
            or self._averaged()
            or self._robot_world()
            or self._planes()
            or self._planes_over_a_moving_pattern()
        )
        if not found and self.too_poor:
            raise UndeterminedError(self.too_poor[0])
        return found

    def require_all(self) -> None:
        """Refuse when a pattern's pose is not known in a collection that counts, or never."""
        for i, block in enumerate(self.setup.problem.blocks):
            missing = self._missing(i)
            if missing.any():
                key = self.setup.dataset.keys[int(missing.argmax())]
                raise InputError(
                    f"{self.setup.dataset.path}: collection {key}: no camera view tells the pose of '{block.name}'; "
                    f"label more corners there, or leave the collection out"
                )

    def _missing(self, block: int) -> BoolArray:
        """The collections (N,) whose views depend on a block that is not known there."""
        observed = np.zeros(self.setup.problem.collections, bool)
        for group in self.setup.problem.groups:
            if any(link.block == block for link in group.chain.links):
                observed[group.collections] = True
        missing: BoolArray = observed & ~self.known[block]
        return missing

    def _moving(self) -> bool:
        """The moving patterns, and whatever each collection has its own of, that a camera sees through a known chain.

        The fullest view decides.
        """
        problem = self.setup.problem
        found = False
        for local in problem.local:
            best = np.zeros(problem.collections, int)
            for i, T in self.poses.items():
                group = problem.groups[i]
                if not self._only_unknown(group, local, everywhere=False):
                    continue
                candidates, usable = self._solved_for(group, T, local)
                counts = group.terms[0].counts
                better = usable & ~self.known[local][group.collections] & (counts > best[group.collections])
                where = group.collections[better]
                self.values[local][where] = candidates[better]
                best[where] = counts[better]
            new = best > 0
            self.known[local] |= new
            found = found or bool(new.any())
        return found

    def _averaged(self) -> bool:
        """The shared block that most camera views give directly."""
        problem = self.setup.problem
        votes: dict[int, list[Array]] = {}
        for block in self._unknown_shared():
            for i, T in self.poses.items():
                group = problem.groups[i]
                if self._only_unknown(group, block):
                    candidates, usable = self._solved_for(group, T, block)
                    if usable.any():
                        votes.setdefault(block, []).append(candidates[usable])
        if not votes:
            return False
        block = max(votes, key=lambda b: sum(len(c) for c in votes[b]))
        self._set(block, mean_pose(np.concatenate(votes[block])))
        return True

    def _robot_world(self) -> bool:
        """Two unknowns at once: of one chain, or of two chains that share the poses of a moving pattern."""
        pairs = [pair for pair in (*self._pairs_in_one_chain(), *self._pairs_over_a_moving_pattern()) if len(pair[2])]
        self.too_poor = []
        for a, b, A, B in sorted(pairs, key=lambda pair: -len(pair[2])):
            solution = solve_robot_world_robustly(A, B)
            problem = self._too_poor(a, b, solution, len(A))
            if problem is None:
                for (block, inverted), T in ((a, solution.X), (b, solution.Y)):
                    self._set(block, inverse(T) if inverted else T)
                return True
            self.too_poor.append(problem)
        return False

    def _planes(self) -> bool:
        """What stands before a LiDAR or a depth camera, from the planes it sees and the pattern's poses, known by now.

        All views that speak for the same block count together.
        """
        views: dict[tuple[int, bool, bool], list[_RangeViews]] = {}
        for group, term in self._range_groups():
            for block in self._unknown_shared():
                if self._only_unknown(group, block):
                    before, inverted, after, usable = self._around(group, block)
                    found = _RangeViews(term.take(np.flatnonzero(usable)), before[usable], after[usable])
                    views.setdefault((block, inverted, self._is_2d(group)), []).append(found)
        return any(self._aligned(*key, found) for key, found in views.items())

    def _planes_over_a_moving_pattern(self) -> bool:
        """What stands before a camera that sees a moving pattern with a LiDAR or a depth camera, known by now.

        From ``T1 = U X C P`` of the camera and ``T2 = H P`` of the other the pattern drops out:
        ``T2 = (H inverse(C)) inverse(X) (inverse(U) T1)``.
        """
        views: dict[tuple[int, bool, bool], list[_RangeViews]] = {}
        for camera, (block, inverted), after, C in self._halves():
            for group, term in self._range_groups():
                if group.pattern == camera.pattern:
                    H, _, _, known = self._around(group, group.chain.links[-1].block)
                    _, at, own = np.intersect1d(camera.collections, group.collections, return_indices=True)
                    usable = known[own] & np.isfinite(after[at, 0, 0])
                    at, own = at[usable], own[usable]
                    found = _RangeViews(term.take(own), H[own] @ inverse(C[at]), after[at])
                    if len(own):
                        views.setdefault((block, not inverted, self._is_2d(group)), []).append(found)
        return any(self._aligned(*key, found) for key, found in views.items())

    def _range_groups(self) -> list[tuple[ViewGroup, RangeTerm]]:
        groups = self.setup.problem.groups
        return [(group, group.terms[0]) for group in groups if isinstance(group.terms[0], RangeTerm)]

    def _is_2d(self, group: ViewGroup) -> bool:
        return self.setup.dataset.sensors[group.sensor].modality == LIDAR2D

    def _aligned(self, block: int, inverted: bool, cuts: bool, views: list["_RangeViews"]) -> bool:
        """Whether views ``T_sensor_pattern = before X after``, X a block or its inverse, have given the block."""
        before, after = (np.concatenate(parts) for parts in zip(*((v.before, v.after) for v in views), strict=True))
        if cuts:
            points = [view.term.points.swapaxes(1, 2)[view.term.present] for view in views]
            view = np.repeat(np.arange(len(before)), np.concatenate([view.term.counts for view in views]))
            back = align_scans(*scan_equations(np.concatenate(points), before[view], after[view]))  # inverse(X)
            if back is None:
                return False
            self._set(block, back if inverted else inverse(back))
            return True
        planes = [fit_planes(view.term.points, view.term.present) for view in views]
        normals, offsets = (np.concatenate(parts) for parts in zip(*planes, strict=True))
        guess = inverse(self.values[block]) if inverted else self.values[block]
        X = align_planes(normals, offsets, before, after, guess)
        self._set(block, inverse(X) if inverted else X)
        return True

    def take_guess(self) -> bool:
        """Nothing follows: take the guess of one more block, an additional transform first."""
        patterns = self.setup.dataset.patterns
        names = [block.name for block in self.setup.problem.blocks]
        moving = [b for b in self.setup.problem.local if names[b] not in patterns and self._missing(b).any()]
        unknown = [*self._unknown_shared(), *moving]
        if not unknown:
            return False
        sensors = {sensor.edge for sensor in self.setup.dataset.sensors.values()}
        rank = [(e in sensors) + 2 * (names[i] in patterns) for i, e in enumerate(self.setup.edges)]
        block = min(unknown, key=lambda b: (rank[b], b))
        self.guessed.append(names[block])
        self._set(block, self.values[block])
        return True

    # ------------------------------------------------------------------------------------------

    def _unknown_shared(self) -> list[int]:
        return [b for b in self.setup.problem.shared if not self.known[b].any()]

    def _set(self, block: int, T: Array) -> None:
        self.values[block] = T
        self.known[block][:] = True

    def _unknown(self, group: ViewGroup) -> list[int]:
        """The positions in a group's chain of links that are known in none of its collections."""
        return [k for k, link in enumerate(group.chain.links) if not self.known[link.block][group.collections].any()]

    def _only_unknown(self, group: ViewGroup, block: int, everywhere: bool = True) -> bool:
        """Whether this block, once in the chain, is the only one that is not known.

        A moving pattern may be known in some collections already (``everywhere`` False).
        """
        positions = [k for k, link in enumerate(group.chain.links) if link.block == block]
        others = [k for k in self._unknown(group) if k not in positions]
        return len(positions) == 1 and not others and (not everywhere or positions == self._unknown(group))

    def _around(self, group: ViewGroup, block: int) -> tuple[Array, bool, Array, BoolArray]:
        """A chain around one block: ``T = before * block^(+-1) * after`` (V, 4, 4 each), and where it is known."""
        links = group.chain.links
        k = next(k for k, link in enumerate(links) if link.block == block)
        usable = np.ones(len(group.collections), bool)
        for link in links[:k] + links[k + 1 :]:
            usable &= self.known[link.block][group.collections]
        return self._between(group, -1, k), links[k].inverted, self._between(group, k, len(links)), usable

    def _between(self, group: ViewGroup, start: int, end: int) -> Array:
        """The product (V, 4, 4) of what stands between two links of a chain; -1 is its begin, its length its end."""
        chain = group.chain
        constant = chain.before if start < 0 else chain.links[start].after
        part = Chain(constant, chain.links[start + 1 : end])
        return part.poses(tuple(self.values), slice(None), group.collections)

    def _solved_for(self, group: ViewGroup, T: Array, block: int) -> tuple[Array, BoolArray]:
        """What each view says a block is, and whether it says anything."""
        before, inverted, after, usable = self._around(group, block)
        X = inverse(before) @ T @ inverse(after)
        return inverse(X) if inverted else X, usable & np.isfinite(T[:, 0, 0])

    def _pairs_in_one_chain(self) -> list["_Pair"]:
        """Chains with two unknown shared blocks: ``X B Y = A`` with A measured and B known."""
        pairs: list[_Pair] = []
        for i, T in self.poses.items():
            group = self.setup.problem.groups[i]
            links, unknown = group.chain.links, self._unknown(group)
            if len(unknown) == 2 and not any(self.setup.problem.blocks[links[k].block].per_collection for k in unknown):
                first, second = unknown
                B = self._between(group, first, second)
                A = inverse(self._between(group, -1, first)) @ T @ inverse(self._between(group, second, len(links)))
                usable = np.isfinite(A[:, 0, 0])
                pairs.append((_unknown_of(group, first), _unknown_of(group, second), A[usable], B[usable]))
        return pairs

    def _pairs_over_a_moving_pattern(self) -> list["_Pair"]:
        """Two chains that end in the same moving pattern, each with one unknown shared block before it.

        From ``T1 = U1 X C1 P`` and ``T2 = U2 Y C2 P`` the pattern drops out:
        ``inverse(U1) T1 inverse(T2) U2 = X (C1 inverse(C2)) inverse(Y)``.
        """
        halves = self._halves()
        pairs: list[_Pair] = []
        for i, (one, x, Z1, C1) in enumerate(halves):
            for two, y, Z2, C2 in halves[i + 1 :]:
                common, at1, at2 = np.intersect1d(one.collections, two.collections, return_indices=True)
                if one.pattern == two.pattern and x[0] != y[0] and len(common):
                    A = Z1[at1] @ inverse(Z2[at2])
                    usable = np.isfinite(A[:, 0, 0])
                    pairs.append((x, (y[0], not y[1]), A[usable], (C1[at1] @ inverse(C2[at2]))[usable]))
        return pairs

    def _halves(self) -> list["_Half"]:
        """The cameras' chains that end in a moving pattern, with one unknown shared block X before it: ``U X C P``."""
        problem = self.setup.problem
        halves: list[_Half] = []
        for i, T in self.poses.items():
            group = problem.groups[i]
            links, unknown = group.chain.links, self._unknown(group)
            moving = [problem.blocks[links[k].block].per_collection for k in unknown]
            if moving == [False, True] and unknown[1] == len(links) - 1 and links[-1].after is None:
                first = unknown[0]
                U, C = self._between(group, -1, first), self._between(group, first, len(links) - 1)
                halves.append((group, _unknown_of(group, first), inverse(U) @ T, C))
        return halves

    def _too_poor(self, a: "_Unknown", b: "_Unknown", solution: RobotWorld, views: int) -> str | None:
        """Why a motion cannot tell the two unknowns apart; None when it can."""
        names = [self.setup.problem.blocks[block].name for block, _ in (a, b)]
        what = f"{self.setup.dataset.path}: '{names[0]}' and '{names[1]}' cannot be told apart"
        axes = solution.spectrum.axes(SINGLE_AXIS)
        if views < 3:
            return f"{what}: {views} views, at least 3 with different rotations are needed"
        if axes == 0:
            return f"{what}: the robot never rotates; add collections with rotations about two axes"
        if axes == 1:
            parent, child = self.setup.edges[b[0]]
            axis = solution.spectrum.axis * np.sign(solution.spectrum.axis[np.abs(solution.spectrum.axis).argmax()])
            x, y, z = np.round(axis, 2) + 0.0
            return (
                f"{what}: the robot rotates about a single axis only, ({x:g}, {y:g}, {z:g}) in frame "
                f"'{child if b[1] else parent}'; add collections with rotations about another axis"
            )
        return None


_Unknown = tuple[int, bool]
"""A block, and whether it stands inverted in its chain."""
_Pair = tuple[_Unknown, _Unknown, Array, Array]
"""Two unknowns X and Y with ``A_i = X B_i Y``, and the poses A and B (n, 4, 4)."""
_Half = tuple[ViewGroup, _Unknown, Array, Array]
"""Views with ``T = U X C P``: the unknown X, ``inverse(U) T`` and C (V, 4, 4)."""


class _RangeViews(NamedTuple):
    """Views of a LiDAR or a depth camera with ``T_sensor_pattern = before X after``, (V, 4, 4)."""

    term: RangeTerm
    before: Array
    after: Array


def _unknown_of(group: ViewGroup, position: int) -> _Unknown:
    link = group.chain.links[position]
    return link.block, link.inverted
