"""Errors of tasks: what they are made of, and tasks that do not fit their robot."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import ALL_EXACT, Options
from calibration.engine.tasks.robot_task import Box, RobotTask
from calibration.engine.tasks.task_errors import TaskError, task_errors
from tests.engine.estimation import systems


@pytest.fixture(scope="module")
def hand() -> Calibration:
    return calibrate(systems.eye_in_hand(pixel_noise=0.2).dataset())


@pytest.fixture(scope="module")
def arm() -> Calibration:
    return calibrate(systems.jointed_arm(free={}, pixel_noise=0.2).dataset())


@pytest.fixture(scope="module")
def pair() -> Calibration:
    return calibrate(systems.stereo(pixel_noise=0.2).dataset())


@pytest.fixture(scope="module")
def ranging() -> Calibration:
    return calibrate(systems.camera_and_lidar(pixel_noise=0.2, range_noise=0.01).dataset())


def error(calibration: Calibration, **task: object) -> TaskError:
    [found] = task_errors(calibration, [RobotTask("work", **task)])  # type: ignore[arg-type]
    return found


def test_parts_sum_to_the_whole(hand: Calibration) -> None:
    """Each has its own; nothing but noise is left where all that is held is exact."""
    found = error(hand, seen_by=("cam",), frame="flange", distance=0.6)
    squares = np.sum(list(found.variances.values()), axis=0)
    np.testing.assert_allclose(squares, np.einsum("nii->n", found.covariance), rtol=1e-9)
    assert {"labels", "lens", "board", "arm"} <= set(found.parts())
    exact = calibrate(hand.dataset, Options(assume=ALL_EXACT))
    assert set(error(exact, seen_by=("cam",), frame="flange", distance=0.6).parts()) <= {"labels", "collections"}


def test_a_lens_and_what_it_does_to_a_mount_make_up_for_each_other(ranging: Calibration) -> None:
    """Where the board was, a wrong camera_info moves the LiDAR so that its points still fit the image."""
    found = error(ranging, seen_by=("lidar",), image="cam", points=((0.0, 0.0, 1.5),))
    [lens] = [each.columns for each in found.sources if each.kind == "lens"]
    own = lens.copy()
    own[: ranging.solution.model.shared] = 0.0
    both, alone = (np.linalg.norm(found.jacobian[0] @ each) for each in (lens, own))
    assert both < 0.5 * alone


def test_the_median_is_below_the_limit_of_95_percent(pair: Calibration) -> None:
    """At every point; the worst point has the largest."""
    found = error(pair, seen_by=("left", "right"), distance=3.0)
    assert (found.median < found.most).all()
    assert found.most[found.worst] == found.most.max()
    depth = error(pair, seen_by=("left", "right"), points=((0, 0, 1.0), (0, 0, 4.0)))
    assert depth.most[1] > 4 * depth.most[0]


def test_a_calibration_that_has_not_converged_has_none(pair: Calibration) -> None:
    """No error bars, no errors."""
    assert task_errors(replace(pair, error_bars=None), [RobotTask("work", seen_by=("left",), distance=1.0)]) == []


BAD: dict[str, tuple[str, dict[str, object], tuple[str, ...]]] = {
    "unknown sensor": ("hand", {"seen_by": ("eye",), "distance": 1.0}, ("seen-by", "'eye'", "cam")),
    "unknown frame": ("hand", {"seen_by": ("cam",), "frame": "claw", "distance": 1.0}, ("in", "'claw'", "flange")),
    "behind the camera": ("hand", {"seen_by": ("cam",), "points": ((0, 0, -1.0),)}, ("points", "-1", "behind")),
    "beside the image": ("hand", {"seen_by": ("cam",), "points": ((9.0, 0, 1.0),)}, ("points", "9", "beside")),
    "box out of sight": (
        "hand",
        {"seen_by": ("cam",), "box": Box((0, 0, -2.0), (1.0, 1.0, -1.0))},
        ("box", "behind"),
    ),
    "one point of two": ("hand", {"seen_by": ("cam",), "points": ((0, 0, 1.0), (0, 0, -1.0))}, ("points", "behind")),
    "without intrinsics": (
        "ranging",
        {"seen_by": ("cam",), "image": "lidar", "points": ((0, 0, 1.0),)},
        ("in-image-of", "'lidar'", "intrinsics"),
    ),
    "triangulated by a LiDAR": (
        "ranging",
        {"seen_by": ("cam", "lidar"), "points": ((0, 0, 1.0),)},
        ("seen-by", "'lidar'", "intrinsics"),
    ),
    "no image": ("ranging", {"seen_by": ("lidar",), "distance": 5.0}, ("distance", "no camera")),
    "off the plane": (
        "hand",
        {"seen_by": ("cam",), "plane": "board_link", "points": ((0, 0, 0.1),)},
        ("points", "z = 0"),
    ),
    "moves by itself": (
        "pair",
        {"seen_by": ("left",), "frame": "board_link", "distance": 1.0},
        ("in", "world-board_link", "each collection"),
    ),
    "unknown place": (
        "pair",
        {"seen_by": ("left",), "frame": "world", "distance": 1.0},
        ("seen-by", "world", "relative to the others"),
    ),
    "collection": ("hand", {"seen_by": ("cam",), "distance": 1.0, "collections": ("x",)}, ("collections", "'x'")),
    "out of reach": (
        "arm",
        {"of": "base", "frame": "j6", "points_in": "base", "points": ((5.0, 0, 0),)},
        ("points", "5 m from base", "j6"),
    ),
    "nothing between": ("arm", {"of": "base", "frame": "world", "points": ((0, 0, 0.0),)}, ("error is 0",)),
}


@pytest.mark.parametrize("case", BAD)
def test_tasks_that_do_not_fit_are_named(case: str, request: pytest.FixtureRequest) -> None:
    """One line: which task and key, what was found, what is expected."""
    of, task, said = BAD[case]
    calibration: Calibration = request.getfixturevalue(of)
    with pytest.raises(InputError) as refused:
        error(calibration, **task)
    text = str(refused.value)
    assert text.startswith("tasks.work")
    assert "\n" not in text
    assert all(each in text for each in said), text
