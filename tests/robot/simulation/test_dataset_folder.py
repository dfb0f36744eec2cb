import json
from pathlib import Path

import cv2
import pytest

from calibration.base import InfrastructureError, InputError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.evaluation.truth import find_truth
from calibration.robot.simulation import dataset_folder
from calibration.robot.simulation.dataset_folder import replacing_dataset, write_dataset
from calibration.robot.simulation.kinematics import Play
from calibration.robot.simulation.motion import read_motion
from calibration.robot.simulation.record import Record
from calibration.robot.simulation.system import read_system

Writer = tuple[Play, list[Record], Path]


@pytest.fixture
def collected(rlbot_play: Play, rlbot_records: list[Record], rlbot_files: Path) -> Writer:
    return rlbot_play, [record for record in rlbot_records if record.kept], rlbot_files


def write(folder: Path, collected: Writer, overwrite: bool = False, kept: int = 2) -> None:
    play, records, files = collected
    with replacing_dataset(folder, overwrite) as new:
        write_dataset(new, play, records[:kept], files)


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_folder_is_a_systems_folder_too(collected: Writer, tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    write(folder, collected)
    assert sorted(snapshot(folder)) == sorted(
        [
            *("config.yml", "dataset.json", "ground_truth.json", "motion.json", "robot.urdf", "simulation.yml"),
            *("rgb_left_000.jpg", "rgb_left_002.jpg", "lidar_right_000.pcd", "lidar_right_002.pcd"),
        ]
    )
    assert read_system(folder).configuration == collected[0].system.configuration
    assert len(read_motion(folder / "motion.json")) == 3  # with the pose that was lost: it can be played again


def test_the_dataset_has_the_kept_collections(collected: Writer, tmp_path: Path) -> None:
    write(tmp_path, collected)
    dataset = read_dataset(tmp_path)
    assert dataset.keys == ("000", "002")
    assert [len(collection.labels) for collection in dataset.collections] == [2, 2]
    message = dataset.document["collections"]["002"]["data"]["rgb_left"]
    image = cv2.imread(str(tmp_path / message["data_file"]))
    assert image is not None
    assert image.shape == (message["height"], message["width"], 3)
    truth = find_truth(dataset)
    assert truth is not None
    assert set(truth.patterns) == {"000", "002"}
    assert 0.01 < json.loads(truth.path.read_text())["corner_rms_px"] < 0.2


def test_a_dataset_is_not_overwritten_unless_asked(collected: Writer, tmp_path: Path) -> None:
    write(tmp_path, collected)
    (tmp_path / "notes.txt").write_text("mine")
    before = snapshot(tmp_path)
    with pytest.raises(InputError, match=r"dataset.json: exists already; --overwrite replaces the dataset"):
        write(tmp_path, collected)
    assert snapshot(tmp_path) == before
    write(tmp_path, collected, overwrite=True, kept=1)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert [path.name for path in tmp_path.glob("*.pcd")] == ["lidar_right_000.pcd"]  # of the old ones none is left
    assert len(read_dataset(tmp_path).collections) == 1


def test_a_recorded_motion_is_not_replaced_by_another_one(collected: Writer, tmp_path: Path) -> None:
    (tmp_path / "motion.json").write_text("{}")
    with pytest.raises(InputError, match=r"motion.json: exists already and differs; --overwrite replaces it"):
        write(tmp_path, collected)
    assert snapshot(tmp_path) == {"motion.json": b"{}"}


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError, ValueError])
def test_an_interrupted_run_leaves_everything_as_it_was(
    collected: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: bool, error: type[BaseException]
) -> None:
    folder = tmp_path / "output"
    if old:
        write(folder, collected, kept=1)
    before = snapshot(tmp_path)
    rename, countdown = Path.rename, 0

    def interrupted(self: Path, target: Path) -> Path:
        nonlocal countdown
        countdown -= 1
        if countdown == 0:
            raise error
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", interrupted)
    for move in range(1, 19 if old else 11):
        countdown = move
        with pytest.raises(InfrastructureError if error is OSError else error):
            write(folder, collected, overwrite=True)
        assert snapshot(tmp_path) == before
        assert folder.exists() == old
    countdown = 0
    write(folder, collected, overwrite=True)
    assert len(snapshot(tmp_path)) == 10


def test_a_full_disk_while_writing(collected: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(dataset_folder, "link_or_copy", full)
    with pytest.raises(InfrastructureError, match="output: cannot be written: No space left on device"):
        write(tmp_path / "output", collected)
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


def test_an_output_that_is_a_file(collected: Writer, tmp_path: Path) -> None:
    (tmp_path / "output").write_text("mine")
    with pytest.raises(InputError, match="output: is a file, expected a folder for the dataset"):
        write(tmp_path / "output", collected)
    with pytest.raises(InfrastructureError, match="output/inside: cannot be made: Not a directory"):
        write(tmp_path / "output" / "inside", collected)
