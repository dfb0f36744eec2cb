"""An engine that dies, or stops answering, during a run: one message, exit code 3."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from calibration.ci.execution.docker.labels import new_run
from calibration.ci.execution.docker.run_objects import find_leftovers
from tests.docker_engine import OwnEngine, only_sleep, started_engine, wait_until

PROJECT = Path(__file__).resolve().parents[3]
IMAGE = "only-sleep:1"


@pytest.fixture
def own_engine(monkeypatch: pytest.MonkeyPatch) -> Iterator[OwnEngine]:
    with started_engine("--storage-driver=vfs") as engine:
        client = engine.api()
        client.api.import_image_from_data(only_sleep(), *IMAGE.split(":"))
        client.close()
        monkeypatch.setenv("DOCKER_HOST", engine.address)
        yield engine


def start(folder: Path, run: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.integration.execution.program", "bare", run, str(folder), IMAGE]
    return subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def running(engine: OwnEngine, run: str) -> int:
    client = engine.api()
    try:
        return sum(each.state == "running" for each in find_leftovers(client.api, run))
    finally:
        client.close()


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_lost_in_mid_run(own_engine: OwnEngine, tmp_path: Path, number: signal.Signals) -> None:
    """Killed, its connections break; stopped, it keeps them without answering."""
    run = new_run()
    with start(tmp_path, run) as process:
        try:
            wait_until(lambda: running(own_engine, run) == 2, "both jobs run")
            own_engine.process.send_signal(number)
            out, err = process.communicate(timeout=120)
        finally:
            process.kill()
    assert process.returncode == 3, out + err
    lines = [line for line in out.splitlines() if " | " not in line]
    assert sorted(line.split()[:2] for line in lines) == [["j0", "3"], ["j1", "3"]]
    for line in lines:
        assert f"the Docker Engine at {own_engine.address} does not answer any more" in line
        assert line.endswith(f"of this run: calibration cleanup --run {run}")
    assert err == ""


def test_nothing_is_left_when_it_is_back(own_engine: OwnEngine, tmp_path: Path) -> None:
    """`calibration cleanup` finds the leftovers of a lost engine by their labels."""
    run = new_run()
    with start(tmp_path, run) as process:
        wait_until(lambda: running(own_engine, run) == 2, "both jobs run")
        process.kill()
    done = subprocess.run(
        [sys.executable, "-m", "calibration", "cleanup"], cwd=PROJECT, capture_output=True, text=True, check=True
    )
    assert "2 containers, 2 volumes removed" in done.stdout
    client = own_engine.api()
    assert find_leftovers(client.api) == []
    client.close()
