import base64
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from calibration.base import InfrastructureError
from calibration.ci.image import builders
from calibration.ci.image.builders import Program, find_buildkit, lines_of, write_login
from calibration.ci.registries.reference import Credentials
from tests.docker_engine import wait_until
from tests.processes import runs


def program(folder: Path, script: str) -> str:
    folder.mkdir()
    path = folder / "docker"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return str(folder)


def test_which_docker_does_buildkit(tmp_path: Path) -> None:
    broken = program(tmp_path / "a", "exit 1")
    new = program(tmp_path / "b", 'test "$1" = buildx && exit 1; echo "Docker version 28.2.0, build x"')
    old = program(tmp_path / "c", 'test "$1" = buildx && exit 1; echo "Docker version 20.10.24+dfsg1, build x"')
    buildx = program(tmp_path / "d", 'test "$1" = buildx && echo "github.com/docker/buildx v0.12"')
    ancient = program(tmp_path / "e", 'test "$1" = buildx && exit 1; echo "Docker version 17.06.1-ce, build x"')
    assert find_buildkit(":".join([broken, new, ancient, "", "/nowhere"])) is None
    assert find_buildkit(f"{new}:{old}") == Program(f"{old}/docker", buildx=False)
    assert find_buildkit(f"{old}:{buildx}") == Program(f"{buildx}/docker", buildx=True)


def test_a_program_that_never_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(builders, "VERSION_SECONDS", 0.2)
    assert find_buildkit(program(tmp_path / "slow", "exec sleep 60")) is None


def test_lines_and_exit_code(tmp_path: Path) -> None:
    with (tmp_path / "in").open("w+b") as stdin:
        stdin.write(b"hello")
        stdin.seek(0)
        command = ["sh", "-c", 'cat; echo; echo "$A" >&2; exit 5']
        assert list(lines_of(command, stdin, {"A": "b", "PATH": os.environ["PATH"]})) == ["hello", "b", 5]
        with pytest.raises(InfrastructureError, match="/nowhere/docker: cannot be started: No such file"):
            list(lines_of(["/nowhere/docker"], stdin, {}))


@pytest.mark.parametrize("ignores", ["", "trap '' TERM; "])
def test_closing_the_generator_stops_the_program_and_its_children(
    tmp_path: Path, ignores: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calibration.base.process.STOP_SECONDS", 0.2)
    mark = f"{os.getpid()}{time.monotonic_ns() % 100_000}"
    with (tmp_path / "in").open("w+b") as stdin:
        command = ["sh", "-c", f"{ignores}sleep 3{mark[-5:]} & echo $!; wait; sleep 3600"]
        with closing(lines_of(command, stdin, dict(os.environ))) as lines:
            child = int(next(lines))
            assert Path(f"/proc/{child}").exists()
    wait_until(lambda: not runs(child), "its child has ended")


def test_an_interrupt_stops_the_program(tmp_path: Path) -> None:
    script = """
import os, sys
from contextlib import closing
from calibration.ci.image.builders import lines_of
command = ["sh", "-c", "echo $$; exec sleep 3600"]
with open(os.devnull, "rb") as stdin, closing(lines_of(command, stdin, os.environ)) as lines:
    for line in lines:
        print(line, flush=True)
"""
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as ours:
        assert ours.stdout is not None
        child = int(ours.stdout.readline())
        ours.send_signal(signal.SIGINT)
        try:
            ours.wait(60)
        finally:
            ours.kill()
    assert not runs(child)


def test_a_login_for_the_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "home" / "cli-plugins").mkdir(parents=True)
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path / "home"))
    found = write_login(Credentials("ghcr.io", "robot", "hunter2"), tmp_path)
    folder = Path(found["DOCKER_CONFIG"])
    file = folder / "config.json"
    auth = base64.b64encode(b"robot:hunter2").decode()
    assert json.loads(file.read_text()) == {"auths": {"ghcr.io": {"auth": auth}}}
    assert (file.stat().st_mode & 0o777, folder.stat().st_mode & 0o777) == (0o600, 0o700)
    assert (folder / "cli-plugins").resolve() == tmp_path / "home" / "cli-plugins"


def test_a_token_for_docker_hub_and_no_login_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path / "nothing"))
    assert write_login(Credentials("ghcr.io"), tmp_path) == {}
    found = write_login(Credentials("docker.io", identity_token="t"), tmp_path)  # noqa: S106
    document = json.loads(Path(found["DOCKER_CONFIG"], "config.json").read_text())
    assert document == {"auths": {"https://index.docker.io/v1/": {"identitytoken": "t"}}}
