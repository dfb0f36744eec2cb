import fnmatch
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.addons.aws_batch.definition import (
    DIGEST_TAG,
    MAX_DEFINITION_BYTES,
    definition_name,
    job_definition,
    shape_of,
)
from calibration.addons.aws_batch.settings import BatchSettings
from calibration.base import InputError
from calibration.ci.execution.job import Container, Job, Mount, Relaxations
from tests.addons.aws_batch.samples import (
    EC2,
    REGISTRY,
    SETTINGS,
    TOKEN_ARN,
    complaints,
    container,
    job,
    simulation,
    unknown_keys,
)

WITH_SECRET = replace(SETTINGS, secrets={"TOKEN": TOKEN_ARN})


def definition(wanted: Job, settings: BatchSettings = SETTINGS) -> dict[str, Any]:
    request = job_definition(shape_of(wanted, settings), settings)
    assert complaints("RegisterJobDefinition", request) == ""
    assert unknown_keys("RegisterJobDefinition", request) == []
    return request


def task(wanted: Job, settings: BatchSettings = SETTINGS) -> dict[str, Any]:
    (found,) = definition(wanted, settings)["ecsProperties"]["taskProperties"]
    return dict(found)


def named(wanted: Job, name: str, settings: BatchSettings = SETTINGS) -> dict[str, Any]:
    (found,) = (each for each in task(wanted, settings)["containers"] if each["name"] == name)
    return dict(found)


def test_all_of_a_definition(tmp_path: Path) -> None:
    def common(name: str, cpus: str, memory: str) -> dict[str, Any]:
        return {
            "name": name,
            "essential": False,
            "resourceRequirements": [{"type": "VCPU", "value": cpus}, {"type": "MEMORY", "value": memory}],
            "linuxParameters": {"initProcessEnabled": True},
            "logConfiguration": {
                "logDriver": "awslogs",
                "options": {
                    "awslogs-group": "/aws/batch/job",
                    "awslogs-region": "eu-west-1",
                    "awslogs-stream-prefix": "calibration",
                },
            },
        }

    def mount(volume: str, path: str, read_only: bool = False) -> dict[str, Any]:
        return {"sourceVolume": volume, "containerPath": path, "readOnly": read_only}

    tools = {
        "image": f"{REGISTRY}/calibration-ci:1",
        "user": "root",
    }
    inside = ["python3", "-m", "calibration.addons.aws_batch.inside"]
    after_prepare = [{"containerName": "calibration-prepare", "condition": "SUCCESS"}]
    shared = [mount("job", "/calibration/job"), mount("output", "/calibration/output")]
    request = definition(simulation(tmp_path), WITH_SECRET)
    assert request.pop("tags").keys() == {DIGEST_TAG}
    assert request == {
        "jobDefinitionName": "calibration-simulation-robot-007cdc24",
        "type": "container",
        "platformCapabilities": ["FARGATE"],
        "propagateTags": True,
        "retryStrategy": {
            "attempts": 3,
            "evaluateOnExit": [
                {"onStatusReason": "Host EC2*", "action": "RETRY"},
                {"onStatusReason": "Your Spot Task was interrupted*", "action": "RETRY"},
                {"onStatusReason": "*", "action": "EXIT"},
                {"onReason": "*", "action": "EXIT"},
                {"onExitCode": "*", "action": "EXIT"},
            ],
        },
        "ecsProperties": {
            "taskProperties": [
                {
                    "taskRoleArn": SETTINGS.job_role,
                    "executionRoleArn": SETTINGS.execution_role,
                    "networkConfiguration": {"assignPublicIp": "DISABLED"},
                    "runtimePlatform": {"operatingSystemFamily": "LINUX", "cpuArchitecture": "X86_64"},
                    "volumes": [{"name": "job"}, {"name": "output"}, {"name": "mount-0"}, {"name": "mount-1"}],
                    "containers": [
                        {
                            **common("calibration-prepare", "0.25", "512"),
                            **tools,
                            "command": [*inside, "prepare"],
                            "mountPoints": [
                                *shared,
                                mount("mount-0", "/calibration/mounts/0"),
                                mount("mount-1", "/calibration/mounts/1"),
                            ],
                        },
                        {
                            # 1 + 2 CPUs need a task of 4, of which our containers get half a CPU
                            **common("simulation", "2.5", "3073"),
                            "image": f"{REGISTRY}/simulation@sha256:{'0' * 64}",
                            "command": ["/bin/sh", "/calibration/job/simulation.sh"],
                            "dependsOn": after_prepare,
                            "mountPoints": [*shared, mount("mount-0", "/data", read_only=True)],
                        },
                        {
                            **common("robot", "1", "2048"),
                            "image": f"{REGISTRY}/robot:1",
                            "command": ["/bin/sh", "/calibration/job/robot.sh"],
                            "dependsOn": after_prepare,
                            "user": "1000",
                            "secrets": [{"name": "TOKEN", "valueFrom": TOKEN_ARN}],
                            "mountPoints": [
                                *shared,
                                mount("mount-0", "/data", read_only=True),
                                mount("mount-1", "/scratch"),
                            ],
                        },
                        {
                            **common("calibration-watch", "0.25", str(8192 - 3073 - 2048 - 512)),
                            **tools,
                            "essential": True,
                            "command": [*inside, "watch"],
                            "dependsOn": after_prepare,
                            "stopTimeout": 120,
                            "mountPoints": shared,
                        },
                    ],
                }
            ]
        },
    }


def test_nothing_secret_is_in_it(tmp_path: Path) -> None:
    assert "s3cret" not in str(definition(simulation(tmp_path), WITH_SECRET))


def test_a_secret_without_an_arn(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"container 'robot': secrets: TOKEN has no ARN"):
        definition(simulation(tmp_path))


def test_settings_of_ec2_only() -> None:
    relaxed = Relaxations(devices=("/dev/video0",), gpus=True, privileged=True)
    robot = named(job(container(relaxations=relaxed)), "robot", EC2)
    assert robot["privileged"] is True
    assert robot["linuxParameters"] == {"initProcessEnabled": True, "devices": [{"hostPath": "/dev/video0"}]}
    assert robot["resourceRequirements"] == [
        {"type": "VCPU", "value": "1"},  # a whole one, without a decimal point: AWS refuses 1.0
        {"type": "MEMORY", "value": "2048"},
        {"type": "GPU", "value": "1"},
    ]


def test_the_platforms_differ() -> None:
    ec2, fargate = task(job(), replace(EC2, execution_role=None)), task(job())
    assert {"networkConfiguration", "runtimePlatform", "executionRoleArn"} == fargate.keys() - ec2.keys()
    # only EC2 instances may wait for the inputs for more than three minutes
    assert named(job(), "calibration-prepare", EC2)["startTimeout"] == 3600
    assert "startTimeout" not in named(job(), "calibration-prepare")


def test_fargate_as_asked() -> None:
    settings = replace(SETTINGS, disk=100, public_ip=True, architecture="arm64")
    found = task(job(), settings)
    assert found["ephemeralStorage"] == {"sizeInGiB": 100}
    assert found["networkConfiguration"] == {"assignPublicIp": "ENABLED"}
    assert found["runtimePlatform"]["cpuArchitecture"] == "ARM64"


@pytest.mark.parametrize("settings", [SETTINGS, EC2])
def test_the_rules_of_conditions(tmp_path: Path, settings: BatchSettings) -> None:
    containers = task(simulation(tmp_path), replace(settings, secrets={"TOKEN": TOKEN_ARN}))["containers"]
    essential = {each["name"] for each in containers if each["essential"]}
    assert essential == {"calibration-watch"}
    waits = [wait for each in containers for wait in each.get("dependsOn", ())]
    assert len(waits) == 3
    assert not {wait["containerName"] for wait in waits} & essential


def test_a_revision_only_where_something_differs(tmp_path: Path) -> None:
    def tag(wanted: Job, settings: BatchSettings) -> str:
        return str(definition(wanted, settings)["tags"][DIGEST_TAG])

    wanted = simulation(tmp_path)
    first = tag(wanted, WITH_SECRET)
    assert first == tag(simulation(tmp_path / "elsewhere"), WITH_SECRET)
    others = {
        tag(wanted, replace(WITH_SECRET, **{key: value}))
        for key, value in {
            "tools_image": "other",
            "job_role": "arn:aws:iam::123456789012:role/other",
            "attempts": 1,
            "tags": {"team": "robots"},
            "log_group": "other",
            "secrets": {"TOKEN": f"{TOKEN_ARN}x"},
            "memory": 10**9,
        }.items()
    }
    assert len(others) == 7
    assert first not in others
    # these are set on submission
    assert first == tag(wanted, replace(WITH_SECRET, queue="other", deadline=3.0, stuck=1.0, share="a", priority=1))


def test_another_image_is_a_revision_not_another_definition() -> None:
    def name(image: str, settings: BatchSettings = SETTINGS, **changes: Any) -> str:
        return definition_name(shape_of(job(container(image=image, **changes)), settings), settings)

    first = name("host:5000/team/robot:1")
    assert first == name("host:5000/team/robot") == name(f"host:5000/team/robot:2@sha256:{'a' * 64}")
    assert first == name("host:5000/team/robot:1", user="root") == name("host:5000/team/robot", replace(EC2, cpus=7))
    assert first != name("host:5000/team/simulation:1")
    assert first != name("host:5000/team/robot:1", replace(SETTINGS, prefix="other"))


def test_long_names_fit() -> None:
    many = job(*(container(f"container_{i}" + "x" * 40) for i in range(8)))
    name = definition(many)["jobDefinitionName"]
    assert len(name) <= 128
    assert name.startswith("calibration-container-0xxx")


def test_one_that_is_too_long(tmp_path: Path) -> None:
    mounts = tuple(Mount(tmp_path, f"/data/{'x' * 100}{i}") for i in range(200))
    with pytest.raises(InputError, match=rf"AWS Batch accepts {MAX_DEFINITION_BYTES}: it has 200 mounts and 0 secrets"):
        definition(job(container(mounts=mounts)))


@pytest.mark.parametrize(
    ("ended", "action"),
    [
        ({"onStatusReason": "Host EC2 (instance i-0123) terminated."}, "RETRY"),
        ({"onStatusReason": "Your Spot Task was interrupted."}, "RETRY"),
        ({"onStatusReason": "Essential container in task exited", "onExitCode": "1"}, "EXIT"),
        ({"onStatusReason": "Essential container in task exited", "onReason": "OutOfMemoryError: killed"}, "EXIT"),
        ({"onStatusReason": "Task failed to start", "onReason": "CannotPullContainerError"}, "EXIT"),
        ({"onReason": "CannotPullContainerError"}, "EXIT"),
        ({"onExitCode": "137"}, "EXIT"),
    ],
)
def test_only_a_lost_host_is_tried_again(ended: dict[str, str], action: str) -> None:
    rules = definition(job())["retryStrategy"]["evaluateOnExit"]
    matching = (
        rule["action"]
        for rule in rules
        if all(key in ended and fnmatch.fnmatchcase(ended[key], rule[key]) for key in rule if key != "action")
    )
    assert next(matching, "RETRY") == action  # a failure that matches no rule is retried


def test_containers_keep_their_order() -> None:
    names = [each["name"] for each in task(Job("j", (Container("b", "i"), Container("a", "i"))))["containers"]]
    assert names == ["calibration-prepare", "b", "a", "calibration-watch"]
