"""Advice on what to record next, as a cell's own results have it, and in words."""

from collections.abc import Mapping, Sequence

from calibration.base import count_of
from calibration.base.records import field, result
from calibration.engine.baseline.calibration_document import PromiseDocument
from calibration.engine.next_pose import MAX_NEEDED, WORTH_TAKING
from calibration.engine.tasks.robot_task import TaskUnit

MANY_POSES = 20
"""Poses above which it is said what else would make a limit hold."""


@result
class NextGoal:
    """Limit that further poses are to decide."""

    name: str = field("Sensor, joint or task.")
    unit: TaskUnit = field("Of its sizes.")
    limit: float = field("The limit.")
    wanted: float = field("Standard deviation that decides it; of a task the limit itself.")
    now: float | None = field(
        "Standard deviation, in all; of a task the error that 95 % stay below. Null before anything is recorded."
    )
    least: float = field("The same with any number of poses.")


@result
class NextView:
    """Pattern in a camera's view, at a pose."""

    camera: str = field("The camera.")
    pattern: str = field("The pattern.")
    outline: tuple[tuple[int, int], ...] = field("Its border in the image.", unit="px")


@result
class NextPose:
    """Pose to take next, after those before it."""

    text: str = field("What to do.")
    joints: Mapping[str, float] = field("Positions of the joints, rad or m, where the robot is described.")
    views: tuple[NextView, ...] = field("What the cameras see there.")
    sizes: tuple[float, ...] = field("Expected size of each goal's error after it.")


@result
class NextPoses:
    """Advice on what to record next."""

    goals: tuple[NextGoal, ...] = field("The limits.")
    poses: tuple[NextPose, ...] = field("The poses, best first.", default=())
    needed: int | None = field("Poses after which all limits hold; null if no number of them does it.", default=None)
    beyond_poses: Mapping[str, float] = field("Shares of what poses cannot mend, by cause.", default_factory=dict)
    remarks: tuple[str, ...] = field("What was not known.", default=())

    @property
    def open_goals(self) -> tuple[int, ...]:
        """The limits that are not decided yet."""
        return tuple(k for k, goal in enumerate(self.goals) if goal.now is None or goal.now > goal.wanted)

    @property
    def promise(self) -> PromiseDocument | None:
        """What the poses are expected to bring, as the accepted calibration keeps it."""
        if not self.poses:
            return None
        sizes: dict[str, dict[TaskUnit, float]] = {}
        for size, goal in self._last:
            sizes.setdefault(goal.name, {})[goal.unit] = size
        return PromiseDocument(len(self.poses), sizes)

    @property
    def lines(self) -> tuple[str, ...]:
        """The advice in words: the poses, what they bring, how many it takes, and what no pose can mend."""
        shown = self.open_goals or tuple(range(len(self.goals)))[:1]
        poses = [f"{k}. {pose.text}: {self._changes(shown, k)}" for k, pose in enumerate(self.poses, 1)]
        return (*(poses if self.open_goals else ()), self.sentence, *self.remarks)

    def _changes(self, shown: Sequence[int], number: int) -> str:
        before = tuple(goal.now for goal in self.goals) if number == 1 else self.poses[number - 2].sizes
        after = self.poses[number - 1].sizes
        return ", ".join(
            f"{self.goals[k].name} {'' if (old := before[k]) is None else f'{old:.3g} -> '}{after[k]:.3g} "
            f"{self.goals[k].unit}"
            for k in shown
        )

    @property
    def sentence(self) -> str:
        """How many poses it takes, or that none can do it, or that it is enough."""
        if not self.goals:
            return "no limit asks for anything that poses could decide"
        if not self.open_goals:
            if not self.poses:
                return "enough: all limits hold"
            brings = max((1 - size / goal.now if goal.now else 0.0 for size, goal in self._last), default=0.0)
            size = "less than 5 %" if brings < WORTH_TAKING else f"{brings:.0%}"
            return f"enough: all limits hold; {count_of(len(self.poses), 'further pose')} would bring {size}"
        worst = max(self.open_goals, key=lambda k: self.goals[k].least / self.goals[k].wanted)
        goal = self.goals[worst]
        if not self.poses:
            return (
                f"no pose can mend it: nothing moves between sensors and patterns, or no sensor would see it "
                f"({goal.name} {goal.now or 0:.2g} {goal.unit}, {goal.wanted:.2g} would decide its limit)"
            )
        causes = ", ".join(f"{share:.0%} {name}" for name, share in list(self.beyond_poses.items())[:3])
        if self.needed is not None:
            more = self.needed - len(self.poses)
            holds = f"the limit of {goal.limit:.3g} {goal.unit} holds"
            if more <= 0:
                return f"after {self.needed} of these poses {holds}"
            sooner = f"; sooner if what is held is better known: {causes}" if more > MANY_POSES and causes else ""
            return f"{more} more such, {self.needed} poses in all, and {holds}{sooner}"
        if goal.least <= goal.wanted:
            sooner = f"; better know what is held: {causes}" if causes else ""
            return f"more than {MAX_NEEDED} such poses decide the limit of {goal.limit:.3g} {goal.unit}{sooner}"
        of = f": of that is {causes}" if causes else ""
        end = "calibrate it, or state under 'assume' how well it is known" if causes else "take poses from nearer"
        return (
            f"no number of such poses decides the limit of {goal.limit:.3g} {goal.unit}: {goal.name} stays at "
            f"{goal.least:.2g}, {goal.wanted:.2g} is needed{of}; {end}"
        )

    @property
    def _last(self) -> Sequence[tuple[float, NextGoal]]:
        """What the last pose brings to each goal."""
        return list(zip(self.poses[-1].sizes, self.goals, strict=True)) if self.poses else []
