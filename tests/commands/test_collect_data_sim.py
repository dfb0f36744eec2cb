import shutil
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.dataset.reading import read_dataset

PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def in_project(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(PROJECT)
    for variable in ("GITHUB_ACTIONS", "GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY"):
        monkeypatch.delenv(variable, raising=False)


def run(*arguments: str | Path) -> int:
    return main(["collect-data-sim", *map(str, arguments)])


def same_files(a: Path, b: Path) -> bool:
    files = [{path.name: path.read_bytes() for path in folder.iterdir()} for folder in (a, b)]
    return files[0] == files[1]


@pytest.mark.parametrize("name", ["t2rgb", "rlbot", "riwbot"])
def test_a_system_that_ships_by_its_name(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--system", name, "--output", tmp_path / name) == 0
    assert same_files(tmp_path / name, PROJECT / "datasets" / name)
    out, err = capsys.readouterr()
    assert err == ""
    count = len(read_dataset(tmp_path / name).collections)
    lines = out.splitlines()
    assert lines[0] == f"{name}: {count} poses of datasets/{name}/motion.json, seed 1"
    assert lines[1].startswith(f"   1/{count}  ")
    assert lines[-1] == f"{count} collections in {tmp_path / name}"


def test_what_was_detected_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "dataset"
    assert run("--system", "rlbot", "--motion", "generate:3", "--seed", "9", "--output", output) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "rlbot: 3 poses of a generated motion, seed 9"
    assert lines[1].startswith("   1/3  rgb_left ")
    assert " corners, lidar_right " in lines[1]
    assert lines[-3] == "lidar_right: detected in 3 of 3 collections"
    assert lines[-2].startswith("rgb_left: detected in 3 of 3 collections, ")


def test_a_users_own_folder_robot_and_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "mine"
    shutil.copytree(PROJECT / "datasets" / "t2rgb", source, ignore=shutil.ignore_patterns("*.json"))
    robot, config = tmp_path / "r.urdf", tmp_path / "c.yml"
    (source / "robot.urdf").rename(robot)
    (source / "config.yml").rename(config)
    monkeypatch.chdir(tmp_path)
    motion = PROJECT / "datasets" / "t2rgb" / "motion.json"
    arguments = ("--robot", robot, "--config", config, "--motion", motion, "--output", "out/put")
    assert run("--system", "mine", *arguments) == 0
    dataset = read_dataset(tmp_path / "out" / "put")
    assert dataset.document["_metadata"]["dataset_name"] == "mine"
    assert dataset.collections[0].labels.keys() == {("pattern_1", "left_camera"), ("pattern_1", "right_camera")}


def test_an_old_dataset_needs_the_flag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("--system", "riwbot", "--output", tmp_path)
    assert run(*arguments) == 0
    capsys.readouterr()
    assert run(*arguments) == 2
    out, err = capsys.readouterr()
    assert f"{tmp_path}/dataset.json: exists already; --overwrite replaces the dataset" in err
    assert len(err.splitlines()) == 1
    assert out == ""
    assert run(*arguments, "--seed", "2", "--overwrite") == 0
    assert not same_files(tmp_path, PROJECT / "datasets" / "riwbot")
    assert run(*arguments, "--overwrite", "true") == 0
    assert same_files(tmp_path, PROJECT / "datasets" / "riwbot")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--system", "t3rgb"), "system: found 't3rgb', expected one of riwbot, rlbot, t2rgb or a folder"),
        (("--system", ""), "system: found '', expected one of riwbot, rlbot, t2rgb or a folder"),
        (("--system", "t2rgb", "--backend", "docker"), "backend: found 'docker', expected embedded"),
        (
            ("--system", "t2rgb", "--motion", "generate:0"),
            "motion: found 'generate:0', expected generate:N with N from 1",
        ),
        (
            ("--system", "t2rgb", "--motion", "generate:x"),
            "motion: found 'generate:x', expected generate:N with N from 1",
        ),
        (("--system", "t2rgb", "--motion", "no.json"), "it cannot be read: No such file or directory"),
        (("--system", "t2rgb", "--seed", "-1"), "'-1' is not a whole number of at least 0"),
        (("--system", "t2rgb", "--seed", "x"), "'x' is not a whole number of at least 0"),
        (("--system", "t2rgb", "--robot", "no.urdf"), "no.urdf: a file of the system was expected"),
        (("--system", "t2rgb", "--robot", "datasets/rlbot/robot.urdf"), "config.yml: sensors/left_camera/link: frame"),
        (("--system", "tests"), "robot.urdf: a file of the system was expected"),
        (("--system", "t2rgb", "--motion", "datasets/riwbot/motion.json"), "riwbot/motion.json: found no position"),
        ((), "Missing option '--system'"),
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


def test_a_system_without_a_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(PROJECT / "datasets" / "t2rgb", tmp_path / "mine", ignore=shutil.ignore_patterns("*.json"))
    assert run("--system", tmp_path / "mine", "--output", tmp_path / "output") == 2
    assert "mine/motion.json: does not exist; give a motion: a file or generate:N" in capsys.readouterr().err


def test_outputs_of_the_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_OUTPUT", str(tmp_path / "outputs"))
    assert run("--system", "riwbot", "--output", tmp_path / "d") == 0
    assert (tmp_path / "outputs").read_text().splitlines() == [
        f"dataset={tmp_path / 'd'}",
        "collections=24",
        'detections={"rgb_world": 24}',
    ]
