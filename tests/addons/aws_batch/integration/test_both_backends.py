"""The same jobs on the machine's engine and on the emulator: what comes of them is the same."""

from pathlib import Path
from typing import Any

import pytest

from calibration.addons.aws_batch.backend import BatchBackend
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.ci.execution.backends import JobBackend
from calibration.ci.execution.docker.backend import DockerBackend
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job, Mount, Readiness
from tests.addons.aws_batch.emulator.faults import child
from tests.addons.aws_batch.fixtures import BUCKET, QUEUE, REGION, Aws
from tests.docker_engine import PYTHON_IMAGE

ROBOT = f"""
mkdir -p {OUTPUT}/dataset/images
cp /in/motion.json {OUTPUT}/dataset
printf 'seed %s' "$1" > {OUTPUT}/dataset/images/1.txt
echo "seed $1 is done"
exit $2
"""
SERVER = "trap 'exit 0' TERM; touch /tmp/ready; while :; do sleep 0.1; done"


def jobs(folder: Path) -> list[Job]:
    """Of two, the last fails."""
    folder.chmod(0o755)  # for the user of the image
    (folder / "motion.json").write_text('{"poses": []}')

    def containers(seed: int, code: int) -> tuple[Container, ...]:
        ready = Readiness(file="/tmp/ready", seconds=30)  # noqa: S108
        server = Container("server", PYTHON_IMAGE, ("sh", "-c", SERVER), readiness=ready, essential=False)
        command = ("sh", "-c", ROBOT, "robot", str(seed), str(code))
        mounts = (Mount(folder, "/in"),)
        brought = (Artifact(f"{OUTPUT}/dataset"),)
        return server, Container("robot", PYTHON_IMAGE, command, mounts=mounts, after=("server",), artifacts=brought)

    return [Job(f"scenarios/{seed}", containers(seed, code), seconds=90.0) for seed, code in ((1, 0), (2, 4))]


def run(backend: JobBackend, given: list[Job], folder: Path) -> list[tuple[Any, ...]]:
    """What came of each job, without what may differ: how long it took, and how its helpers ended."""
    found = []
    for index, outcome in backend.run(given, folder):
        robot = next(each for each in outcome.containers if each.name == "robot")
        files = [(file.path, file.size, file.sha256) for file in outcome.artifacts]
        contents = [(outcome.folder / "artifacts" / file.path).read_bytes() for file in outcome.artifacts]
        found.append((index, outcome.exit_code, outcome.reasons, robot.end, robot.exit_code, files, contents))
    return sorted(found, key=lambda each: each[0])


@pytest.mark.usefixtures("python_image")
def test_the_backends_agree(
    batch_in_containers: Aws, tools_image: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    given = jobs(tmp_path_factory.mktemp("in"))
    settings = BatchSettings(
        region=REGION,
        queue=QUEUE,
        bucket=BUCKET,
        tools_image=tools_image,
        job_role="arn:aws:iam::123456789012:role/job",
        execution_role="arn:aws:iam::123456789012:role/execution",
    )
    batch_in_containers.faults.lose_host(child(0))
    batch_in_containers.faults.throttle("SubmitJob")
    with BatchBackend(settings) as cloud:
        in_the_cloud = run(cloud, given, tmp_path / "cloud")
    with DockerBackend() as engine:
        here = run(engine, given, tmp_path / "here")
    assert in_the_cloud == here
    assert [(index, code) for index, code, *_ in here] == [(0, 0), (1, 1)]
    assert [path for path, *_ in here[0][5]] == ["dataset/images/1.txt", "dataset/motion.json"]
    lost = next(job for job in batch_in_containers.batch.every_job() if job.index == 0)
    assert [attempt["statusReason"][:8] for attempt in lost.attempts] == ["Host EC2", "Essentia"]
