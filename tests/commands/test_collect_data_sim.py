import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.commands.collect_data_sim import CollectionSettings, collection_request, described_applications
from calibration.engine.dataset.reading import read_dataset
from calibration.pipeline.collection.request import CollectionLimits, CollectionRequest
from tests.small import first_poses

PROJECT = Path(__file__).resolve().parents[2]
T2RGB = PROJECT / "datasets" / "t2rgb"
SCENARIOS = ("--system", "t2rgb", "--scenario-set", "datasets/scenarios.yml", "--scenarios", "2")


@pytest.fixture(autouse=True)
def in_project(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(PROJECT)
    for variable in ("GITHUB_ACTIONS", "GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY"):
        monkeypatch.delenv(variable, raising=False)


@pytest.fixture
def motion(small: Path, tmp_path: Path) -> Path:
    return first_poses(small, 4, tmp_path / "four.json")


def run(*arguments: str | Path) -> int:
    return main(["collect-data-sim", *map(str, arguments)])


def snapshot(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_system_by_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output, motion = tmp_path / "output", first_poses(T2RGB, 4, tmp_path / "four.json")
    assert run("--system", "t2rgb", "--motion", motion, "--output", output) == 0
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert lines[0] == f"t2rgb: 4 poses of {motion}, seed 1"
    assert re.fullmatch(r"\[1/4\] pose [1-4]: left_camera \d+, right_camera \d+", lines[1])
    assert lines[5].split()[:2] == ["Sensor", "Detected"]
    assert lines[-1].startswith("pass: t2rgb: 4 of 4 collections kept, calibrates with 0.")
    assert lines[-1].endswith(f"({output}/results.json)")
    assert len(read_dataset(output).collections) == 4


def test_a_generated_motion(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "dataset"
    assert run("--system", small, "--motion", "generate:3", "--seed", "9", "--output", output) == 0
    assert capsys.readouterr().out.startswith("small: 3 poses of a generated motion, seed 9\n")
    assert json.loads((output / "ground_truth.json").read_text())["seed"] == 9


def test_a_users_own_folder_robot_and_configuration(
    small: Path, motion: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "mine"
    shutil.copytree(small, source, ignore=shutil.ignore_patterns("*.json"))
    robot, config = tmp_path / "r.urdf", tmp_path / "c.yml"
    (source / "robot.urdf").rename(robot)
    (source / "config.yml").rename(config)
    monkeypatch.chdir(tmp_path)
    arguments = ("--robot", robot, "--config", config, "--motion", motion, "--output", "out/put")
    assert run("--system", "mine", *arguments) == 0
    dataset = read_dataset(tmp_path / "out" / "put")
    assert dataset.document["_metadata"]["dataset_name"] == "mine"
    assert dataset.collections[0].labels.keys() == {("pattern_1", "left_camera"), ("pattern_1", "right_camera")}


def test_an_old_dataset_needs_the_flag(
    small: Path, motion: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "output"
    arguments = ("--system", small, "--motion", motion, "--output", output)
    assert run(*arguments) == 0
    first = snapshot(output)
    capsys.readouterr()
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert f"{output}/dataset.json: exists already; --overwrite replaces the dataset" in err
    assert len(err.splitlines()) == 1
    assert out == ""
    assert run(*arguments, "--seed", "2", "--overwrite") == 0
    assert snapshot(output) != first
    assert run(*arguments, "--overwrite", "true") == 0
    assert snapshot(output) == first


def test_red_is_red(small: Path, motion: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("--system", small, "--motion", motion, "--output", tmp_path / "output")
    assert run(*arguments, "--minimum-collections", "5") == 1
    out, err = capsys.readouterr()
    assert "collections: found 4, expected at least 5" in out + err
    assert out.splitlines()[-1].startswith("fail: small: 4 of 4 collections kept")
    assert run(*arguments, "--overwrite", "--max-translation-mm", "0.000001") == 1
    assert run(*arguments, "--overwrite", "--minimum-coverage", "1") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--system", "t3rgb"),
            "system: found 't3rgb', expected one of riwbot, rlbot, softbot, spjbot, t2rgb or a folder",
        ),
        (("--system", ""), "system: found '', expected one of riwbot, rlbot, softbot, spjbot, t2rgb or a folder"),
        (("--system", "t2rgb", "--backend", "doker"), "backend: found 'doker', expected embedded, docker or aws-batch"),
        (("--system", "t2rgb", "--backend", "docker"), "backend: found docker; it runs the team's applications"),
        (("--system", "t2rgb", "--backend", "aws-batch"), "backend: found aws-batch; it runs the team's applications"),
        (("--system", "t2rgb", "--image", "robot:1"), "image: is for containers: give applications"),
        (("--system", "t2rgb", "--run", "mine"), "run-name: is for containers"),
        (("--system", "t2rgb", "--timeout", "1h"), "timeout: is for containers"),
        (("--system", "t2rgb", "--resume"), "resume: is for scenarios in containers: backend docker or aws-batch"),
        (("--system", "t2rgb", "--ros", "1"), "ros: needs applications"),
        (
            (*SCENARIOS, "--backend", "docker"),
            "image: missing: docker runs every scenario in an image that has calibration-ci",
        ),
        (
            (*SCENARIOS, "--backend", "aws-batch", "--image", "i", "--aws-batch", "no.yml"),
            "no.yml: a file with a section aws-batch",
        ),
        (
            (*SCENARIOS, "--backend", "aws-batch", "--image", "i", "--aws-batch", "datasets/scenarios.yml"),
            "datasets/scenarios.yml: missing aws-batch: region, queue, bucket, tools-image, job-role",
        ),
        ((*SCENARIOS, "--minimum-coverage", "0.5"), "minimum-coverage: judges one dataset"),
        (
            ("--system", "t2rgb", "--robot-command", "run", "--image", "i", "--resume"),
            "resume: one dataset has no part that could be missing",
        ),
        (
            (
                *("--system", "t2rgb", "--robot-command", "run", "--image", "i"),
                "--scenarios",
                "2",
                "--scenario",
                "s1-00000",
            ),
            "scenario: give either scenarios (how many) or scenario (the id of one)",
        ),
        (
            ("--system", "t2rgb", "--robot-command", "run", "--image", "i", "--scenario", "7"),
            "scenario: found '7', expected an id such as s1-00017",
        ),
        (("--system", "t2rgb", "--robot-command", "run"), "containers.robot: missing image"),
        (
            ("--system", "t2rgb", "--robot-command", "run", "--image", "i", "--backend", "embedded"),
            "backend: found embedded",
        ),
        (
            ("--system", "t2rgb", "--robot-command", "run {sed}", "--image", "i"),
            "there is no placeholder '{sed}': did you mean 'seed'",
        ),
        (
            ("--system", "t2rgb", "--robot-command", "run", "--image", "i", "--scenario-set", "s", "--scenarios", "2"),
            "scenario-set: scenarios vary in our own simulation only; applications receive {scenario}",
        ),
        (
            ("--system", "t2rgb", "--robot-command", "run", "--image", "i", "--player", "ros1"),
            "ros1 needs a ROS master",
        ),
        (("--system", "t2rgb", "--applications", "none.yml"), "none.yml"),
        (
            ("--system", "t2rgb", "--motion", "generate:0"),
            "motion: found 'generate:0', expected generate:N with N from 1",
        ),
        (
            ("--system", "t2rgb", "--motion", "generate:x"),
            "motion: found 'generate:x', expected generate:N with N from 1",
        ),
        (("--system", "t2rgb", "--motion", "generate:1001"), "expected generate:N with N from 1 to 1000"),
        (("--system", "t2rgb", "--motion", "no.json"), "it cannot be read: No such file or directory"),
        (("--system", "t2rgb", "--seed", "-1"), "seed: found -1, expected a whole number of at least 0"),
        (("--system", "t2rgb", "--seed", "x"), "'x' is not a whole number"),
        (("--system", "t2rgb", "--minimum-detection-rate", "1.5"), "'1.5' is above 1"),
        (("--system", "t2rgb", "--robot", "no.urdf"), "no.urdf: a robot description was expected"),
        (("--system", "t2rgb", "--robot", "datasets/rlbot/robot.urdf"), "config.yml: sensors/left_camera/link: frame"),
        (("--system", "tests"), "simulation.yml: the description of a simulation was expected"),
        (("--system", "t2rgb", "--motion", "datasets/riwbot/motion.json"), "riwbot/motion.json: found no position"),
        ((), "Missing option '--system'"),
        (("--system", "t2rgb", "--scenarios", "3"), "scenarios and scenario need a scenario-set"),
        (("--system", "t2rgb", "--scenario", "s1-00001"), "scenarios and scenario need a scenario-set"),
        (("--system", "t2rgb", "--scenario-set", "datasets/scenarios.yml"), "scenario-set: give either scenarios"),
        (
            ("--system", "t2rgb", "--scenario-set", "datasets/scenarios.yml", "--scenario", "17"),
            "scenario: found '17', expected an id such as s1-00017",
        ),
        (
            ("--system", "t2rgb", "--scenario-set", "no.yml", "--scenarios", "3"),
            "no.yml: a scenario set was expected",
        ),
        (
            ("--system", "t2rgb", "--scenario-set", "no.yml", "--scenarios", "1000000"),
            "scenarios: found 1000000, expected 100000 at most",
        ),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    arguments: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*arguments, "--output", tmp_path / "output") == 2
    out, err = capsys.readouterr()
    assert message in err
    assert len(err.splitlines()) == 1
    assert "Traceback" not in out + err
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_applications_is_an_entry_of_calibration_yml_and_options_take_precedence(tmp_path: Path) -> None:
    file = tmp_path / "applications.yml"
    file.write_text("containers: {robot: {image: i, command: run}}\nseed: 7\nlimits: {translation-mm: 9}\ntruth: none")

    def asked(keys: dict[str, object], **inputs: float) -> CollectionRequest:
        settings = CollectionSettings(system="t2rgb", applications=file, output=tmp_path, keys=keys, **inputs)
        return collection_request(settings, described_applications(settings))

    told = asked({})
    assert (told.name, told.seed, told.truth, told.effective_checks.limits) == (
        "t2rgb",
        7,
        "none",
        CollectionLimits(9),
    )
    given = asked({"seed": 8, "truth": "dataset"}, max_translation_mm=4)
    assert (given.seed, given.truth, given.effective_checks.limits) == (8, "dataset", CollectionLimits(4, 0.3))


def test_our_own_simulation_knows_its_truth(tmp_path: Path) -> None:
    settings = CollectionSettings(system="t2rgb", output=tmp_path, keys={"truth": "none"})
    request = collection_request(settings, {})
    assert (request.truth, request.effective_checks.limits) == (None, CollectionLimits(5, 0.3))


def test_a_name_where_there_are_no_systems(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["collect-data-sim", "--system", "t2rgb", "--output", "x"]) == 2
    error = capsys.readouterr().err
    assert "found 't2rgb', expected a folder with robot.urdf, config.yml and simulation.yml" in error
    assert f"{tmp_path} has no datasets/" in error


def test_a_system_without_a_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(T2RGB, tmp_path / "mine", ignore=shutil.ignore_patterns("*.json", "*.jpg"))
    assert run("--system", tmp_path / "mine", "--output", tmp_path / "output") == 2
    assert "mine/motion.json: does not exist; give a motion: a file or generate:N" in capsys.readouterr().err


def test_outputs_of_the_step(small: Path, motion: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_OUTPUT", str(tmp_path / "outputs"))
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "summary"))
    output = tmp_path / "d"
    assert run("--system", small, "--motion", motion, "--output", output) == 0
    found = dict(line.split("=", 1) for line in (tmp_path / "outputs").read_text().splitlines())
    assert found["verdict"] == "pass"
    assert found["dataset"] == str(output)
    assert found["collections"] == "4"
    assert json.loads(found["lost"]) == []
    assert json.loads(found["detection-rate"]) == {"left_camera": 1.0, "right_camera": 1.0}
    assert 0.01 < float(found["corner-error-px"]) < 0.2
    assert 0 < float(found["translation-mm"]) < 1
    assert 0 < float(found["rotation-deg"]) < 0.1
    assert Path(found["contact-sheet"]).exists()
    assert Path(found["results"]).exists()
    assert "## Collection in simulation: pass" in (tmp_path / "summary").read_text()


def test_a_scenario_whose_process_dies_leaves_no_temporary_folder(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.setattr("calibration.robot.simulation.scenarios.run.prove", lambda *_, **__: os._exit(3))
    scenarios = tmp_path / "scenarios.yml"
    scenarios.write_text("assembly: {translation_mm: {normal: [0, 3]}}\nmotion: {poses: 2}\n")
    arguments = ("--system", small, "--scenario-set", scenarios, "--scenarios", "2", "--jobs", "2")
    assert run(*arguments, "--output", tmp_path / "all") == 3
    assert "a worker process died" in capsys.readouterr().err
    assert list((tmp_path / "tmp").iterdir()) == []


@pytest.mark.thorough
def test_many_scenarios_and_one_of_them_again(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenarios = tmp_path / "scenarios.yml"
    scenarios.write_text("assembly: {translation_mm: {normal: [0, 3]}}\nmotion: {poses: 3}\n")
    common = ("--system", small, "--scenario-set", scenarios)
    assert run(*common, "--scenarios", "3", "--seed", "4", "--output", tmp_path / "all") == 0
    out = capsys.readouterr().out
    assert out.startswith(f"small: 3 scenarios of {scenarios}, seed 4\n")
    assert "pass: 3 of 3 scenarios of small pass" in out.splitlines()[-1]
    files = snapshot(tmp_path / "all")
    assert set(files) == {"results.json", "scenarios.csv", "scenarios.png", "summary.md", "junit.xml"}
    document = json.loads(files["results.json"])
    assert [each["id"] for each in document["scenarios"]] == ["s4-00000", "s4-00001", "s4-00002"]
    assert run(*common, "--scenario", "s4-00002", "--output", tmp_path / "one") == 0
    again = json.loads((tmp_path / "one" / "results.json").read_text())["calibration"]
    assert again["translation_mm"] == document["scenarios"][2]["translation_mm"]
    assert again["rms_px"] == document["scenarios"][2]["rms_px"]
    assert run(*common, "--scenarios", "1", "--max-translation-mm", "0.00001", "--output", tmp_path / "red") == 1
    assert json.loads((tmp_path / "red" / "results.json").read_text())["success_rate"] == 0
    rate = ("--minimum-success-rate", "0")
    assert run(*common, "--scenarios", "1", "--max-translation-mm", "0.00001", *rate, "--output", tmp_path / "red") == 0


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("struck", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_run_leaves_no_half_dataset_and_goes_on(struck: signal.Signals, small: Path, tmp_path: Path) -> None:
    output = tmp_path / "output"
    command = [sys.executable, "-m", "calibration", "collect-data-sim", "--system", str(small), "--output", str(output)]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("COVERAGE")}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("[ 3/"):
                process.send_signal(struck)
                break
        rest = process.stdout.read()
        code = process.wait(60)
    assert code == (-struck if struck == signal.SIGKILL else 128 + struck), rest
    assert "Traceback" not in rest
    assert struck == signal.SIGKILL or " poses are done: the same command goes on from there" in rest
    assert not (output / "dataset.json").exists()
    done = len(list((output / ".unfinished").glob("*.result.json")))
    assert done >= 3
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:  # workers of a killed parent die too, and release the lock
        again = subprocess.run([*command, "--jobs", "2"], capture_output=True, text=True, check=False, env=environment)
        if "another collection into this folder is running" not in again.stderr:
            break
        time.sleep(0.2)
    assert again.returncode == 0, again.stdout + again.stderr
    assert (output / "dataset.json").exists()
    assert not (output / ".unfinished").exists()
