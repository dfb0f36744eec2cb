"""Exports of a system that passes; none of one that fails."""

import json
import shutil
from pathlib import Path

import pytest
import yaml

from calibration.__main__ import main
from tests.pipeline.conftest import DATASETS

FOLDER = Path("output/robot/translation-0_rotation-0_seed-1/exports")


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("dataset.json", "robot.urdf"):
        (tmp_path / "robot").mkdir(exist_ok=True)
        shutil.copy(DATASETS / "t2rgb" / name, tmp_path / "robot" / name)
    monkeypatch.chdir(tmp_path)
    configure(tmp_path)
    return tmp_path


def configure(root: Path, **changes: object) -> None:
    exports = {"formats": ["urdf", "autoware"], "robot-description": "robot/robot.urdf"}
    document = {"systems": {"robot": {"dataset": "robot", "truth": "none"}}, "exports": exports, **changes}
    (root / "calibration.yml").write_text(yaml.safe_dump(document))


def test_a_system_that_passes_leaves_its_files(
    repository: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GITHUB_OUTPUT", str(repository / "outputs"))
    assert main(["run"]) == 0
    assert sorted(each.name for each in FOLDER.iterdir()) == [
        "calibrated.urdf",
        "calibration.json",
        "sensor_kit_calibration.yaml",
    ]
    assert f"{FOLDER}: calibrated.urdf, calibration.json, sensor_kit_calibration.yaml" in capsys.readouterr().out
    assert str(FOLDER) in (repository / "outputs").read_text()
    found = json.loads((FOLDER / "calibration.json").read_text())
    assert (found["schema"], found["system"], found["verdict"]) == (1, "robot", "pass")
    [pose] = [each for each in found["calibration"]["poses"] if "sigma-mm" in each]
    kit = yaml.safe_load((FOLDER / "sensor_kit_calibration.yaml").read_text())
    assert 1e3 * kit[pose["parent"]][pose["child"]]["y"] == pytest.approx(pose["xyz-mm"][1], abs=1e-5)


def test_a_system_that_fails_leaves_none_and_none_of_an_earlier_run(repository: Path) -> None:
    assert main(["run"]) == 0
    configure(repository, limits={"rms-px": 0.0001})
    assert main(["run"]) == 1
    assert not FOLDER.exists() or list(FOLDER.iterdir()) == []


def test_what_is_undecided_is_exported_by_its_rule_and_said(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for rule, code in (("fail", 1), ("pass", 0)):
        configure(repository, limits={"translation-mm": 0.001}, undecided=rule)
        assert main(["run"]) == code
        assert FOLDER.exists() == (rule == "pass")
    assert "robot: undecided: 'right_camera' is not determined well enough" in capsys.readouterr().out


def test_a_description_that_does_not_fit_is_red(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(DATASETS / "riwbot" / "robot.urdf", repository / "robot")
    assert main(["run"]) == 1
    assert "robot: exports: " in capsys.readouterr().err
    assert json.loads(Path("output/results.json").read_text())["verdict"] == "fail"


@pytest.mark.parametrize(
    ("exports", "expected"),
    [
        ({"formats": ["urfd"]}, "exports.formats"),
        ({"formats": ["urdf"]}, "urdf needs robot-description"),
        ({"format": ["ros2"]}, "did you mean 'formats'"),
    ],
)
def test_what_makes_no_sense_is_named(
    repository: Path, capsys: pytest.CaptureFixture[str], exports: dict, expected: str
) -> None:
    configure(repository, exports=exports)
    assert main(["run"]) == 2
    assert expected in capsys.readouterr().err
