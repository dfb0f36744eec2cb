import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.recorder.session import Session, joined
from calibration.base import InfrastructureError, InputError
from calibration.engine.geometry.transforms import from_xyz_rpy, translation
from calibration.robot.simulation.motion import Motion, read_motion
from calibration.robot.simulation.system import System
from tests.addons.recorder.conftest import DATASETS

OPERATIONS = ("save", "replace", "delete", "earlier", "later", "select", "move")


def at(x: float) -> np.ndarray:
    return from_xyz_rpy([x, 0.1, 0.9], [1.2, 0.0, -1.5])


def with_poses(system: System, *places: float) -> Session:
    session = Session(system)
    for x in places:
        session.move_model(at(x))
        session.save()
    return session


def order(session: Session) -> list[float]:
    return [float(pose.positions[0, 0]) for pose in session.poses if pose.positions is not None]


def same(one: Motion, other: Motion) -> None:
    for a, b in ((one.positions, other.positions), (one.orientations, other.orientations)):
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            np.testing.assert_array_equal(a, b)
    assert one.joints.keys() == other.joints.keys()
    for name in one.joints:
        np.testing.assert_array_equal(one.joints[name], other.joints[name])


@pytest.fixture
def t2rgb(systems: dict[str, System]) -> System:
    return systems["t2rgb"]


def test_saved_poses_are_in_the_order_of_saving_and_the_last_is_selected(t2rgb: System) -> None:
    session = with_poses(t2rgb, 1.5, 1.6, 1.7)
    assert order(session) == [1.5, 1.6, 1.7]
    assert session.selected == 2
    assert not session.is_changed


def test_a_pose_can_be_saved_twice_and_each_is_its_own(t2rgb: System) -> None:
    session = with_poses(t2rgb, 1.5)
    session.save()
    session.select(0)
    session.move_model(at(1.9))
    assert session.is_changed
    session.replace_selected()
    assert order(session) == [1.9, 1.5]
    assert not session.is_changed


def test_poses_move_up_and_down_and_no_further(t2rgb: System) -> None:
    session = with_poses(t2rgb, 1.0, 2.0, 3.0)
    session.shift_selected(-1)
    assert order(session) == [1.0, 3.0, 2.0]
    session.shift_selected(-5)
    assert order(session) == [3.0, 1.0, 2.0]
    assert session.selected == 0
    session.shift_selected(1)
    assert order(session) == [1.0, 3.0, 2.0]


def test_deleting_selects_the_next_and_at_the_end_the_one_before(t2rgb: System) -> None:
    session = with_poses(t2rgb, 1.0, 2.0, 3.0)
    session.select(1)
    session.delete_selected()
    assert order(session) == [1.0, 3.0]
    assert session.pose is session.poses[1]
    session.delete_selected()
    assert session.pose is session.poses[0]
    session.delete_selected()
    assert session.poses == ()
    assert session.selected is None
    session.delete_selected()  # nothing left to delete: nothing happens


@given(st.lists(st.tuples(st.sampled_from(OPERATIONS), st.integers(0, 5)), max_size=25))
def test_undo_takes_back_every_change_in_turn(systems: dict[str, System], steps: list[tuple[str, int]]) -> None:
    session = Session(systems["t2rgb"], read_motion(DATASETS / "t2rgb" / "motion.json").take([0]))
    states = [session.poses]
    for step, number in steps:
        match step:
            case "save":
                session.save()
            case "replace":
                session.replace_selected()
            case "delete":
                session.delete_selected()
            case "earlier":
                session.shift_selected(-1)
            case "later":
                session.shift_selected(1)
            case "move":
                session.move_model(at(1 + number / 10))
            case "select" if number < len(session.poses):
                session.select(number)
        assert session.selected is None or 0 <= session.selected < len(session.poses)
        if session.poses != states[-1]:
            states.append(session.poses)
    for state in reversed(states[:-1]):
        assert session.can_undo
        session.undo()
        assert session.poses == state
    assert not session.can_undo


def test_a_pose_that_does_not_exist_cannot_be_selected(t2rgb: System) -> None:
    with pytest.raises(IndexError):
        Session(t2rgb).select(0)


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot"])
def test_a_sequence_that_is_loaded_and_exported_is_the_same(
    systems: dict[str, System], name: str, tmp_path: Path
) -> None:
    motion = read_motion(DATASETS / name / "motion.json")
    session = Session(systems[name], motion)
    assert len(session.poses) == len(motion)
    assert not session.is_unsaved  # the file that it was read from has it
    assert not session.can_undo
    session.export(tmp_path / "again.json")
    same(read_motion(tmp_path / "again.json"), motion)


def test_a_recorded_sequence_keeps_all_its_digits(t2rgb: System, shared_data: Path, tmp_path: Path) -> None:
    recorded = shared_data / "t2rgb-paper" / "movement_sequence.json"
    Session(t2rgb, read_motion(recorded)).export(tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == json.loads(recorded.read_text())


def test_what_is_saved_is_what_a_file_holds(systems: dict[str, System], tmp_path: Path) -> None:
    for name, system in systems.items():
        session = Session(system)
        T = session.handle_pose()
        assert T is not None
        assert session.drag(T @ translation([1 / 3000, 0.0, 0.0]))
        session.save()
        session.export(tmp_path / f"{name}.json")
        same(read_motion(tmp_path / f"{name}.json"), session.motion())


def test_a_loaded_sequence_that_does_not_fit_changes_nothing(systems: dict[str, System]) -> None:
    session = with_poses(systems["t2rgb"], 1.5)
    before = (session.poses, session.pose, session.selected)
    with pytest.raises(InputError, match="position and orientation"):
        session.load(read_motion(DATASETS / "riwbot" / "motion.json"))
    assert (session.poses, session.pose, session.selected) == before


def test_loading_can_be_undone(t2rgb: System) -> None:
    session = with_poses(t2rgb, 1.5, 1.6)
    session.load(read_motion(DATASETS / "t2rgb" / "motion.json"))
    assert session.pose is session.poses[0]
    session.undo()
    assert order(session) == [1.5, 1.6]


def test_joints_that_a_sequence_does_not_name_rest(rail: System) -> None:
    session = Session(rail, Motion(None, None, {"slide": np.array([0.1, 0.2])}))
    assert [float(pose.joints["pan"][0]) for pose in session.poses] == [0.0, 0.0]


def test_joints_move_within_their_limits_and_to_the_last_digit_of_them(systems: dict[str, System]) -> None:
    session = Session(systems["riwbot"])
    limit = systems["riwbot"].robot.movable["elbow_joint"].upper
    session.move_joints({"elbow_joint": 100.0})
    assert session.pose.joints["elbow_joint"][0] == limit  # 3.1415926535898, which six digits would exceed
    session.placement  # noqa: B018 (it can be played)
    session.move_joints({"elbow_joint": 1 / 3})
    assert session.pose.joints["elbow_joint"][0] == 0.333333


def test_a_handle_that_cannot_follow_leaves_the_pose(systems: dict[str, System]) -> None:
    session = Session(systems["riwbot"])
    pose, T = session.pose, session.handle_pose()
    assert T is not None
    assert not session.drag(translation([9.0, 0.0, 0.0]) @ T)
    assert session.pose is pose


def test_export_makes_folders_and_never_replaces_what_it_did_not_write(t2rgb: System, tmp_path: Path) -> None:
    session, path = with_poses(t2rgb, 1.5), tmp_path / "new" / "motion.json"
    session.export(path)
    session.move_model(at(1.6))
    session.save()
    session.export(path)  # its own file: no question
    assert len(read_motion(path)) == 2
    path.write_text("somebody else's")
    with pytest.raises(InputError, match=r"motion\.json: exists already"):
        session.export(path)
    assert path.read_text() == "somebody else's"
    session.export(path, replace_file=True)
    assert len(read_motion(path)) == 2
    assert [p.name for p in path.parent.iterdir()] == ["motion.json"]


def test_nothing_is_exported_before_a_pose_is_saved(t2rgb: System, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no pose is saved yet"):
        Session(t2rgb).export(tmp_path / "motion.json")
    assert not list(tmp_path.iterdir())


def test_what_no_file_has_is_saved_beside_the_output(t2rgb: System, tmp_path: Path) -> None:
    output = tmp_path / "motion.json"
    assert Session(t2rgb).autosave(output) is None  # nothing to lose
    session = with_poses(t2rgb, 1.5)
    session.export(output)
    assert session.autosave(output) is None
    session.delete_selected()
    assert session.autosave(output) is None  # an empty sequence is no work
    session.undo()
    session.save()
    assert session.autosave(output) == tmp_path / "motion.autosave.json"
    assert len(read_motion(tmp_path / "motion.autosave.json")) == 2
    assert len(read_motion(output)) == 1
    other = with_poses(t2rgb, 1.5)  # another session, which must not take the place of the first
    assert other.autosave(output) == tmp_path / "motion.autosave-2.json"


def test_what_cannot_be_saved_beside_the_output_goes_to_temporary_files(
    t2rgb: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "a file").write_text("")
    output = tmp_path / "a file" / "motion.json"  # no folder can be made there
    session = with_poses(t2rgb, 1.5)
    with pytest.raises(InfrastructureError):
        session.export(output)
    assert session.is_unsaved
    assert session.autosave(output) == tmp_path / "motion.autosave.json"


def test_a_system_in_which_nothing_moves_has_nothing_to_record(systems: dict[str, System]) -> None:
    system = systems["riwbot"]
    stiff = replace(system.robot, joints=tuple(replace(joint, kind="fixed") for joint in system.robot.joints))
    with pytest.raises(InputError, match="nothing to record"):
        Session(replace(system, robot=stiff, nominal=stiff))


def test_without_a_camera_the_pattern_begins_in_front_of_the_first_sensor(systems: dict[str, System]) -> None:
    system = systems["rlbot"]
    lidar = replace(
        system,
        sensors={"lidar_right": system.sensors["lidar_right"]},
        configuration=replace(
            system.configuration, sensors={"lidar_right": system.configuration.sensors["lidar_right"]}
        ),
    )
    session = Session(lidar)
    T_lidar_pattern = session.placement.pattern_in("lidar_right", "pattern_1")[0]
    distance = np.linalg.norm(apply_centre(T_lidar_pattern, lidar))
    assert distance == pytest.approx(2.0, abs=1e-3)


def apply_centre(T: np.ndarray, system: System) -> np.ndarray:
    (pattern,) = system.patterns.values()
    moved: np.ndarray = T[:3, :3] @ pattern.centre + T[:3, 3]
    return moved


def test_joining_takes_poses_apart_and_together(systems: dict[str, System]) -> None:
    for name in systems:
        motion = read_motion(DATASETS / name / "motion.json")
        same(joined([motion.take([i]) for i in range(len(motion))]), motion)
