"""Advice on the next poses, by greedy choice: what they bring, how many a limit takes, what no pose can mend."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.next_pose.goals import Goal, goals_of
from calibration.engine.next_pose.knowledge import Knowledge, knowledge_of
from calibration.engine.tasks.task_errors import TaskError

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
