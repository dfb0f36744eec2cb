"""``init``: its files are valid, and the dataset passes with them."""

import json
import shutil
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml

from calibration.__main__ import main
from calibration.commands.schema import generated
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import write_dataset
from calibration.engine.geometry.transforms import translation
from calibration.robot.importing.importing import import_data
from tests.pipeline.conftest import DATASETS


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def bring(repository: Path, name: str) -> None:
    shutil.copytree(DATASETS / name, repository / "data" / name, ignore=shutil.ignore_patterns("*.jpg"))


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("t2rgb", "rgb-to-rgb:left_camera:right_camera"),
        ("rlbot", "lidar-to-rgb:lidar_right:rgb_left"),
        ("riwbot", "inter-collection-rgb-to-rgb:rgb_world:rgb_world"),
        ("softbot", "rgb-to-rgb:front_left_camera:front_right_camera"),
        ("spjbot", "inter-collection-rgb-to-rgb:rgb_hand:rgb_hand"),
    ],
)
def test_the_written_configuration_passes(repository: Path, name: str, table: str) -> None:
    bring(repository, name)
    assert main(["init", "--dataset", f"data/{name}"]) == 0
    document = yaml.safe_load((repository / "calibration.yml").read_text())
    jsonschema.validate(document, json.loads(generated("calibration.yml")))
    assert document["systems"][name]["evaluate"] == table
    assert ("joint-mm" in document["systems"][name]["limits"]) == (name == "spjbot")
    assert main(["run", "--jobs", "1"]) == 0


def test_parts_without_files_are_reported(repository: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bring(repository, "softbot")
    for cloud in (repository / "data" / "softbot").glob("*.pcd"):
        cloud.unlink()
    assert main(["init", "--dataset", "data/softbot"]) == 0
    assert "softbot: 14 data files of sensor 'lidar3d' not found: lidar3d_000.pcd" in capfd.readouterr().out
    assert main(["run", "--jobs", "1"]) == 0
    said = capfd.readouterr().err
    assert "warning: 14 data files of sensor 'lidar3d' not found" in said
    assert "it is not calibrated, and stays where the robot's description puts it" in said


def test_every_limit_has_a_reason(repository: Path) -> None:
    bring(repository, "t2rgb")
    main(["init", "--dataset", "data/t2rgb"])
    lines = (repository / "calibration.yml").read_text().splitlines()
    numbers = [line for line in lines if "-mm:" in line or "-deg:" in line]
    assert len(numbers) == 2
    assert not any("max:" in line for line in lines)  # nothing is asked that this recording alone has taught
    assert all("a good robot that sees this" in line.partition("#")[2] for line in numbers)


def test_what_is_left_to_do_is_said(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bring(repository, "t2rgb")
    assert main(["init", "--dataset", "data/t2rgb", "--suite", "OWNER/suite@v1"]) == 0
    said = capsys.readouterr().out
    assert "calibration.yml: put the owner of your copy of the suite in the place of OWNER" in said
    assert "then commit these, data/t2rgb and calibration-baseline.json" in said


def test_the_workflow_runs_the_suite_that_is_named(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bring(repository, "t2rgb")
    assert main(["init", "--dataset", "data/t2rgb", "--suite", "team/suite@v2"]) == 0
    assert "OWNER" not in capsys.readouterr().out
    workflow = yaml.safe_load((repository / ".github/workflows/calibration.yml").read_text())
    assert workflow["jobs"]["robot"]["uses"] == "team/suite/.github/workflows/pipeline.yml@v2"


def test_nothing_is_replaced_unless_asked(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bring(repository, "t2rgb")
    (repository / "calibration.yml").write_text("mine")
    assert main(["init", "--dataset", "data/t2rgb"]) == 2
    assert "calibration.yml: there is such a file already" in capsys.readouterr().err
    assert (repository / "calibration.yml").read_text() == "mine"
    assert not (repository / ".github").exists()
    assert main(["init", "--dataset", "data/t2rgb", "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dataset", "data/none"], "data/none"),
        (["--dataset", str(DATASETS / "t2rgb")], "expected a dataset in the folder of calibration.yml"),
        (["--dataset", "data/t2rgb", "--suite", "x"], "expected OWNER/REPOSITORY@VERSION"),
        (["--dataset", "data/t2rgb", "--suite", "a/b@c: {}"], "expected OWNER/REPOSITORY@VERSION"),
    ],
)
def test_errors_are_one_line(
    repository: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    bring(repository, "t2rgb")
    assert main(["init", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (repository / "calibration.yml").exists()


def test_a_camera_that_moves_while_it_records_is_red(repository: Path) -> None:
    """In the second half of a later recording it is 5 mm away."""
    bring(repository, "riwbot")
    assert main(["init", "--dataset", "data/riwbot"]) == 0
    dataset = read_dataset(repository / "data" / "riwbot")
    edge = ("base_link", "base_link_inertia")  # the arm moves in the opposite direction
    late = np.arange(len(dataset.collections)) >= len(dataset.collections) // 2
    there = dataset.transforms[edge]
    moved = np.where(late[:, None, None], there @ translation([0.005, 0.0, 0.0]), there)
    write_dataset(dataset.with_transforms({edge: moved}), repository / "moved", images=False)
    shutil.copytree(repository / "moved", repository / "data" / "riwbot", dirs_exist_ok=True)
    assert main(["run", "--jobs", "1"]) == 1


@pytest.mark.thorough
def test_from_photographs_of_a_real_arm_to_a_verdict(
    shared_data: Path, repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a guessed lens it fails, with the reason; with a calibrated lens it passes."""
    data = shared_data / "real-arm"
    camera: dict[str, Any] = {"parent": "base_link", "intrinsics": str(data / "camera_intr.yaml")}
    description = {
        "sensors": {"camera": camera},
        "patterns": {"board": {"target": str(data / "target.yaml"), "parent": "tool0"}},
        "samples": {"file": str(data / "cal_data.yaml")},
    }
    (repository / "import.yml").write_text(json.dumps(description))
    import_data(repository / "import.yml", repository / "given", jobs=1)
    assert main(["init", "--dataset", "given"]) == 1
    said = capsys.readouterr().out
    assert "given: fails: " in said
    assert "image scale does not fit" in said
    assert "calibration.yml: not written" in said
    assert not Path("calibration.yml").exists()
    assert main(["init", "--dataset", "given", "--although"]) == 1
    assert "# This recording does not pass" in Path("calibration.yml").read_text()
    del camera["intrinsics"]
    (repository / "import.yml").write_text(json.dumps(description))
    import_data(repository / "import.yml", repository / "free", jobs=1)
    assert main(["init", "--dataset", "free", "--overwrite"]) == 0
    system = yaml.safe_load((repository / "calibration.yml").read_text())["systems"]["free"]
    assert (system["description"], system["intrinsics"]) == ("rough", ["camera"])
    assert main(["run", "--jobs", "1"]) == 0
