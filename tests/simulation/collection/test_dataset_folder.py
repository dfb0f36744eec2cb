import json
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.dataset.reading import read_dataset
from calibration.dataset.truth import find_truth
from calibration.errors import InputError, WorldError
from calibration.simulation.collection import dataset_folder
from calibration.simulation.collection.capture import SimulatedCollection, collect
from calibration.simulation.collection.dataset_folder import replacing_dataset, write_dataset_folder
from calibration.simulation.motion.sequence import Motion, moving_model, read_motion
from calibration.simulation.system import System, read_system
from tests.simulation.conftest import DATASETS


@pytest.fixture(scope="module")
def collected(systems: dict[str, System]) -> tuple[System, Motion, list[SimulatedCollection]]:
    system = systems["rlbot"]
    motion = read_motion(DATASETS / "rlbot" / "motion.json").take([0, 1, 2])
    return system, motion, list(collect(system, motion, 1))


Collected = tuple[System, Motion, list[SimulatedCollection]]


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_folder_is_a_systems_folder_too(collected: Collected, tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    write_dataset_folder(folder, *collected, seed=1)
    assert sorted(snapshot(folder)) == sorted(
        ["config.yml", "dataset.json", "ground_truth.json", "motion.json", "robot.urdf", "simulation.yml"]
        + [f"lidar_right_00{i}.pcd" for i in range(3)]
    )
    again = list(collect(read_system(folder), read_motion(folder / "motion.json"), 1))
    write_dataset_folder(tmp_path / "b", read_system(folder), read_motion(folder / "motion.json"), again, seed=1)
    assert snapshot(tmp_path / "b") | {"dataset.json": b""} == snapshot(folder) | {"dataset.json": b""}


def test_a_dataset_is_not_overwritten_unless_asked(collected: Collected, tmp_path: Path) -> None:
    system, motion, collections = collected
    write_dataset_folder(tmp_path, *collected, seed=1)
    (tmp_path / "notes.txt").write_text("mine")
    before = snapshot(tmp_path)
    with pytest.raises(InputError, match=r"dataset.json: exists already; --overwrite replaces the dataset"):
        write_dataset_folder(tmp_path, *collected, seed=1)
    assert snapshot(tmp_path) == before
    write_dataset_folder(tmp_path, system, motion.take([0]), collections[:1], seed=1, overwrite=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert [path.name for path in tmp_path.glob("*.pcd")] == ["lidar_right_000.pcd"]  # of the old ones none is left
    assert len(read_dataset(tmp_path).collections) == 1


def test_a_recorded_motion_is_not_replaced_by_another_one(collected: Collected, tmp_path: Path) -> None:
    (tmp_path / "motion.json").write_text("{}")
    with pytest.raises(InputError, match=r"motion.json: exists already and differs; --overwrite replaces it"):
        write_dataset_folder(tmp_path, *collected, seed=1)
    assert snapshot(tmp_path) == {"motion.json": b"{}"}


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError, ValueError])
def test_an_interrupted_run_leaves_everything_as_it_was(
    collected: Collected,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    old: bool,
    error: type[BaseException],
) -> None:
    folder = tmp_path / "output"
    if old:
        write_dataset_folder(folder, *collected, seed=1)
    before = snapshot(tmp_path)
    rename, countdown = Path.rename, 0

    def interrupted(self: Path, target: Path) -> Path:
        nonlocal countdown
        countdown -= 1
        if countdown == 0:
            raise error
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", interrupted)
    for move in range(1, 19 if old else 10):
        countdown = move
        with pytest.raises(WorldError if error is OSError else error):
            write_dataset_folder(folder, *collected, seed=2, overwrite=True)
        assert snapshot(tmp_path) == before
        assert folder.exists() == old
    write_dataset_folder(folder, *collected, seed=2, overwrite=True)
    assert json.loads((folder / "ground_truth.json").read_bytes())["seed"] == 2
    assert len(snapshot(tmp_path)) == 9


def test_a_full_disk_while_writing(collected: Collected, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(dataset_folder, "write_points", full)
    with pytest.raises(WorldError, match="output: cannot be written: No space left on device"):
        write_dataset_folder(tmp_path / "output", *collected, seed=1)
    assert list(tmp_path.iterdir()) == []


def test_the_json_comes_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rename, order = Path.rename, []

    def watched(self: Path, target: Path) -> Path:
        order.append(self.name)
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", watched)
    with replacing_dataset(tmp_path / "d", overwrite=False) as new:
        for name in ("z.pcd", "dataset.json", "a.pcd"):
            (new / name).write_text("{}")
    assert order[-1] == "dataset.json"


def test_files_that_an_old_dataset_names_elsewhere_stay(tmp_path: Path) -> None:
    folder = tmp_path / "d"
    folder.mkdir()
    (tmp_path / "keep.pcd").write_text("mine")
    data = {"a": {"data_file": "../keep.pcd"}, "b": {"data_file": "old.pcd"}, "c": {"data_file": 5}}
    (folder / "dataset.json").write_text(json.dumps({"collections": {"000": {"data": data}}}))
    (folder / "old.pcd").write_text("old")
    with replacing_dataset(folder, overwrite=True) as new:
        (new / "dataset.json").write_text("{}")
    assert snapshot(tmp_path) == {"keep.pcd": b"mine", "d/dataset.json": b"{}"}


def test_an_old_dataset_that_cannot_be_read_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "dataset.json").write_text("[broken")
    with replacing_dataset(tmp_path, overwrite=True) as new:
        (new / "dataset.json").write_text("{}")
    assert snapshot(tmp_path) == {"dataset.json": b"{}"}


def test_an_output_that_is_a_file(collected: Collected, tmp_path: Path) -> None:
    (tmp_path / "output").write_text("mine")
    with pytest.raises(InputError, match="output: is a file, expected a folder for the dataset"):
        write_dataset_folder(tmp_path / "output", *collected, seed=1)
    with pytest.raises(WorldError, match="output/inside: cannot be made: Not a directory"):
        write_dataset_folder(tmp_path / "output" / "inside", *collected, seed=1)


def test_what_a_sensor_does_not_detect_is_in_the_dataset_as_such(systems: dict[str, System], tmp_path: Path) -> None:
    system = systems["rlbot"]
    system = replace(
        system,
        configuration=replace(system.configuration, additional_tfs={"plate": ("tripod", "tripod_plate")}),
    )
    poses = read_motion(DATASETS / "rlbot" / "motion.json").take([0, 1]).model_poses
    assert poses is not None
    poses[1, 2, 3] += 5.0  # high above both
    motion = moving_model(poses)
    write_dataset_folder(tmp_path, system, motion, list(collect(system, motion, 1)), seed=1)
    dataset = read_dataset(tmp_path)
    assert [len(collection.labels) for collection in dataset.collections] == [2, 0]
    assert dataset.document["patterns"]["pattern_1"]["transforms_initial"]["001"] == {"detected": False}
    labels = dataset.document["collections"]["001"]["labels"]["pattern_1"]
    assert labels["rgb_left"] == {"detected": False, "idxs": []}
    assert labels["lidar_right"] == {"detected": False, "idxs": [], "idxs_limit_points": []}
    assert dataset.document["transforms"]["tripod-tripod_plate"]["is_transformation_calibrated"]
    truth = find_truth(dataset)
    assert truth is not None
    assert truth.transforms["tripod", "tripod_plate"][2, 3] == 1.65


def test_a_pattern_that_no_camera_sees(systems: dict[str, System], tmp_path: Path) -> None:
    system = systems["rlbot"]
    motion = moving_model(read_motion(DATASETS / "rlbot" / "motion.json").take([0, 1]).model_poses[:, [1, 0, 2, 3]])  # type: ignore[index]
    collections = list(collect(system, motion, 1))
    with pytest.raises(InputError, match="no camera of rlbot detects a pattern in any of the 2 poses"):
        write_dataset_folder(tmp_path / "output", system, motion, collections, seed=1)
    assert list(tmp_path.iterdir()) == []
