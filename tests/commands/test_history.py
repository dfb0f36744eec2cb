"""``history``: accepted calibrations of a repository, with sudden and gradual movements of sensors."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.__main__ import main
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.document import Baseline, write_baseline
from tests.engine.baseline.scenes import stereo, taken
from tests.repositories import git

PROJECT = Path(__file__).parents[2]
FILE = "calibration-baseline.json"


@pytest.fixture(scope="module")
def accepted() -> CalibrationDocument:
    return taken(stereo())


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    git(tmp_path, "init", "--quiet", "--initial-branch=main")
    (tmp_path / "calibration.yml").write_text("systems: {robot: {dataset: robot}}\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def accept(
    root: Path, accepted: CalibrationDocument, count: int, place: Callable[[int], float], name: str = "robot"
) -> None:
    """Commit calibrations with a position of the right camera along its x, mm, and a little noise."""
    rng = np.random.default_rng(3)
    for i in range(count):
        poses = []
        for pose in accepted.poses:
            if pose.sigma_mm:
                x, y, z = np.array(pose.xyz_mm) + 0.02 * rng.normal(size=3)
                pose = replace(pose, xyz_mm=(round(x + place(i), 6), round(y, 6), round(z, 6)))
            poses.append(pose)
        write_baseline(root / FILE, Baseline(1, {name: replace(accepted, poses=tuple(poses))}))
        git(root, "add", ".")
        git(root, "commit", "--quiet", "-m", f"Accept {i} | <b>")


def results() -> dict:
    return json.loads(Path("output/history/results.json").read_text())


def test_a_sensor_that_moved_is_found_at_its_commit(
    repository: Path, accepted: CalibrationDocument, capsys: pytest.CaptureFixture[str]
) -> None:
    accept(repository, accepted, 12, lambda i: 5.0 * (i >= 7))
    assert main(["history"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"robot: right +(5|4.99) mm, \S+ deg +Accept 7", out)
    assert "pass: 12 accepted, 1 change (" in out
    trend = next(each for each in results()["trends"] if each["name"] == "right")
    assert len(trend["points"]) == 12
    assert trend["crept_mm"] is None
    assert Path("output/history/history.svg").read_bytes().startswith(b"<?xml")


def test_slow_drift_is_creeping(
    repository: Path, accepted: CalibrationDocument, capsys: pytest.CaptureFixture[str]
) -> None:
    accept(repository, accepted, 10, lambda i: 0.3 * i)
    assert main(["history"]) == 0
    assert re.search(r"robot: right has crept 2\.\d+ mm in 9 accepted changes since", capsys.readouterr().out)
    assert next(each for each in results()["trends"] if each["name"] == "right")["steps"] == []


def test_since_a_commit_and_a_system(
    repository: Path, accepted: CalibrationDocument, capsys: pytest.CaptureFixture[str]
) -> None:
    accept(repository, accepted, 6, lambda i: 5.0 * (i >= 2))
    assert main(["history", "--since", "HEAD~3", "--systems", "robot"]) == 0
    assert "pass: 3 accepted, 0 changes" in capsys.readouterr().out
    assert main(["history", "--systems", "robt"]) == 2
    assert "no commit has accepted 'robt' (accepted: robot)" in capsys.readouterr().err
    assert main(["history", "--since", "HEAD"]) == 2
    assert "no commit after HEAD has accepted anything" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["{]", '{"version": 1, "systems": {"a": 1}, "systems": {}}'])
def test_a_commit_with_a_broken_file_is_skipped_and_reported(
    text: str, repository: Path, accepted: CalibrationDocument, capsys: pytest.CaptureFixture[str]
) -> None:
    accept(repository, accepted, 3, lambda i: 0.0)
    (repository / FILE).write_text(text)
    git(repository, "commit", "--quiet", "-am", "broken")
    broken = git(repository, "rev-parse", "HEAD")
    accept(repository, accepted, 2, lambda i: 0.1)
    assert main(["history"]) == 0
    assert f"{broken[:12]}: no baseline of this version" in capsys.readouterr().out
    assert results()["unreadable"] == [broken]
    assert results()["commits"] == 5


def test_without_a_repository_or_a_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "calibration.yml").write_text("systems: {robot: {dataset: robot}}\n")
    assert main(["history"]) == 2
    assert "a folder in a git repository was expected" in capsys.readouterr().err
    git(tmp_path, "init", "--quiet")
    assert main(["history"]) == 2
    assert "no commit has accepted anything: calibration accept" in capsys.readouterr().err


@pytest.mark.thorough
def test_git_bisect_finds_the_commit_that_changed_the_result(repository: Path) -> None:
    [line] = [
        each for each in (PROJECT / "docs/baseline.md").read_text().splitlines() if each.startswith("git bisect run")
    ]
    robot = repository / "robot"
    robot.mkdir()
    shutil.copy(PROJECT / "datasets" / "t2rgb" / "dataset.json", robot)
    (repository / "calibration.yml").write_text("systems: {robot: {dataset: robot, truth: none}}\n")
    (repository / ".gitignore").write_text("output\n")
    assert main(["run", "--only", "calibrate,introspect"]) == 0
    assert main(["accept"]) == 0
    commits = []
    for i in range(4):
        if i == 2:
            text = (robot / "dataset.json").read_text()
            document = json.loads(text)
            for collection in document["collections"].values():
                collection["transforms"]["camera_left_link-camera_left_rgb_frame"]["trans"][1] += 0.004
            (robot / "dataset.json").write_text(json.dumps(document))
        (repository / "notes").write_text(f"change {i}")
        git(repository, "add", ".")
        git(repository, "commit", "--quiet", "-m", f"change {i}")
        commits.append(git(repository, "rev-parse", "HEAD"))
    git(repository, "bisect", "start", commits[-1], commits[0])
    run = line.replace("calibration run", f"PYTHONPATH={PROJECT} {sys.executable} -m calibration run")
    done = subprocess.run(["bash", "-c", run], cwd=repository, capture_output=True, text=True, check=True)
    assert f"{commits[2]} is the first bad commit" in done.stdout
