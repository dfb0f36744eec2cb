import numpy as np
import pytest

from calibration.addons.recorder.preview import Preview, SensorPreview
from calibration.addons.recorder.recording import serving
from calibration.addons.recorder.scene import (
    KEPT_COLOUR,
    LOST_COLOUR,
    UNKNOWN_COLOUR,
    RobotScene,
    extent,
    print_of,
    view_point,
    wxyz,
)
from calibration.addons.recorder.session import Session
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import moving_joints
from calibration.robot.simulation.system import System


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot"])
def test_the_patterns_outline_is_where_the_pattern_is(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    session = Session(system)
    with serving("127.0.0.1", 0) as server:
        scene = RobotScene(server.scene, system, session.placement, session.handle_pose())
        (outline,) = scene.outlines(session.placement)
        T = session.handle_pose()
        assert T is not None
        assert scene.gizmo is not None
        np.testing.assert_allclose(outline.mean(axis=0), T[:3, 3], atol=1e-9)  # the handle is on its middle
        np.testing.assert_allclose(scene.gizmo.position, T[:3, 3], atol=1e-9)


def test_what_is_shown_follows_the_pose(systems: dict[str, System]) -> None:
    system = systems["riwbot"]
    session = Session(system)
    with serving("127.0.0.1", 0) as server:
        scene = RobotScene(server.scene, system, session.placement, session.handle_pose())
        session.move_joints({"elbow_joint": 0.3})
        scene.show(session.placement, session.handle_pose())
        T = session.handle_pose()
        assert T is not None
        assert scene.gizmo is not None
        np.testing.assert_allclose(scene.gizmo.position, T[:3, 3], atol=1e-9)
        held = np.array(scene.gizmo.position)
        session.move_joints({"elbow_joint": 0.6})
        scene.show(session.placement, None)  # while it is dragged it is left alone
        np.testing.assert_array_equal(scene.gizmo.position, held)


def test_views_verdicts_and_saved_poses_are_shown_and_taken_away(systems: dict[str, System]) -> None:
    system = systems["rlbot"]
    session = Session(system)
    views = {
        "lidar_right": SensorPreview(
            "2 points", True, points=np.ones((3, 3)), on_pattern=np.array([True, True, False])
        ),
        "rgb_left": SensorPreview("nothing", False, picture=np.zeros((4, 6, 3), np.uint8)),
    }
    with serving("127.0.0.1", 0) as server:
        scene = RobotScene(server.scene, system, session.placement, session.handle_pose())
        scene.show_views(views)
        scene.show_views(Preview({}, ("it cannot be played",)).views)
        outline = scene.outlines(session.placement)[0]
        scene.show_saved([(outline, KEPT_COLOUR), (outline, LOST_COLOUR), (outline, UNKNOWN_COLOUR)])
        scene.show_extras(frames=True, saved=False)
        scene.show_saved([(outline, LOST_COLOUR)])
        scene.show_saved([])


def test_a_camera_on_a_rail_is_shown_too(rail: System) -> None:
    placement = place(rail, moving_joints({"slide": np.array([0.2])}))
    with serving("127.0.0.1", 0) as server:
        assert RobotScene(server.scene, rail, placement, None).gizmo is None


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot"])
def test_one_looks_from_behind_the_sensors_at_what_is_there(systems: dict[str, System], name: str) -> None:
    system = systems[name]
    placement = Session(system).placement
    position, look_at = view_point(system, placement)
    size = extent(system, placement)
    ahead = (look_at - position) / np.linalg.norm(look_at - position)
    things = [T[0, :3, 3] for T in (*placement.sensors.values(), *placement.patterns.values())]
    for thing in things:
        cosine = (thing - position) @ ahead / np.linalg.norm(thing - position)
        assert cosine > np.cos(np.radians(25))
    assert np.linalg.norm(position - look_at) < 4 * size


def test_a_print_is_as_large_as_the_board_and_has_its_border() -> None:
    pattern = PatternConfiguration(
        "board", "chessboard", "board", "world", False, dimension=(4, 3), size=0.1, border_size=(0.05, 0.0)
    )
    picture = print_of(pattern, False)
    width, height = np.ptp(pattern.pattern().outline, axis=0)
    assert picture.shape[1] / picture.shape[0] == pytest.approx(width / height, rel=0.02)
    side = picture.shape[0] // 4
    assert (picture[:, : side // 2] > 200).all()  # the border on the left
    assert picture[side // 2, side].max() < 60  # the first square is black
    assert picture[-1, side].min() > 200 or picture[-1, side].max() < 60  # no border below


def test_the_print_of_an_aprilgrid_is_as_large_as_the_board_too() -> None:
    pattern = PatternConfiguration(
        "board", "aprilgrid", "board", "world", False, (3, 2), 0.1, border_size=(0.05, 0.0), spacing=0.3
    )
    picture = print_of(pattern, False)
    width, height = np.ptp(pattern.pattern().outline, axis=0)
    assert picture.shape[1] / picture.shape[0] == pytest.approx(width / height, rel=0.02)
    side = picture.shape[0] / 2.9  # of a tag
    assert (picture[:, : int(side / 2) - 2] > 200).all()  # the border on the left
    for corner in (picture[3, int(side / 2) + 3], picture[-4, -int(side / 2) - 4]):
        assert corner.max() < 60  # black squares at the corners


def test_quaternions_have_w_first() -> None:
    T = from_xyz_rpy([1.0, 2.0, 3.0], [0.3, -0.2, 1.1])
    w, x, y, z = wxyz(T)
    np.testing.assert_allclose(rotations.from_quaternion([x, y, z, w]), T[:3, :3], atol=1e-12)
