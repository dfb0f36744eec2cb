"""Labelled points of a LiDAR on a board, against the true hits, with other objects around."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.geometry.transforms import transform
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.points import PatternPoints, label_points
from tests.properties import at_most
from tests.robot.labelling.worlds import (
    BOARD,
    Measured,
    Rectangle,
    board,
    displaced,
    lidar_rays,
    measure,
    standing,
    true_border,
    upright,
)

RAYS = lidar_rays()
WALL = upright(0.0, 6.0, 30.0, 12.0)
GROUND = Rectangle(transform(np.eye(3), [0.0, 0.0, -0.6]), 30.0, 30.0)


def cloud(measured: Measured, absent: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """The points, ring by ring, and the (ring, azimuth) of each; rays without a return are absent or NaN."""
    points = (RAYS * measured.distances[..., None]).reshape(-1, 3)
    place = np.stack(np.indices(measured.distances.shape), -1).reshape(-1, 2)
    there = np.isfinite(points).all(-1) if absent else np.ones(len(points), bool)
    return points[there], place[there]


def found(points, T, **how) -> PatternPoints:
    labels = label_points(points, BOARD, T, **how)
    assert isinstance(labels, PatternPoints), labels
    assert (np.diff(labels.on_pattern) > 0).all()
    assert set(labels.on_border) <= set(labels.on_pattern)
    return labels


def compare(labels: PatternPoints, measured: Measured, place) -> tuple[int, int, int, int]:
    """Points missed and wrong, border points missed and wrong."""
    got = {tuple(p) for p in place[labels.on_pattern].tolist()}
    true = set(zip(*(i.tolist() for i in np.nonzero(measured.on_board)), strict=True))
    ends = {tuple(p) for p in place[labels.on_border].tolist()}
    border = true_border(measured)
    return len(true - got), len(got - true), len(border - ends), len(ends - border)


guesses = st.tuples(
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
)
turns = st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-np.pi, np.pi))


@at_most(40)
@given(st.floats(-np.pi, np.pi), st.floats(1.2, 3.0), turns, guesses, st.sampled_from([0.0, 0.008, 0.02]))
def test_any_pose_any_noise_any_guess_within_the_tolerance(azimuth, distance, turn, guess, noise) -> None:
    """5 cm and 3 degrees off, with a wall behind and the ground below: hardly a point is wrong or missed."""
    T = standing(azimuth, distance, turn)
    measured = measure(RAYS, board(T), [WALL, GROUND], noise, 1)
    points, place = cloud(measured)
    shift, angle = (np.array(v) / np.linalg.norm(v) for v in guess)
    labels = found(points, displaced(T, 0.05 * shift, np.radians(3) * angle))
    missed, wrong, border_missed, border_wrong = compare(labels, measured, place)
    assert wrong == 0
    assert missed <= 2 + 0.08 * measured.on_board.sum()  # at worst a part of a ring that grazes the border
    assert border_wrong <= 1
    assert border_missed <= 2 + 0.2 * len(true_border(measured))


def test_with_a_perfect_sensor_everything_is_exact() -> None:
    T = standing(0.3, 2.0, (0.4, -0.3, 0.5))
    measured = measure(RAYS, board(T), [WALL], 0.0)
    points, place = cloud(measured)
    assert compare(found(points, T), measured, place) == (0, 0, 0, 0)


def test_the_order_of_the_points_and_rays_without_return_do_not_matter() -> None:
    T = standing(-3.1, 2.0, (0.4, -0.3, 0.5))  # across the seam of the azimuth
    measured = measure(RAYS, board(T), [], 0.005)
    points, place = cloud(measured)
    labels = found(points, T)
    with_nan, all_places = cloud(measured, absent=False)
    order = np.random.default_rng(0).permutation(len(with_nan))
    again = found(with_nan[order], T)
    for a, b in ((labels.on_pattern, again.on_pattern), (labels.on_border, again.on_border)):
        assert sorted(map(tuple, place[a].tolist())) == sorted(map(tuple, all_places[order][b].tolist()))


def test_the_same_points_give_the_same_labels() -> None:
    T = standing(0.3, 2.0, (0.4, -0.3, 0.5))
    points, _ = cloud(measure(RAYS, board(T), [WALL], 0.01))
    a, b = (found(points.copy(), displaced(T, np.full(3, 0.02), np.full(3, 0.01))) for _ in range(2))
    np.testing.assert_array_equal(a.on_pattern, b.on_pattern)
    np.testing.assert_array_equal(a.on_border, b.on_border)


def test_no_point_belongs_to_a_wall_close_behind_or_a_box_that_crosses_the_plane() -> None:
    T = standing(0.0, 2.0, (0.2, 0.1, 0.1))
    behind = Rectangle(T @ np.array([[1, 0, 0, 0.3], [0, 1, 0, 0.2], [0, 0, 1, 0.06], [0, 0, 0, 1.0]]), 3.0, 3.0)
    beside = upright(0.25, 2.0, 1.0, 0.8, (0.2, 0.1 + np.pi / 2, 0.1))  # edge on, through the plane
    measured = measure(RAYS, board(T), [WALL, behind, beside], 0.005)
    points, place = cloud(measured)
    labels = found(points, displaced(T, np.array([0.02, -0.01, 0.03]), np.array([0.02, -0.01, 0.02])))
    missed, wrong, _, border_wrong = compare(labels, measured, place)
    assert (wrong, border_wrong) == (0, 0)
    assert missed <= 3


def test_a_pole_in_the_plane_of_the_board_is_not_the_board() -> None:
    T = standing(0.0, 2.0)
    middle = board(T).T_sensor_rectangle
    pole = Rectangle(middle @ np.array([[1, 0, 0, 0.0], [0, 1, 0, 0.8], [0, 0, 1, 0], [0, 0, 0, 1.0]]), 0.08, 1.0)
    measured = measure(RAYS, board(T), [WALL, pole], 0.005)
    points, place = cloud(measured)
    _, wrong, _, border_wrong = compare(found(points, T), measured, place)
    assert wrong <= 30  # of the ring beside the border, where one cannot tell
    assert border_wrong <= 2


@pytest.mark.parametrize("side", [-1, 1])
def test_where_something_nearer_hides_the_edge_there_is_no_border(side) -> None:
    T = standing(0.0, 2.0)
    front = upright(side * 0.2, 1.2, 0.35, 2.0)
    measured = measure(RAYS, board(T), [WALL, front], 0.005)
    points, place = cloud(measured)
    labels = found(points, displaced(T, np.full(3, 0.02), np.full(3, 0.01)))
    missed, wrong, _, border_wrong = compare(labels, measured, place)
    assert (wrong, border_wrong) == (0, 0)
    assert missed <= 3
    azimuth = np.arctan2(*points[labels.on_border][:, [1, 0]].T)
    assert len(azimuth) >= 5
    assert (np.sign(azimuth) == -side).all()


@pytest.mark.parametrize("hidden", [0.01, 0.02, 0.04, 0.08])
def test_an_edge_that_is_hidden_by_a_finger_s_breadth_is_no_border(hidden) -> None:
    T = standing(0.0, 2.0)
    front = Rectangle(transform(upright(0.0, 1.0, 1, 1).T_sensor_rectangle[:3, :3], [1.0, 0.3 - hidden / 2, 0]), 0.2, 2)
    measured = measure(RAYS, board(T), [WALL, front], 0.0)
    points, place = cloud(measured)
    _, wrong, border_missed, border_wrong = compare(found(points, T), measured, place)
    assert (wrong, border_missed, border_wrong) == (0, 0, 0)
    assert len(true_border(measured)) < len(true_border(measure(RAYS, board(T), [WALL], 0.0)))


def test_what_hides_the_middle_leaves_both_ends() -> None:
    T = standing(0.0, 2.0)
    measured = measure(RAYS, board(T), [WALL, upright(0.0, 1.2, 0.1, 2.0)], 0.005)
    points, place = cloud(measured)
    labels = found(points, T)
    missed, wrong, border_missed, border_wrong = compare(labels, measured, place)
    assert (wrong, border_missed, border_wrong) == (0, 0, 0)
    assert missed <= 2


def test_a_thing_too_near_to_return_makes_no_border() -> None:
    """Rays that give nothing in the middle of the board: it does not end there."""
    T = standing(0.0, 2.0)
    measured = measure(RAYS, board(T), [WALL], 0.0)
    azimuth = np.arctan2(RAYS[..., 1], RAYS[..., 0])
    measured.distances[azimuth < -0.02] = np.nan
    points, _ = cloud(measured)
    labels = found(points, T)
    assert (np.arctan2(*points[labels.on_border][:, [1, 0]].T) > 0.1).all()


# No detection


def reason(points, T, **how) -> str:
    labels = label_points(points, BOARD, T, **how)
    assert isinstance(labels, NotDetected), labels
    return labels.reason


def test_no_board_there() -> None:
    T = standing(0.0, 2.0)
    nothing = measure(RAYS, board(standing(2.0, 2.0)), [WALL], 0.005)
    assert reason(cloud(nothing)[0], T) == "0 points where the pattern is expected, at least 10 are needed"
    assert "at least 10" in reason(np.zeros((0, 3)), T)
    assert "at least 10" in reason(np.full((50, 3), np.nan), T)


def test_a_smaller_board_is_not_this_one() -> None:
    T = standing(0.0, 2.0)
    small = Rectangle(board(T).T_sensor_rectangle, 0.3, 0.25)
    measured = measure(RAYS, small, [WALL], 0.005)
    assert "rays go past it" in reason(cloud(measured)[0], T)


def test_a_hidden_board() -> None:
    T = standing(0.0, 2.0)
    front = upright(0.03, 1.2, 0.42, 2.0)
    measured = measure(RAYS, board(T), [WALL, front], 0.005)
    assert measured.on_board.sum() > 10
    assert reason(cloud(measured)[0], T) == "the pattern is hidden"


def test_one_ring_is_no_plane() -> None:
    T = standing(0.0, 2.0)
    measured = measure(RAYS, board(T), [WALL], 0.0)
    points, place = cloud(measured)
    one = points[place[:, 0] == 8]
    assert "on 1 rings, at least 10 on 2" in reason(one, T)


def test_clutter_is_no_board() -> None:
    random = np.random.default_rng(0)
    T = standing(0.0, 2.0)
    points = board(T).T_sensor_rectangle[:3, 3] + random.uniform(-0.5, 0.5, (3000, 3))
    assert reason(points, T)


def test_float32_clouds_are_taken() -> None:
    T = standing(0.3, 2.0, (0.4, -0.3, 0.5))
    points, _ = cloud(measure(RAYS, board(T), [WALL], 0.0))
    exact, rounded = found(points, T), found(points.astype(np.float32), T)
    np.testing.assert_array_equal(exact.on_pattern, rounded.on_pattern)
