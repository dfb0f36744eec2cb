from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.addons.aws_batch.checks import check_for_batch
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.base import InputError
from calibration.ci.execution.job import OUTPUT, Artifact, Job, Limits, Mount, Readiness, Relaxations
from calibration.ci.execution.job_check import check_jobs
from calibration.ci.execution.ros import on_one_address, with_ros
from tests.addons.aws_batch.samples import EC2, SETTINGS, TOKEN_ARN, container, job, simulation


def refused(*jobs: Job, settings: BatchSettings = SETTINGS) -> str:
    check_jobs(jobs)  # all are valid on Docker
    with pytest.raises(InputError) as caught:
        check_for_batch(jobs, settings)
    return str(caught.value)


def test_valid_jobs_are_accepted(tmp_path: Path) -> None:
    settings = replace(SETTINGS, secrets={"TOKEN": TOKEN_ARN})
    check_for_batch([simulation(tmp_path), replace(simulation(tmp_path), name="k", seconds=5)], settings)
    relaxed = Relaxations(
        new_privileges=True, capabilities=("SYS_ADMIN",), devices=("/dev/null",), gpus=True, privileged=True
    )
    check_for_batch([job(container(relaxations=relaxed), network="host")], EC2)
    check_for_batch([job(container(relaxations=Relaxations(capabilities=("NET_RAW",))))], SETTINGS)
    check_for_batch([job(*(container(f"c{i}") for i in range(8)))], SETTINGS)
    # a mount of another container is not nested
    check_for_batch(
        [job(container("a", mounts=(Mount(tmp_path, "/m"),)), container("b", mounts=(Mount(tmp_path, "/m/n"),)))],
        SETTINGS,
    )
    check_for_batch([job(container(command=(), entrypoint=("/run",)))], SETTINGS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "calibration-watch"}, "this is the name of one of our own containers"),
        ({"name": "calibration-prepare"}, "this is the name of one of our own containers"),
        ({"name": "robot.arm"}, "a container's name has letters, digits, _ and - only"),
        ({"image": "robot 1"}, "this is no name of an image: 'robot 1'"),
        ({"image": "r" * 256}, "this is no name of an image"),
        ({"command": ()}, "the image's default command is not known: set command"),
        ({"command": (), "entrypoint": ()}, "the image's default command is not known: set command"),
        ({"artifacts": (Artifact("/out/*.csv"),)}, "only files in /calibration/output are copied, so artifact"),
        ({"artifacts": (Artifact("/calibration/output2/x"),)}, "only files in /calibration/output are copied"),
        ({"artifacts": (Artifact("/calibration/out*/x"),)}, "only files in /calibration/output are copied"),
        ({"relaxations": Relaxations(docker_socket=True)}, "there is no Docker Engine: remove docker-socket"),
        ({"relaxations": Relaxations(gpus=True)}, "Fargate has no gpus: set platform: ec2, or remove it"),
        ({"relaxations": Relaxations(devices=("/dev/video0",))}, "Fargate has no devices: set platform: ec2"),
        ({"relaxations": Relaxations(privileged=True)}, "Fargate has no privileged: set platform: ec2"),
        (
            {"relaxations": Relaxations(capabilities=("NET_RAW", "SYS_PTRACE"))},
            "no capability can be added, and SYS_PTRACE is not among the default ones",
        ),
    ],
)
def test_a_container_that_cannot_run(changes: dict[str, Any], message: str) -> None:
    wanted = container(**changes)
    said = refused(job(wanted))
    assert said.startswith(f"job 'j', container '{wanted.name}': on AWS Batch ")
    assert message in said


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (job(*(container(f"c{i}") for i in range(9))), "found 9, expected at most 8"),
        (job(network="none"), "a task has to reach S3, so there is no network 'none': set network: private"),
        (job(network="internal"), "so there is no network 'internal'"),
        (job(network="host"), "a task on Fargate has its own network, not a host's"),
        (
            job(container("a", readiness=Readiness(port=80)), container("b", readiness=Readiness(port=80))),
            "so 'a' and 'b' cannot both listen on port 80: give one another port",
        ),
    ],
)
def test_a_job_that_cannot_run(wanted: Job, message: str) -> None:
    said = refused(wanted)
    assert said.startswith("job 'j': on AWS Batch ")
    assert message in said


def test_different_ports_are_fine() -> None:
    wanted = job(
        container("a", readiness=Readiness(port=80)),
        container("b", readiness=Readiness(port=81)),
        container("c", readiness=Readiness(log="up")),
    )
    check_for_batch([wanted], SETTINGS)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("/a", "/a/b"),
        ("/a/b/c", "/a"),
        ("/calibration/job", None),
        ("/calibration/job/x", None),
        ("/calibration/mounts/7", None),
    ],
)
def test_a_mount_in_another(tmp_path: Path, one: str, other: str | None) -> None:
    targets = ["/a-b", "/ab", one, *([] if other is None else [other])]
    wanted = job(container(mounts=tuple(Mount(tmp_path, target) for target in targets)))
    assert "mounts must not be nested: found" in refused(wanted)


def test_a_file_cannot_be_mounted(tmp_path: Path) -> None:
    file = tmp_path / "motion.json"
    file.touch()
    said = refused(job(container(mounts=(Mount(file, "/motion.json"),))))
    assert said == (
        f"job 'j': on AWS Batch only folders can be mounted, and {file} (at /motion.json) is not a "
        "folder: mount its folder"
    )


def test_one_place_with_two_contents(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
    first = container("a", mounts=(Mount(tmp_path / "a", "/data"),))
    said = refused(job(first, container("b", mounts=(Mount(tmp_path / "b", "/data/"),))))
    assert "all containers have to mount the same folder at /data: change one target" in said
    # the same folder by another path
    check_for_batch([job(first, container("b", mounts=(Mount(tmp_path / "b/../a", "/data/"),)))], SETTINGS)


def test_larger_than_any_task() -> None:
    said = refused(job(container(limits=Limits(cpus=64))))
    assert said.startswith("job 'j': its containers ask for 64 CPUs")


def test_a_secret_without_an_arn() -> None:
    wanted = container(environment={"TOKEN": "s3cret"}, secrets=frozenset({"TOKEN"}))
    said = refused(job(), job(wanted, name="k"))
    assert said.startswith("job 'k': container 'robot': secrets: TOKEN has no ARN")
    assert "s3cret" not in said


@pytest.mark.parametrize(
    ("wanted", "what"),
    [
        (job(container(readiness=Readiness(port=11345))), "container 'robot' listens on port 11345"),
        (on_one_address(with_ros(job(), "1")), "container 'master' listens on port 11311"),
        (with_ros(job(), "2"), "ROS in container 'robot' looks for others in the network"),
        (
            job(container(environment={"ROS_MASTER_URI": "http://127.0.0.1:1"})),
            "ROS in container 'robot' looks for others in the network",
        ),
    ],
)
def test_conflicts_on_a_shared_instance(wanted: Job, what: str) -> None:
    two = [wanted, replace(wanted, name="k")]
    said = refused(*two, settings=EC2)
    assert said == (
        f"job 'j': {what}, and of 2 jobs on platform ec2 several may share an instance's network: set platform: "
        "fargate, or shared-hosts: false if each instance holds one job"
    )
    check_for_batch([wanted], EC2)  # a single job cannot conflict
    check_for_batch(two, replace(EC2, shared_hosts=False))
    check_for_batch(two, SETTINGS)


def test_jobs_without_conflicts_share_instances() -> None:
    check_for_batch([job(), job(container(artifacts=(Artifact(f"{OUTPUT}/x"),)), name="k")], EC2)
