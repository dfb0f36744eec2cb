"""``bundle`` and the stage deliver: what is bundled, what is left out, marked or refused; the same bytes everywhere."""

import base64
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from calibration.__main__ import main
from calibration.addons.delivery.manifest import unpack_files
from calibration.commands.schema import generated
from tests.repositories import git

from .bundles import OTHER_KEY, private_pem

ROOT = Path(__file__).parents[3]
CONFIGURATION = """\
assume: exact
exports: {formats: [ros2, tf-static, camera-info]}
systems:
  robot: {dataset: robot, truth: none, exports: {formats: [urdf, ros2], robot-description: robot/robot.urdf}}
  other: {dataset: robot, truth: none}
"""


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a repository with two systems that have passed, of which one is accepted."""
    folder = tmp_path_factory.mktemp("team")
    (folder / "robot").mkdir()
    for name in ("dataset.json", "robot.urdf"):
        shutil.copy(ROOT / "datasets" / "t2rgb" / name, folder / "robot")
    (folder / "calibration.yml").write_text(CONFIGURATION)
    (folder / ".gitignore").write_text("output\n*.pem\n")
    git(folder, "init")
    git(folder, "add", ".")
    git(folder, "commit", "-m", "Recorded")
    assert _run_in(folder, "run") == 0
    _run_in(folder, "accept", "--systems", "robot")
    git(folder, "add", ".")
    git(folder, "commit", "-m", "Accepted")
    return folder


def _run_in(folder: Path, *arguments: str) -> int:
    before = Path.cwd()
    os.chdir(folder)
    try:
        return main(list(arguments))
    finally:
        os.chdir(before)


@pytest.fixture
def team(calibrated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a copy of the repository, as working folder."""
    folder = tmp_path / "team"
    shutil.copytree(calibrated, folder, symlinks=True)
    monkeypatch.chdir(folder)
    monkeypatch.delenv("CALIBRATION_SIGNING_KEY", raising=False)
    return folder


def bundled(name: str = "robot") -> tuple[Any, dict[str, bytes]]:
    """Return the manifest and the files of the bundle."""
    files = unpack_files(Path(f"output/bundle/{name}.calibration.tar").read_bytes())
    return json.loads(files["manifest.json"]), files


def test_what_passed_and_is_accepted_is_bundled(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (team / "key.pem").write_text(private_pem())
    assert main(["bundle", "--signing-key-file", "key.pem", "--serial", "SN-7"]) == 0
    assert "other: left out: it is not accepted: calibration accept" in capsys.readouterr().err
    manifest, files = bundled()
    assert set(files) == {
        "manifest.json",
        *(f"robot/{name}" for name in ("calibrated.urdf", "calibrated.launch.py", "calibration.json")),
    }
    assert [(each["name"], each["verdict"], each["marks"]) for each in manifest["systems"]] == [("robot", "pass", [])]
    assert manifest["left_out"] == [{"name": "other", "why": "it is not accepted: calibration accept"}]
    head = git(team, "rev-parse", "HEAD~")
    assert (manifest["commit"], manifest["uncommitted"], manifest["serial"]) == (head, False, "SN-7")
    assert manifest["made"] == int(git(team, "log", "-1", "--format=%ct", head))
    envelope = json.loads(Path("output/bundle/robot.calibration.tar.intoto.jsonl").read_text())
    statement = json.loads(base64.b64decode(envelope["payload"]))
    predicate = statement["predicate"]
    assert (statement["_type"], predicate["result"]) == ("https://in-toto.io/Statement/v1", "WARNED")
    assert predicate["passedTests"] == ["robot, 0 m, 0 rad, seed 1"]
    assert {"name": "commit", "digest": {"gitCommit": head}} in predicate["configuration"]
    assert json.loads(Path("output/bundle/robot.calibration.tar.predicate.json").read_text()) == predicate


def test_the_bundle_is_verified_against_what_it_delivers(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bundle"]) == 0
    assert main(["verify", "output/bundle", "--unsigned", "--unpack", "there"]) == 0
    capsys.readouterr()
    used = "there/robot/calibrated.urdf,there/robot/calibrated.launch.py"
    assert main(["verify", "there", "--unsigned", "--description", "robot/robot.urdf", "--in-use", used]) == 0
    assert main(["verify", "there", "--unsigned", "--in-use", "robot/robot.urdf"]) == 1
    assert "error: robot/robot.urdf: camera_right_rgb_frame: found it " in capsys.readouterr().err


def test_the_manifest_has_its_schema(team: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    assert main(["bundle"]) == 0
    jsonschema.validate(bundled()[0], json.loads(generated("bundle-manifest")))


def test_the_same_input_has_the_same_digest_anywhere(team: Path, tmp_path: Path) -> None:
    assert main(["bundle"]) == 0
    first = Path("output/bundle/robot.calibration.tar").read_bytes()
    elsewhere = tmp_path / "other machine"
    shutil.copytree(team, elsewhere, symlinks=True)
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "7"}
    environment |= {"TZ": "Pacific/Kiritimati", "LC_ALL": "tr_TR.UTF-8", "HOME": "/nonexistent"}
    done = subprocess.run(
        [
            *(sys.executable, "-m", "calibration", "bundle", "--config", "../other machine/calibration.yml"),
            *("--output", str(elsewhere / "output")),
        ],
        cwd=tmp_path / "team",
        env=environment,
        umask=0o077,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0
    assert (elsewhere / "output/bundle/robot.calibration.tar").read_bytes() == first


def test_another_time_is_another_bundle(team: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    assert main(["bundle"]) == 0
    manifest, _ = bundled()
    assert (manifest["made"], manifest["version"]) == (86400, "19700102.000000")


def test_what_is_not_accepted_is_refused_by_name_and_bundled_with_a_reason_only(
    team: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bundle", "--systems", "robot,other"]) == 2
    assert "other: not bundled: it is not accepted" in capsys.readouterr().err
    assert main(["bundle", "--systems", "robot,other", "--although", "a test"]) == 0
    manifest, _ = bundled()
    assert [each["marks"] for each in manifest["systems"]] == [[], ["it is not accepted: calibration accept"]]
    assert main(["verify", "output/bundle", "--unsigned"]) == 1
    assert main(["verify", "output/bundle", "--unsigned", "--marked"]) == 0


def test_a_red_system_is_not_bundled(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (team / "calibration.yml").write_text(CONFIGURATION + "limits: {rms-px: 0.0001}\n")
    assert main(["bundle"]) == 2  # judged by the configuration as it is now
    assert "robot: not bundled: fail: RMS" in capsys.readouterr().err
    assert main(["bundle", "--although", "a test", "--systems", "robot"]) == 0
    manifest, _ = bundled()
    [system] = manifest["systems"]
    assert system["verdict"] == "fail"
    assert system["marks"][0].startswith("fail: RMS")
    assert manifest["uncommitted"] is True


def test_another_calibration_than_the_accepted_one_is_not_bundled(team: Path) -> None:
    path = team / "calibration-baseline.json"
    baseline = json.loads(path.read_text())
    poses = baseline["systems"]["robot"]["poses"]
    path.write_text(json.dumps(baseline))
    assert main(["bundle"]) == 0
    assert bundled()[0]["uncommitted"] is True
    poses[-1]["xyz-mm"][0] += 0.1
    path.write_text(json.dumps(baseline))
    assert main(["bundle"]) == 2
    poses[-1]["xyz-mm"][0] -= 0.1
    baseline["systems"]["robot"]["data"] = "0" * 64
    path.write_text(json.dumps(baseline))
    assert main(["bundle"]) == 2


def test_a_run_that_is_red_beside_its_cells_is_not_bundled(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = team / "output/results.json"
    results = json.loads(path.read_text())
    results["exports"][0]["reasons"] = ["robot: exports: no frame"]
    path.write_text(json.dumps(results))
    assert main(["bundle"]) == 2
    why = "the run is red: robot: exports: no frame"
    assert why in capsys.readouterr().err
    assert main(["bundle", "--although", "a test"]) == 0
    assert [each["marks"][0] for each in bundled()[0]["systems"]] == [why, why]


@pytest.mark.parametrize("text", ["x", "-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----"])
def test_a_wrong_key_is_an_error_that_does_not_quote_it(
    team: Path, text: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CALIBRATION_SIGNING_KEY", text)
    assert main(["bundle"]) == 2
    shown = "".join(capsys.readouterr())
    assert "CALIBRATION_SIGNING_KEY: expected an unencrypted private key in PEM" in shown
    assert "AAAA" not in shown
    assert not Path("output/bundle").exists() or not list(Path("output/bundle").glob("*.tar"))


def test_a_key_on_the_command_line_is_refused(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bundle", "--signing-key", private_pem()]) == 2
    shown = "".join(capsys.readouterr())
    assert "every process reads it" in shown
    assert private_pem().splitlines()[1] not in shown


def test_a_system_without_a_calibrated_dataset_is_left_out(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = team / "output/results.json"
    results = json.loads(path.read_text())
    for cell in results["cells"]:
        cell["folder"], cell["dataset"] = str(Path(cell["dataset"]).parent), None
    path.write_text(json.dumps(results))
    assert main(["bundle"]) == 2
    assert "robot: not bundled: it keeps no calibrated dataset" in capsys.readouterr().err


def test_a_bundle_of_no_commit_needs_a_time(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(team / ".git")
    assert main(["bundle"]) == 2
    assert "expected one: a bundle says when it was made" in capsys.readouterr().err


def test_the_stage_bundles_what_it_may_and_says_why_not(team: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CALIBRATION_SIGNING_KEY", private_pem(OTHER_KEY))
    (team / "calibration.yml").write_text(CONFIGURATION + "delivery: {serial: SN-3, version: '2.1', name: rig}\n")
    (team / "output/bundle").mkdir(exist_ok=True)
    (team / "output/bundle/older.calibration.tar").write_bytes(b"")
    assert main(["run", "--only", "introspect,deliver"]) == 0
    found = json.loads((team / "output/results.json").read_text())["delivery"]
    assert (found["verdict"], found["bundle"]["systems"], found["bundle"]["version"]) == ("pass", ["robot"], "2.1")
    assert sorted(path.name for path in (team / "output/bundle").iterdir()) == [
        f"rig.calibration.tar{ending}" for ending in ("", ".intoto.jsonl", ".predicate.json")
    ]
    assert bundled("rig")[0]["serial"] == "SN-3"
    (team / "calibration-baseline.json").unlink()
    assert main(["run", "--only", "introspect,deliver"]) == 0
    found = json.loads((team / "output/results.json").read_text())["delivery"]
    assert found["bundle"] is None
    assert "robot: not bundled: it is not accepted" in found["why_not"]
    assert not list((team / "output/bundle").iterdir())
