"""Collections of a later recording are added to a dataset of the same robot, with their files."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from calibration.base import InputError
from calibration.commands.recordings import add_collections_command as command
from calibration.engine.dataset.model import ESTIMATED_KEY
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.evaluation.truth import TRUTH_FILE, read_truth
from calibration.robot.importing.amending import add_collections

SHIPPED = Path(__file__).parents[3] / "datasets" / "t2rgb"


def copied(folder: Path, change: Callable[[dict[str, Any]], object] = lambda _: None) -> Path:
    """The shipped dataset with its first four collections, and two images of these."""
    folder.mkdir()
    document = json.loads((SHIPPED / FILE_NAME).read_bytes())
    document["collections"] = {key: document["collections"][key] for key in ("000", "001", "002", "003")}
    change(document)
    (folder / FILE_NAME).write_text(json.dumps(document))
    for name in (TRUTH_FILE, "left_camera_000.jpg", "left_camera_003.jpg"):
        shutil.copy(SHIPPED / name, folder)
    return folder


def test_they_follow_with_their_files_and_truth(tmp_path: Path) -> None:
    first, second = copied(tmp_path / "first"), copied(tmp_path / "second")
    (second / "left_camera_000.jpg").write_bytes(b"another image")
    before = read_dataset(first)
    found = CliRunner().invoke(command, [str(second), "--to", str(first)], catch_exceptions=False)
    assert "4 more of" in found.output
    both = read_dataset(first)
    assert both.keys == (*before.keys, "004", "005", "006", "007")
    assert both.collections[5].labels.keys() == before.collections[1].labels.keys()
    assert (first / "left_camera_004.jpg").read_bytes() == b"another image"
    assert (first / "left_camera_000.jpg").read_bytes() == (SHIPPED / "left_camera_000.jpg").read_bytes()
    document = json.loads((first / FILE_NAME).read_bytes())
    assert document["collections"]["007"]["data"]["left_camera"]["data_file"] == "left_camera_007.jpg"
    assert read_truth(first / TRUTH_FILE).patterns.keys() >= set(both.keys)


def another_focal_length(document: dict[str, Any]) -> None:
    document["sensors"]["left_camera"]["camera_info"]["K"][0] *= 1.01


def another_board(document: dict[str, Any]) -> None:
    document["calibration_config"]["calibration_patterns"]["pattern_1"]["size"] = 0.07


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (another_focal_length, "sensors/left_camera/camera_info/K"),
        (another_board, "calibration_config/calibration_pat"),
    ],
)
def test_those_of_another_robot_are_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], said: str
) -> None:
    first, second = copied(tmp_path / "first"), copied(tmp_path / "second", change)
    known = (first / FILE_NAME).read_bytes()
    with pytest.raises(InputError, match=said):
        add_collections(second, first)
    assert (first / FILE_NAME).read_bytes() == known


def test_intrinsics_that_an_import_has_estimated_may_differ(tmp_path: Path) -> None:
    first = copied(tmp_path / "first", lambda document: document["_metadata"].update({ESTIMATED_KEY: ["left_camera"]}))
    second = copied(tmp_path / "second", another_focal_length)
    assert add_collections(second, first) == (4, 4)


def test_without_its_truth_nothing_is_added_to_simulated_ones(tmp_path: Path) -> None:
    first, second = copied(tmp_path / "first"), copied(tmp_path / "second")
    (second / TRUTH_FILE).unlink()
    with pytest.raises(InputError, match="found ground truth, and none in"):
        add_collections(second, first)
    with pytest.raises(InputError, match="the same folder twice"):
        add_collections(first, first)
