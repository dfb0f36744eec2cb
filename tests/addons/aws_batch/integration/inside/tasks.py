"""Tasks of AWS Batch without AWS: containers on the engine with shared volumes, supervised from here."""

import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import docker

from calibration.addons.aws_batch.inside.__main__ import prepare
from calibration.addons.aws_batch.inside.script import Signs
from calibration.addons.aws_batch.inside.watch import Watch, WatchTimeouts
from calibration.addons.aws_batch.wire import JOB_FOLDER, TaskJob, TaskOutcome
from calibration.ci.execution.job import OUTPUT, Container, Job
from tests.docker_engine import PYTHON_IMAGE, wait_until

if TYPE_CHECKING:
    from docker.models.containers import Container as Running

NONE = "none"
"""Image of a container that cannot be started."""
TIMEOUTS = WatchTimeouts(arrival=60, silence=60, settling=60)


@dataclass(frozen=True)
class Ran:
    """Result of a task."""

    outcome: TaskOutcome
    artifacts: Path
    codes: Mapping[str, int]
    """Exit codes of the containers on the engine."""
    logs: Mapping[str, str]


def run_task(folder: Path, *containers: Container, timeouts: WatchTimeouts = TIMEOUTS, **settings: Any) -> Ran:
    """Run a job of some containers, and remove them.

    ``network_mode`` is passed to the engine; other settings are of the job.
    """
    network = settings.pop("network_mode", "none")
    job = Job(settings.pop("name", "job"), containers, **settings)
    signs, output = Signs(folder / "signs"), folder / "output"
    output.mkdir(parents=True)
    prepare(TaskJob(job), None, signs, folder / "mounts", output)  # type: ignore[arg-type]
    with started(job, signs.folder, output, network) as running:
        wait_until(lambda: all(signs.beat(name) is not None for name in running), "all are there")
        watch = Watch(job, signs, output, timeouts)
        watch.run(folder / "artifacts")
        codes = {name: each.wait(timeout=60)["StatusCode"] for name, each in running.items()}
        logs = {name: each.logs().decode() for name, each in running.items()}
    return Ran(watch.outcome(1), folder / "artifacts", codes, logs)


@contextmanager
def started(job: Job, signs: Path, output: Path, network: str = "none") -> Iterator[dict[str, "Running"]]:
    """Start the containers of a job as Batch does: all at once, each with its script."""
    client = docker.from_env(timeout=60)
    running: dict[str, Running] = {}
    try:
        for container in (each for each in job.containers if each.image != NONE):
            running[container.name] = client.containers.run(
                PYTHON_IMAGE if container.image == "" else container.image,
                ["/bin/sh", f"{JOB_FOLDER}/{container.name}.sh"],
                name=f"inside-{uuid.uuid4().hex[:12]}",
                detach=True,
                init=True,
                user=container.user,
                network_mode=network,
                mem_limit=container.limits.memory,
                memswap_limit=container.limits.memory,
                volumes={str(signs): {"bind": JOB_FOLDER}, str(output): {"bind": OUTPUT}},
            )
        yield running
    finally:
        for each in running.values():
            each.remove(force=True)
        client.close()
