import math
from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, inverse
from calibration.robot.simulation.kinematics import Placement, place
from calibration.robot.simulation.kinematics import views as views_of
from calibration.robot.simulation.motion import moving_model
from calibration.robot.simulation.scene import Box, Scene
from calibration.robot.simulation.sensors import SimulatedDepthCamera
from calibration.robot.simulation.sensors.camera import (
    COVERAGE_CELLS,
    LEAST_SQUARE,
    LEAST_TAG,
    CornerViews,
    least_widths,
    square_corners,
)
from calibration.robot.simulation.sensors.sensor import LEAST_SHARE
from calibration.robot.simulation.system import System
from tests.robot.simulation.conftest import corner_views, detects

PATTERN, CAMERA, LIDAR = "pattern_1", "rgb_left", "lidar_right"


@pytest.fixture(scope="module")
def rlbot(systems: dict[str, System]) -> System:
    """A camera and a LiDAR, with nothing around them."""
    return replace(systems["rlbot"], scene=Scene())


def standing(system: System, T_camera_pattern: Array) -> Placement:
    """The pattern at poses (N, 4, 4) in front of the camera."""
    at_rest = place(system, moving_model(np.eye(4)[None]))
    T_world_pattern = at_rest.sensors[CAMERA] @ T_camera_pattern
    return place(system, moving_model(T_world_pattern @ inverse(system.T_model_pattern)))


def in_front(system: System, right: float = 0.0, tilt: float = 0.0, distance: float = 2.0, count: int = 1) -> Placement:
    """The pattern's centre before the camera, and aside of its axis."""
    T = from_xyz_rpy([0.0, 0, 0], [0, tilt, 0])
    T[:3, 3] = np.array([right, 0, distance]) - T[:3, :3] @ system.patterns[PATTERN].centre
    return standing(system, np.repeat(T[None], count, axis=0))


def views(system: System, placement: Placement) -> CornerViews:
    return corner_views(system, CAMERA, PATTERN, placement)


def test_the_squares_stand_around_the_corners(rlbot: System) -> None:
    corners = square_corners(rlbot.configuration.patterns[PATTERN], rlbot.patterns[PATTERN])
    assert corners.shape == (10, 13, 3)
    np.testing.assert_allclose(corners[1:-1, 1:-1].reshape(-1, 3), rlbot.patterns[PATTERN].corners, atol=1e-15)
    border = rlbot.configuration.patterns[PATTERN].border_size
    np.testing.assert_allclose(corners[0, 0, :2] - border, rlbot.patterns[PATTERN].outline[0], atol=1e-12)
    np.testing.assert_allclose(corners[-1, -1, :2] + border, rlbot.patterns[PATTERN].outline[2], atol=1e-12)


def test_a_whole_view(rlbot: System) -> None:
    seen = views(rlbot, in_front(rlbot))
    assert seen.seen.all()
    assert seen.detectable.all()
    assert not seen.partial.any()
    T = in_front(rlbot).pattern_in(CAMERA, PATTERN)
    expected = rlbot.cameras[CAMERA].camera.project(apply(T, rlbot.patterns[PATTERN].corners))
    np.testing.assert_allclose(seen.pixels, expected, atol=1e-9)


def test_a_pattern_that_leaves_the_image(rlbot: System) -> None:
    """Columns of corners are lost with their squares: before the corners themselves are off the image."""
    found = [views(rlbot, in_front(rlbot, right)) for right in np.linspace(0, 2, 60)]
    counts = [int(view.seen.sum()) for view in found]
    assert counts == sorted(counts, reverse=True)
    assert set(counts) == {8 * columns for columns in range(12)}
    for view, count in zip(found, counts, strict=True):
        assert view.detectable[0] == (count >= LEAST_SHARE * 88)
        assert view.partial[0] or count >= 80  # the outermost squares are off the image before a corner is
        assert not view.partial[0] or count < 88
    assert found[-1].partial.all()


def test_a_chessboard_is_found_whole_or_not_at_all(rlbot: System) -> None:
    pattern = replace(rlbot.patterns[PATTERN], kind="chessboard")
    chessboard = replace(rlbot, patterns={PATTERN: pattern})
    found = [views(chessboard, in_front(rlbot, right)) for right in np.linspace(0, 2, 60)]
    assert {(bool(view.detectable[0]), bool(view.seen.all())) for view in found} == {(True, True), (False, False)}


@pytest.mark.parametrize(("distance", "detectable"), [(4.0, True), (5.0, False)])
def test_small_squares_are_not_detected(rlbot: System, distance: float, detectable: bool) -> None:
    assert (rlbot.cameras[CAMERA].camera.fx * 0.06 / distance > LEAST_SQUARE) == detectable
    seen = views(rlbot, in_front(rlbot, distance=distance))
    assert seen.detectable.all() == seen.seen.all() == seen.seen.any() == detectable


def test_narrow_squares_are_not_either(rlbot: System) -> None:
    """Of a pattern that turns away, the far side is lost first; three quarters of the width are left at 41 degrees."""
    width = rlbot.cameras[CAMERA].camera.fx * 0.06 / 3.3
    assert width * math.cos(math.radians(41)) == pytest.approx(LEAST_SQUARE, abs=0.3)
    found = [views(rlbot, in_front(rlbot, tilt=math.radians(tilt), distance=3.3)) for tilt in (0, 35, 39, 43, 47, 55)]
    counts = [int(view.seen.sum()) for view in found]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] == 88
    assert 0 < counts[3] < 88
    assert counts[-1] == 0
    far_to_near = found[3].seen.reshape(8, 11).astype(int)
    assert (np.diff(far_to_near, axis=1) >= 0).all()


@pytest.mark.parametrize("tilt", [70, 110, 180])
def test_from_aside_and_behind_nothing_is_detected(rlbot: System, tilt: float) -> None:
    assert not views(rlbot, in_front(rlbot, tilt=math.radians(tilt), distance=1.0)).detectable.any()


def test_behind_the_camera_nothing_is_seen(rlbot: System) -> None:
    seen = views(rlbot, in_front(rlbot, distance=-2.0))
    assert not seen.seen.any()
    assert not seen.cells(rlbot.cameras[CAMERA].camera).any()


def between(placement: Placement, sensor: str, share: float, size: tuple[float, float, float]) -> Box:
    """A box on the way from a sensor to the pattern's centre."""
    here = placement.sensors[sensor][0, :3, 3]
    there = placement.patterns[PATTERN][0, :3, 3]
    T = np.eye(4)
    T[:3, 3] = here + share * (there - here)
    return Box(T, np.array(size))


def test_what_something_hides_is_not_seen(rlbot: System) -> None:
    placement = in_front(rlbot)
    post = Scene(boxes=(between(placement, CAMERA, 0.5, (0.01, 0.15, 3.0)),))
    seen = views(replace(rlbot, scene=post), placement)
    assert seen.partial.all()
    assert 0 < seen.seen.sum() < 88
    wall = Scene(boxes=(between(placement, CAMERA, 0.5, (0.01, 3.0, 3.0)),))
    hidden = views(replace(rlbot, scene=wall), placement)
    assert not hidden.seen.any()
    assert not hidden.detectable.any()


def test_cells(rlbot: System) -> None:
    camera = rlbot.cameras[CAMERA].camera
    columns, rows = COVERAGE_CELLS
    corner = np.array([[-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5], [camera.width / 2 - 0.6, 0]])
    view = CornerViews(corner[None], np.ones((1, 3), bool), np.zeros(1, bool), np.ones(1, bool))
    assert np.flatnonzero(view.cells(camera)).tolist() == [0, columns // 2 - 1, columns * rows - 1]
    hidden = replace(view, seen=np.array([[True, False, False]]))
    assert np.flatnonzero(hidden.cells(camera)).tolist() == [0]


def test_the_centre_on_the_image(rlbot: System) -> None:
    edge = 2.0 * 600 / rlbot.cameras[CAMERA].camera.fx
    for right, tilt, shown in ((0.98 * edge, 0.0, True), (1.02 * edge, 0.0, False), (0.0, 2.0, False)):
        views = views_of(rlbot, in_front(rlbot, right, tilt), CAMERA, PATTERN)
        assert rlbot.cameras[CAMERA].shows_centre(views).all() == shown


def test_a_lidar_needs_rings_range_and_sight(rlbot: System) -> None:
    assert detects(rlbot, LIDAR, PATTERN, in_front(rlbot, count=3)).tolist() == [True] * 3
    assert not detects(rlbot, LIDAR, PATTERN, in_front(rlbot, distance=8.0)).any()  # two rings cross it
    wall = Scene(boxes=(between(in_front(rlbot), LIDAR, 0.5, (0.01, 3.0, 3.0)),))
    assert not detects(replace(rlbot, scene=wall), LIDAR, PATTERN, in_front(rlbot)).any()
    near = replace(rlbot.sensors[LIDAR], reach=(3.0, 130.0))
    blind = replace(rlbot, sensors={**rlbot.sensors, LIDAR: near})
    assert not detects(blind, LIDAR, PATTERN, in_front(rlbot)).any()


def test_a_depth_camera_needs_range_and_sight(rlbot: System) -> None:
    depth = SimulatedDepthCamera(rlbot.cameras[CAMERA].camera, reach=(0.5, 3.0))
    system = replace(rlbot, sensors={CAMERA: depth})
    for distance, measured in ((2.0, True), (3.5, False), (0.4, False), (-2.0, False)):
        placement = in_front(rlbot, distance=distance)
        assert detects(system, CAMERA, PATTERN, placement).all() == measured
    assert not detects(system, CAMERA, PATTERN, in_front(rlbot, tilt=math.pi)).any()
    wall = Scene(boxes=(between(in_front(rlbot), CAMERA, 0.5, (0.01, 3.0, 3.0)),))
    assert not detects(replace(system, scene=wall), CAMERA, PATTERN, in_front(rlbot)).any()


def test_the_squares_of_an_aprilgrid_are_its_tags_and_gaps() -> None:
    board = PatternConfiguration("b", "aprilgrid", "b", "world", True, (3, 2), 0.1, spacing=0.2)
    corners = square_corners(board, board.pattern())
    assert corners.shape == (6, 8, 3)
    np.testing.assert_allclose(corners[1:-1, 1:-1].reshape(-1, 3), board.pattern().corners, atol=1e-15)
    np.testing.assert_allclose(np.diff(corners[0, :, 0]), [0.02, 0.1, 0.02, 0.1, 0.02, 0.1, 0.02])
    np.testing.assert_allclose(np.diff(corners[:, 0, 1]), [-0.02, -0.1, -0.02, -0.1, -0.02])
    outline = board.pattern().outline
    np.testing.assert_allclose([corners[-1, 0, :2], corners[0, -1, :2]], [outline[0], outline[2]], atol=1e-12)
    widths = least_widths(board)
    np.testing.assert_allclose(widths[1], LEAST_TAG * np.array([0.2, 1, 0.2, 1, 0.2, 1, 0.2]))
    np.testing.assert_allclose(widths[0], LEAST_TAG * 0.2)


def test_squares_of_any_pattern() -> None:
    for kind in ("charuco", "chessboard"):
        board = PatternConfiguration("b", kind, "b", "world", True, (5, 3), 0.1)
        corners = square_corners(board, board.pattern())
        np.testing.assert_allclose(corners[1:-1, 1:-1].reshape(-1, 3), board.pattern().corners, atol=1e-15)
        np.testing.assert_allclose(np.diff(corners[..., 0], axis=1), 0.1)
        np.testing.assert_allclose(np.diff(corners[..., 1], axis=0), 0.1)
