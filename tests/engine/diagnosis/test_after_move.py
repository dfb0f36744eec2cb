"""A sensor has moved within the recording: the result is where it is now, or a warning says that it is not."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.after_move import after_move
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import prepare
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import Options
from calibration.engine.geometry.transforms import retract
from tests.engine.estimation.scenes import Scene
from tests.engine.estimation.systems import eye_to_hand, stereo

N = 24
LIMITS = Limits(translation_mm=2, rotation_deg=1)
TWIST = np.array([0.006, 0.0, 0.003, 0.0, 0.004, 0.0])
"""By which a camera moves, in its own frame."""


def moved_from(scene: Scene, name: str, since: int, twist: Array = TWIST) -> tuple[Dataset, Array]:
    """The dataset of a scene in which a camera moves before a collection, and where it is then."""
    edge = scene.dataset().sensors[name].edge
    before = scene.transforms[edge]
    now = retract(before, twist)
    places = np.stack([before if i < since else now for i in range(N)])
    return replace(scene, transforms={**scene.transforms, edge: places}).dataset().with_transforms({edge: before}), now


def judged(dataset: Dataset) -> tuple[Calibration, Calibration, tuple[Finding, ...]]:
    """The calibrations of all views and of the robot as it is now, and what is said of the latter."""
    options = Options()
    prepared = prepare(dataset, options)
    mixed = prepared.optimum
    findings = diagnose(mixed, dataset, options, LIMITS)
    after, said = after_move(mixed, findings, prepared, LIMITS)
    return mixed, after, said


def off(calibration: Calibration, true: Array, name: str) -> float:
    """How far a camera is from where it is in truth, mm."""
    T = calibration.transforms[calibration.dataset.sensors[name].edge]
    return 1e3 * float(np.linalg.norm(T[:3, 3] - true[:3, 3]))


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("since", [8, 12, 16])
def test_the_result_is_where_the_camera_is_now(since: int) -> None:
    dataset, now = moved_from(eye_to_hand(N, pixel_noise=0.1), "cam", since)
    mixed, after, [said] = judged(dataset)
    assert (said.severity, said.sensors) == ("warning", ("cam",))
    assert f" since collection {dataset.keys[since]}: " in said.text
    assert off(after, now, "cam") < min(1.5, off(mixed, now, "cam") / 2)
    assert after.sigma_mm(dataset.sensors["cam"].edge) > 0.3 * off(after, now, "cam")
    assert {view.collection for view in after.dropped_views} == set(dataset.keys[:since])
    assert after.dataset.collections == mixed.dataset.collections  # all views are kept in what is written


@pytest.mark.thorough
def test_of_two_cameras_either_may_have_moved() -> None:
    """They are 6.7 mm nearer or farther; which one has moved the data cannot tell, and it does not matter."""
    dataset, now = moved_from(stereo(N, pixel_noise=0.1), "right", 14)
    mixed, after, [said] = judged(dataset)
    assert "left and right since collection 014: 28 views" in said.text
    left, right = (dataset.sensors[name].edge for name in ("left", "right"))
    true = np.linalg.inv(dataset.transforms[left][0]) @ now

    def wrong(calibration: Calibration) -> float:
        T = np.linalg.inv(calibration.transforms[left]) @ calibration.transforms[right]
        return 1e3 * float(np.linalg.norm(T[:3, 3] - true[:3, 3]))

    assert wrong(after) < min(1.0, wrong(mixed) / 2)


def test_a_camera_that_has_moved_late_is_not_known() -> None:
    dataset, _ = moved_from(stereo(N, pixel_noise=0.1), "right", 21, TWIST / 2)
    mixed, result, [said] = judged(dataset)
    assert result is mixed
    assert "lies between before and after: 3 collections since then are too few to know where left is" in said.text


def test_a_board_that_has_moved_is_where_it_is_now_too() -> None:
    scene = eye_to_hand(N, pixel_noise=0.1)
    edge = ("flange", "board_link")
    places = np.stack([scene.transforms[edge] if i < 12 else retract(scene.transforms[edge], TWIST) for i in range(N)])
    dataset = replace(scene, transforms={**scene.transforms, edge: places}).dataset()
    mixed, after, [said] = judged(dataset.with_transforms({edge: places[0]}))
    true = dataset.transforms["world", "cam"][0]
    assert "the robot as it stands now, of board " in said.text
    assert off(after, true, "cam") < min(2.0, off(mixed, true, "cam"))


def test_of_a_robot_on_which_nothing_has_moved_nothing_is_said() -> None:
    mixed, result, said = judged(eye_to_hand(N, pixel_noise=0.1).dataset())
    assert result is mixed
    assert said == ()
