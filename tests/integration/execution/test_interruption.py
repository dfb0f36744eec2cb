"""Nothing is left after an interruption in any phase; leftovers of a killed run are found by `calibration cleanup`."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calibration.base import InfrastructureError
from calibration.ci.execution.docker.backend import DockerBackend
from calibration.ci.execution.docker.labels import RUN_LABEL, new_run
from calibration.ci.execution.docker.run_objects import find_leftovers, remove
from calibration.ci.execution.job import Job
from calibration.ci.workflow import Runner
from calibration.ci.workflow.streams import LogDisplay
from tests.docker_engine import wait_until
from tests.integration.execution.jobs import left, shell

if TYPE_CHECKING:
    from docker import DockerClient

PROJECT = Path(__file__).resolve().parents[3]
HOST = new_run()
"""Name of this machine in these tests: else others would remove what killed runs leave here, as each run does."""
_AS_HOST = f"import runpy, socket, sys; socket.gethostname = lambda: '{HOST}'; sys.argv.pop(0); "
_AS_HOST += "runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"


@contextmanager
def program(
    folder: Path, engine: "DockerClient", kind: str, argument: str = ""
) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Start the program that runs jobs; yield the name of its run, and the process."""
    run = new_run()
    command = [sys.executable, "-c", _AS_HOST, "tests.integration.execution.program", kind, run, str(folder), argument]
    with subprocess.Popen(
        command, cwd=PROJECT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            yield run, process
        finally:
            process.kill()
            process.communicate()
            remove(engine.api, find_leftovers(engine.api, run))


def has(engine: "DockerClient", run: str, state: str, count: int = 1) -> bool:
    found = [each for each in find_leftovers(engine.api, run) if each.kind == "container" and each.state == state]
    return len(found) >= count


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize(
    ("kind", "state", "count", "number"),
    [
        ("waiting", "running", 1, signal.SIGTERM),
        ("creating", "created", 1, signal.SIGTERM),
        ("running", "running", 4, signal.SIGTERM),
        ("running", "running", 4, signal.SIGINT),
        ("copying", "exited", 1, signal.SIGTERM),
    ],
)
def test_stopped_while_it_goes_on(
    tmp_path: Path, engine: "DockerClient", kind: str, state: str, count: int, number: signal.Signals
) -> None:
    with program(tmp_path, engine, kind) as (run, process):
        wait_until(lambda: has(engine, run, state, count) or process.poll() is not None, f"{kind}: {state}")
        begin = time.time()
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
        assert process.returncode == (143 if number == signal.SIGTERM else 130), out + err
        assert left(engine, run) == []
        assert err == ""
    # GitHub kills after 7.5 s, so containers are killed without SIGTERM
    asked = {"event": ["kill"], "label": [f"{RUN_LABEL}={run}"]}
    events = engine.api.events(f"{begin:.6f}", f"{time.time():.6f}", filters=asked, decode=True)
    sent = {event["Actor"]["Attributes"]["signal"] for event in events}
    assert sent == ({"9"} if state == "running" else set())


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("delay", [0.9, 1.3, 1.7, 2.1])
def test_stopped_at_any_moment(tmp_path: Path, engine: "DockerClient", delay: float) -> None:
    """During creation, start, stop, copying and removal: one after the other, for each job."""
    with program(tmp_path, engine, "short") as (run, process):
        assert process.stdout is not None
        wait_until(lambda: has(engine, run, "running") or process.poll() is not None, "the first runs")
        time.sleep(delay - 0.9)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=60)
        assert (process.returncode, err) == (143, "")
        assert left(engine, run) == []


def test_stopped_while_it_pulls(tmp_path: Path, engine: "DockerClient") -> None:
    with socket.create_server(("127.0.0.1", 0)) as hangs:
        asked = threading.Event()

        def accept() -> None:
            connection, _ = hangs.accept()
            asked.set()
            connection.recv(1)
            time.sleep(20)
            connection.close()

        threading.Thread(target=accept, daemon=True).start()
        with program(tmp_path, engine, "pulling", f"127.0.0.1:{hangs.getsockname()[1]}") as (run, process):
            assert asked.wait(60)
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=60)
            assert process.returncode == 143
            assert left(engine, run) == []


def test_who_stops_reading_leaves_nothing(tmp_path: Path, engine: "DockerClient") -> None:
    jobs = [Job("quick", (shell("true"),)), Job("slow", (shell("sleep 600"),)), Job("never", (shell("true"),))]
    with DockerBackend() as backend:
        with closing(backend.run(jobs, tmp_path, workers=2)) as outcomes:  # type: ignore[type-var]
            assert next(outcomes)[1].job == "quick"
        assert left(engine, backend.run_name) == []
        again = [outcome.verdict for _, outcome in backend.run([jobs[0], jobs[2]], tmp_path)]
        assert again == ["pass", "pass"]
    assert left(engine, backend.run_name) == []


def test_an_error_of_the_reader_leaves_nothing(tmp_path: Path, engine: "DockerClient") -> None:
    jobs = [Job("quick", (shell("true"),)), Job("slow", (shell("sleep 600"),))]
    with pytest.raises(ZeroDivisionError), DockerBackend() as backend:
        _ = [1 / 0 for _ in backend.run(jobs, tmp_path, workers=2)]
    assert left(engine, backend.run_name) == []


def test_a_name_that_is_taken_is_replaced_by_another(
    tmp_path: Path, engine: "DockerClient", monkeypatch: pytest.MonkeyPatch
) -> None:
    run = new_run()
    names = iter(["taken", "taken", "free"])
    monkeypatch.setattr("calibration.ci.execution.docker.container_run.new_run", lambda: next(names))
    other = engine.api.create_container("calibration-test:python", ["true"], name=f"calibration-{run}-job-a-taken")
    try:
        with DockerBackend(run=run) as backend:
            [(_, outcome)] = backend.run([Job("job", (shell("true"),))], tmp_path)
        assert outcome.reasons == ()
        assert next(names, "none left") == "none left"
        assert engine.api.inspect_container(other)["State"]["Status"] == "created"  # of another run
    finally:
        engine.api.remove_container(other, force=True)


def cleanup(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", _AS_HOST, "calibration", "cleanup", *arguments],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "GITHUB_ACTIONS": ""},
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_leftovers_of_killed_runs_are_removed_and_running_ones_kept(tmp_path: Path, engine: "DockerClient") -> None:
    with program(tmp_path / "alive", engine, "waiting") as (alive, _):
        wait_until(lambda: has(engine, alive, "running"), "it runs")
        with program(tmp_path / "dead", engine, "waiting") as (dead, process):
            wait_until(lambda: has(engine, dead, "running"), "it runs")
            process.kill()
            process.wait()
            before = left(engine, dead)
            assert sorted({each.split()[0] for each in before}) == ["container", "network", "volume"]
            said = cleanup("--dry-run")
            assert all(each.split()[1] in said for each in before)
            assert "would be removed" in said
            assert left(engine, dead) == before
            said = cleanup()
            assert all(each.split()[1] in said for each in before)
            assert left(engine, dead) == []
            assert dead not in cleanup()
        assert len(left(engine, alive)) == 3
        assert "1 container, 1 network, 1 volume removed" in cleanup("--run", alive)
        assert left(engine, alive) == []
        assert cleanup("--run", alive) == "nothing removed\n"


@pytest.mark.thorough
def test_a_run_removes_what_killed_ones_have_left(
    tmp_path: Path, engine: "DockerClient", monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with (
        program(tmp_path / "alive", engine, "waiting") as (alive, _),
        program(tmp_path / "dead", engine, "waiting") as (dead, process),
    ):
        wait_until(lambda: has(engine, alive, "running") and has(engine, dead, "running"), "both run")
        process.kill()
        process.wait()
        with DockerBackend(show=LogDisplay(Runner())):
            assert len(left(engine, dead)) == 3  # of another machine, as far as this one knows
        monkeypatch.setattr(socket, "gethostname", lambda: HOST)
        with DockerBackend(show=LogDisplay(Runner())):
            assert left(engine, dead) == []
            assert len(left(engine, alive)) == 3
        assert capfd.readouterr().out == "1 container, 1 network, 1 volume of a killed run removed\n"


def test_what_cannot_be_removed_is_named_and_the_run_goes_on(
    engine: "DockerClient", monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def fail(_: object) -> None:
        raise InfrastructureError("cannot be removed: volume v")

    monkeypatch.setattr("calibration.ci.execution.docker.backend.remove_of_dead_runs", fail)
    with DockerBackend(show=LogDisplay(Runner())):
        pass
    assert capfd.readouterr().out == "of a killed run: cannot be removed: volume v\n"


@pytest.mark.parametrize("name", ["_remove_objects", "_stop_jobs"])
def test_interrupted_while_it_removes(
    tmp_path: Path, engine: "DockerClient", monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    plain = getattr(DockerBackend, name)
    struck: list[bool] = []

    def strike(self: DockerBackend, *arguments: object, **settings: object) -> None:
        if not struck:
            struck.append(True)
            raise KeyboardInterrupt
        plain(self, *arguments, **settings)

    monkeypatch.setattr(DockerBackend, name, strike)
    helper = shell("sleep 600", "helper", essential=False)
    jobs = [Job("quick", (shell("true"), helper)), Job("slow", (shell("sleep 600"),))]
    with (
        pytest.raises(KeyboardInterrupt),
        DockerBackend() as backend,
        closing(backend.run(jobs, tmp_path, workers=2)) as outcomes,
    ):
        next(outcomes)
    assert struck
    assert left(engine, backend.run_name) == []
