"""The baseline of the base branch: what a change accepts is shown, and a base that cannot be read is said."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.document import Baseline, BaselineUpdate, write_baseline
from calibration.engine.baseline.quality import BaselineSettings
from calibration.engine.baseline.verdict import Accepted, against_baseline
from calibration.pipeline.baselines import with_accepted
from calibration.pipeline.matrix.cell_result import Details
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.report import baseline_line
from calibration.pipeline.report_tables import changes_table
from calibration.pipeline.results import PipelineResults
from calibration.pipeline.system import NoiseGrid, System
from tests.displaced import displace
from tests.engine.baseline.scenes import stereo, taken
from tests.pipeline.matrix.test_cell_verdict import CELL
from tests.repositories import git

ROOT = Path(__file__).parents[2]
FILE = "calibration-baseline.json"
MATRIX = Matrix((System("robot", Path("robot")),), NoiseGrid())


@pytest.fixture(scope="module")
def snapshots() -> tuple[CalibrationDocument, CalibrationDocument]:
    return taken(stereo(1)), taken(stereo(2, (0.0, 0.0, 0.005, 0.0, 0.0, 0.0)))


def commit(root: Path, message: str) -> str:
    git(root, "add", ".")
    git(root, "commit", "--quiet", "-m", message)
    return git(root, "rev-parse", "HEAD").strip()


@pytest.fixture
def repository(tmp_path: Path, snapshots: tuple[CalibrationDocument, CalibrationDocument]) -> Path:
    root = tmp_path / "repository"
    root.mkdir()
    git(root, "init", "--quiet", "--initial-branch=main")
    write_baseline(root / FILE, Baseline(1, {"robot": snapshots[0]}))
    commit(root, "accepted")
    return root


def event(tmp_path: Path, base: str) -> dict[str, str]:
    """A runner's description of a pull request."""
    path = tmp_path / "event.json"
    sides = {side: {"sha": base, "repo": {"full_name": "team/robot"}} for side in ("base", "head")}
    path.write_text(json.dumps({"pull_request": sides}))
    return {"GITHUB_ACTIONS": "true", "GITHUB_EVENT_NAME": "pull_request", "GITHUB_EVENT_PATH": str(path)}


def test_a_file_that_stayed_accepts_nothing(repository: Path) -> None:
    matrix, update = with_accepted(MATRIX, BaselineSettings(repository / FILE), {})
    [system] = matrix.systems
    assert system.accepted is not None
    assert system.accepted.snapshot is not None
    assert system.accepted.since.startswith(f"{FILE} of 2")
    assert (update.updates, update.problem, update.unused) == ((), None, ())
    assert (update.compared, update.since) == (("robot",), system.accepted.since)


def test_a_pull_request_that_updates_the_file_shows_what_it_accepts(
    repository: Path, tmp_path: Path, snapshots: tuple[CalibrationDocument, CalibrationDocument]
) -> None:
    base = head_of(repository)
    moved = replace(snapshots[1], although="knocked, and glued")
    write_baseline(repository / FILE, Baseline(1, {"robot": moved, "second": snapshots[0]}))
    commit(repository, "knocked")
    update = with_accepted(MATRIX, BaselineSettings(repository / FILE), event(tmp_path, base))[1]
    assert update.base == base
    assert update.unused == ("second",)
    by_name = {each.change.name if each.change else each.system: each for each in update.updates}
    right = by_name["right"]
    assert right.change is not None
    assert right.change.mm == pytest.approx(5, abs=0.5)
    assert right.although == "knocked, and glued"
    assert right.before != right.now
    assert by_name["second"].before == ""


def head_of(root: Path) -> str:
    return git(root, "rev-parse", "HEAD").strip()


@pytest.mark.parametrize("required", [False, True])
def test_an_unreadable_base_is_reported_and_red_if_required(repository: Path, tmp_path: Path, required: bool) -> None:
    settings = BaselineSettings(repository / FILE, required=required)
    git(tmp_path, "clone", "--quiet", "--depth=1", f"file://{repository}", "shallow")
    settings = replace(settings, file=tmp_path / "shallow" / FILE)
    update = with_accepted(MATRIX, settings, event(tmp_path, "a" * 40))[1]
    assert update.problem is not None
    assert "cannot be compared with: the commit aaaa" in update.problem
    assert bool(update.reasons) is required


def test_an_invalid_file_in_the_base_is_reported(repository: Path, tmp_path: Path) -> None:
    good = (repository / FILE).read_text()
    (repository / FILE).write_text('{"version": 7}')
    base = commit(repository, "of a newer version")
    (repository / FILE).write_text(good)
    commit(repository, "mended")
    update = with_accepted(MATRIX, BaselineSettings(repository / FILE), event(tmp_path, base))[1]
    assert "version: found 7" in str(update.problem)


def test_without_git_there_is_the_file_alone(
    tmp_path: Path, snapshots: tuple[CalibrationDocument, CalibrationDocument]
) -> None:
    write_baseline(tmp_path / FILE, Baseline(1, {"robot": snapshots[0]}))
    matrix, update = with_accepted(MATRIX, BaselineSettings(tmp_path / FILE), {})
    assert matrix.systems[0].accepted is not None
    assert matrix.systems[0].accepted.since == FILE
    assert (update.base, update.problem) == (None, None)


def test_differences_of_rounding_are_no_rows_and_no_change(
    snapshots: tuple[CalibrationDocument, CalibrationDocument],
) -> None:
    def shown(accepted: CalibrationDocument) -> tuple[int, str]:
        comparison, findings = against_baseline(Accepted(BaselineSettings(), accepted, FILE), snapshots[0])
        assert comparison is not None
        details = Details(changes=comparison.changes)
        cell = replace(CELL, details=details, findings=findings)
        results = PipelineResults((cell,), baseline=BaselineUpdate(file=FILE, since=FILE, compared=("robot",)))
        return len(changes_table(results).rows), baseline_line(results)

    [pose] = [each for each in snapshots[0].poses if each.sensor == "right"]

    def along_x(mm: float) -> CalibrationDocument:
        x, *yz = pose.xyz_mm
        poses = (replace(pose, xyz_mm=(x + mm, *yz)) if each is pose else each for each in snapshots[0].poses)
        return replace(snapshots[0], poses=tuple(poses))

    assert shown(along_x(1e-6)) == (0, f"Nothing has changed since {FILE}: robot")
    assert shown(along_x(pose.norm_mm)) == (1, f"Compared with {FILE}: robot")
    assert shown(replace(snapshots[0], rms_px=0.01)) == (0, f"Compared with {FILE}: robot")


def test_a_run_shows_what_the_change_accepts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = tmp_path / "robot"
    robot.mkdir()
    shutil.copy(ROOT / "datasets" / "t2rgb" / "dataset.json", robot)
    (tmp_path / "calibration.yml").write_text("systems: {robot: {dataset: robot, truth: none}}\n")
    (tmp_path / ".gitignore").write_text("output\n")
    monkeypatch.chdir(tmp_path)
    git(tmp_path, "init", "--quiet", "--initial-branch=main")
    assert main(["run"]) == 0
    assert main(["accept"]) == 0
    base = commit(tmp_path, "accepted")
    capsys.readouterr()
    assert main(["run"]) == 0
    assert re.search(rf"^Nothing has changed since {FILE} of \S+ \(\w{{7}}\): robot$", capsys.readouterr().out, re.M)
    displace(robot, "right_camera", (0.003, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert main(["run"]) == 1
    out = capsys.readouterr().out
    assert re.search(rf"^Compared with {FILE} of \S+ \(\w{{7}}\): robot$", out, re.M)
    assert "robot: right_camera" in out
    assert main(["accept"]) == 0
    commit(tmp_path, "knocked")
    for name, value in event(tmp_path, base).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "step.md"))
    capsys.readouterr()
    assert main(["run"]) == 0
    out = capsys.readouterr().out
    assert "Accepted by this change" in out
    assert "Since the baseline" not in out
    assert "Nothing has changed since" in out
    summary = (tmp_path / "step.md").read_text()
    assert "| robot: right\\_camera | " in summary
