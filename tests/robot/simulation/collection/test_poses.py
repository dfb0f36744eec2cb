"""All poses: the same with any number of processes and however often it is interrupted."""

from pathlib import Path

import pytest

from calibration.robot.simulation.collection import poses
from calibration.robot.simulation.collection.capture import Requirements
from calibration.robot.simulation.collection.poses import collect, kept
from calibration.robot.simulation.collection.record import Record
from calibration.robot.simulation.placement import Play

from .conftest import record_workspace


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
