"""The pure parts of the robot application: the board, the dataset on the disk."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from example_robot.board import Board
from example_robot.dataset import DatasetFolder, View

from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.robot.simulation.capture import capture
from calibration.robot.simulation.record import pose_document
from tests.examples.ros1.conftest import EXAMPLE, Collected

CONFIG = yaml.safe_load((EXAMPLE / "system" / "config.yml").read_text())
BOARD = CONFIG["calibration_patterns"]["board"]


def test_the_board_is_the_one_that_is_simulated(collected: Collected) -> None:
    assert np.array_equal(Board(BOARD).corners, np.round(collected.dataset.patterns["board"].corners, 6))


def test_it_detects_what_ours_detects(collected: Collected) -> None:
    board, seen = Board(BOARD), capture(collected.play, 0)
    for name, image in seen.data.items():
        ours = seen.labels["board", name]
        assert isinstance(ours, CornerLabels)
        ids, pixels = board.detect(image)
        _, in_theirs, in_ours = np.intersect1d(ids, ours.ids, return_indices=True)
        assert len(in_theirs) == 40
        assert np.linalg.norm(pixels[in_theirs] - ours.pixels[in_ours], axis=1).max() < 0.5


def test_two_poses_of_the_motion_are_not_seen_by_both_cameras(collected: Collected) -> None:
    board = Board(BOARD)
    missing = {}
    for number in range(len(collected.play)):
        images = capture(collected.play, number).data
        missing[number + 1] = [name for name, image in images.items() if board.detect(image) is None]
    assert {pose: names for pose, names in missing.items() if names} == {5: ["right_camera"], 11: ["left_camera"]}


def test_an_image_without_the_board_is_no_detection() -> None:
    assert Board(BOARD).detect(np.full((480, 640, 3), 128, np.uint8)) is None


def views(collected: Collected, number: int) -> tuple[dict[str, View], dict[str, object]]:
    """What the robot holds at a pose: of each camera, and of tf."""
    board, seen = Board(BOARD), capture(collected.play, number)
    sensors = collected.dataset.document["sensors"]
    found = {}
    for name, image in seen.data.items():
        message = {"height": 480, "width": 640, "encoding": "bgr8", "header": {"frame_id": f"{name}_optical"}}
        found[name] = View(image, message, sensors[name]["camera_info"], *board.detect(image))
    transforms = {
        f"{parent}-{child}": pose_document((parent, child), T[number])
        for (parent, child), T in collected.play.nominal.transforms.items()
    }
    return found, transforms


def test_the_dataset_is_whole_after_every_collection(collected: Collected, tmp_path: Path) -> None:
    folder = DatasetFolder(tmp_path / "dataset", CONFIG, Board(BOARD))
    for count, number in enumerate((0, 2, 5)):
        assert folder.add(*views(collected, number)) == f"{count:03d}"
        dataset = read_dataset(folder.folder)
        assert dataset.keys == tuple(f"{n:03d}" for n in range(count + 1))
        names = {path.name for path in folder.folder.iterdir()}
        files = {f"{camera}_{key}.jpg" for camera in CONFIG["sensors"] for key in dataset.keys}
        assert names == {"dataset.json", *files}
    assert {len(labels.ids) for labels in dataset.collections[0].labels.values()} == {40}
    assert cv2.imread(str(folder.folder / "left_camera_000.jpg")).shape == (480, 640, 3)
    # the first guess of the board's pose is near the truth: the transforms are true
    initial = dataset.document["patterns"]["board"]["transforms_initial"]["001"]
    true = collected.play.true.patterns["board"][2]
    assert (initial["parent"], initial["child"], initial["sensor"]) == ("world", "pattern_link", "left_camera")
    assert np.linalg.norm(np.array(initial["trans"]) - true[:3, 3]) < 0.01


def test_a_failing_save_leaves_the_dataset_as_it_was(collected: Collected, tmp_path: Path) -> None:
    folder = DatasetFolder(tmp_path, CONFIG, Board(BOARD))
    folder.add(*views(collected, 0))
    before = (tmp_path / "dataset.json").read_bytes()
    found, transforms = views(collected, 2)
    (tmp_path / ".dataset.json.new").mkdir()  # it cannot be written
    with pytest.raises(OSError, match="directory"):
        folder.add(found, transforms)
    assert (tmp_path / "dataset.json").read_bytes() == before
    (tmp_path / ".dataset.json.new").rmdir()
    assert folder.add(found, transforms) == "001"
    assert list(json.loads((tmp_path / "dataset.json").read_text())["collections"]) == ["000", "001"]


def test_another_dataset_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "dataset.json").write_text("mine")
    with pytest.raises(FileExistsError, match="exists already; collect into another folder"):
        DatasetFolder(tmp_path, CONFIG, Board(BOARD))
    assert (tmp_path / "dataset.json").read_text() == "mine"
