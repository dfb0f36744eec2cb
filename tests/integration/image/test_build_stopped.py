"""Builds that are stopped, or whose engine is lost: one message, the right exit code, and nothing left."""

import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.docker_engine import started_engine, wait_until
from tests.integration.image.builds import Builds, builds
from tests.integration.image.test_build import buildkit_or_skip

__all__ = ["builds"]

BASE = "debian:bookworm"
SCRIPT = """
import sys
from calibration.__main__ import _execute
from calibration.commands.build_image import command
sys.exit(_execute(command, "build-image", sys.argv[1:]))
"""


@contextmanager
def building(builds: Builds, builder: str, marker: str, **variables: str) -> Iterator["subprocess.Popen[str]"]:
    """Run the command with a build whose last step sleeps."""
    builds.write("image.yml", f"name: {builds.name}\nbase: {BASE}\ncommands: ['sleep 600; echo {marker}']")
    arguments = ["--spec", "image.yml", "--builder", builder]
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *arguments],
        cwd=builds.folder,
        env={**os.environ, "TMPDIR": str(builds.folder), **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            wait_until(lambda: process.poll() is not None or sleeping(marker), "the step runs", 60)
            yield process
        finally:
            process.kill()


def sleeping(marker: str) -> bool:
    """Return whether a process of the step runs, in any container."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = path.read_bytes()
        except OSError:
            continue
        if marker.encode() in command and b"/bin/bash" in command and b"image.yml" not in command:
            return True
    return False


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("builder", ["engine", "buildkit"])
def test_a_signal_stops_the_build(builds: Builds, builder: str, number: signal.Signals) -> None:
    if builder == "buildkit":
        buildkit_or_skip()
    marker = uuid.uuid4().hex
    with building(builds, builder, marker) as process:
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert errors == f"error: stopped by {number.name}\n"
    wait_until(lambda: not sleeping(marker), "the step has ended")

    def containers() -> list[str]:
        return [c["Id"] for c in builds.engine.api.containers(all=True) if marker in c["Command"]]

    wait_until(lambda: not containers(), "no container is left")
    assert builds.tags() == []
    assert [path.name for path in builds.folder.iterdir()] == ["image.yml"]  # no secret or archive is left in TMPDIR


@pytest.mark.thorough
def test_an_engine_that_is_killed(builds: Builds) -> None:
    marker = uuid.uuid4().hex
    with started_engine() as engine:
        client = engine.api()
        client.images.load(b"".join(builds.engine.images.get(BASE).save(named=BASE)))
        client.close()
        with building(builds, "engine", marker, DOCKER_HOST=engine.address) as process:
            engine.process.kill()
            _, errors = process.communicate(timeout=60)
    assert process.returncode == 3
    assert errors == f"error: image {builds.name}: the engine broke off the build\n"


def test_no_engine(builds: Builds) -> None:
    builds.write("image.yml", f"base: {BASE}")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, "--spec", "image.yml"],
        cwd=builds.folder,
        env={**os.environ, "DOCKER_HOST": "unix:///nowhere/s"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 3
    assert done.stderr.startswith("error: no Docker Engine answers at unix:///nowhere/s")
    assert len(done.stderr.splitlines()) == 1
