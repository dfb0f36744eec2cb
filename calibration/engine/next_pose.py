"""Next poses: which further views would decide an undecided limit soonest, and what they are expected to bring.

Information is additive. Of the F calibrated parameters and the H held ones, known to ``s`` each, a calibration has the
matrix ``T`` (`covariance.linear_model`), and the views of a further pose add ``G_c``, with the pattern's own pose
eliminated. With the parts ``A`` (F, F) and ``B`` (F, H) of their sum, and a quantity ``R x`` of all parameters x::

    variance = tr(R_F A^-1 (1 + D) R_F^T) + |(R_H - R_F A^-1 B) diag(s)|^2

where D is by how much the recording's collections disagree beyond the noise of their labels: further ones are expected
to disagree as much. This is what `covariance.error_bars` states once the poses are taken. Goals are the limits of
sensors, joints and tasks, as standard deviations that decide them; the advice (`next_poses`) is a greedy choice of some
candidate poses, how many a limit takes, and what no pose can mend.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.base.arrays import Array, IntArray
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.limits import TWIST_UNITS, Limits, allowed, block_of, stated
from calibration.engine.estimation.covariance.fixed_inputs import LAG_KIND, Cause
from calibration.engine.estimation.covariance.linear_model import information_of_each
from calibration.engine.estimation.covariance.result import Calibration, Solution
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.problem.blocks import Values
from calibration.engine.estimation.problem.problem import Problem
from calibration.engine.estimation.start.build import groups_of_views
from calibration.engine.geometry.transforms import translation
from calibration.engine.tasks.robot_task import TaskUnit
from calibration.engine.tasks.task_errors import TaskError

NEXT_TO_NOTHING = 1e-9
"""Information before anything is recorded, in that of all views that are looked at."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Information on F calibrated and H held parameters."""

    solution: Solution
    causes: tuple[Cause, ...]
    """Calibrated ones, then those that are held with an assumed error: their parameters follow the shared ones."""
    columns: IntArray
    """(F + H,): the parameters' columns of the linear model."""
    information: Array
    """(F + H, F + H)."""
    calibrated: int
    """F."""
    disagreement: Array
    """(F,): D, on the diagonal."""

    @cached_property
    def held_sigmas(self) -> Array:
        """(H,): standard deviations of the held parameters."""
        assumed = [sigma for cause in self.causes if not cause.free for sigma in cause.assumed]
        return np.array(assumed, float)

    def with_views(self, information: Array) -> "Knowledge":
        """Return what is known with further views, by their information (F + H, F + H)."""
        return replace(self, information=self.information + information)

    def views(self, poses: Dataset) -> Array:
        """Return the information (M, F + H, F + H) of each collection of a dataset of further views.

        Args:
            poses: the sensors and patterns of the calibrated dataset, and its transforms where nothing moves.
        """
        return information_of_further_views(self.solution, poses, self.causes)

    def variances(self, rows: Array, more: Array | None = None) -> Array:
        """Return the variances (M, r) of quantities, by their derivatives (r, F + H).

        Args:
            rows: the derivatives.
            more: information (M, F + H, F + H) that is added, each alone; None for one of nothing.
        """
        return np.asarray(self._parts(rows, more)[0])

    def held_parts(self, rows: Array, more: Array | None = None) -> Mapping[str, Array]:
        """Return by held cause its part (M, r) of the variances."""
        squares, parts, start = self._parts(rows, more)[1], {}, 0
        for cause in self.causes:
            if not cause.free:
                parts[cause.name] = squares[:, :, start : start + cause.size].sum(-1)
                start += cause.size
        return parts

    def _parts(self, rows: Array, more: Array | None) -> tuple[Array, Array]:
        """Return the variances (M, r), and the parts (M, r, H) of each held parameter in them."""
        F = self.calibrated
        T = self.information[None] if more is None else self.information + more
        own, held = rows[:, :F], rows[:, F:]
        weights = np.stack([np.ones(F), np.sqrt(self.disagreement)])[: 1 + bool(self.disagreement.any())]
        sides = (weights[:, None] * own).reshape(-1, F).T
        solved = np.linalg.solve(T[:, :F, :F], np.broadcast_to(sides, (len(T), *sides.shape)))
        by_labels = (solved * sides).sum(1).reshape(len(T), -1, len(rows)).sum(1)
        moved = held - np.swapaxes(solved[:, :, : len(rows)], 1, 2) @ T[:, :F, F:]
        squares = (moved * self.held_sigmas) ** 2
        return by_labels + squares.sum(-1), squares


def knowledge_of(calibration: Calibration) -> Knowledge:
    """Return what a calibration that has converged knows.

    Args:
        calibration: the calibration.
    """
    solution, bars = calibration.solution, calibration.error_bars
    if bars is None:
        raise AssertionError("it has converged")
    found = _of_model(solution)
    disagreement = np.zeros(found.calibrated)
    for block, at in solution.setup.problem.shared_parameters.items():
        beyond = np.trace(np.linalg.solve(bars.labels[block], bars.total[block] - bars.expected[block]))
        disagreement[at] = max(0.0, float(beyond) / len(bars.labels[block]))
    return replace(found, disagreement=disagreement)


def knowledge_before(solution: Solution) -> Knowledge:
    """Return what is known before anything is recorded: next to nothing.

    Args:
        solution: any views of the sensors that are planned, at the nominal poses.
    """
    found = _of_model(solution)
    prior = solution.model.prior[found.columns[:, None], found.columns]
    return replace(found, information=prior + np.diag(NEXT_TO_NOTHING * solution.model.alone[found.columns]))


def _of_model(solution: Solution) -> Knowledge:
    """Return what a solution's views tell; they are taken to agree."""
    model = solution.model
    placed = model.placed()
    kept = [each for each in placed if each[0].free] + [
        (cause, at) for cause, at in placed if cause.counts and not cause.free and any(cause.assumed)
    ]
    columns = np.concatenate([np.arange(model.shared), *(np.arange(at.start, at.stop) for _, at in kept)])
    calibrated = model.shared + sum(cause.size for cause, _ in kept if cause.free)
    return Knowledge(
        solution,
        tuple(cause for cause, _ in kept),
        columns,
        model.total[columns[:, None], columns],
        calibrated,
        np.zeros(calibrated),
    )


def information_of_further_views(solution: Solution, poses: Dataset, causes: tuple[Cause, ...]) -> Array:
    """Return the information (M, C, C) of each collection of further views on the shared parameters and some causes.

    What is linearised at is the optimum; of patterns and transforms that differ between collections, what the dataset
    of the views has. Frames of a robot that stands still tell nothing about a lag.
    """
    setup = solution.setup
    blocks, kinds = setup.problem.blocks, solution.weighting.scales
    groups = [
        replace(group, terms=terms)
        for group in groups_of_views(poses, blocks)
        if (terms := tuple(term for term in group.terms if term.kind in kinds))
    ]
    problem = Problem(blocks, tuple(groups), len(poses.collections))
    size = problem.sizes[0] + sum(cause.size for cause in causes)
    if not groups:
        return np.zeros((problem.collections, size, size))
    still = [replace(cause, effect=_no_effect) if cause.kind == LAG_KIND else cause for cause in causes]
    nothing = Cause("nothing", "", "1", (0.0,), _no_effect)
    weighting = Weighting(kinds, None)  # no label is an outlier yet
    found = information_of_each(problem, _values_at(solution, poses), weighting, poses, still or [nothing])
    return found[:, :size, :size]


def _no_effect(_: object) -> None:
    return None


def _values_at(solution: Solution, poses: Dataset) -> Values:
    """Return the optimum, with the poses (M, 4, 4) of what differs between collections."""
    centres = {pattern.edge: translation(pattern.centre) for pattern in poses.patterns.values()}
    values = []
    for block, value in zip(solution.setup.problem.blocks, solution.values, strict=True):
        if block.per_collection and block.edge is not None:
            value = poses.transforms[block.edge] @ centres.get(block.edge, np.eye(4))
        values.append(value)
    return tuple(values)


MIN_WANTED = 1e-9
"""mm, deg: least of what is wanted of an error; a limit may be 0."""
MAX_POINTS = 6
"""Points of a task that are looked at."""
_UNITS: tuple[tuple[TaskUnit, str, float], ...] = (("mm", "m", 1e3), ("deg", "rad", 180 / np.pi))
"""Of limits, of the parameters, and their ratio."""


@dataclass(frozen=True, eq=False)
class Goal:
    """Error that is to be small enough for a limit to be decided."""

    name: str
    """Sensor, joint or task."""
    unit: TaskUnit
    rows: Array
    """(p, r, F + H): its derivatives by the parameters of `Knowledge`, in its unit, at p points of a task, else at one.
    Its size is the root of the sum of their variances at the worst point: a standard deviation, or of a task the error
    that 95 % stay below."""
    wanted: float
    """Size at which its limit holds, in its unit."""
    limit: float
    """The limit."""


def goals_of(
    calibration: Calibration, knowledge: Knowledge, limits: Limits, tasks: Sequence[TaskError] = ()
) -> tuple[Goal, ...]:
    """Return the goals of a calibration that has converged: its limits, set or default, and those of its tasks."""
    goals: list[Goal] = []
    for name in stated(calibration):
        limit = allowed(calibration, limits, name)
        block, units = block_of(calibration, name)
        goals += _goals_of_block(
            name, (limit.translation_mm, limit.rotation_deg), limits.guard, knowledge, block, units
        )
    with_limit = ((error, error.task.limit) for error in tasks if error.task.limit is not None)
    return (*goals, *(_goal_of_task(error, limit, knowledge) for error, limit in with_limit))


def goals_before(knowledge: Knowledge, limits: Limits) -> tuple[Goal, ...]:
    """Return the goals of a calibration that is planned: its limits, or the least default ones if none is set."""
    setup = knowledge.solution.setup
    shared, goals = setup.problem.shared_parameters, list[Goal]()
    given = (limits.translation_mm, limits.rotation_deg, limits.joint_mm, limits.joint_deg)
    most = [np.inf if each is None else each for each in given] if limits.any_set else [*limits.sensor, *limits.joint]
    for sensor in setup.dataset.sensors.values():
        if (block := setup.block(sensor.edge)) in shared:
            goals += _goals_of_block(sensor.name, most[:2], limits.guard, knowledge, block, TWIST_UNITS)
    for name, joint in setup.dataset.joints.items():
        units = [joint.model.unit(parameter) for parameter in joint.parameters]
        goals += _goals_of_block(name, most[2:], limits.guard, knowledge, setup.block(joint.edge), units)
    return tuple(goals)


def _goals_of_block(
    name: str, most: Sequence[float], guard: float, knowledge: Knowledge, block: int, units: Sequence[str]
) -> Iterator[Goal]:
    """Yield the goals of a shared block: its lengths and its angles, as far as they have a limit."""
    at = knowledge.solution.setup.problem.shared_parameters[block]
    for limit, (unit, parameter, scale) in zip(most, _UNITS, strict=True):
        own = np.arange(at.start, at.stop)[[each == parameter for each in units]]
        if np.isfinite(limit) and len(own) and guard:
            rows = np.zeros((1, len(own), len(knowledge.columns)))
            rows[0, np.arange(len(own)), own] = scale
            yield Goal(name, unit, rows, max(limit / guard, MIN_WANTED), limit)


def _goal_of_task(error: TaskError, limit: float, knowledge: Knowledge) -> Goal:
    """Return the goal at some of a task's points, the worst one among them; the shape of its error is taken to stay."""
    some = np.linspace(0, len(error.most) - 1, MAX_POINTS - 1).round().astype(int)
    points = np.unique([error.worst, *some.tolist()])
    rows = error.jacobian[points][:, :, knowledge.columns]
    sizes = np.sqrt(knowledge.variances(rows.reshape(-1, rows.shape[-1]))[0].reshape(rows.shape[:2]).sum(1))
    scales = np.divide(error.most[points], sizes, out=np.ones(len(points)), where=sizes > 0)
    return Goal(error.task.name, error.task.unit, rows * scales[:, None, None], limit, limit)


MAX_CHOSEN = 8
"""Poses that are chosen one by one, by default."""
MAX_NEEDED = 200
"""Poses above which a limit is out of reach."""
WORTH_TAKING = 0.05
"""Part of an error bar that further poses have to take away to be worth taking."""
MIN_NAMED_SHARE = 0.03
"""Part of the variance that poses cannot mend, from which on its cause is named."""


@dataclass(frozen=True, eq=False)
class AdvisedPose:
    """Candidate that is chosen, after those before it."""

    candidate: int
    sizes: Array
    """(g,): expected size of each goal's error after it, in the goal's unit."""


@dataclass(frozen=True, eq=False)
class Advice:
    """What to record next for some goals."""

    goals: tuple[Goal, ...]
    sizes: Array
    """(g,): size of each goal's error now, in its unit."""
    poses: tuple[AdvisedPose, ...]
    """Best first; none if there are no candidates, or nothing is to be reached."""
    needed: int | None
    """Poses after which all goals are expected to be reached; 0 if they are, None if not by `MAX_NEEDED`."""
    least: Array
    """(g,): size of each goal's error with any number of the candidates' poses."""
    beyond_poses: Mapping[str, float]
    """Of the goal that poses can mend least, the share of each cause in the variance that they leave, largest first;
    empty where all goals are reached."""

    @property
    def open_goals(self) -> list[int]:
        """The goals that are not reached yet."""
        return [k for k, goal in enumerate(self.goals) if self.sizes[k] > goal.wanted]

    @property
    def hopeless_goals(self) -> list[int]:
        """Those that no pose can reach."""
        return [k for k in self.open_goals if self.least[k] > self.goals[k].wanted]

    @property
    def brings(self) -> float:
        """Largest part that the advised poses take away of any goal's error."""
        if not self.poses:
            return 0.0
        return float(np.max(1 - self.poses[-1].sizes / np.maximum(self.sizes, 1e-300)))

    @property
    def is_enough(self) -> bool:
        """Whether further poses are not worth taking: all goals are reached, or the poses bring next to nothing."""
        return not self.open_goals or self.brings < WORTH_TAKING


@dataclass(frozen=True, eq=False)
class PoseAdvisor:
    """Knowledge, goals, and the information of M candidates: further views are added without another calibration."""

    knowledge: Knowledge
    goals: tuple[Goal, ...]
    candidates: Array
    """(M, F + H, F + H)."""

    def after(self, views: Dataset) -> "PoseAdvisor":
        """Return the advisor after further views, by the labels that they have.

        Args:
            views: as in `Knowledge.views`.
        """
        more = self.knowledge.with_views(self.knowledge.views(views).sum(0))
        return PoseAdvisor(more, self.goals, self.candidates)

    def advise(self, count: int, most: int = MAX_CHOSEN) -> Advice:
        """Choose the next poses.

        Args:
            count: how many at least, up to ``most``.
            most: how many are chosen one by one until all goals are reached; to count more, they are taken again.
        """
        now = self._sizes(self.knowledge)[0]
        wanted = np.array([goal.wanted for goal in self.goals])
        if not len(self.candidates) or not self.goals:
            reached = 0 if (now <= wanted).all() else None
            return Advice(self.goals, now, (), reached, now, {} if reached == 0 else self._left(self.knowledge))
        chosen, needed, knowledge = list[AdvisedPose](), 0 if (now <= wanted).all() else None, self.knowledge
        taken = np.zeros(len(self.candidates), bool)  # the same pose again tells little: it has the same errors
        for number in range(1, min(most, len(taken)) + 1):
            sizes = self._sizes(knowledge, self.candidates)
            best = int(np.where(taken, np.inf, self._still_to_go(sizes)).argmin())
            taken[best] = True
            chosen.append(AdvisedPose(best, sizes[best]))
            knowledge = knowledge.with_views(self.candidates[best])
            if needed is None and (sizes[best] <= wanted).all():
                needed = number
            if needed is not None and number >= count:
                break
        again = self.candidates[taken].sum(0)
        ever = MAX_NEEDED**2 * np.stack([again, self.candidates.sum(0)])
        least = np.min([now, *self._sizes(self.knowledge, ever), *(each.sizes for each in chosen)], axis=0)
        if needed is None and (least <= wanted).all():
            rounds = np.arange(2, MAX_NEEDED // len(chosen) + 1)
            holds = (self._sizes(self.knowledge, rounds[:, None, None] * again) <= wanted).all(1)
            needed = len(chosen) * int(rounds[holds.argmax()]) if holds.any() else None
        left = {} if (now <= wanted).all() else self._left(self.knowledge.with_views(ever[0]))
        return Advice(self.goals, now, tuple(chosen[:count]), needed, least, left)

    def _sizes(self, knowledge: Knowledge, more: Array | None = None) -> Array:
        """Return the sizes (M, g) of the goals' errors, by what each candidate adds."""
        if not self.goals:
            return np.zeros((1 if more is None else len(more), 0))
        shapes = [goal.rows.shape[:2] for goal in self.goals]
        variances = knowledge.variances(
            np.concatenate([goal.rows.reshape(-1, goal.rows.shape[-1]) for goal in self.goals]), more
        )
        own = np.split(variances, np.cumsum([p * r for p, r in shapes])[:-1], axis=1)
        squares = [each.reshape(-1, *shape).sum(-1).max(-1) for each, shape in zip(own, shapes, strict=True)]
        return np.asarray(np.sqrt(np.stack(squares, 1)))

    def _still_to_go(self, sizes: Array) -> Array:
        """Return what is left to do (M,): the mean square of the goals in what is wanted of each, 1 once it is reached.

        Where all are reached, that of all.
        """
        ratios = (sizes / np.array([goal.wanted for goal in self.goals])) ** 2
        open_ = np.maximum(ratios, 1.0)
        return np.asarray(open_.sum(1) + 1e-3 * ratios.sum(1))

    def _left(self, knowledge: Knowledge) -> dict[str, float]:
        """Return by cause its share in the variance of the goal that is farthest from what is wanted."""
        sizes = self._sizes(knowledge)[0]
        goal = self.goals[int(np.argmax(sizes / np.array([each.wanted for each in self.goals])))]
        rows = max(goal.rows, key=lambda point: float(knowledge.variances(point).sum()))
        total = float(knowledge.variances(rows).sum())
        parts = {name: float(part.sum()) / total for name, part in knowledge.held_parts(rows).items()}
        return {n: p for n, p in sorted(parts.items(), key=lambda each: -each[1]) if p > MIN_NAMED_SHARE}


def next_poses(
    calibration: Calibration,
    candidates: Dataset,
    limits: Limits,
    tasks: Sequence[TaskError] = (),
    count: int = 3,
) -> Advice:
    """Return the best of some candidate poses for the limits of a calibration that has converged.

    Args:
        calibration: the calibration.
        candidates: one collection for each pose, with the labels that are expected there (`candidates`).
        limits: those that the user has set; without any, the default ones.
        tasks: errors of the robot's tasks; those with a limit count.
        count: number of poses to choose.
    """
    return pose_advisor(calibration, candidates, limits, tasks).advise(count, max(count, MAX_CHOSEN))


def pose_advisor(
    calibration: Calibration, candidates: Dataset, limits: Limits, tasks: Sequence[TaskError] = ()
) -> PoseAdvisor:
    """Return an advisor, see `next_poses`."""
    knowledge = knowledge_of(calibration)
    found = knowledge.views(candidates)
    return PoseAdvisor(knowledge, goals_of(calibration, knowledge, limits, tasks), found)
