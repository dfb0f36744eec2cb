"""Jobs for tests, and their leftovers on the engine."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibration.ci.execution.docker.backend import DockerBackend
from calibration.ci.execution.docker.run_objects import find_leftovers
from calibration.ci.execution.job import Container, Job
from calibration.ci.execution.outcome import JobOutcome
from tests.docker_engine import PYTHON_IMAGE

if TYPE_CHECKING:
    from docker import DockerClient


def shell(text: str, name: str = "a", image: str = PYTHON_IMAGE, **settings: Any) -> Container:
    """Return a container that runs a line of shell as the image's user, who is not root."""
    return Container(name, image, ("sh", "-c", text), **settings)


def python(text: str, name: str = "a", **settings: Any) -> Container:
    return Container(name, PYTHON_IMAGE, ("python3", "-c", text), **settings)


def run_jobs(folder: Path, *jobs: Job, workers: int | None = None, **settings: Any) -> list[JobOutcome]:
    """Run jobs; return their outcomes in order, and check that nothing is left on the engine."""
    with DockerBackend(**settings) as backend:
        outcomes = dict(backend.run(jobs, folder, workers))
        name = backend.run_name
        client = backend._engine.client()
    try:
        assert find_leftovers(client.api, name) == []
    finally:
        client.close()
    return [outcomes[index] for index in range(len(jobs))]


def run_job(folder: Path, *containers: Container, name: str = "job", **settings: Any) -> JobOutcome:
    [outcome] = run_jobs(folder, Job(name, containers, **settings))
    return outcome


def left(engine: "DockerClient", run: str) -> list[str]:
    """Return the objects of a run on the engine."""
    return [f"{each.kind} {each.name}" for each in find_leftovers(engine.api, run)]
