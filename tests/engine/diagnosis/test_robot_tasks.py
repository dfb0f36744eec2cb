"""Limits of tasks: what does not fit is judged by what it does to them."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.robot_tasks import unsure_tasks, worst_at_tasks
from calibration.engine.diagnosis.what_does_not_fit import what_does_not_fit
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.tasks.placed_task import PlacedTask
from calibration.engine.tasks.robot_task import RobotTask
from calibration.engine.tasks.task_errors import TaskError, task_errors
from tests.engine.estimation import systems

GRASP = RobotTask("grasp", seen_by=("cam",), frame="flange", distance=0.7)


@pytest.fixture(scope="module")
def good() -> Calibration:
    return calibrate(systems.eye_in_hand(16, pixel_noise=0.1).dataset())


@pytest.fixture(scope="module")
def wrong() -> Calibration:
    """The camera_info has a focal length that is 1 % too long."""
    dataset = systems.eye_in_hand(16, pixel_noise=0.1).dataset()
    camera = dataset.sensors["cam"].camera
    assert camera
    return calibrate(dataset.with_cameras({"cam": replace(camera, fx=1.01 * camera.fx, fy=1.01 * camera.fy)}))


def found(calibration: Calibration, task: RobotTask, limits: Limits | None = None) -> tuple[Finding, ...]:
    limits, tasks = limits or Limits(by_tasks=task.limit is not None), task_errors(calibration, [task])
    suspects = what_does_not_fit(calibration, limits, tasks)
    return (*suspects, *unsure_tasks(tasks, suspects))


def test_a_cause_is_red_by_what_it_does_to_a_task(wrong: Calibration) -> None:
    """It names the task, the size there and the limit."""
    [red] = [each for each in found(wrong, replace(GRASP, limit_mm=2.0)) if each.severity == "red"]
    assert (red.kind, red.tasks) == ("suspect", ("grasp",))
    assert "task 'grasp' (limit 2 mm)" in red.text


def test_the_same_cause_is_harmless_where_the_task_bears_it(wrong: Calibration) -> None:
    """Though it would be red by the default limits of a mount; and by those that the user has set beside."""
    loose = replace(GRASP, limit_mm=100.0)
    assert [each.severity for each in found(wrong, loose) if each.kind == "suspect"] == ["note"]
    assert [each for each in found(wrong, loose, Limits()) if each.severity == "red"]
    by_both = found(wrong, loose, Limits(translation_mm=1.0, by_tasks=True))
    assert [each for each in by_both if each.severity == "red" and not each.tasks]


def test_a_limit_that_the_error_bar_reaches_over_is_undecided(good: Calibration) -> None:
    """With its parts, and whether more collections would help; nothing where it holds."""
    [error] = task_errors(good, [GRASP])
    most = float(error.most[error.worst])
    holds, tight, impossible = (
        [each for each in found(good, replace(GRASP, limit_mm=share * most)) if each.kind == "task"]
        for share in (1.01, 0.99, 0.5)
    )
    assert holds == []
    assert [(each.severity, each.tasks, each.unit) for each in tight] == [("undecided", ("grasp",), "mm")]
    assert tight[0].value == pytest.approx(most)
    assert "no more collections like these can make it hold" in impossible[0].text


def test_a_task_without_a_limit_asks_nothing(good: Calibration, wrong: Calibration) -> None:
    """Findings are those without it."""
    for calibration in (good, wrong):
        bare = what_does_not_fit(calibration, Limits())
        assert {(each.kind, each.severity) for each in found(calibration, GRASP)} == {
            (each.kind, each.severity) for each in bare
        }


def test_cameras_alone_are_judged_by_their_tasks_too() -> None:
    """A board whose squares are half a percent longer one way: its focal lengths are wrong, and so is the aim."""
    dataset = systems.covering(30, 0, 1, pixel_noise=0.1).dataset(0)
    [(name, pattern)] = dataset.patterns.items()
    stretched = replace(pattern, corners=pattern.corners * (1.005, 1.0, 1.0))
    found_alone = calibrate(replace(dataset, patterns={name: stretched}), Options(intrinsics=("all",)))
    assert found_alone.of_cameras_alone
    loose = Limits(projection_px=100.0)
    colours = {
        limit: [
            (each.severity, each.tasks)
            for each in found(found_alone, RobotTask("aim", seen_by=("c0",), distance=1.0, limit_mm=limit), loose)
            if each.kind == "suspect"
        ]
        for limit in (0.5, 100.0)
    }
    assert colours == {0.5: [("red", ("aim",))], 100.0: [("note", ())]}


def test_a_change_that_is_no_larger_than_its_error_breaks_no_task(good: Calibration) -> None:
    """By its estimate alone it may: undecided."""
    [error] = task_errors(good, [replace(GRASP, limit_mm=1.0)])
    change = np.zeros(error.jacobian.shape[2])
    change[0] = 0.01  # of the camera's mount, m
    assert worst_at_tasks([error], [change], [0.1 * change[:, None]]).broken == ("grasp",)
    unsure = worst_at_tasks([error], [change], [change[:, None]])
    assert (unsure.broken, unsure.undecided) == ((), ("grasp",))
    assert worst_at_tasks([error], [0.01 * change], [change[:, None]]).undecided == ()


def test_a_change_within_a_limit_that_the_error_bar_needs_too_is_undecided(good: Calibration) -> None:
    """Each alone is within it; a small one leaves it holding."""
    [error] = task_errors(good, [GRASP])
    change = np.zeros(error.jacobian.shape[2])
    change[0] = 0.001
    size, most = error.largest_change(change), float(error.most.max())
    near = replace(error, placed=_with_limit(error, 1.1 * max(size, most)))
    both = [worst_at_tasks([near], [share * change], [1e-3 * change[:, None]]) for share in (1.0, 0.01)]
    assert [(each.broken, each.undecided) for each in both] == [((), ("grasp",)), ((), ())]


def test_collections_that_disagree_break_a_task_where_labels_are_too_noisy(good: Calibration) -> None:
    """If it would hold but for that; else, and where nothing is wrong with the labels, it is undecided."""
    [error] = task_errors(good, [GRASP])
    wide = [
        replace(each, columns=30 * error.sources[0].columns) if each.kind == "collections" else each
        for each in error.sources
    ]
    noisy = [Finding("noisy-sensor", "note", "")]
    most = float(error.most.max())
    severities = {}
    for share in (1.5, 0.2):
        apart = replace(error, sources=tuple(wide), placed=_with_limit(error, share * most))
        severities[share] = [each.severity for of in (noisy, []) for each in unsure_tasks([apart], of)]
    assert severities == {1.5: ["red", "undecided"], 0.2: ["undecided", "undecided"]}


def _with_limit(error: TaskError, limit: float) -> PlacedTask:
    return replace(error.placed, task=replace(error.task, limit_mm=limit))
