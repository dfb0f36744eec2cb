"""Views that are wrong as a whole: found by the other views, in any system."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.suspects import explain
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.linear_start import linear_start
from calibration.engine.estimation.start.wrong_views import wrong_views
from tests.engine.estimation.scenes import Scene, pose, true_values
from tests.engine.estimation.systems import camera_and_lidar, eye_in_hand, eye_to_hand, ring, stereo, two_bodies

FEW, MANY = (3, 8), (0, 2, 5, 8)


def exchanged(dataset: Dataset, sensor: str, which: Sequence[int]) -> Dataset:
    """The dataset with a sensor's labels of some collections handed on to the next of them."""
    collections = list(dataset.collections)
    for i, other in zip(which, np.roll(which, 1), strict=True):
        labels = {key: label for key, label in dataset.collections[other].labels.items() if key[1] == sensor}
        collections[i] = replace(collections[i], labels={**collections[i].labels, **labels})
    return replace(dataset, collections=tuple(collections))


def with_poses_exchanged(dataset: Dataset, which: Sequence[int]) -> Dataset:
    """The dataset with the robot's whole pose of some collections handed on to the next of them."""
    order = np.arange(len(dataset.collections))
    order[list(which)] = np.roll(which, 1)
    return replace(dataset, transforms={edge: T[order] for edge, T in dataset.transforms.items()})


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize(
    ("scene", "sensor", "named", "wrong"),
    [
        (stereo(10, pixel_noise=0.1), "left", {"left", "right"}, FEW),
        (stereo(10, pixel_noise=0.1), "right", {"left", "right"}, MANY),
        (camera_and_lidar(11, pixel_noise=0.1, range_noise=0.008), "lidar", {"cam", "lidar"}, MANY),
        (eye_to_hand(10, pixel_noise=0.1), "cam", {"cam"}, MANY),
        (two_bodies(10, pixel_noise=0.1), "a", {"a", "b"}, FEW),
    ],
    ids=["stereo, few", "stereo, many", "lidar", "arm", "two bodies"],
)
def test_labels_of_another_moment(scene: Scene, sensor: str, named: set[str], wrong: Sequence[int]) -> None:
    dataset = scene.dataset()
    result = calibrate(exchanged(dataset, sensor, wrong))
    assert {int(view.collection) for view in result.dropped_views} == set(wrong)
    assert {view.sensor for view in result.dropped_views} == named
    assert all(view.mm > 5 or view.degrees > 0.5 for view in result.dropped_views)
    assert result.converged
    without = calibrate(dataset.with_collections([i for i in range(len(dataset.collections)) if i not in wrong]))
    for edge, T in without.transforms.items():
        assert result.transforms[edge] == pytest.approx(T, abs=1e-5)


def test_how_far_a_view_is_off() -> None:
    """The arm is half a metre from its reported pose in one collection."""
    dataset = eye_to_hand(10, pixel_noise=0.05).dataset()
    moved = dataset.transforms["base", "flange"].copy()
    moved[4, 0, 3] += 0.5
    [view] = calibrate(dataset.with_transforms({("base", "flange"): moved})).dropped_views
    assert (view.sensor, view.pattern, view.collection) == ("cam", "board", "004")
    assert view.mm == pytest.approx(500, rel=0.02)
    assert view.degrees < 1


def test_the_robot_s_pose_of_another_moment() -> None:
    result = calibrate(with_poses_exchanged(eye_in_hand(10, pixel_noise=0.1).dataset(), MANY))
    assert {int(view.collection) for view in result.dropped_views} == set(MANY)


def test_a_sensor_that_contradicts_all_others_is_the_wrong_one() -> None:
    dataset = ring(8, cameras=3, pixel_noise=0.1, sees=lambda sensor, pattern, collection: True).dataset()
    result = calibrate(exchanged(dataset, "c1", (2, 6)))
    assert {(view.sensor, int(view.collection)) for view in result.dropped_views} == {("c1", 2), ("c1", 6)}


@pytest.mark.parametrize("scene", [stereo(), eye_to_hand(), camera_and_lidar(range_noise=0.01)])
def test_nothing_is_wrong(scene: Scene) -> None:
    assert not calibrate(scene.dataset()).dropped_views


def test_an_arm_that_is_bad_everywhere_contradicts_nothing() -> None:
    """Errors of 2 mm in every pose are the spread of the views, not single wrong ones."""
    dataset = eye_to_hand(16, pixel_noise=0.05).dataset()
    poses = dataset.transforms["base", "flange"].copy()
    poses[:, :3, 3] += np.random.default_rng(3).normal(size=(16, 3)) * 0.002
    assert not calibrate(dataset.with_transforms({("base", "flange"): poses})).dropped_views


def test_what_one_cause_explains_is_not_left_out() -> None:
    """The board was pushed by 3 cm in the arm's hand between two collections: all views after that are good."""
    dataset = eye_to_hand(20, pixel_noise=0.1).dataset()
    poses = dataset.transforms["base", "flange"].copy()
    poses[14:] = poses[14:] @ pose(0.03, 0.0, 0.0, 0.0, 0.0, 0.0)
    pushed = dataset.with_transforms({("base", "flange"): poses})
    setup = build(pushed)
    assert {int(view.collection) for view in wrong_views(setup, linear_start(setup, true_values(setup)).values)} == {
        *range(14, 20)
    }
    result = calibrate(pushed)
    assert not result.dropped_views
    explanation = explain(result.solution.model)
    assert explanation is not None
    assert [(each.cause.kind, each.since) for each in explanation.suspects] == [("place", 14)]


def test_no_majority() -> None:
    """Each of four collections contradicts all others."""
    setup = build(exchanged(stereo(4, pixel_noise=0.1).dataset(), "left", range(4)))
    assert not wrong_views(setup, linear_start(setup, true_values(setup)).values)
