"""``export``: a calibrated dataset in file formats of robots."""

from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.dataset.reading import read_dataset
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
