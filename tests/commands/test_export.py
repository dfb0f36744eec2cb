"""``export``: a calibrated dataset in file formats of robots."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.__main__ import main
from calibration.engine.dataset.model import ROUGH_KEY
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.geometry.transforms import retract
from tests.displaced import displace
from tests.pipeline.conftest import DATASETS

T2RGB = str(DATASETS / "t2rgb")
DESCRIPTION = str(DATASETS / "t2rgb" / "robot.urdf")


def test_all_formats_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "out"
    assert main(["export", "--dataset", T2RGB, "--robot-description", DESCRIPTION, "--output", str(output)]) == 0
    names = {each.name for each in output.iterdir()}
    cameras = {f"camera_info_{name}.yaml" for name in read_dataset(DATASETS / "t2rgb").sensors}
    assert names >= {"calibrated.urdf", "calibrated.launch.py", "tf_static.yaml", "opencv.yml", *cameras}
    assert str(output / "calibrated.urdf") in capsys.readouterr().out


def test_only_requested_formats_are_written(tmp_path: Path) -> None:
    assert main(["export", "--dataset", T2RGB, "--formats", "ros1,opencv", "--output", str(tmp_path / "o")]) == 0
    assert {each.name for each in (tmp_path / "o").iterdir()} == {"calibrated.ros1.launch", "opencv.yml"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--formats", "urfd"], "found 'urfd', expected urdf, xacro"),
        (["--formats", "urdf"], "give robot-description"),
        (["--robot-description", "none.urdf"], "none.urdf: a robot description was expected"),
        (["--robot-description", str(DATASETS / "riwbot" / "robot.urdf")], "no chain of joints"),
    ],
)
def test_failed_exports_are_one_line_and_leave_no_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    output = tmp_path / "out"
    assert main(["export", "--dataset", T2RGB, "--output", str(output), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not output.exists()


def run(folder: Path, limits: str, undecided: str = "fail") -> Path:
    """Run the matrix on a robot without a truth, and return its cell's folder."""
    shutil.copy(DATASETS / "riwbot" / "dataset.json", folder)
    system = f"{{dataset: ., truth: none, undecided: {undecided}, limits: {limits}}}"
    (folder / "calibration.yml").write_text(f"systems: {{robot: {system}}}")
    main(["run", "--config", str(folder / "calibration.yml"), "--output", str(folder / "output")])
    [cell] = json.loads((folder / "output" / "results.json").read_text())["cells"]
    return folder / "output" / str(cell["folder"])


@pytest.mark.parametrize(
    ("limits", "undecided", "verdict"),
    [("{rms-px: 0.001}", "fail", "fail"), ("{translation-mm: 0.01}", "fail", "undecided")],
)
def test_a_cell_that_has_not_passed_is_refused_unless_asked(
    limits: str, undecided: str, verdict: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = run(tmp_path, limits, undecided)
    output = tmp_path / "exports"
    copied = shutil.copytree(cell, tmp_path / "copied")
    for dataset in (cell, cell / "dataset.json", copied):
        assert main(["export", "--dataset", str(dataset), "--output", str(output)]) == 2
        line = capsys.readouterr().err.splitlines()[-1]
        assert f"{dataset}: the verdict of this cell is {verdict} (" in line
        assert not output.exists()
    assert main(["export", "--dataset", str(cell), "--output", str(output), "--although", "a test drive"]) == 0
    assert output.is_dir()


def test_an_undecided_cell_that_counts_as_passed_is_exported_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = run(tmp_path, "{translation-mm: 0.01}", "pass")
    assert main(["export", "--dataset", str(cell), "--output", str(tmp_path / "exports")]) == 0
    assert "undecided" in capsys.readouterr().out.splitlines()[-1]


def test_of_a_camera_that_has_moved_its_pose_of_now_is_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(DATASETS / "t2rgb" / "dataset.json", tmp_path)
    displace(tmp_path, "right_camera", twist := (0.02, 0.0, 0.01, 0.0, 0.0, 0.0), since=11)
    (tmp_path / "calibration.yml").write_text("systems: {robot: {dataset: ., truth: none}}")
    output = tmp_path / "output"
    assert main(["run", "--config", str(tmp_path / "calibration.yml"), "--output", str(output)]) == 1
    cell = output / json.loads((output / "results.json").read_text())["cells"][0]["folder"]
    command = ["export", "--dataset", str(cell), "--formats", "opencv", "--output", str(tmp_path / "exports")]
    capsys.readouterr()
    assert main([*command, "--although", "it has to drive"]) == 0
    said = capsys.readouterr().out.splitlines()[-1]
    assert "the result is that of the robot as it stands now, of left_camera and right_camera since collection" in said

    before = calibrate(read_dataset(DATASETS / "t2rgb")).dataset
    left, right = (before.sensors[name] for name in ("left_camera", "right_camera"))
    now = before.with_transforms({right.edge: retract(before.transforms[right.edge], np.array(twist))})
    storage = cv2.FileStorage(str(tmp_path / "exports" / "opencv.yml"), cv2.FILE_STORAGE_READ)
    exported = storage.getNode("T_0_1").mat().ravel()
    apart = [
        1e3 * np.linalg.norm(exported - each.transform(right.frame, left.frame)[0, :3, 3]) for each in (before, now)
    ]
    assert apart[0] > 20
    assert apart[1] < 2


def test_a_dataset_that_was_imported_and_never_calibrated_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = json.loads((DATASETS / "t2rgb" / "dataset.json").read_text())
    document["_metadata"][ROUGH_KEY] = True
    (tmp_path / "dataset.json").write_text(json.dumps(document))
    assert main(["export", "--dataset", str(tmp_path), "--output", str(tmp_path / "exports")]) == 2
    assert f"{tmp_path}: this dataset was imported" in capsys.readouterr().err
    assert not (tmp_path / "exports").exists()


def test_arguments_of_a_xacro(tmp_path: Path) -> None:
    xacro, urdf = tmp_path / "robot.urdf.xacro", Path(DESCRIPTION).read_text()
    body = urdf[urdf.index(">", urdf.index("<robot")) + 1 :]
    xacro.write_text(f'<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro">{body}')
    command = ["export", "--dataset", T2RGB, "--robot-description", str(xacro), "--formats", "urdf"]
    assert main([*command, "--xacro", "name=ours", "--output", str(tmp_path / "o")]) == 0
    assert '<robot name="ours"' in (tmp_path / "o" / "calibrated.urdf").read_text()
    assert main([*command, "--xacro", "name", "--output", str(tmp_path / "p")]) == 2
