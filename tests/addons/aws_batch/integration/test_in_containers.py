"""Client, task and emulator together: tasks are real containers, and end as on Docker."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.addons.aws_batch.backend import BatchBackend
from calibration.ci.execution.docker.backend import DockerBackend
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job, Limits, Mount, Readiness
from calibration.ci.execution.outcome import JobOutcome
from tests.addons.aws_batch.client import SETTINGS, running
from tests.addons.aws_batch.fixtures import Aws
from tests.docker_engine import PYTHON_IMAGE

pytestmark = pytest.mark.usefixtures("python_image")


def shell(text: str, name: str = "robot", **settings: object) -> Container:
    return Container(name, PYTHON_IMAGE, ("sh", "-c", text), **settings)  # type: ignore[arg-type]


def given(folder: Path) -> list[Job]:
    """Return jobs with every kind of end, the first one with everything that a job may have."""
    mounted = (Mount(folder, "/calibration/in"),)
    found = (Artifact(f"{OUTPUT}/dataset"),)
    simulation = shell(
        "echo simulating; touch /tmp/ready; sleep 60",
        "simulation",
        essential=False,
        readiness=Readiness(file="/tmp/ready"),  # noqa: S108
    )
    robot = shell(
        'test -f /calibration/in/motion.json && mkdir "$OUT" && cp /calibration/in/motion.json "$OUT" && pwd',
        after=("simulation",),
        mounts=mounted,
        artifacts=found,
        environment={"OUT": f"{OUTPUT}/dataset", "ODD": 'a\'b "c" $(d)'},
        working_directory="/var",
    )
    memory = Limits(memory=64 * 1024**2)
    eat = "python3 -c 'bytearray(200 * 1024**2)'"
    return [
        Job("whole", (simulation, robot), seconds=60),
        Job("nothing", (shell("true", artifacts=found),), seconds=60),
        Job("memory", (shell(eat, limits=memory),), seconds=60),
    ]


def in_order(outcomes: dict[int, JobOutcome]) -> list[JobOutcome]:
    return [outcomes[index] for index in sorted(outcomes)]


def told(outcomes: Sequence[JobOutcome]) -> list[tuple[object, ...]]:
    """Return the parts of outcomes that must be equal for all backends."""
    return [
        (
            outcome.job,
            int(outcome.exit_code),
            outcome.reasons,
            [(each.name, each.end) for each in outcome.containers],
            [(file.path, file.sha256) for file in outcome.artifacts],
            sorted(path.relative_to(outcome.folder).as_posix() for path in outcome.folder.rglob("*") if path.is_file()),
        )
        for outcome in outcomes
    ]


@pytest.mark.thorough
@pytest.mark.usefixtures("python_image")
def test_jobs_end_as_on_docker(batch_in_containers: Aws, tools_image: str, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "motion.json").write_text('{"poses": []}')
    jobs = given(tmp_path / "in")
    settings = replace(SETTINGS, tools_image=tools_image, memory=512 * 1024**2)
    with BatchBackend(settings) as cloud:
        there = in_order(dict(cloud.run(jobs, tmp_path / "cloud")))
    with DockerBackend() as machine:
        here = in_order(dict(machine.run(jobs, tmp_path / "docker", workers=2)))
    assert told(there) == told(here)
    assert [int(outcome.exit_code) for outcome in here] == [0, 1, 1]
    log = (there[0].folder / "logs" / "robot.log").read_text()
    assert log.splitlines()[-1] == "/var"
    assert running(batch_in_containers) == []
