"""``fleet``: robots that stand out, in a repository with a folder for each."""

import json
import time
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.base.records import text_of
from calibration.engine.baseline.calibration_document import CalibratedPose, CalibrationDocument
from calibration.engine.baseline.document import BASELINE_VERSION, Baseline, write_baseline
from calibration.pipeline.stages import ExportedCalibration
from tests.engine.baseline.test_fleet import fleet
from tests.repositories import git

from .bundles import MANIFEST, NAME, SYSTEM, packed

ROBOTS = 10


def calibration(pose: CalibratedPose) -> CalibrationDocument:
    return CalibrationDocument(
        data="1" * 64, collections=9, engine="1", poses=(pose,), rejected_labels=0, labels=9, iterations=3, views={}
    )


@pytest.fixture
def robots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a repository with ten robots, all alike and accepted, and what was delivered of them."""
    folder = tmp_path / "robots"
    for name, pose in fleet(1, ROBOTS)["mount"].items():
        document = calibration(pose)
        (folder / name).mkdir(parents=True)
        write_baseline(folder / name / "calibration-baseline.json", Baseline(BASELINE_VERSION, {"stereo": document}))
        exported = ExportedCalibration(1, "stereo", "pass", None, document)
        manifest = replace(MANIFEST, name=name, systems=(SYSTEM,))
        content = packed(manifest, **{"stereo/calibration.json": text_of(exported).encode()})
        delivered = tmp_path / "delivered" / name / "1.0.0"
        delivered.mkdir(parents=True)
        (delivered / NAME).write_bytes(content)
    git(tmp_path, "init")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-m", "Accepted")
    monkeypatch.chdir(tmp_path)
    return folder


def results() -> dict[str, list[str]]:
    """Return the reasons of each robot that stands out."""
    document = json.loads(Path("output/fleet/results.json").read_text())
    return {each["name"]: each["reasons"] for each in document["robots"] if each["reasons"]}


OPTIONS = ("fleet", "robots", "--max-age", "30d", "--delivered", "delivered/{robot}")


def test_robots_that_are_alike_pass(robots: Path) -> None:
    assert main([*OPTIONS]) == 0
    assert results() == {}
    page = Path("output/fleet/fleet.html").read_text()
    assert "stereo: camera, mm, robot robot 0: " in page
    found = json.loads(Path("output/fleet/results.json").read_text())["robots"]
    assert {each["delivered"] for each in found} == {"1.4"}


def test_each_robot_that_stands_out_is_named_with_its_reason(robots: Path) -> None:
    path = robots / "robot 2/calibration-baseline.json"
    document = json.loads(path.read_text())
    document["systems"]["stereo"]["poses"][0]["xyz-mm"][0] += 60
    path.write_text(json.dumps(document))
    (robots / "new").mkdir()
    (robots / "new/calibration.yml").write_text("systems: {}\n")
    (robots / "docs").mkdir()
    (robots / "robot 3/calibration-baseline.json").write_text("{")
    (Path("delivered") / "robot 4/1.0.0" / NAME).unlink()
    assert main([*OPTIONS]) == 1
    found = results()
    assert sorted(found) == ["new", "robot 2", "robot 3", "robot 4"]
    moved, outlier = found["robot 2"]
    assert moved.startswith("1.4, which was delivered, is another calibration: stereo: camera: 60 ")
    assert outlier.startswith("stereo: camera is not like the fleet's: ")
    assert found["new"] == ["no calibration of it is accepted"]
    assert "this is not a baseline" in found["robot 3"][0]
    assert found["robot 4"][0].startswith("nothing was delivered: ")


def test_an_old_calibration_stands_out(robots: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    later = time.time() + 40 * 86400
    monkeypatch.setattr(time, "time", lambda: later)
    assert main([*OPTIONS]) == 1
    assert [*results().values()] == [["its calibration is 40 days old, expected at most 30 days"]] * ROBOTS


def test_wrong_inputs_are_errors(robots: Path, tmp_path: Path) -> None:
    assert main(["fleet", "nowhere"]) == 2
    assert main(["fleet", "delivered"]) == 2
    assert main(["fleet", "robots", "--delivered", "delivered"]) == 2
