"""Rejection of views that are wrong as a whole: labels and pose of different moments.

Such a view is consistent in itself, so the robust loss on its labels does not reveal it. It contradicts the majority of
the other views: two sensors that see the same moving pattern, or an arm and a camera, have one relative pose in all
collections. Each such pair is tested by itself: the relative pose that fits a bare majority of its collections best
(least trimmed squares, from poses that a few views drawn at random give, improved by refitting to the better half:
P. J. Rousseeuw and K. Van Driessen, "Computing LTS regression for large data sets", 2006; the random draws as in M. A.
Fischler and R. C. Bolles, "Random sample consensus", 1981), then that of all collections that agree with them. Up to
45 % of the collections may be wrong. A view is rejected if its residuals are far larger than the others'.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.base.errors import InputError, UndeterminedError
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.covariance.fixed_inputs import ARM_ACCURACY, STILL
from calibration.engine.estimation.covariance.result import DroppedView
from calibration.engine.estimation.problem.assumptions import EXACT, Assumptions
from calibration.engine.estimation.problem.blocks import Pose, Values
from calibration.engine.estimation.problem.gauge import free_gauge
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.median import median
from calibration.engine.estimation.residuals.pose_residuals import PoseTerm
from calibration.engine.estimation.residuals.ray_residuals import RangeTerm
from calibration.engine.estimation.residuals.views import Term, ViewGroup
from calibration.engine.estimation.solve.least_squares import Termination, choose, minimise, settle
from calibration.engine.estimation.solve.normal_equations import Weighting
from calibration.engine.estimation.solve.optimisation import HUBER_THRESHOLD
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.flipped_patterns import unflipped
from calibration.engine.estimation.start.linear_start import linear_start, local_poses
from calibration.engine.estimation.start.plane_alignment import fit_planes
from calibration.engine.estimation.start.single_views import robust_poses
from calibration.engine.geometry.transforms import distance

NOTICEABLE: dict[NoiseKind, float] = {"pixel": 1.0, "range": 0.01, "lidar2d_range": 0.01, "pose_translation": 0.01}
"""Median residual of a view's labels (px or m) below which it is never rejected."""
ABOVE_NOISE = 4.0
"""Median residual, in multiples of the noise inside the views, below which a view fits and no view is tested."""
SPREADS = 12.0
"""Distance of a wrong view's residual from the median of the agreeing ones, in their robust standard deviations."""
MEDIANS = 8.0
"""Residual of a wrong view, in multiples of the agreeing ones' median beyond the noise inside the views: an arm's own
errors are not wrong views."""
ARM_ERRORS = 4.0
"""Residual of a wrong view, in multiples of what an arm's own error makes (`ARM_ACCURACY`)."""
FIRST = 3.0
"""Limit of the residuals of the first, bare majority, in multiples of the largest one of its best half."""
DRAWN = 3
"""Number of collections per random draw: with two unknown poses they need rotations about two axes."""
DRAWN_OF_POINTS = 4
"""The same with points of a LiDAR, of which each view determines only a plane."""
WRONG = 0.45
"""Share of wrong collections that is found reliably."""
MISSED = 1e-3
"""Probability that all draws contain a wrong collection, at that share."""
MOST = 200
"""Number of collections in which the majority is searched; of more, a subset."""
CLEAR = 2.0
"""Residual of the majority, in multiples of the noise, below which the search ends."""
AGREEING = 10.0
"""Residual of the majority, in multiples of what is noticeable, above which there is no majority."""
ROUNDS = 8
"""Limit of the refits to the better half."""
POINTS = 32
"""Approximate number of points of a LiDAR's view that are used."""
IMPROVING = Termination(decrease=0.1, iterations=15)
SURPLUS = 2.6
"""Required number of equations of a bare majority, as a multiple of the unknowns."""


def wrong_views(setup: Setup, start: Values, assume: Assumptions = EXACT) -> tuple[DroppedView, ...]:
    """Find the views that contradict the majority of the others, in the order of the collections.

    Args:
        setup: the problem.
        start: its initial values. If a few steps from there fit all views well, no view is tested.
        assume: how well an arm is known: what it is off by is no wrong view.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        values = _nearer(setup.problem, start)
        if values is None:
            return ()
        verdicts = [verdict for each in _together(setup) if (verdict := _tested(setup, each, values, assume))]
        return tuple(
            _dropped(setup, verdicts, group, c)
            for c in range(setup.problem.collections)
            for group in sorted(_culprits(verdicts, c))
        )


def without(dataset: Dataset, dropped: Sequence[DroppedView]) -> Dataset:
    """Return the dataset without the labels of some views."""
    if not dropped:
        return dataset
    views = {(view.collection, view.pattern, view.sensor) for view in dropped}
    collections = tuple(
        replace(c, labels={key: label for key, label in c.labels.items() if (c.key, *key) not in views})
        for c in dataset.collections
    )
    return replace(dataset, collections=collections)


# ----------------------------------------------------------------------------------------------


def _nearer(problem: Problem, start: Values) -> Values | None:
    """Return values closer to the optimum than the initial ones; None if all views fit well."""
    if _all_fit(problem, start):
        return None
    nearby = replace(problem, groups=tuple(replace(group, terms=group.terms[:1]) for group in problem.groups))
    kinds = {group.terms[0].kind for group in nearby.groups}
    weighting = Weighting({kind: NOTICEABLE[kind] / 2 for kind in kinds}, HUBER_THRESHOLD)
    nearer = minimise(nearby, start, weighting, IMPROVING).values
    return None if _all_fit(nearby, nearer) else nearer


def _all_fit(problem: Problem, values: Values) -> bool:
    """Whether all views fit well."""
    return all(_fits(problem, group, values) for group in problem.groups)


def _fits(problem: Problem, group: ViewGroup, values: Values) -> bool:
    """Whether the median residual of each of a group's views is not noticeable, or not above the noise inside them."""
    term, *_ = problem.terms(group, values)
    magnitudes, middle = term.magnitudes(problem.poses(group, values)), (term.counts - 1) // 2

    def below(limit: float) -> bool:
        return bool((np.count_nonzero(magnitudes <= limit, axis=-1) > middle).all())

    return below(NOTICEABLE[term.kind]) or below(ABOVE_NOISE * noise_in_own_fits(group))


def noise_in_own_fits(group: ViewGroup) -> float:
    """Return the median over the views of the labels' residuals from their own view's fit, px or m."""
    term = group.terms[0]
    if isinstance(term, CornerTerm):
        return median(np.nan_to_num(_middle(term.magnitudes(term.linear_poses), term.counts), posinf=0.0))
    if isinstance(term, RangeTerm):
        normals, offsets = fit_planes(term.points, term.present)
        off = np.abs(np.einsum("vi,vil->vl", normals, term.points) - offsets[:, None])
        return median(_middle(np.where(term.present, off, np.nan), term.counts))
    return 0.0


def median_residuals(problem: Problem, group: ViewGroup, values: Values) -> Array:
    """Return the median residual (V,) of each view's labels, px or m."""
    term, *_ = problem.terms(group, values)
    return _middle(term.magnitudes(problem.poses(group, values)), term.counts)


def _middle(magnitudes: Array, counts: IntArray) -> Array:
    """Return the median (V,) of magnitudes (V, L), in which NaN of existing labels counts as infinite."""
    ranked = np.sort(magnitudes, axis=-1)  # NaN last
    middle = ranked[np.arange(len(ranked)), (counts - 1) // 2]
    return np.where(np.isnan(middle), np.inf, middle)


def _noticeable(dataset: Dataset, group: ViewGroup, assume: Assumptions) -> float:
    """Return the median residual below which a view is never wrong, px or m: by far more than its arm is off by."""
    term = group.terms[0]
    least = NOTICEABLE[term.kind]
    if not _is_on_an_arm(dataset, group):
        return least
    length, angle = ARM_ACCURACY * assume.arm_translation, ARM_ACCURACY * assume.arm_rotation
    if isinstance(term, CornerTerm):
        away = median(np.linalg.norm(term.linear_poses[:, :3, 3], axis=-1))
        return max(least, ARM_ERRORS * float(np.sqrt(term.camera.fx * term.camera.fy)) * (length / away + angle))
    if isinstance(term, RangeTerm):
        away = median(np.linalg.norm(term.points, axis=1)[term.present])
        return max(least, ARM_ERRORS * (length + angle * away))
    return max(least, ARM_ERRORS * length)


def _is_on_an_arm(dataset: Dataset, group: ViewGroup) -> bool:
    """Whether something moves between a sensor and the pattern that it sees, as the robot says."""
    path = dataset.tree.path(dataset.sensors[group.sensor].frame, dataset.patterns[group.pattern].parent_link)
    transforms = [dataset.transforms[step.parent, step.child] for step in path]
    return any(np.abs(T - T[0]).max() > STILL for T in transforms)


# ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Verdict:
    """Result of a test."""

    groups: tuple[int, ...]
    """Groups of the whole problem."""
    setup: Setup
    """Setup of these groups alone."""
    values: Values
    """Values on which most collections agree."""
    tested: BoolArray
    """(N,): collections that all of the groups saw."""
    wrong: BoolArray
    """(N,): collections that contradict the others."""


def _together(setup: Setup) -> Iterator[tuple[int, ...]]:
    """Yield the groups to test together: pairs with a common pose per collection, others by themselves."""
    local = set(setup.problem.local)
    own = [{link.block for link in group.chain.links} & local for group in setup.problem.groups]
    yield from ((i,) for i, blocks in enumerate(own) if not blocks)
    yield from ((i, j) for i, j in combinations(range(len(own)), 2) if own[i] and own[i] == own[j])


def _tested(setup: Setup, which: tuple[int, ...], values: Values, assume: Assumptions) -> _Verdict | None:
    """Test some groups for collections that contradict the majority; None if that is not possible."""
    part = _part(setup, which)
    if part is None or not part.problem.shared:
        return None
    problem = part.problem
    collections = problem.groups[0].collections
    points = any(isinstance(group.terms[0], RangeTerm) for group in problem.groups)
    equations = sum(6 if isinstance(g.terms[0], CornerTerm) else 3 for g in problem.groups) - problem.sizes[1]
    if (len(collections) // 2 + 1) * equations < SURPLUS * problem.sizes[0]:
        return None
    unknown = sum(isinstance(problem.blocks[i].parameters, Pose) for i in problem.shared)
    draw = DRAWN_OF_POINTS if points else 1 if unknown == 1 else DRAWN
    some = np.sort(np.random.default_rng(0).permutation(collections)[:MOST])
    noticeable = {group.sensor: _noticeable(part.dataset, group, assume) for group in problem.groups}
    most = _Consensus(part, values, some, equations, noticeable).majority(draw)
    if most is None or (found := _Consensus(part, values, collections, equations, noticeable).agreed(most)) is None:
        return None
    best, wrong = found
    return _Verdict(which, part, best, np.isin(np.arange(problem.collections), collections), wrong)


def _part(setup: Setup, which: tuple[int, ...]) -> Setup | None:
    """Return the setup with some groups only, in the collections that all of them saw; None if not connected."""
    problem = setup.problem
    groups = [replace(problem.groups[i], terms=(_thinned(problem.groups[i].terms[0]),)) for i in which]
    seen = [np.isin(np.arange(problem.collections), group.collections) for group in groups]
    shared = np.logical_and.reduce(seen)
    if shared.sum() < 3:
        return None
    groups = [group.take(np.flatnonzero(shared[group.collections])) for group in groups]
    used = {link.block for group in groups for link in group.chain.links}
    blocks = [replace(b, held=b.held or i not in used) for i, b in enumerate(problem.blocks)]
    try:
        gauge = free_gauge(setup.dataset, groups, blocks)
    except UndeterminedError:
        return None
    fixing = [setup.dataset.sensors[gauge.sensor].edge] if gauge.sensor else []
    fixing += [setup.pattern_edge(name) for name in gauge.patterns]
    blocks = [replace(block, held=block.held or block.edge in fixing) for block in blocks]
    return replace(setup, problem=Problem(tuple(blocks), tuple(groups), problem.collections))


def _thinned(term: Term) -> Term:
    """Return the term with only as many points of each view as its plane needs."""
    if not isinstance(term, RangeTerm):
        return term
    step = max(1, int(term.counts.min()) // POINTS)
    every = (..., slice(None, None, step))
    return replace(term, rays=term.rays[every], ranges=term.ranges[every], present=term.present[every])


class _Consensus:
    """Search for the shared transforms on which most collections agree."""

    def __init__(
        self, setup: Setup, values: Values, collections: IntArray, equations: int, noticeable: Mapping[str, float]
    ) -> None:
        """Create the search over collections, each with this number of equations.

        ``noticeable`` is the smallest residual of a wrong view of each sensor.
        """
        self._noticeable = noticeable
        self._tested = np.isin(np.arange(setup.problem.collections), collections)
        self.problem = setup.problem.seen_in(self._tested)
        self.setup = replace(setup, problem=self.problem)
        self._values = values
        self._collections, self._majority = collections, len(collections) // 2 + 1
        self._equations, self._parameters = equations, self.problem.sizes[0]
        self._noise = {g.terms[0].kind: 0.1 * NOTICEABLE[g.terms[0].kind] for g in self.problem.groups}
        for group in self.problem.groups:
            kind = group.terms[0].kind
            self._noise[kind] = max(self._noise[kind], noise_in_own_fits(group))

    def majority(self, draw: int) -> Values | None:
        """Return the values on which a bare majority agrees best; None if no collections determine any."""
        best: tuple[float, Values] | None = None
        least = np.inf
        for subset in self._draws(draw):
            values = self._from(subset)
            if values is None or (score := self._best(values)[0]) >= least:
                continue
            least = score
            improved = self._improved(score, values)
            if best is None or improved[0] < best[0]:
                best = improved
            if best[0] <= CLEAR:
                break
        return None if best is None else best[1]

    def _draws(self, size: int) -> Iterator[IntArray]:
        """Yield random subsets of collections, from a fixed seed."""
        rng = np.random.default_rng(0)
        if size == 1:
            yield from rng.permutation(self._collections)[: math.ceil(math.log(MISSED) / math.log(WRONG)), None]
            return
        for _ in range(math.ceil(math.log(MISSED) / math.log(1 - (1 - WRONG) ** size))):
            yield rng.choice(self._collections, size, replace=False)

    def _mask(self, collections: IntArray) -> BoolArray:
        mask = np.zeros(self.problem.collections, bool)
        mask[collections] = True
        return mask

    def _from(self, subset: IntArray) -> Values | None:
        """Return the values determined by a few collections, or None."""
        few = replace(self.setup, problem=self.problem.seen_in(self._mask(subset)))
        try:
            start = linear_start(few, self._values)
            return None if start.guessed else self._placed(start.values)
        except (InputError, UndeterminedError, np.linalg.LinAlgError):
            return None

    def _placed(self, values: Values) -> Values:
        return local_poses(self.setup, values) if self.problem.local else values

    def _misses(self, values: Values) -> Array:
        """Return the median residual (G, N) of each group's labels, px or m; 0 without a view."""
        out = np.zeros((len(self.problem.groups), self.problem.collections))
        for miss, group in zip(out, self.problem.groups, strict=True):
            miss[group.collections] = median_residuals(self.problem, group, values)
        return out

    def _in_noise(self, values: Values) -> Array:
        """Return the largest residual (N,) in multiples of the noise."""
        noise = np.array([self._noise[group.terms[0].kind] for group in self.problem.groups])
        return np.asarray((self._misses(values) / noise[:, None]).max(0))

    def _best(self, values: Values) -> tuple[float, IntArray]:
        """Return the residual of the best majority, in multiples of the noise, and its collections."""
        miss = self._in_noise(values)[self._collections]
        order = miss.argsort(kind="stable")[: self._majority]
        return float(miss[order].mean()), self._collections[order]

    def _refitted(self, values: Values, which: BoolArray, thoroughly: bool = False) -> Values:
        """Return the optimum of some collections (N,), with the local poses of the others adapted."""
        weighting = self._weighting(values, which)
        part = self.problem.seen_in(which)
        fitted = minimise(part, values, weighting, IMPROVING).values
        if not self.problem.local:
            return fitted
        others = choose(self.problem, which, fitted, self._placed(fitted))
        settled, cost = settle(self.problem, others, weighting, self._tested)
        return unflipped(self.problem, settled, weighting, cost)[0] if thoroughly else settled

    def _weighting(self, values: Values, which: BoolArray) -> Weighting:
        scales = dict(self._noise)
        for group, miss in zip(self.problem.groups, self._misses(values), strict=True):
            kind = group.terms[0].kind
            typical = median(miss[which])
            if np.isfinite(typical):
                scales[kind] = max(scales[kind], typical)
        return Weighting(scales, HUBER_THRESHOLD)

    def _improved(self, score: float, values: Values) -> tuple[float, Values]:
        for _ in range(ROUNDS):
            _, best = self._best(values)
            trial = self._refitted(values, self._mask(best))
            trial_score = self._best(trial)[0]
            if not trial_score < score * 0.99:
                break
            score, values = trial_score, trial
        return score, values

    def agreed(self, values: Values) -> tuple[Values, BoolArray] | None:
        """Extend the best majority to all collections that agree with it; None if it does not agree itself."""
        values = self._placed(values)
        tested, first = self._tested, self._mask(self._best(values)[1])
        agreeing = first
        for _ in range(ROUNDS):
            values = self._refitted(values, agreeing, thoroughly=True)
            miss = self._misses(values)
            widest = FIRST if agreeing is first else 0.0
            limits = [self._limit(g, m[agreeing], widest) for g, m in zip(self.problem.groups, miss, strict=True)]
            updated = tested & (miss <= np.array(limits)[:, None]).all(0)
            if updated.sum() < self._majority or any(map(self._disagrees, self.problem.groups, miss[:, updated])):
                return None
            if (updated == agreeing).all():
                break
            agreeing = updated
        return values, tested & ~agreeing

    def _disagrees(self, group: ViewGroup, agreeing: Array) -> bool:
        """Whether even the collections of the majority disagree: half of their residuals are above `AGREEING`."""
        return median(agreeing) > AGREEING * NOTICEABLE[group.terms[0].kind]

    def _limit(self, group: ViewGroup, agreeing: Array, widest: float) -> float:
        """Return the residual above which a view of a group is wrong, by those of the agreeing ones."""
        # residuals that p of n equations have fitted are smaller by sqrt(1 - p / n), those of others larger by
        # sqrt(1 + p / n) (generalised cross-validation: P. Craven and G. Wahba, 1978)
        fitted = self._parameters / (self._equations * len(agreeing))
        optimism = math.sqrt((1 + fitted) / max(1 - fitted, 0.1))
        middle = median(agreeing)
        spread = 1.4826 * median(np.abs(agreeing - middle))
        beyond_noise = math.sqrt(max(0.0, middle**2 - self._noise[group.terms[0].kind] ** 2))
        far = max(middle + SPREADS * spread, MEDIANS * beyond_noise, widest * float(agreeing.max()))
        return max(self._noticeable[group.sensor], optimism * far)


# ----------------------------------------------------------------------------------------------


def _culprits(verdicts: Sequence[_Verdict], collection: int) -> set[int]:
    """Return the groups whose view of a collection is wrong: those that contradict most others; all in case of a tie.

    A group that agrees with another one is right.
    """
    cleared = {i for v in verdicts if v.tested[collection] and not v.wrong[collection] for i in v.groups}
    bad = [set(v.groups) - cleared or set(v.groups) for v in verdicts if v.wrong[collection]]
    culprits: set[int] = set()
    while bad:
        counts = Counter(i for groups in bad for i in groups)
        most = max(counts.values())
        worst = {i for i, count in counts.items() if count == most}
        culprits |= worst
        bad = [groups for groups in bad if not groups & worst]
    return culprits


def _dropped(setup: Setup, verdicts: Sequence[_Verdict], group: int, collection: int) -> DroppedView:
    views = setup.problem.groups[group]
    apart = [_apart(v, collection) for v in verdicts if v.wrong[collection] and group in v.groups]
    t, r = max(apart)
    key = setup.dataset.keys[collection]
    return DroppedView(views.sensor, views.pattern, key, round(1e3 * t, 3), round(float(np.degrees(r)), 4))


def _apart(verdict: _Verdict, collection: int) -> tuple[float, float]:
    """Return the distance (m, rad) of a pattern's pose from that of the agreeing collections and the pair's camera.

    Of a LiDAR, or if corners determine no pose: the distance of the pattern's plane.
    """
    problem = verdict.setup.problem
    one = problem.seen_in(np.arange(problem.collections) == collection)
    camera = max(one.groups, key=lambda group: isinstance(group.terms[0], CornerTerm | PoseTerm))
    other = next((group for group in one.groups if group is not camera), camera)
    values = verdict.values
    if problem.local:
        values = local_poses(replace(verdict.setup, problem=replace(one, groups=(camera,))), values)
    T, term = one.poses(other, values)[0], other.terms[0]
    if isinstance(term, CornerTerm | PoseTerm):
        (seen,) = robust_poses([term]) if isinstance(term, CornerTerm) else (term.measured,)
        t, r = distance(T, seen[0])
        return float(t), float(r)
    if not isinstance(term, RangeTerm):
        return float("nan"), float("nan")
    (normal,), (offset,) = fit_planes(term.points, term.present)
    return float(np.abs(normal @ T[:3, 3] - offset)), float(np.arccos(min(1.0, abs(normal @ T[:3, 2]))))
