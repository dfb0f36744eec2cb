"""Records: what a pose leaves, as JSON and back; and the collection of all poses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.engine.dataset.model import CornerLabels
from calibration.engine.geometry.transforms import apply
from calibration.robot.simulation import record as poses
from calibration.robot.simulation.capture import Requirements, capture
from calibration.robot.simulation.dataset_folder import truth_document
from calibration.robot.simulation.kinematics import Play, play
from calibration.robot.simulation.record import Record, collect, kept, record
from calibration.robot.simulation.system import System
from tests.robot.simulation.conftest import own_motion
from tests.robot.simulation.test_capture import bent

from .conftest import record_workspace


def test_a_record_survives_json(rlbot_records: list[Record]) -> None:
    for one in rlbot_records:
        again = Record.from_json(one.to_json())
        assert again == one
        assert again.to_json() == one.to_json()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"number": 1}', "null"])
def test_what_is_no_record(text: str) -> None:
    with pytest.raises((ValueError, TypeError, KeyError)):
        Record.from_json(text)


def test_lost_and_kept(rlbot_records: list[Record]) -> None:
    assert [record.kept for record in rlbot_records] == [True, False, True]
    assert [record.key for record in rlbot_records] == ["000", "001", "002"]
    lost = rlbot_records[1]
    assert lost.labels == {"lidar_right": 0, "rgb_left": 0}
    assert lost.initial == {"pattern_1": {"detected": False}}
    assert lost.errors == {}
    labels = lost.collection["labels"]["pattern_1"]
    assert labels["rgb_left"] == {"detected": False, "idxs": []}
    assert labels["lidar_right"] == {"detected": False, "idxs": [], "idxs_limit_points": []}


def test_corner_errors_are_those_against_the_projected_truth(rlbot_play: Play, rlbot_records: list[Record]) -> None:
    system = rlbot_play.system
    labels = rlbot_records[0].collection["labels"]["pattern_1"]["rgb_left"]["idxs"]
    found = np.array([[label["x"], label["y"]] for label in labels])
    ids = [label["id"] for label in labels]
    T_camera_pattern = rlbot_play.true.pattern_in("rgb_left", "pattern_1")[0]
    true = system.cameras["rgb_left"].camera.project(apply(T_camera_pattern, system.patterns["pattern_1"].corners[ids]))
    error = found - true
    told = rlbot_records[0].errors["rgb_left"]
    assert told.count == len(labels) == rlbot_records[0].labels["rgb_left"]
    assert told.rms == pytest.approx(np.sqrt((error**2).sum(-1).mean()), abs=1e-6)
    assert told.mean == pytest.approx(error.mean(0), abs=1e-6)
    assert told.largest == pytest.approx(np.linalg.norm(error, axis=-1).max(), abs=1e-6)


def test_cells_are_those_with_a_corner(rlbot_records: list[Record]) -> None:
    record = rlbot_records[0]
    labels = record.collection["labels"]["pattern_1"]["rgb_left"]["idxs"]
    expected = {4 * min(int((p["y"] + 0.5) / (800 / 3)), 2) + min(int((p["x"] + 0.5) / 300), 3) for p in labels}
    assert record.cells == {"rgb_left": sorted(expected)}


def test_the_corner_of_a_pixel_is_where_a_cell_begins(systems: dict[str, System]) -> None:
    """Pixel (159, y) is the last of the first of four cells over 640: 159.4 lies on it, 159.6 on the next one."""
    system = systems["t2rgb"]
    it = play(system, own_motion(system).take([0]), 1)
    seen = capture(it, 0)
    for x, cells in ((159.4, [0]), (159.6, [1])):
        label = CornerLabels(np.array([0]), np.array([[x, 10.0]]))
        alone = replace(seen, labels={**seen.labels, ("pattern_1", "left_camera"): label})
        assert record(it, alone, ()).cells["left_camera"] == cells


def test_the_dataset_has_the_designed_robot_and_the_truth_the_real_one(systems: dict[str, System]) -> None:
    system = bent(systems["rlbot"])
    it = play(system, own_motion(system).take([0]), 1)
    made = record(it, capture(it, 0), ())
    edge = ("tripod_right_support", "lidar_right_base_link")
    designed = made.collection["transforms"]["-".join(edge)]["trans"]
    np.testing.assert_allclose(designed, [0.015, 0, 0.006])
    truth = truth_document(it, [made])["sensors"]["lidar_right"]["trans"]
    np.testing.assert_allclose(truth, it.true.transforms[edge][0, :3, 3])
    assert np.abs(np.array(truth) - designed).max() > 0.01


def test_numbers_are_rounded(rlbot_records: list[Record]) -> None:
    """The last bits of a machine's arithmetic do not show."""

    def check(value: object, decimals: int) -> None:
        if isinstance(value, float):
            assert round(value, decimals) == value
        for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            check(part, decimals)

    document = json.loads(rlbot_records[0].to_json())
    check(document["collection"]["labels"], 4)
    check(document["collection"]["transforms"], 9)
    check(document["initial"], 5)
    check(document["errors"], 6)


def test_a_collection_has_the_nominal_joints(systems: dict[str, System]) -> None:
    system = systems["spjbot"]
    played = play(system, own_motion(system).take([3]), seed=1)
    one = record(played, capture(played, 0), ())
    assert list(one.collection["joints"]) == ["j2_joint", "j3_joint", "j4_joint"]
    assert one.collection["joints"]["j3_joint"] == {
        "transform_key": "quill_link-j3_link",
        "position": played.motion.joints["j3_joint"][0],
        "origin_x": 0,
        "origin_y": 0,
        "origin_z": 0.1,
        "origin_roll": 0,
        "origin_pitch": 0,
        "origin_yaw": 0,
        "axis_x": 0,
        "axis_y": 0,
        "axis_z": 1,
        "parent_link": "quill_link",
        "child_link": "j3_link",
        "joint_type": "prismatic",
    }
    position = played.motion.joints["j3_joint"][0]
    assert one.collection["transforms"]["quill_link-j3_link"]["trans"] == [
        0,
        0,
        pytest.approx(0.1 + position, abs=1e-9),
    ]
    assert played.true.transforms["quill_link", "j3_link"][0, 2, 3] == pytest.approx(0.105 + position)
    document = truth_document(played, [one])
    assert document["joints"]["j3_joint"] == {"origin_z": 0.105}
    assert "joints" not in truth_document(play(systems["riwbot"], own_motion(systems["riwbot"]), 1), [one])


def test_the_pose_of_a_base_is_true_of_one_collection(systems: dict[str, System]) -> None:
    system = systems["softbot"]
    played = play(system, own_motion(system).take([3]), seed=1)
    one = record(played, capture(played, 0), ())
    assert [(pose["parent"], pose["child"]) for pose in one.truth] == [
        ("world", "pattern_link"),
        ("odometry_y", "base_footprint"),
    ]
    document = truth_document(played, [one])
    assert document["patterns"]["000"] == list(one.truth)
    assert [(pose["parent"], pose["child"]) for pose in document["transforms"]] == [("world", "pattern_link")]


def snapshot(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_same_bytes_with_several_processes(
    rlbot_play: Play, rlbot_records: list[Record], rlbot_files: Path, tmp_path: Path
) -> None:
    seen = []
    records = collect(rlbot_play, Requirements(), record_workspace(tmp_path), 3, lambda *step: seen.append(step[:2]))
    assert records == rlbot_records
    assert snapshot(tmp_path) == snapshot(rlbot_files)
    assert sorted(seen) == [(1, 3), (2, 3), (3, 3)]
    assert [record.number for record in kept(records)] == [0, 2]


def test_an_interrupted_one_goes_on(
    rlbot_play: Play, rlbot_records: list[Record], rlbot_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pose = poses.collect_pose

    def interrupted(play: Play, number: int, requirements: Requirements) -> tuple[Record, dict[str, bytes]]:
        if number == 1:
            raise KeyboardInterrupt
        return pose(play, number, requirements)

    monkeypatch.setattr(poses, "collect_pose", interrupted)
    with pytest.raises(KeyboardInterrupt):
        collect(rlbot_play, Requirements(), record_workspace(tmp_path), 1)
    assert [record_workspace(tmp_path).find(name) is None for name in "012"] == [False, True, True]

    made: list[int] = []

    def watched(play: Play, number: int, requirements: Requirements) -> tuple[Record, dict[str, bytes]]:
        made.append(number)
        return pose(play, number, requirements)

    monkeypatch.setattr(poses, "collect_pose", watched)
    seen: list[int] = []
    records = collect(
        rlbot_play, Requirements(), record_workspace(tmp_path), 1, lambda done, _, record: seen.append(done)
    )
    assert made == [1, 2]
    assert seen == [1, 2, 3]
    assert records == rlbot_records
    assert snapshot(tmp_path) == snapshot(rlbot_files)


def test_files_of_rejected_poses_are_kept(rlbot_records: list[Record], rlbot_files: Path) -> None:
    names = {message["data_file"] for record in rlbot_records for message in record.collection["data"].values()}
    assert names == {f"{s}_00{i}.{e}" for s, e in (("rgb_left", "jpg"), ("lidar_right", "pcd")) for i in range(3)}
    assert names <= set(snapshot(rlbot_files))


def test_without_images(rlbot_play: Play, rlbot_records: list[Record]) -> None:
    record, files = poses.collect_pose(rlbot_play, 0, Requirements(), images=False)
    assert record == rlbot_records[0]
    assert list(files) == ["lidar_right_000.pcd"]
