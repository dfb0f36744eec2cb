from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.addons.recorder.preview import MAX_PICTURE_WIDTH, draw_corners, draw_depth, preview
from calibration.addons.recorder.session import Session
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.geometry.transforms import apply, from_xyz_rpy, translation
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import read_motion
from calibration.robot.simulation.scene import Box, Scene
from calibration.robot.simulation.system import System, read_system
from tests.pipeline.systems import with_scanner
from tests.pipeline.test_lidar2d import LIDAR
from tests.pipeline.test_new_modality import SONAR, source
from tests.robot.simulation.conftest import DATASETS, detects

__all__ = ["source"]


def green(picture: np.ndarray) -> np.ndarray:
    """Where something found is drawn: rows, columns."""
    red, middle, blue = (picture[..., i].astype(int) for i in range(3))
    return np.argwhere((middle > 150) & (red < 90) & (blue < 120))


def test_a_pose_that_every_sensor_sees_is_kept(systems: dict[str, System]) -> None:
    for name in ("t2rgb", "rlbot", "riwbot"):
        seen = preview(systems[name], Session(systems[name]).pose)
        assert seen.kept, (name, seen.reasons)
        assert list(seen.views) == list(systems[name].sensors)
        assert all(view.detected and view.finding for view in seen.views.values())


def test_a_picture_shows_the_corners_where_they_are(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    session = Session(system)
    view = preview(system, session.pose).views["left_camera"]
    assert view.picture is not None
    camera = system.cameras["left_camera"].camera
    assert view.picture.shape == (camera.height, camera.width, 3)
    T = session.placement.pattern_in("left_camera", "pattern_1")[0]
    corners = camera.project(apply(T, system.patterns["pattern_1"].corners))
    rings = green(view.picture)[:, ::-1]
    assert len(rings) > 400
    nearest = np.linalg.norm(rings[:, None] - corners[None], axis=-1).min(axis=1)
    assert nearest.max() < 8


def test_a_pattern_that_is_turned_away_is_lost_with_a_reason_for_each_sensor(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    session = Session(system)
    T = session.handle_pose()
    assert T is not None
    session.drag(T @ from_xyz_rpy([0.0, 0.0, 0.0], [np.pi, 0.0, 0.0]))
    seen = preview(system, session.pose)
    assert not seen.kept
    assert len(seen.reasons) == 2
    assert all(any(name in reason for reason in seen.reasons) for name in system.sensors)
    assert not any(view.detected for view in seen.views.values())
    assert not any(len(green(view.picture)) for view in seen.views.values() if view.picture is not None)


def test_a_pose_that_cannot_be_played_is_lost_and_shows_nothing(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    session = Session(system)
    around = Box(session.placement.sensors["left_camera"][0], np.array([1.0, 1.0, 1.0]))
    seen = preview(replace(system, scene=Scene(None, (around,))), session.pose)
    assert seen.views == {}
    assert len(seen.reasons) == 1
    assert "in a box" in seen.reasons[0]


def test_a_lidar_shows_its_points_and_which_are_on_the_pattern(systems: dict[str, System]) -> None:
    system = systems["rlbot"]
    session = Session(system)
    view = preview(system, session.pose).views["lidar_right"]
    assert view.picture is None
    assert view.points is not None
    assert view.on_pattern is not None
    assert view.on_pattern.shape == view.points.shape[:1]
    assert f"{view.on_pattern.sum()} points" in view.finding
    T_lidar_pattern = session.placement.pattern_in("lidar_right", "pattern_1")[0]
    on_pattern = apply(np.linalg.inv(T_lidar_pattern), view.points[view.on_pattern])
    assert np.abs(on_pattern[:, 2]).max() < 0.05


def test_the_same_pose_gives_the_same_picture(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    pose = Session(system).pose
    one, other = (preview(system, pose).views["left_camera"].picture for _ in range(2))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("width", [320, 640, 1280, 1999])
def test_pictures_are_at_most_so_wide_and_rings_scale_with_them(width: int) -> None:
    image = np.full((width // 2, width, 3), 128, np.uint8)
    pixels = np.array([[width * 0.25, width * 0.25], [width * 0.75, width * 0.25]])
    picture = draw_corners(image, [CornerLabels(np.array([3, 4]), pixels)])
    assert picture.shape[1] == min(width, MAX_PICTURE_WIDTH)
    rings = green(picture)
    for centre in (0.25, 0.75):
        part = rings[np.abs(rings[:, 1] / picture.shape[1] - centre) < 0.2]
        np.testing.assert_allclose(part.mean(axis=0), picture.shape[1] * np.array([0.25, centre]), atol=1.0)


def test_pictures_are_red_first_and_the_first_corner_is_red() -> None:
    image = np.zeros((100, 100, 3), np.uint8)
    image[:, :, 0] = 200  # blue, blue first
    picture = draw_corners(image, [CornerLabels(np.array([0]), np.array([[50.0, 50.0]]))])
    assert picture[0, 0].tolist() == [0, 0, 200]
    assert (picture[..., 0] > 200).any()
    assert not len(green(picture))


def test_corners_near_the_edge_and_none_at_all_are_drawn() -> None:
    image = np.zeros((40, 60, 3), np.uint8)
    draw_corners(image, [CornerLabels(np.array([1, 2]), np.array([[-0.4, -0.4], [59.4, 39.4]]))])
    assert not draw_corners(image, []).any()


def test_depth_is_warm_where_near_black_where_nothing_returns_and_green_on_the_pattern() -> None:
    depth = np.tile(np.linspace(5000, 60000, 100).astype(np.uint16), (50, 1))
    depth[:10] = 65535
    picture = draw_depth(depth, [np.array([20 * 100 + 50])])
    assert not picture[:10].any()
    assert picture[30, 5, 0] > picture[30, 5, 2]  # near: yellow
    assert picture[30, 95, 0] < picture[30, 95, 2]  # far: blue
    assert green(picture).tolist() == [[20, 50]]


def test_depth_without_any_return_is_black() -> None:
    assert not draw_depth(np.full((4, 6), 65535, np.uint16), []).any()


def test_a_pattern_far_away_is_lost(systems: dict[str, System]) -> None:
    system = systems["t2rgb"]
    session = Session(system)
    T = session.handle_pose()
    assert T is not None
    session.drag(translation([30.0, 0.0, 0.0]) @ T)
    assert not preview(system, session.pose).kept


def test_it_shows_the_points_of_a_2d_lidar(tmp_path: Path) -> None:
    system = read_system(with_scanner(tmp_path))
    motion = read_motion(DATASETS / "rlbot" / "motion.json")
    detected = detects(system, LIDAR, "pattern_1", place(system, motion))
    view = preview(system, motion.take([int(detected.argmax())])).views[LIDAR]
    assert view.detected
    assert np.isfinite(view.points).all()
    assert 10 < view.on_pattern.sum() < len(view.points)


def test_it_shows_a_modality_that_the_package_does_not_know(source: Path) -> None:
    system = read_system(source)
    view = preview(system, Session(system).pose).views[SONAR]
    assert view.detected
    assert view.points is not None
