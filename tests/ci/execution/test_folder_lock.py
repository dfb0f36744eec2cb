"""Locks of output folders: one run at a time, in any process, and none after its process was killed."""

import fcntl
import subprocess
import sys
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.base import InfrastructureError, InputError
from calibration.ci.execution.tasks import locked

HOLDING = """
import sys, time
from pathlib import Path
from calibration.ci.execution.tasks import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(600)
"""
T2RGB = str(Path(__file__).parents[3] / "datasets/t2rgb")


def test_one_at_a_time_until_it_is_killed(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with subprocess.Popen([sys.executable, "-c", HOLDING, folder], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"locked\n"
        with (
            pytest.raises(InputError, match="a/b: another run uses this folder; wait for it, or stop it"),
            locked(folder),
        ):
            pass
        process.kill()
    with locked(folder):
        assert list(folder.iterdir()) == []
    assert folder.is_dir()  # which another has made


def test_folders_that_stay_empty_are_removed(tmp_path: Path) -> None:
    with locked(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()
    assert list(tmp_path.iterdir()) == []
    with locked(tmp_path / "a" / "b"):
        (tmp_path / "a" / "file").touch()
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "file"]


def test_a_folder_that_another_run_removes_before_it_is_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, lock, calls = tmp_path / "a", fcntl.flock, []

    def locking_late(descriptor: int, operation: int) -> None:
        calls.append(descriptor)
        if len(calls) == 1:
            folder.rmdir()
            folder.mkdir()
        lock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", locking_late)
    with locked(folder), pytest.raises(InputError, match="another run uses this folder"), locked(folder):
        pass


def test_an_empty_folder_is_removed_under_its_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else it is removed from under another run that has locked it in the meantime."""
    folder, removed, remove = tmp_path / "a", [], Path.rmdir

    def removing(path: Path) -> None:
        with pytest.raises(InputError, match="another run uses this folder"), locked(path):
            pass
        removed.append(path)
        remove(path)

    monkeypatch.setattr(Path, "rmdir", removing)
    with locked(folder):
        pass
    assert removed == [folder]


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InfrastructureError, match="it, or a folder above it, is a file"), locked(path):
            pass


@pytest.fixture
def configuration(tmp_path: Path) -> Path:
    path = tmp_path / "robot" / "calibration.yml"
    path.parent.mkdir()
    path.write_text(f"systems: {{t2rgb: {{dataset: {T2RGB}}}}}\n")
    return path


def test_run_and_calibrate_matrix_wait_for_nobody(
    tmp_path: Path, configuration: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "output"
    with locked(output):
        for command in (["run", "--config", str(configuration)], ["calibrate-matrix", "--dataset", T2RGB]):
            assert main([*command, "--output", str(output)]) == 2
            assert f"{output}: another run uses this folder" in capsys.readouterr().err
        assert list(output.iterdir()) == []


def test_accept_needs_the_results_and_the_file_for_itself(
    tmp_path: Path, configuration: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "output"
    accepting = ["accept", "--config", str(configuration), "--output", str(output)]
    assert main(["run", "--config", str(configuration), "--output", str(output)]) == 0
    for folder in (output, configuration.parent):
        with locked(folder):
            assert main(accepting) == 2
        assert f"{folder}: another run uses this folder" in capsys.readouterr().err
        assert [path.name for path in configuration.parent.iterdir()] == ["calibration.yml"]
    assert main(accepting) == 0


def test_accept_where_results_and_file_are_in_one_folder(configuration: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(configuration.parent)
    assert main(["run", "--output", "."]) == 0
    assert main(["accept", "--output", "."]) == 0
