"""``label``: labels images of a dataset that have no labels."""

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calibration.__main__ import main
from calibration.engine.dataset.reading import read_dataset
from tests.pipeline.conftest import DATASETS


def without_labels(folder: Path, keep: tuple[str, ...] = ()) -> dict[str, Any]:
    """Write the first six collections of t2rgb, with the labels of some of them only."""
    source = DATASETS / "t2rgb"
    document = json.loads((source / "dataset.json").read_text())
    folder.mkdir()
    document["collections"] = {key: document["collections"][key] for key in list(document["collections"])[:6]}
    for key, collection in document["collections"].items():
        for message in collection["data"].values():
            shutil.copy(source / message["data_file"], folder)
        if key not in keep:
            collection["labels"] = {}
    (folder / "dataset.json").write_text(json.dumps(document))
    return dict(document)


def test_images_are_labelled(tmp_path: Path) -> None:
    document = without_labels(tmp_path / "in", keep=("000",))
    arguments = ["--dataset", str(tmp_path / "in"), "--output", str(tmp_path / "out"), "--jobs", "1"]
    assert main(["label", *arguments]) == 0
    labelled = json.loads((tmp_path / "out" / "dataset.json").read_text())
    assert labelled["collections"]["000"]["labels"] == document["collections"]["000"]["labels"]  # unchanged
    dataset = read_dataset(tmp_path / "out")
    assert all(len(collection.labels) == 2 for collection in dataset.collections)
    sheet = cv2.imread(str(tmp_path / "out" / "contact_sheet.png"))
    assert sheet is not None
    assert sheet.std() > 10
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert {name: each["images"] for name, each in results["sensors"].items()} == {"left_camera": 5, "right_camera": 5}
    assert main(["label", *arguments, "--overwrite", "--again"]) == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["sensors"]["left_camera"]["labelled"] == 6


def test_a_dataset_of_version_2(shared_data: Path, tmp_path: Path) -> None:
    arguments = ["--dataset", str(shared_data / "t2rgb-paper"), "--output", str(tmp_path / "out"), "--again"]
    assert main(["label", *arguments, "--jobs", "1"]) == 0
    dataset = read_dataset(tmp_path / "out")
    assert sum(len(collection.labels) for collection in dataset.collections) == 39
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert sum(len(each["rejected"]) for each in results["sensors"].values()) == 5


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("all labelled", "found labels for all images of left_camera, right_camera; add --again"),
        ("no image", "expected the image beside the dataset"),
        ("outside", "expected a file in the dataset's folder"),
        ("blank", "'left_camera' sees pattern 'pattern_1'"),
        ("itself", "is the dataset itself"),
    ],
)
def test_errors_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: str, message: str) -> None:
    folder, output = tmp_path / "in", tmp_path / "out"
    document = without_labels(folder, keep=tuple(f"{i:03d}" for i in range(6)) if damage == "all labelled" else ())
    if damage == "no image":
        (folder / "left_camera_002.jpg").unlink()
    if damage == "outside":
        document["collections"]["001"]["data"]["left_camera"]["data_file"] = "../x.jpg"
        (folder / "dataset.json").write_text(json.dumps(document))
    if damage == "blank":
        for path in folder.glob("left_camera*.jpg"):
            cv2.imwrite(str(path), np.full((480, 640), 90, np.uint8))
    if damage == "itself":
        output = folder
    arguments = ["--dataset", str(folder), "--output", str(output), "--jobs", "1", "--overwrite"]
    assert main(["label", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out" / "dataset.json").exists()
