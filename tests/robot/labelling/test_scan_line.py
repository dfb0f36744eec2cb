"""Labelled rays of a 2D LiDAR on a board, against the true hits, with other objects around."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.geometry.transforms import apply
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.points import PatternPoints
from calibration.robot.labelling.scan_line import label_scan_line, scan_line_ends
from tests.robot.labelling.worlds import BOARD, Measured, board, displaced, measure, standing, true_border, upright

ANGLES = np.radians(np.arange(-135, 135.1, 0.25))
RAYS = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], -1)[None]
WALL = upright(0.0, 6.0, 30.0, 12.0)


def points_of(measured: Measured) -> np.ndarray:
    return (RAYS * measured.distances[..., None])[0]


def found(points: np.ndarray, T: np.ndarray) -> PatternPoints:
    labels = label_scan_line(points, BOARD, T)
    assert isinstance(labels, PatternPoints), labels
    assert (np.diff(labels.on_pattern) > 0).all()
    assert set(labels.on_border) <= set(labels.on_pattern)
    return labels


unit = st.tuples(*[st.floats(-1, 1)] * 3)


@given(
    azimuth=st.floats(-1.8, 1.8),
    distance=st.floats(1.0, 3.5),
    turn=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-3, 3)),
    height=st.floats(-0.05, 0.05),
    walled=st.booleans(),
    shift=unit,
    twist=unit,
)
def test_its_rays_and_ends_are_found_where_a_guess_is_wrong(azimuth, distance, turn, height, walled, shift, twist):
    T = standing(azimuth, distance, turn, height)
    measured = measure(RAYS, board(T), [WALL] if walled else [], 0.005)
    labels = found(points_of(measured), displaced(T, 0.03 * np.array(shift), 0.04 * np.array(twist)))
    true = set(np.flatnonzero(measured.on_board[0]).tolist())
    # of some 80 rays, more than four lie beyond three standard deviations once in a million
    assert len(true ^ set(labels.on_pattern.tolist())) <= 4
    # the outermost ray on the board may err so much that it is taken for something else, which hides the end
    strays = true & {int(labels.on_pattern[0]) - 1, int(labels.on_pattern[-1]) + 1}
    assert 2 - len(strays) <= len(labels.on_border) <= 2
    ends = np.array([column for _, column in true_border(measured)])
    assert all(np.abs(ends - border).min() <= 1 for border in labels.on_border)


def test_an_end_behind_something_nearer_is_none():
    T = standing(0.1, 2.5)
    post = upright(0.1 + 0.14, 1.5, 0.15, 2.0)
    measured = measure(RAYS, board(T), [WALL, post], 0.005)
    labels = found(points_of(measured), T)
    assert labels.on_border.tolist() == [int(np.flatnonzero(measured.on_board[0])[0])]


def test_an_end_of_the_scan_is_no_end_of_the_pattern():
    T = standing(np.radians(135), 2.0)  # half of it beyond the last ray
    measured = measure(RAYS, board(T), [], 0.005)
    labels = found(points_of(measured), T)
    assert labels.on_pattern[-1] == len(ANGLES) - 1
    assert labels.on_border.tolist() == [labels.on_pattern[0]]


def test_a_ray_that_is_missing_does_not_end_the_pattern():
    T = standing(0.0, 2.0)
    points = points_of(measure(RAYS, board(T), [WALL], 0.005))
    whole = found(points, T)
    gone = whole.on_pattern[[10, 11, 30]]
    points[gone] = np.nan
    labels = found(points, T)
    assert set(labels.on_pattern) == set(whole.on_pattern) - set(gone)
    assert labels.on_border.tolist() == whole.on_border.tolist()


def test_it_is_found_far_out_in_the_tolerance_beside_a_nearby_wall():
    T = standing(0.0, 2.5, (0.0, 0.4, 0.0))
    behind = upright(0.0, 3.2, 4.0, 4.0)
    points = points_of(measure(RAYS, board(T), [behind], 0.005))
    for shift in (-0.07, 0.07):
        labels = found(points, displaced(T, [0.0, 0.0, shift], np.zeros(3)))
        assert labels.on_pattern.tolist() == found(points, T).on_pattern.tolist()


@pytest.mark.parametrize(
    ("T", "others", "reason"),
    [
        (standing(0.0, 2.0, height=0.5), [WALL], "the scan does not cross the pattern at its expected pose"),
        (standing(0.0, 2.0), [upright(0.0, 1.0, 3.0, 3.0)], "0 points where the pattern is expected, at least 5"),
        (standing(3.1, 2.0), [WALL], "0 points where the pattern is expected"),
    ],
)
def test_what_is_not_seen_is_not_detected(T, others, reason):
    labels = label_scan_line(points_of(measure(RAYS, board(T), others, 0.005)), BOARD, T)
    assert isinstance(labels, NotDetected)
    assert labels.reason.startswith(reason)


def test_something_smaller_than_the_board_is_none():
    T = standing(0.0, 2.0)
    points = points_of(measure(RAYS, upright(0.0, 2.0, 0.2, 0.2), [WALL], 0.005))
    labels = label_scan_line(points, BOARD, T)
    assert isinstance(labels, NotDetected)
    assert "no board of its size" in labels.reason


def test_scattered_points_are_no_line():
    rng = np.random.default_rng(0)
    T = standing(0.0, 2.0)
    points = RAYS[0] * np.where(np.arange(len(ANGLES)) % 9 == 0, rng.uniform(1.91, 2.09, len(ANGLES)), np.nan)[:, None]
    labels = label_scan_line(points, BOARD, T)
    assert isinstance(labels, NotDetected)


@given(turn=st.tuples(*[st.floats(-3, 3)] * 3), height=st.floats(-0.6, 0.6))
def test_the_ends_of_a_scan_line_are_on_the_outline_and_in_the_scans_plane(turn, height):
    T = standing(0.3, 2.0, turn, height)
    ends = scan_line_ends(BOARD, np.stack([T, T]))
    assert ends.shape == (2, 2, 2)
    corners = apply(T, np.append(BOARD.outline, np.zeros((4, 1)), -1))
    if np.ptp(np.sign(corners[:, 2])) == 0:
        assert np.isnan(ends).all()
        return
    local = apply(np.linalg.inv(T), np.append(ends[0], np.zeros((2, 1)), -1))
    np.testing.assert_allclose(local[:, 2], 0, atol=1e-9)
    low, high = BOARD.outline.min(0), BOARD.outline.max(0)
    on_border = np.minimum(np.abs(local[:, :2] - low), np.abs(local[:, :2] - high)).min(-1)
    np.testing.assert_allclose(on_border, 0, atol=1e-9)
    assert ((local[:, :2] > low - 1e-9) & (local[:, :2] < high + 1e-9)).all()
