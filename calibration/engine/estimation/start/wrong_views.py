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

from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import Array, BoolArray, IntArray
from calibration.engine.dataset.modalities import NoiseKind
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.covariance.fixed_inputs import ARM_ACCURACY, STILL_TOLERANCE
from calibration.engine.estimation.covariance.result import DroppedView
from calibration.engine.estimation.least_squares.minimisation import (
    HUBER_THRESHOLD,
    Termination,
    choose,
    minimise,
    settle,
)
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.options import ALL_EXACT, Assumptions
from calibration.engine.estimation.problem.blocks import Pose, Values
from calibration.engine.estimation.problem.fixing import with_gauge_fixed
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.residuals.corner_residuals import CornerTerm
from calibration.engine.estimation.residuals.pose_residuals import PoseTerm
from calibration.engine.estimation.residuals.ray_residuals import RangeTerm
from calibration.engine.estimation.residuals.views import Term, ViewGroup
from calibration.engine.estimation.start.ambiguous_views import unflipped
from calibration.engine.estimation.start.build import Setup
from calibration.engine.estimation.start.linear_solvers import fit_planes
from calibration.engine.estimation.start.linear_start import linear_start, local_poses
from calibration.engine.estimation.start.single_views import robust_poses
from calibration.engine.geometry.transforms import distance
from calibration.engine.statistics import median

MIN_NOTICEABLE_RESIDUAL: dict[NoiseKind, float] = {
    "pixel": 1.0,
    "range": 0.01,
    "lidar2d_range": 0.01,
    "pose_translation": 0.01,
}
"""Median residual of a view's labels (px or m) below which it is never rejected."""
ABOVE_NOISE = 4.0
"""Median residual, in multiples of the noise inside the views, below which a view fits and no view is tested."""
MIN_SPREADS_OF_WRONG_VIEW = 12.0
"""Distance of a wrong view's residual from the median of the agreeing ones, in their robust standard deviations."""
MIN_MEDIANS_OF_WRONG_VIEW = 8.0
"""Residual of a wrong view, in multiples of the agreeing ones' median beyond the noise inside the views: an arm's own
errors are not wrong views."""
ARM_ERRORS = 4.0
"""Residual of a wrong view, in multiples of what an arm's own error makes (`ARM_ACCURACY`)."""
MAX_RATIO_OF_FIRST_MAJORITY = 3.0
"""Limit of the residuals of the first, bare majority, in multiples of the largest one of its best half."""
COLLECTIONS_PER_DRAW = 3
"""Number of collections per random draw: with two unknown poses they need rotations about two axes."""
COLLECTIONS_PER_DRAW_OF_POINTS = 4
"""The same with points of a LiDAR, of which each view determines only a plane."""
MAX_WRONG_SHARE = 0.45
"""Share of wrong collections that is found reliably."""
MAX_PROBABILITY_OF_MISS = 1e-3
"""Probability that all draws contain a wrong collection, at that share."""
MAX_COLLECTIONS_SEARCHED = 200
"""Number of collections in which the majority is searched; of more, a subset."""
MAX_RESIDUAL_IF_CLEAR = 2.0
"""Residual of the majority, in multiples of the noise, below which the search ends."""
MAX_RESIDUAL_OF_MAJORITY = 10.0
"""Residual of the majority, in multiples of what is noticeable, above which there is no majority."""
MAX_REFITS = 8
"""Limit of the refits to the better half."""
POINTS_PER_VIEW = 32
"""Approximate number of points of a LiDAR's view that are used."""
TERMINATION_OF_REFIT = Termination(decrease=0.1, iterations=15)
MIN_EQUATIONS_PER_UNKNOWN = 2.6
"""Required number of equations of a bare majority, as a multiple of the unknowns."""


def wrong_views(setup: Setup, start: Values, assume: Assumptions = ALL_EXACT) -> tuple[DroppedView, ...]:
    """Find the views that contradict the majority of the others, in the order of the collections.

    Args:
        setup: the problem.
        start: its initial values. If a few steps from there fit all views well, no view is tested.
        assume: how well an arm is known: what it is off by is no wrong view.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        values = _nearer_values(setup.problem, start)
        if values is None:
            return ()
        verdicts = [
            verdict for each in _groups_to_test(setup) if (verdict := _test_groups(setup, each, values, assume))
        ]
        return tuple(
            _dropped_view(setup, verdicts, group, c)
            for c in range(setup.problem.collections)
            for group in sorted(_groups_of_wrong_views(verdicts, c))
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


def _nearer_values(problem: Problem, start: Values) -> Values | None:
    """Return values closer to the optimum than the initial ones; None if all views fit well."""
    if _all_fit(problem, start):
        return None
    nearby = replace(problem, groups=tuple(replace(group, terms=group.terms[:1]) for group in problem.groups))
    kinds = {group.terms[0].kind for group in nearby.groups}
    weighting = Weighting({kind: MIN_NOTICEABLE_RESIDUAL[kind] / 2 for kind in kinds}, HUBER_THRESHOLD)
    nearer = minimise(nearby, start, weighting, TERMINATION_OF_REFIT).values
    return None if _all_fit(nearby, nearer) else nearer


def _all_fit(problem: Problem, values: Values) -> bool:
    """Whether all views fit well."""
    return all(_group_fits(problem, group, values) for group in problem.groups)


def _group_fits(problem: Problem, group: ViewGroup, values: Values) -> bool:
    """Whether the median residual of each of a group's views is not noticeable, or not above the noise inside them."""
    term, *_ = problem.terms(group, values)
    magnitudes, middle = term.magnitudes(problem.poses(group, values)), (term.counts - 1) // 2

    def below(limit: float) -> bool:
        return bool((np.count_nonzero(magnitudes <= limit, axis=-1) > middle).all())

    return below(MIN_NOTICEABLE_RESIDUAL[term.kind]) or below(ABOVE_NOISE * noise_in_own_fits(group))


def noise_in_own_fits(group: ViewGroup) -> float:
    """Return the median over the views of the labels' residuals from their own view's fit, px or m."""
    term = group.terms[0]
    if isinstance(term, CornerTerm):
        return median(np.nan_to_num(_median_magnitudes(term.magnitudes(term.linear_poses), term.counts), posinf=0.0))
    if isinstance(term, RangeTerm):
        normals, offsets = fit_planes(term.points, term.present)
        off = np.abs(np.einsum("vi,vil->vl", normals, term.points) - offsets[:, None])
        return median(_median_magnitudes(np.where(term.present, off, np.nan), term.counts))
    return 0.0


def median_residuals(problem: Problem, group: ViewGroup, values: Values) -> Array:
    """Return the median residual (V,) of each view's labels, px or m."""
    term, *_ = problem.terms(group, values)
    return _median_magnitudes(term.magnitudes(problem.poses(group, values)), term.counts)


def _median_magnitudes(magnitudes: Array, counts: IntArray) -> Array:
    """Return the median (V,) of magnitudes (V, L), in which NaN of existing labels counts as infinite."""
    ranked = np.sort(magnitudes, axis=-1)  # NaN last
    middle = ranked[np.arange(len(ranked)), (counts - 1) // 2]
    return np.where(np.isnan(middle), np.inf, middle)


def _noticeable_residual(dataset: Dataset, group: ViewGroup, assume: Assumptions) -> float:
    """Return the median residual below which a view is never wrong, px or m: by far more than its arm is off by."""
    term = group.terms[0]
    least = MIN_NOTICEABLE_RESIDUAL[term.kind]
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
    return any(np.abs(T - T[0]).max() > STILL_TOLERANCE for T in transforms)


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


def _groups_to_test(setup: Setup) -> Iterator[tuple[int, ...]]:
    """Yield the groups to test together: pairs with a common pose per collection, others by themselves."""
    local = set(setup.problem.local)
    own = [{link.block for link in group.chain.links} & local for group in setup.problem.groups]
    yield from ((i,) for i, blocks in enumerate(own) if not blocks)
    yield from ((i, j) for i, j in combinations(range(len(own)), 2) if own[i] and own[i] == own[j])


def _test_groups(setup: Setup, which: tuple[int, ...], values: Values, assume: Assumptions) -> _Verdict | None:
    """Test some groups for collections that contradict the majority; None if that is not possible."""
    part = _setup_of_groups(setup, which)
    if part is None or not part.problem.shared:
        return None
    problem = part.problem
    collections = problem.groups[0].collections
    points = any(isinstance(group.terms[0], RangeTerm) for group in problem.groups)
    equations = sum(6 if isinstance(g.terms[0], CornerTerm) else 3 for g in problem.groups) - problem.sizes[1]
    if (len(collections) // 2 + 1) * equations < MIN_EQUATIONS_PER_UNKNOWN * problem.sizes[0]:
        return None
    unknown = sum(isinstance(problem.blocks[i].parameters, Pose) for i in problem.shared)
    draw = COLLECTIONS_PER_DRAW_OF_POINTS if points else 1 if unknown == 1 else COLLECTIONS_PER_DRAW
    some = np.sort(np.random.default_rng(0).permutation(collections)[:MAX_COLLECTIONS_SEARCHED])
    noticeable = {group.sensor: _noticeable_residual(part.dataset, group, assume) for group in problem.groups}
    most = _Consensus(part, values, some, equations, noticeable).majority(draw)
    if most is None or (found := _Consensus(part, values, collections, equations, noticeable).agreed(most)) is None:
        return None
    best, wrong = found
    return _Verdict(which, part, best, np.isin(np.arange(problem.collections), collections), wrong)


def _setup_of_groups(setup: Setup, which: tuple[int, ...]) -> Setup | None:
    """Return the setup with some groups only, in the collections that all of them saw; None if not connected."""
    problem = setup.problem
    groups = [replace(problem.groups[i], terms=(_thin_points(problem.groups[i].terms[0]),)) for i in which]
    seen = [np.isin(np.arange(problem.collections), group.collections) for group in groups]
    shared = np.logical_and.reduce(seen)
    if shared.sum() < 3:
        return None
    groups = [group.take(np.flatnonzero(shared[group.collections])) for group in groups]
    used = {link.block for group in groups for link in group.chain.links}
    blocks = [replace(b, held=b.held or i not in used) for i, b in enumerate(problem.blocks)]
    try:
        _, fixed = with_gauge_fixed(setup.dataset, groups, blocks)
    except UndeterminedError:
        return None
    return replace(setup, problem=Problem(fixed, tuple(groups), problem.collections))


def _thin_points(term: Term) -> Term:
    """Return the term with only as many points of each view as its plane needs."""
    if not isinstance(term, RangeTerm):
        return term
    step = max(1, int(term.counts.min()) // POINTS_PER_VIEW)
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
        self._noticeable_residual = noticeable
        self._test_groups = np.isin(np.arange(setup.problem.collections), collections)
        self.problem = setup.problem.seen_in(self._test_groups)
        self.setup = replace(setup, problem=self.problem)
        self._values = values
        self._collections, self._majority = collections, len(collections) // 2 + 1
        self._equations, self._parameters = equations, self.problem.sizes[0]
        self._noise = {g.terms[0].kind: 0.1 * MIN_NOTICEABLE_RESIDUAL[g.terms[0].kind] for g in self.problem.groups}
        for group in self.problem.groups:
            kind = group.terms[0].kind
            self._noise[kind] = max(self._noise[kind], noise_in_own_fits(group))

    def majority(self, draw: int) -> Values | None:
        """Return the values on which a bare majority agrees best; None if no collections determine any."""
        best: tuple[float, Values] | None = None
        least = np.inf
        for subset in self._random_subsets(draw):
            values = self._values_from_subset(subset)
            if values is None or (score := self._best_majority(values)[0]) >= least:
                continue
            least = score
            improved = self._improve_majority(score, values)
            if best is None or improved[0] < best[0]:
                best = improved
            if best[0] <= MAX_RESIDUAL_IF_CLEAR:
                break
        return None if best is None else best[1]

    def _random_subsets(self, size: int) -> Iterator[IntArray]:
        """Yield random subsets of collections, from a fixed seed."""
        rng = np.random.default_rng(0)
        if size == 1:
            yield from rng.permutation(self._collections)[
                : math.ceil(math.log(MAX_PROBABILITY_OF_MISS) / math.log(MAX_WRONG_SHARE)), None
            ]
            return
        for _ in range(math.ceil(math.log(MAX_PROBABILITY_OF_MISS) / math.log(1 - (1 - MAX_WRONG_SHARE) ** size))):
            yield rng.choice(self._collections, size, replace=False)

    def _mask_of_collections(self, collections: IntArray) -> BoolArray:
        mask = np.zeros(self.problem.collections, bool)
        mask[collections] = True
        return mask

    def _values_from_subset(self, subset: IntArray) -> Values | None:
        """Return the values determined by a few collections, or None."""
        few = replace(self.setup, problem=self.problem.seen_in(self._mask_of_collections(subset)))
        try:
            start = linear_start(few, self._values)
            return None if start.guessed else self._place_local_poses(start.values)
        except (InputError, UndeterminedError, np.linalg.LinAlgError):
            return None

    def _place_local_poses(self, values: Values) -> Values:
        return local_poses(self.setup, values) if self.problem.local else values

    def _median_residuals_of_groups(self, values: Values) -> Array:
        """Return the median residual (G, N) of each group's labels, px or m; 0 without a view."""
        out = np.zeros((len(self.problem.groups), self.problem.collections))
        for miss, group in zip(out, self.problem.groups, strict=True):
            miss[group.collections] = median_residuals(self.problem, group, values)
        return out

    def _best_majority(self, values: Values) -> tuple[float, IntArray]:
        """Return the residual of the best majority, in multiples of the noise, and its collections."""
        noise = np.array([self._noise[group.terms[0].kind] for group in self.problem.groups])
        miss = (self._median_residuals_of_groups(values) / noise[:, None]).max(0)[self._collections]
        order = miss.argsort(kind="stable")[: self._majority]
        return float(miss[order].mean()), self._collections[order]

    def _refit_collections(self, values: Values, which: BoolArray, thoroughly: bool = False) -> Values:
        """Return the optimum of some collections (N,), with the local poses of the others adapted."""
        weighting = self._weighting_by_residuals(values, which)
        part = self.problem.seen_in(which)
        fitted = minimise(part, values, weighting, TERMINATION_OF_REFIT).values
        if not self.problem.local:
            return fitted
        others = choose(self.problem, which, fitted, self._place_local_poses(fitted))
        settled, cost = settle(self.problem, others, weighting, self._test_groups)
        return unflipped(self.problem, settled, weighting, cost)[0] if thoroughly else settled

    def _weighting_by_residuals(self, values: Values, which: BoolArray) -> Weighting:
        scales = dict(self._noise)
        for group, miss in zip(self.problem.groups, self._median_residuals_of_groups(values), strict=True):
            kind = group.terms[0].kind
            typical = median(miss[which])
            if np.isfinite(typical):
                scales[kind] = max(scales[kind], typical)
        return Weighting(scales, HUBER_THRESHOLD)

    def _improve_majority(self, score: float, values: Values) -> tuple[float, Values]:
        for _ in range(MAX_REFITS):
            _, best = self._best_majority(values)
            trial = self._refit_collections(values, self._mask_of_collections(best))
            trial_score = self._best_majority(trial)[0]
            if not trial_score < score * 0.99:
                break
            score, values = trial_score, trial
        return score, values

    def agreed(self, values: Values) -> tuple[Values, BoolArray] | None:
        """Extend the best majority to all collections that agree with it; None if it does not agree itself."""
        values = self._place_local_poses(values)
        tested, first = self._test_groups, self._mask_of_collections(self._best_majority(values)[1])
        agreeing = first
        for _ in range(MAX_REFITS):
            values = self._refit_collections(values, agreeing, thoroughly=True)
            miss = self._median_residuals_of_groups(values)
            widest = MAX_RATIO_OF_FIRST_MAJORITY if agreeing is first else 0.0
            limits = [
                self._limit_of_residuals(g, m[agreeing], widest) for g, m in zip(self.problem.groups, miss, strict=True)
            ]
            updated = tested & (miss <= np.array(limits)[:, None]).all(0)
            kinds = [group.terms[0].kind for group in self.problem.groups]
            if updated.sum() < self._majority or any(
                median(own) > MAX_RESIDUAL_OF_MAJORITY * MIN_NOTICEABLE_RESIDUAL[kind]
                for kind, own in zip(kinds, miss[:, updated], strict=True)
            ):
                return None
            if (updated == agreeing).all():
                break
            agreeing = updated
        return values, tested & ~agreeing

    def _limit_of_residuals(self, group: ViewGroup, agreeing: Array, widest: float) -> float:
        """Return the residual above which a view of a group is wrong, by those of the agreeing ones."""
        # residuals that p of n equations have fitted are smaller by sqrt(1 - p / n), those of others larger by
        # sqrt(1 + p / n) (generalised cross-validation: P. Craven and G. Wahba, 1978)
        fitted = self._parameters / (self._equations * len(agreeing))
        optimism = math.sqrt((1 + fitted) / max(1 - fitted, 0.1))
        middle = median(agreeing)
        spread = 1.4826 * median(np.abs(agreeing - middle))
        beyond_noise = math.sqrt(max(0.0, middle**2 - self._noise[group.terms[0].kind] ** 2))
        far = max(
            middle + MIN_SPREADS_OF_WRONG_VIEW * spread,
            MIN_MEDIANS_OF_WRONG_VIEW * beyond_noise,
            widest * float(agreeing.max()),
        )
        return max(self._noticeable_residual[group.sensor], optimism * far)


# ----------------------------------------------------------------------------------------------


def _groups_of_wrong_views(verdicts: Sequence[_Verdict], collection: int) -> set[int]:
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


def _dropped_view(setup: Setup, verdicts: Sequence[_Verdict], group: int, collection: int) -> DroppedView:
    views = setup.problem.groups[group]
    apart = [_distance_from_agreeing(v, collection) for v in verdicts if v.wrong[collection] and group in v.groups]
    t, r = max(apart)
    key = setup.dataset.keys[collection]
    return DroppedView(views.sensor, views.pattern, key, round(1e3 * t, 3), round(float(np.degrees(r)), 4))


def _distance_from_agreeing(verdict: _Verdict, collection: int) -> tuple[float, float]:
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
