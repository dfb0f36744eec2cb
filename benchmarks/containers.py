"""Jobs in containers: many at once, and what one costs over the engine's own command."""

import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.rows import Bar, Row
from benchmarks.timing import interleaved
from calibration.ci.docker_engine import connect, engine_available
from calibration.ci.execution.docker.backend import DockerBackend
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job

IMAGE = "debian:bookworm"
COMMAND = ("true",)


def measure(quick: bool) -> Iterator[Row]:
    """Many jobs, and one."""
    parallel, overhead = "containers/16 jobs of 1 s, 8 at once", "containers/one job over docker run"
    if reason := missing():
        yield Row(parallel, skipped=reason)
        yield Row(overhead, skipped=reason)
        return
    with tempfile.TemporaryDirectory() as folder:
        times = [_sixteen(Path(folder)) for _ in range(1 if quick else 3)]
        yield Row(parallel, statistics.median(times), "s", Bar(high=6), "one after the other: 16 s and more")
        works = {"job": lambda: _one(Path(folder)), "docker run": _docker_run, "four": lambda: _four(Path(folder))}
        found = {name: statistics.median(each) for name, each in interleaved(works, 5 if quick else 15).items()}
    more = found["job"] - found["docker run"]
    note = f"docker run --rm: {found['docker run']:.3f} s; all from finding the engine to removing the volume"
    yield Row(overhead, more, "s", Bar(high=0.3), note)
    note = "four jobs one after the other, each in a private network, with an artifact"
    yield Row("containers/each of 4 jobs", found["four"] / 4 - found["docker run"], "s", None, note)


def missing() -> str:
    """Reason why nothing can be measured; empty if it can."""
    if not engine_available():
        return "needs a Docker Engine"
    client = connect()
    try:
        return "" if client.images.list(IMAGE) else f"needs the image {IMAGE} (tests/docker_engine.py makes it)"
    finally:
        client.close()


def _run(jobs: list[Job], folder: Path, workers: int) -> float:
    start = time.perf_counter()
    with DockerBackend() as backend:
        outcomes = [outcome for _, outcome in backend.run(jobs, folder, workers)]
    assert all(outcome.verdict == "pass" for outcome in outcomes), outcomes
    return time.perf_counter() - start


def _sixteen(folder: Path) -> float:
    jobs = [Job(f"sleep-{i}", (Container("sleep", IMAGE, ("sleep", "1")),)) for i in range(16)]
    return _run(jobs, folder, 8)


def _one(folder: Path) -> float:
    return _run([Job("one", (Container("one", IMAGE, COMMAND),))], folder, 1)


def _four(folder: Path) -> float:
    command = ("cp", "/etc/os-release", OUTPUT)
    artifacts = (Artifact(f"{OUTPUT}/*"),)
    return _run([Job(f"{i}", (Container("one", IMAGE, command, artifacts=artifacts),)) for i in range(4)], folder, 1)


def _docker_run() -> object:
    return subprocess.run(["docker", "run", "--rm", IMAGE, *COMMAND], check=True, capture_output=True)
