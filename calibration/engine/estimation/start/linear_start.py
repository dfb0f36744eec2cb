"""Linear initial guess for the least squares, from the labels alone.

Every camera view determines the pose of its pattern (`planar_pose`), every view of a LiDAR or a
depth camera the pattern's plane, every view of a 2D LiDAR a scan line in that plane. With the chain
``T_sensor_pattern = ... X ... Y ...`` these are linear equations for the unknown transforms:

- one unknown: ``X = A^-1 T_sensor_pattern B^-1`` in each view, averaged (`planar_pose.mean_pose`);
- two unknowns, such as a camera's mount and a pattern on an arm: a robot-world problem ``A_i = X B_i Y``
  (`linear_solvers.solve_robot_world`, by M. Shah, 2013);
- planes or scan lines, with the pattern's pose known: `linear_solvers.align_planes`, `align_scans`.

Two sensors with a common view of an unknown moving pattern P are equivalent to one that sees the other: from
``T1 = U1 P`` and ``T2 = U2 P`` follows ``T2 = U2 inverse(U1) T1``.

So the unknowns are solved one after the other, like a spanning tree: always the one with most views.
Directions that the equations do not determine are taken from the given guess, which is reported. Joints
and intrinsics start from their nominal parameters: they are small corrections, and no equation is linear in them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import Array, BoolArray
from calibration.engine.estimation.problem.blocks import Pose, Values
from calibration.engine.estimation.residuals.planar_pose import mean_pose
from calibration.engine.estimation.residuals.ray_residuals import RangeTerm
from calibration.engine.estimation.residuals.views import Link
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.linear_solvers import (
    RobotWorld,
    align_planes,
    align_scans,
    fit_planes,
    scan_equations,
    solve_robot_world_robustly,
)
from calibration.engine.estimation.start.single_views import Sight
from calibration.engine.geometry.transforms import inverse

MIN_TRAVEL = 1e-3
"""Travel of a robot along an axis (m) below which it stands still, however its encoders tremble."""
SINGLE_AXIS = 0.002
"""rad: rotations of a robot that tilt every direction by less than this, about all but one axis, are insufficient."""


@dataclass(frozen=True, eq=False)
class LinearStart:
    """Initial values of all blocks, and what of them is from the guess."""

    values: Values
    guessed: tuple[str, ...]
    """Blocks without an equation."""
    depends_on_guess: bool
    """Whether the labels leave a direction of a sensor's or an additional transform to the guess. If not, all guesses
    that differ in such transforms alone, as by `StartingNoise`, have this same start."""


def linear_start(setup: Setup, guess: Values) -> LinearStart:
    """Compute initial values for all blocks.

    Args:
        setup: the problem.
        guess: a value for each block; of these only fixed ones are used, and those without an
            equation.

    Raises:
        UndeterminedError: a robot's motion is too small to separate a sensor's mount from the pattern's.
    """
    blocks = setup.problem.blocks
    unknown = {i for i, block in enumerate(blocks) if not block.held and isinstance(block.parameters, Pose)}
    search = _Search(setup, guess, unknown)
    while search.find() or search.take_guess():
        pass
    patterns = {setup.block(pattern.edge) for pattern in setup.dataset.patterns.values()}
    return LinearStart(search.found(), tuple(search.guessed), bool(search.left_to_guess - patterns))


def pattern_poses(setup: Setup, values: Values) -> Values:
    """Set the patterns' poses to those in the cameras' views, with all other blocks fixed.

    Args:
        setup: the problem.
        values: a value for each block.

    Raises:
        InputError: no camera sees a fixed pattern.
    """
    return _solve_for_blocks(setup, values, _free_patterns(setup))


def local_poses(setup: Setup, values: Values) -> Values:
    """Set the transforms per collection to those in the cameras' views, with all others fixed.

    Raises:
        InputError: no camera view determines one of them.
    """
    return _solve_for_blocks(setup, values, set(setup.problem.local))


def place_gauge_patterns(setup: Setup, values: Values) -> Values:
    """Set the patterns that fix the gauge to the poses in the cameras' views, with all other blocks fixed.

    Args and errors are those of `pattern_poses`.
    """
    fixed = {setup.block(setup.pattern_edge(pattern)) for pattern in setup.gauge_patterns}
    if not fixed:
        return values
    placed = _solve_for_blocks(setup, values, _free_patterns(setup) | fixed)
    return tuple(placed[i] if i in fixed else value for i, value in enumerate(values))


def _free_patterns(setup: Setup) -> set[int]:
    """Return the blocks of the patterns that are not fixed by the user."""
    patterns = {setup.block(pattern.edge) for pattern in setup.dataset.patterns.values()}
    return {i for i in patterns if not setup.problem.blocks[i].held}


def _solve_for_blocks(setup: Setup, values: Values, unknown: set[int]) -> Values:
    """Return the values with those of some blocks solved for, from the labels alone."""
    search = _Search(setup, values, unknown)
    while search.find():
        pass
    return search.found()


class _Search:
    """Remaining unknowns, and the views that determine them."""

    def __init__(self, setup: Setup, values: Values, unknown: set[int]) -> None:
        """Start with all blocks known but some, and with the poses in the cameras' views."""
        self.setup, self.problem = setup, setup.problem
        self.guessed: list[str] = []
        self.left_to_guess: set[int] = set()
        """Blocks whose value, or a part of it, is that of the guess."""
        self._start = values
        self._transforms = [np.array(T) for T in self.problem.transforms(values)]
        N = self.problem.collections
        self._known = [np.full(N, i not in unknown) for i in range(len(values))]
        """By block: mask (N,) of the collections in which it is known."""
        self._sights = setup.sights

    def find(self) -> bool:
        """Solve for one more unknown by linear algebra; False if there is none.

        Raises:
            UndeterminedError: all that is left is a robot with insufficient motion.
        """
        if all(known.all() for known in self._known):
            return False
        if self._solve_moving() or self._solve_by_average():
            return True
        sights = [*self._sights, *self._over_moving_patterns()]
        too_poor = self._solve_robot_world(sights)
        if too_poor is None or self._solve_by_planes(sights):
            return True
        if too_poor:
            raise UndeterminedError(too_poor)
        return False

    def take_guess(self) -> bool:
        """Take one more block from the guess, an additional transform first."""
        patterns = self.setup.dataset.patterns
        blocks = self.problem.blocks
        moving = [
            b for b in self.problem.local if blocks[b].name not in patterns and self._collections_missing(b).any()
        ]
        unknown = [*(b for b in self.problem.shared if not self._known[b].any()), *moving]
        if not unknown:
            return False
        sensors = {sensor.edge for sensor in self.setup.dataset.sensors.values()}
        block = min(unknown, key=lambda b: ((blocks[b].edge in sensors) + 2 * (blocks[b].name in patterns), b))
        self.guessed.append(blocks[block].name)
        self.left_to_guess.add(block)
        self._set_block(block, self._transforms[block])
        return True

    def found(self) -> Values:
        """Return the values of all blocks.

        Raises:
            InputError: a pattern's pose is unknown in a used collection, or in all.
        """
        for i, block in enumerate(self.problem.blocks):
            missing = self._collections_missing(i)
            if missing.any():
                key = self.setup.dataset.keys[int(missing.argmax())]
                raise InputError(
                    f"{self.setup.dataset.path}: collection {key}: no camera view tells the pose of '{block.name}'; "
                    f"label more corners there, or leave the collection out"
                )
        each = zip(self.problem.blocks, self._transforms, self._start, strict=True)
        return tuple(T if isinstance(block.parameters, Pose) else start for block, T, start in each)

    def _collections_missing(self, block: int) -> BoolArray:
        """Return a mask (N,) of the collections whose views depend on a block that is unknown there."""
        return np.asarray(self.problem.collections_with(block) & ~self._known[block])

    def _solve_moving(self) -> bool:
        """Solve for the moving patterns and transforms per collection that a camera sees through a known chain.

        Of several views the one with most labels is used.
        """
        found = False
        for local in self.problem.local:
            best = np.zeros(self.problem.collections, int)
            for sight in self._sights:
                at = [k for k, link in enumerate(sight.chain.links) if link.block == local]
                missing = ~self._known[local][sight.collections]
                if at and missing.any() and sight.seen is not None and set(self._unknown_links(sight)) <= set(at):
                    candidates, usable = self._solved_for(sight, sight.seen, at[0])
                    better = usable & missing
                    better &= sight.counts > best[sight.collections]
                    where = sight.collections[better]
                    self._transforms[local][where] = candidates[better]
                    best[where] = sight.counts[better]
            self._known[local] |= best > 0
            found = found or bool((best > 0).any())
        return found

    def _solve_by_average(self) -> bool:
        """Solve for the shared block that most camera views determine directly."""
        votes: dict[int, list[Array]] = {}
        for sight in self._sights:
            unknown = self._unknown_shared_links(sight)
            if len(unknown) == 1 and sight.seen is not None:
                candidates, usable = self._solved_for(sight, sight.seen, unknown[0])
                if usable.any():
                    votes.setdefault(sight.chain.links[unknown[0]].block, []).append(candidates[usable])
        if not votes:
            return False
        block = max(sorted(votes), key=lambda b: sum(len(c) for c in votes[b]))
        self._set_block(block, mean_pose(np.concatenate(votes[block])))
        return True

    def _over_moving_patterns(self) -> Iterator[Sight]:
        """Yield views that combine two sensors' views of the same moving pattern with an unknown pose."""
        cameras = []
        for sight in self._sights:
            last, unknown = len(sight.chain.links) - 1, self._unknown_links(sight)
            moving = sight.chain.links[last].block in self.problem.local
            if moving and sight.seen is not None and len(unknown) > 1 and unknown[-1] == last:
                cameras.append((sight, sight.seen))
        for (one, _), (other, seen) in combinations(cameras, 2):
            if one.pattern == other.pattern:
                yield one.through(other, seen)
        for camera, seen in cameras:
            same = (s for s in self._sights if s.points is not None and s.pattern == camera.pattern)
            yield from (sight.through(camera, seen) for sight in same)

    def _solve_robot_world(self, sights: Sequence[Sight]) -> str | None:
        """Solve for two unknowns X and Y from ``T = U X B Y V``; None on success, else the reason of the failure."""
        problems = []
        for sight in sights:
            unknown = self._unknown_shared_links(sight)
            if len(unknown) == 2 and sight.seen is not None:
                U, B, V = (
                    self._product_between(sight, *ends) for ends in ((-1, unknown[0]), unknown, (unknown[1], None))
                )
                A = inverse(U) @ sight.seen @ inverse(V)
                usable = self._usable_views(sight, unknown) & np.isfinite(A[:, 0, 0])
                if usable.any():
                    problems.append(([sight.chain.links[k] for k in unknown], A[usable], B[usable]))
        why_not = ""
        for (first, second), A, B in sorted(problems, key=lambda problem: -len(problem[1])):
            solution = solve_robot_world_robustly(A, B)
            too_poor = self._why_motion_is_too_poor(first, second, solution, B)
            if not too_poor:
                for link, T in ((first, solution.X), (second, solution.Y)):
                    self._set_block(link.block, inverse(T) if link.inverted else T)
                return None
            why_not = why_not or too_poor
        return why_not

    def _solve_by_planes(self, sights: Sequence[Sight]) -> bool:
        """Solve for a block in the chain of a LiDAR or a depth camera, from its planes and the patterns' known poses.

        All views that determine the same block are used together.
        """
        together: dict[tuple[int, bool, bool], list[tuple[RangeTerm, Array, Array]]] = {}
        for sight in sights:
            unknown = self._unknown_shared_links(sight)
            if len(unknown) == 1 and sight.points is not None:
                link = sight.chain.links[unknown[0]]
                before, after, usable = self._split_at_link(sight, unknown[0])
                if usable.any():
                    planar = self.setup.dataset.sensors[sight.sensor].modality.is_planar
                    views = (sight.points.take(np.flatnonzero(usable)), before[usable], after[usable])
                    together.setdefault((link.block, link.inverted, planar), []).append(views)
        return any(self._align_block(*key, views) for key, views in together.items())

    def _align_block(
        self, block: int, inverted: bool, planar: bool, views: list[tuple[RangeTerm, Array, Array]]
    ) -> bool:
        """Whether views ``T_sensor_pattern = before X after``, X a block or its inverse, have determined the block."""
        terms = [term for term, _, _ in views]
        before, after = (np.concatenate(parts) for parts in list(zip(*views, strict=True))[1:])
        if planar:
            points = [term.points.swapaxes(1, 2)[term.present] for term in terms]
            view = np.repeat(np.arange(len(before)), np.concatenate([term.counts for term in terms]))
            back = align_scans(*scan_equations(np.concatenate(points), before[view], after[view]))  # inverse(X)
            X = None if back is None else inverse(back)
        else:
            planes = [fit_planes(term.points, term.present) for term in terms]
            normals, offsets = (np.concatenate(parts) for parts in zip(*planes, strict=True))
            guess = inverse(self._transforms[block]) if inverted else self._transforms[block]
            X, by_guess = align_planes(normals, offsets, before, after, guess)
            if by_guess:
                self.left_to_guess.add(block)
        if X is not None:
            self._set_block(block, inverse(X) if inverted else X)
        return X is not None

    def _why_motion_is_too_poor(self, first: Link, second: Link, solution: RobotWorld, motion: Array) -> str:
        """Return why a robot's motion, poses (N, 4, 4), cannot separate the two unknowns; empty if it can."""
        blocks = [self.problem.blocks[link.block] for link in (first, second)]
        what = f"{self.setup.dataset.path}: '{blocks[0].name}' and '{blocks[1].name}' cannot be told apart"
        axes = solution.spectrum.axes(SINGLE_AXIS)
        known = next((b.name for b in blocks if b.name in self.setup.dataset.patterns), blocks[1].name)
        or_hold = f", or hold '{known}' if its place in the dataset is known to be right"
        if len(motion) < 3:
            return f"{what}: {len(motion)} views, at least 3 with different rotations are needed{or_hold}"
        if axes == 0 and np.ptp(motion[:, :3, 3], axis=0).max() < MIN_TRAVEL:
            return (
                f"{what}: the robot never moves; name the frames of the arm that does (base, tool and parent in "
                "import.yml), with its poses at the images"
            )
        if axes == 0:
            return f"{what}: the robot never rotates; add collections with rotations about two axes{or_hold}"
        if axes == 1 and blocks[1].edge:
            axis = solution.spectrum.axis * np.sign(solution.spectrum.axis[np.abs(solution.spectrum.axis).argmax()])
            x, y, z = np.round(axis, 2) + 0.0
            return (
                f"{what}: the robot rotates about a single axis only, ({x:g}, {y:g}, {z:g}) in frame "
                f"'{blocks[1].edge[second.inverted]}'; add collections with rotations about another axis{or_hold}"
            )
        return ""

    # ------------------------------------------------------------------------------------------

    def _set_block(self, block: int, T: Array) -> None:
        self._transforms[block] = T
        self._known[block][:] = True

    def _unknown_links(self, sight: Sight) -> list[int]:
        """Return the positions in a chain of the links that are unknown in all of its collections."""
        return [k for k, link in enumerate(sight.chain.links) if not self._known[link.block][sight.collections].any()]

    def _unknown_shared_links(self, sight: Sight) -> list[int]:
        """Return the same if all of them are of different shared blocks; else none."""
        unknown = self._unknown_links(sight)
        blocks = {sight.chain.links[k].block for k in unknown}
        return unknown if len(blocks) == len(unknown) and not blocks & set(self.problem.local) else []

    def _usable_views(self, sight: Sight, unknown: list[int]) -> BoolArray:
        """Return a mask (V,) of the views in which all other links are known."""
        usable = np.ones(len(sight.collections), bool)
        for k, link in enumerate(sight.chain.links):
            if k not in unknown:
                usable &= self._known[link.block][sight.collections]
        return usable

    def _product_between(self, sight: Sight, start: int, end: int | None) -> Array:
        """Return the product (V, 4, 4) between two links of a chain; -1 is its start, None its end."""
        part = sight.chain.part(start, len(sight.chain.links) if end is None else end)
        return part.poses(self._transforms, sight.collections)

    def _split_at_link(self, sight: Sight, k: int) -> tuple[Array, Array, BoolArray]:
        """Split a chain at one link: ``T = before * link * after`` (V, 4, 4 each), with a mask (V,) of known ones."""
        before, after = self._product_between(sight, -1, k), self._product_between(sight, k, None)
        return (
            before,
            after,
            self._usable_views(sight, [k]) & np.isfinite(after[:, 0, 0]) & np.isfinite(before[:, 0, 0]),
        )

    def _solved_for(self, sight: Sight, seen: Array, k: int) -> tuple[Array, BoolArray]:
        """Solve each view for the block of a link; return the values, and a mask of the valid ones."""
        before, after, usable = self._split_at_link(sight, k)
        X = inverse(before) @ seen @ inverse(after)
        return inverse(X) if sight.chain.links[k].inverted else X, usable & np.isfinite(seen[:, 0, 0])
