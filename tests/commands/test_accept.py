"""``accept``, and later runs: changes fail until they are accepted too."""

import json
import shutil
from pathlib import Path

import pytest

from calibration.__main__ import main
from tests.displaced import displace
from tests.repositories import git

ROOT = Path(__file__).parents[2]
CONFIGURATION = """\
noise: {translation: [0.3], rotation: [0.2]}
systems:
  robot: {dataset: robot, truth: none, evaluate: rgb-to-rgb:left_camera:right_camera}
"""
FILE = "calibration-baseline.json"
KNOCKED = (0.003, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a repository with one robot, without an accepted calibration."""
    robot = tmp_path / "robot"
    robot.mkdir()
    shutil.copy(ROOT / "datasets" / "t2rgb" / "dataset.json", robot)
    (tmp_path / "calibration.yml").write_text(CONFIGURATION)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def reasons() -> list[str]:
    found = json.loads(Path("output/results.json").read_text())
    return [reason for cell in found["cells"] for reason in cell["reasons"]]


def test_the_life_of_an_accepted_calibration(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("calibration.yml").write_text(CONFIGURATION.replace("[0.", "[0, 0."))
    assert main(["run"]) == 0
    assert "No calibration accepted yet of robot: calibration accept\n" in capsys.readouterr().out
    assert main(["accept"]) == 0
    assert capsys.readouterr().out.endswith(f"robot: accepted\n{FILE} is written: commit it\n")
    first = Path(FILE).read_text()
    found = json.loads(first)["systems"]["robot"]
    assert (found["passed"], found["starts"]) == (4, 4)
    assert found["averages"]["RMS (pix)"] == found["rms-px"]

    assert main(["run"]) == 0
    assert main(["accept"]) == 0
    assert Path(FILE).read_text() == first

    displace(repository / "robot", "right_camera", KNOCKED)
    assert main(["run"]) == 1
    assert len(reasons()) >= 4
    assert all(reason.startswith("right_camera has moved since calibration-baseline.json: 3") for reason in reasons())
    assert all("along its x" in reason for reason in reasons())

    assert main(["accept", "--systems", "robot"]) == 0
    assert Path(FILE).read_text() != first
    assert main(["run"]) == 0


def test_another_description_of_the_same_data_is_red(repository: Path) -> None:
    assert main(["run"]) == 0
    assert main(["accept"]) == 0
    path = repository / "robot" / "dataset.json"
    document = json.loads(path.read_text())
    for collection in document["collections"].values():
        collection["transforms"]["camera_left_link-camera_left_rgb_frame"]["trans"][1] += 0.005
    path.write_text(json.dumps(document))
    assert main(["run"]) == 1
    assert any("on the same data: 5" in reason for reason in reasons())


def test_failed_systems_are_accepted_with_a_reason_only(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("calibration.yml").write_text(CONFIGURATION + "limits: {rms-px: 0.0001}\n")
    assert main(["run"]) == 1
    assert main(["accept"]) == 2
    error = capsys.readouterr().err
    assert "has failed (RMS: found 0.0" in error
    assert not Path(FILE).exists()
    assert main(["accept", "--although", " "]) == 2
    assert main(["accept", "--although", "the old lens, until Friday"]) == 0
    assert json.loads(Path(FILE).read_text())["systems"]["robot"]["although"] == "the old lens, until Friday"


def test_results_that_were_never_judged_are_judged_by_the_configuration(
    repository: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("calibration.yml").write_text(CONFIGURATION + "limits: {rms-px: 0.0001}\n")
    assert main(["run", "--only", "calibrate"]) == 0
    assert main(["accept"]) == 2
    assert "has failed (RMS: found 0.0" in capsys.readouterr().err
    Path("calibration.yml").write_text(CONFIGURATION + "limits: {rms-px: 1}\n")
    assert main(["accept"]) == 0


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--systems", "robt"], "there is no result of 'robt': did you mean 'robot'?"),
        (["--output", "elsewhere"], "elsewhere/results.json"),
        (["--config", "other.yml"], "other.yml"),
    ],
)
def test_wrong_arguments_are_named(
    repository: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    assert main(["run", "--only", "calibrate,introspect"]) == 0
    capsys.readouterr()
    assert main(["accept", *arguments]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    assert not Path(FILE).exists()


def test_the_page_shows_the_accepted_calibrations_by_commit(repository: Path) -> None:
    git(repository, "init", "--quiet")
    for twist in (None, KNOCKED):
        if twist:
            displace(repository / "robot", "right_camera", twist)
        assert main(["run"]) == (1 if twist else 0)
        assert "Accepted calibrations" not in Path("output/report.html").read_text()
        assert main(["accept"]) == 0
        git(repository, "add", FILE)
        git(repository, "commit", "--quiet", "--message", f"moved by {twist}")
    assert main(["run"]) == 0
    page = Path("output/report.html").read_text()
    assert "Accepted calibrations" in page
    assert "over 2 accepted calibrations: last 3 mm" in page


def test_the_accepted_calibrations_lie_beside_the_configuration(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """From any working directory."""
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    config = ["--config", str(repository / "calibration.yml")]
    Path(FILE).write_text("another project's")
    assert main(["run", *config]) == 0
    assert main(["accept", *config]) == 0
    assert "robot" in json.loads((repository / FILE).read_text())["systems"]


def test_a_required_baseline_that_is_missing_is_red(repository: Path) -> None:
    Path("calibration.yml").write_text(CONFIGURATION + "baseline: required\n")
    assert main(["run"]) == 1
    assert all("no calibration of it has been accepted" in reason for reason in reasons())
    assert main(["accept"]) == 0
    assert main(["run"]) == 0
    shutil.move(FILE, "kept.json")
    Path("calibration.yml").write_text(CONFIGURATION + "baseline: {file: kept.json, required: true}\n")
    assert main(["run"]) == 0


def test_a_broken_baseline_stops_the_run(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path(FILE).write_text("<<<<<<< HEAD\n{}")
    assert main(["run"]) == 2
    assert "merge conflict" in capsys.readouterr().err
