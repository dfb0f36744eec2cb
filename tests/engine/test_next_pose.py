"""Next poses: the information of further views is that of the engine, choices are the best, promises are kept."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.limits import Limits, stated
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.fixed_inputs import CAMERA_INFO
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import ALL_EXACT, Assumptions
from calibration.engine.next_pose import PoseAdvisor, knowledge_of, next_poses, pose_advisor
from calibration.engine.tasks.robot_task import RobotTask
from calibration.engine.tasks.task_errors import task_errors

DATASETS = Path(__file__).resolve().parents[2] / "datasets"
SYSTEMS = ("t2rgb", "riwbot", "rlbot", "softbot", "spjbot")
FIRST = 6


@cache
def whole(system: str) -> Calibration:
    """A system calibrated by all of its collections."""
    return calibrate(read_dataset(DATASETS / system), Options(loss="linear"))


@cache
def begun(system: str, *, exact: bool = False) -> tuple[Calibration, PoseAdvisor]:
    """A system calibrated by its first collections, and an advisor that has the others to choose from."""
    dataset = whole(system).dataset
    options = Options(loss="linear", assume=ALL_EXACT if exact else Assumptions())
    few = calibrate(dataset.with_collections(range(FIRST)), options)
    others = dataset.with_collections(range(FIRST, len(dataset.collections)))
    return few, pose_advisor(few, others, Limits(translation_mm=0.5, joint_deg=0.01))


@pytest.mark.parametrize("system", SYSTEMS)
def test_information_of_the_recorded_views_is_that_of_the_calibration(system: str) -> None:
    """Of cameras, LiDARs, joints, a moving base: what is known is what the views add up to, and the priors."""
    calibration = whole(system)
    knowledge = knowledge_of(calibration)
    model, at = calibration.solution.model, knowledge.columns
    found: Array = knowledge.views(calibration.solution.dataset).sum(0) + model.prior[at[:, None], at]
    scale = np.sqrt(model.alone[at])
    np.testing.assert_allclose(
        found / scale / scale[:, None], knowledge.information / scale / scale[:, None], atol=1e-7
    )


@pytest.mark.parametrize("system", SYSTEMS)
def test_sizes_now_are_what_the_calibration_states(system: str) -> None:
    few, advisor = begun(system)
    now = advisor.advise(1)
    assert now.goals
    for goal, size in zip(now.goals, now.sizes, strict=True):
        assert size == pytest.approx(stated(few)[goal.name][("mm", "deg").index(goal.unit)], rel=1e-6)


@pytest.mark.parametrize("system", SYSTEMS)
def test_what_is_promised_is_reached(system: str) -> None:
    """Within a quarter; not exactly, as new labels have noise of their own, which is estimated anew."""
    few, advisor = begun(system)
    advice = advisor.advise(4)
    chosen = [FIRST + pose.candidate for pose in advice.poses]
    reached = stated(
        calibrate(whole(system).dataset.with_collections([*range(FIRST), *chosen]), Options(loss="linear"))
    )
    for goal, promised in zip(advice.goals, advice.poses[-1].sizes, strict=True):
        assert 0.75 < promised / reached[goal.name][("mm", "deg").index(goal.unit)] < 1.33
    assert stated(few)


@pytest.mark.parametrize(
    ("system", "task"),
    [
        ("spjbot", RobotTask("grasp", seen_by=("rgb_hand",), frame="end_effector_link", distance=0.6, limit_mm=0.1)),
        ("riwbot", RobotTask("grasp", seen_by=("rgb_world",), frame="base_link", distance=1.0, limit_mm=0.1)),
    ],
)
def test_what_is_promised_at_a_task_is_reached_at_its_worst_point(system: str, task: RobotTask) -> None:
    """Which is another one by then."""
    few, dataset = begun(system)[0], whole(system).dataset
    others = dataset.with_collections(range(FIRST, len(dataset.collections)))
    advice = next_poses(few, others, Limits(by_tasks=True), task_errors(few, [task]), 4)
    chosen = [FIRST + pose.candidate for pose in advice.poses]
    both = calibrate(dataset.with_collections([*range(FIRST), *chosen]), Options(loss="linear"))
    [reached] = task_errors(both, [task])
    assert [goal.name for goal in advice.goals] == ["grasp"]
    assert 0.75 < advice.poses[-1].sizes[0] / reached.most.max() < 1.33


def test_the_first_pose_is_the_best_of_all() -> None:
    """Of the only goal: no other candidate leaves a smaller error."""
    _, advisor = begun("t2rgb", exact=True)
    first = advisor.advise(1).poses[0]
    (goal,) = advisor.goals
    alone = [
        float(np.sqrt(advisor.knowledge.with_views(each).variances(goal.rows[0]).sum())) for each in advisor.candidates
    ]
    assert first.candidate == int(np.argmin(alone))
    assert first.sizes[0] == pytest.approx(min(alone))


def test_number_of_poses_that_a_limit_takes() -> None:
    """It is where the promised error falls below what decides the limit: 0 if it is there already."""
    few, _ = begun("t2rgb", exact=True)
    others = whole("t2rgb").dataset.with_collections(range(FIRST, 26))
    sizes = [pose.sizes[0] for pose in begun("t2rgb", exact=True)[1].advise(8).poses]
    assert sizes == sorted(sizes, reverse=True)
    for count in (2, 5):
        advice = next_poses(few, others, Limits(translation_mm=2 * sizes[count - 1] * 1.0001))
        assert advice.needed == count
        assert not advice.is_enough
    done = next_poses(few, others, Limits(translation_mm=100.0))
    assert (done.needed, done.open_goals, done.is_enough) == (0, [], True)
    more = next_poses(few, others, Limits(translation_mm=2 * sizes[7] * 0.8)).needed
    assert more is not None
    assert more > 8


def test_what_no_pose_can_mend_is_named() -> None:
    """Intrinsics that are held: however many poses, the limit is not reached."""
    few, _ = begun("t2rgb")
    others = whole("t2rgb").dataset.with_collections(range(FIRST, 26))
    advice = next_poses(few, others, Limits(translation_mm=0.02))
    assert advice.needed is None
    assert advice.hopeless_goals == [0]
    assert all(name.startswith(CAMERA_INFO) for name in list(advice.beyond_poses)[:2])
    assert sum(advice.beyond_poses.values()) == pytest.approx(1, abs=0.1)
    assert advice.least[0] <= advice.sizes[0]


def test_no_candidate_is_no_advice() -> None:
    few, _ = begun("t2rgb")
    advice = next_poses(few, whole("t2rgb").dataset.with_collections([]), Limits(translation_mm=0.02))
    assert (advice.poses, advice.needed) == ((), None)


def test_views_that_arrive_are_added_without_another_calibration() -> None:
    """As if they had been calibrated with the others."""
    _, advisor = begun("rlbot")
    dataset = whole("rlbot").dataset
    advice = advisor.advise(1)
    later = advisor.after(dataset.with_collections([FIRST + advice.poses[0].candidate])).advise(1)
    np.testing.assert_allclose(later.sizes, advice.poses[0].sizes, rtol=1e-6)
