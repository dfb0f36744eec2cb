"""Cameras of datasets: one answer an episode, a table, and the file meta/calibration.json."""

import json
from pathlib import Path

import numpy as np
import pytest

from calibration.__main__ import main
from calibration.addons.guard.lerobot_check import (
    CALIBRATION_FILE,
    DatasetCalibration,
    DatasetCamera,
    camera_of_dataset,
    card_table,
    check_dataset,
    read_dataset_calibration,
    write_dataset_calibration,
)
from calibration.addons.guard.lerobot_episodes import INFO, episodes_of, frames_at, is_dataset
from calibration.addons.guard.outcome import Placement, SensorCheck
from calibration.base import InputError
from tests.addons.guard.tiny_datasets import COUNT, KEY, RATE, frames, write_dataset, write_droid
from tests.addons.guard.witness.moving_bag import CAMERA, accepted_cameras
from tests.thorough import thorough

NOTHING_KNOWN = DatasetCalibration(1, {})


@pytest.mark.parametrize("version", ["v3.0", thorough("v2.1"), thorough("v2.0")])
def test_each_episode_has_an_answer(version: str, tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "set", version, [frames(), frames(9.0, COUNT // 2)])
    options = ["--card", str(tmp_path / "card.md"), "--annotate", "true", "--output", str(tmp_path / "output")]
    assert main(["check", str(folder), *options]) == 1
    found = json.loads((tmp_path / "output" / "results.json").read_text())["systems"]
    assert [each["outcome"] for (each,) in found.values()] == ["unmoved", "moved"]
    assert found["episode 000001"][0]["since"] == pytest.approx(COUNT / RATE / 2, abs=1.0)
    assert f"| {KEY} | episode 000001 | moved |" in (tmp_path / "card.md").read_text()
    assert read_dataset_calibration(folder / CALIBRATION_FILE).episodes["episode 000001"] == {KEY: "moved"}


def test_the_table_has_a_row_for_episodes_of_one_outcome() -> None:
    outcomes: tuple[Placement, ...] = ("unmoved", "unmoved", "moved", "unmoved")
    table = card_table(
        {
            f"{i}": (SensorCheck(sensor="top", method="", outcome=each, reason="a | b"),)
            for i, each in enumerate(outcomes)
        }
    )
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]
    assert rows == [
        ["top", "0 to 1", "unmoved", "a / b"], ["top", "2", "moved", "a / b"], ["top", "3", "unmoved", "a / b"]
    ]  # fmt: skip


def test_frames_are_those_of_their_times(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "set", "v3.0", [frames(), frames(40.0)])
    _, second = episodes_of(folder, 10)
    video = second.videos[KEY]
    assert (video.begin, video.seconds) == pytest.approx((COUNT / RATE, (COUNT - 1) / RATE))
    before, after = frames_at(video.path, [video.begin - 1 / RATE, video.begin])
    assert after.time == pytest.approx(video.begin, abs=0.01)
    assert after.seconds == pytest.approx(2 * COUNT / RATE, abs=0.3)
    assert abs(before.image.astype(float) - after.image).mean() > 5
    assert abs(frames(40.0)[0].astype(float) - after.image).mean() < 5


@pytest.mark.thorough
def test_folders_as_those_of_droid_are_read_without_the_wrist(tmp_path: Path) -> None:
    folder = write_droid(tmp_path / "droid", [frames(), frames(9.0)])
    assert is_dataset(folder)
    found = check_dataset(folder, NOTHING_KNOWN, ())
    assert [(each.sensor, each.outcome) for (each,) in found.values()] == [("111", "unmoved"), ("111", "moved")]


@pytest.mark.parametrize(("numbers", "column"), [(8, "hand[0:6]"), thorough(6, "hand")])
def test_a_camera_that_is_carried_is_checked_by_its_column_of_poses(numbers: int, column: str, tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "set", "v2.1", [frames()], np.zeros((COUNT, numbers)))
    camera = camera_of_dataset("hand", CAMERA, accepted_cameras(), pose_column=column)
    (found,) = check_dataset(folder, DatasetCalibration(1, {KEY: camera}), ())["episode 000000"]
    assert found.outcome == "cannot-tell"
    assert "0.0 mm" in found.reason  # by the motion of what carries it, and that stands


def test_what_is_accepted_is_written_and_read_again(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "set", "v2.1", [frames()])
    camera = camera_of_dataset("hand", CAMERA, accepted_cameras(), pose_column="hand")
    assert isinstance(camera, DatasetCamera)
    write_dataset_calibration(folder, DatasetCalibration(1, {KEY: camera}), {})
    again = read_dataset_calibration(folder / CALIBRATION_FILE).cameras[KEY]
    assert again == camera
    assert again.T_parent_camera == pytest.approx(accepted_cameras().poses[0].matrix)
    assert again.camera == CAMERA


@pytest.mark.parametrize(
    ("key", "value", "place"),
    [
        ("codebase_version", "v9.0", "codebase_version"),
        ("video_path", "../{video_key}.mp4", "video_path"),
        ("fps", 0, "fps"),
        ("features", {}, "features"),
        ("features", {"../up": {"dtype": "video"}}, "features"),
    ],
)
def test_metadata_that_is_wrong_is_named(key: str, value: object, place: str, tmp_path: Path) -> None:
    (tmp_path / "meta").mkdir()
    info = {"codebase_version": "v2.1", "fps": RATE, "features": {KEY: {"dtype": "video"}}} | {key: value}
    (tmp_path / INFO).write_text(json.dumps(info))
    (tmp_path / "meta" / "episodes.jsonl").write_text("")
    with pytest.raises(InputError, match=f"info.json: {place}"):
        episodes_of(tmp_path, 10)


def read_all(folder: Path) -> None:
    """Read each file of a dataset."""
    read_dataset_calibration(folder / CALIBRATION_FILE)
    for episode in episodes_of(folder, 10):
        episode.column("timestamp")
        list(frames_at(episode.videos[KEY].path, [0.0]))


@pytest.mark.parametrize(
    "broken",
    [
        Path("data/chunk-000/episode_000000.parquet"),
        Path("meta/episodes.jsonl"),
        Path(f"videos/chunk-000/{KEY}/episode_000000.mp4"),
        CALIBRATION_FILE,
    ],
)
def test_files_that_are_none_are_named(broken: Path, tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "set", "v2.1", [frames()[:4]])
    (folder / broken).write_text('{"no"')
    with pytest.raises(InputError, match=broken.name):
        read_all(folder)
