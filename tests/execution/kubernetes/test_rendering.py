import shutil
import signal
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from calibration.errors import InputError
from calibration.execution.job import Job, Readiness, Relaxations
from calibration.execution.kubernetes.rendering import rendered
from tests.engine import wait_until
from tests.execution.batch.samples import REGISTRY, SETTINGS, container, job, simulation

VERSIONS = ["1.29", "1.33", "1.37"]


def manifests(*jobs: Job, run: str = "ab12", **settings: Any) -> list[dict[str, Any]]:
    text = rendered(jobs, replace(SETTINGS, **settings), run)
    found = list(yaml.safe_load_all(text))
    for manifest in found:
        for version in VERSIONS:
            kubernetes_validate.validate(manifest, version, strict=True)
    return found


def pod(*jobs: Job, **settings: Any) -> dict[str, Any]:
    (manifest,) = manifests(*jobs, **settings)
    return dict(manifest["spec"]["template"]["spec"])


def sidecar(wanted: Job) -> dict[str, Any]:
    found = pod(wanted)["initContainers"]
    assert [each["name"] for each in found[:1]] == ["calibration-prepare"]
    return dict(found[1])


def test_the_schema_would_complain(tmp_path: Path) -> None:
    (manifest,) = manifests(simulation(tmp_path))
    manifest["spec"]["completionsMode"] = "Indexed"
    with pytest.raises(kubernetes_validate.ValidationError, match="completionsMode"):
        kubernetes_validate.validate(manifest, VERSIONS[0], strict=True)


def test_all_of_a_manifest(tmp_path: Path) -> None:
    tools = {
        "image": f"{REGISTRY}/calibration-ci:1",
        "env": [
            {"name": "CALIBRATION_LOCATION", "value": "s3://team-robots/calibration/ab12/GROUP"},
            {"name": "CALIBRATION_FIRST", "value": "0"},
            {"name": "AWS_REGION", "value": "eu-west-1"},
            {"name": "AWS_BATCH_JOB_ATTEMPT", "value": "1"},
            {
                "name": "AWS_BATCH_JOB_ARRAY_INDEX",
                "valueFrom": {
                    "fieldRef": {"fieldPath": "metadata.annotations['batch.kubernetes.io/job-completion-index']"}
                },
            },
        ],
        "resources": {"requests": {"cpu": "0.25", "memory": "512Mi"}, "limits": {"memory": "512Mi"}},
        "securityContext": {
            "runAsUser": 0,
            "allowPrivilegeEscalation": False,
            "capabilities": {"drop": ["ALL"], "add": ["DAC_OVERRIDE", "FOWNER"]},
        },
    }
    inside = ["python3", "-m", "calibration.execution.batch.inside"]
    shared = [
        {"name": "job", "mountPath": "/calibration/job"},
        {"name": "output", "mountPath": "/calibration/output"},
    ]
    jobs = [simulation(tmp_path), replace(simulation(tmp_path), name="k", seconds=60)]
    (manifest,) = manifests(*jobs)
    group = manifest["metadata"]["name"].split("-")[2]
    once = manifest["spec"]["template"]["spec"]["initContainers"][1]["args"][2]
    labels = {"app.kubernetes.io/name": "calibration-ci", "ci.calibration/run": "ab12"}
    tools["env"][0]["value"] = f"s3://team-robots/calibration/ab12/{group}"  # type: ignore[index]
    assert manifest == {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": {"name": f"calibration-ab12-{group}-0", "labels": labels},
        "spec": {
            "completionMode": "Indexed",
            "completions": 2,
            "parallelism": 2,
            "backoffLimitPerIndex": 2,
            "maxFailedIndexes": 2,
            "podFailurePolicy": {
                "rules": [
                    {"action": "Count", "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]},
                    {"action": "FailIndex", "onExitCodes": {"operator": "NotIn", "values": [0]}},
                ]
            },
            "template": {
                "metadata": {"labels": labels},
                "spec": {
                    "restartPolicy": "Never",
                    "serviceAccountName": "calibration",
                    "automountServiceAccountToken": False,
                    "enableServiceLinks": False,
                    "nodeSelector": {"kubernetes.io/os": "linux", "kubernetes.io/arch": "amd64"},
                    "terminationGracePeriodSeconds": 120,
                    "activeDeadlineSeconds": 3600 + 1800,
                    "volumes": [
                        {"name": "job", "emptyDir": {}},
                        {"name": "output", "emptyDir": {}},
                        {"name": "mount-0", "emptyDir": {}},
                        {"name": "mount-1", "emptyDir": {}},
                    ],
                    "initContainers": [
                        {
                            "name": "calibration-prepare",
                            **tools,
                            "command": [*inside, "prepare"],
                            "volumeMounts": [
                                *shared,
                                {"name": "mount-0", "mountPath": "/calibration/mounts/0"},
                                {"name": "mount-1", "mountPath": "/calibration/mounts/1"},
                            ],
                        },
                        {
                            "name": "simulation",
                            "image": f"{REGISTRY}/simulation@sha256:{'0' * 64}",
                            "restartPolicy": "Always",
                            "args": [
                                "/bin/sh",
                                "-c",
                                once,
                                "sh",
                                "/calibration/job/simulation.sh",
                                "/calibration/job/state/simulation/started",
                            ],
                            "env": [],
                            "volumeMounts": [*shared, {"name": "mount-0", "mountPath": "/data", "readOnly": True}],
                            "resources": {
                                "requests": {"cpu": "2", "memory": "3073Mi"},
                                "limits": {"memory": "3073Mi"},
                            },
                            "securityContext": {
                                "allowPrivilegeEscalation": False,
                                "capabilities": {"drop": ["ALL"]},
                            },
                        },
                        {
                            "name": "robot",
                            "image": f"{REGISTRY}/robot:1",
                            "restartPolicy": "Always",
                            "args": [
                                "/bin/sh",
                                "-c",
                                once,
                                "sh",
                                "/calibration/job/robot.sh",
                                "/calibration/job/state/robot/started",
                            ],
                            "env": [
                                {
                                    "name": "TOKEN",
                                    "valueFrom": {"secretKeyRef": {"name": "calibration", "key": "TOKEN"}},
                                }
                            ],
                            "volumeMounts": [
                                *shared,
                                {"name": "mount-0", "mountPath": "/data", "readOnly": True},
                                {"name": "mount-1", "mountPath": "/scratch", "readOnly": False},
                            ],
                            "resources": {
                                "requests": {"cpu": "1", "memory": "2048Mi"},
                                "limits": {"memory": "2048Mi"},
                            },
                            "securityContext": {
                                "allowPrivilegeEscalation": False,
                                "capabilities": {"drop": ["ALL"]},
                                "runAsUser": 1000,
                            },
                        },
                    ],
                    "containers": [
                        {
                            "name": "calibration-watch",
                            **tools,
                            "command": [*inside, "watch"],
                            "volumeMounts": shared,
                        }
                    ],
                },
            },
        },
    }


def test_the_file_says_what_it_needs_and_nothing_secret(tmp_path: Path) -> None:
    text = rendered([simulation(tmp_path)], SETTINGS, "ab12")
    head = [line for line in text.splitlines() if line.startswith("#")]
    assert "s3://team-robots/calibration" in head[0]
    assert any("ServiceAccount calibration" in line for line in head)
    assert any("Secret calibration" in line for line in head)
    assert "s3cret" not in text
    assert "&id" not in text  # no references within it
    assert "Secret" not in rendered([job()], SETTINGS, "ab12").partition("---")[0]


def test_jobs_of_two_shapes_and_more_than_an_array_takes() -> None:
    jobs = [job(name=str(i)) for i in range(10_001)] + [job(container(image="other"), name="other")]
    found = [yaml.safe_load(part) for part in rendered(jobs, SETTINGS, "ab12").split("---\n")[1:]]
    assert [each["spec"]["completions"] for each in found] == [10_000, 1, 1]
    assert [each["spec"]["parallelism"] for each in found] == [256, 1, 1]
    firsts = [each["spec"]["template"]["spec"]["containers"][0]["env"][1]["value"] for each in found]
    assert firsts == ["0", "10000", "0"]
    assert len({each["metadata"]["name"] for each in found}) == 3


def test_what_is_asked_for() -> None:
    relaxed = Relaxations(new_privileges=True, capabilities=("NET_RAW",), gpus=True)
    found = sidecar(job(container(relaxations=relaxed, user="1000:100")))
    assert found["securityContext"] == {
        "allowPrivilegeEscalation": True,
        "capabilities": {"drop": ["ALL"], "add": ["NET_RAW"]},
        "runAsUser": 1000,
        "runAsGroup": 100,
    }
    assert found["resources"]["limits"] == {"memory": "2048Mi", "nvidia.com/gpu": "1"}
    assert sidecar(job(container(relaxations=Relaxations(privileged=True))))["securityContext"] == {"privileged": True}


def test_other_machines_and_no_limit_in_time() -> None:
    found = pod(job(seconds=None), architecture="arm64")
    assert found["nodeSelector"]["kubernetes.io/arch"] == "arm64"
    assert "activeDeadlineSeconds" not in found


def test_one_attempt_is_never_tried_again() -> None:
    (manifest,) = manifests(job(), attempts=1)
    assert manifest["spec"]["backoffLimitPerIndex"] == 0


def test_names_that_kubernetes_takes() -> None:
    names = ["My_Robot", "my-robot", "My-Robot", "x" * 63, "a__b"]
    (manifest,) = manifests(job(*(container(name) for name in names)), run="A Run: " + "y" * 100)
    found = [each["name"] for each in manifest["spec"]["template"]["spec"]["initContainers"]]
    assert len(set(found)) == 6
    scripts = [each["args"][-2] for each in manifest["spec"]["template"]["spec"]["initContainers"][1:]]
    assert scripts == [f"/calibration/job/{name}.sh" for name in names]
    for name in [*found, manifest["metadata"]["name"], manifest["metadata"]["labels"]["ci.calibration/run"]]:
        assert name.replace("-", "").isalnum()
        assert name == name.lower().strip("-")
        assert len(name) <= 52  # a pod's name has "-9999-abcde" behind it, and at most 63 characters


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (job(network="host"), "on Kubernetes a pod has a network of its own: say network: private"),
        (job(network="none"), "on Kubernetes a task has to reach S3"),
        (job(container(user="robot")), "on Kubernetes a user is a number, found 'robot': say its number"),
        (job(container(command=())), "on Kubernetes nobody can ask an image for its own command"),
        (
            job(container(relaxations=Relaxations(devices=("/dev/video0",)))),
            "on Kubernetes there are no devices without a plugin",
        ),
        (
            job(container("a", readiness=Readiness(port=1)), container("b", readiness=Readiness(port=1))),
            "cannot both listen on port 1",
        ),
    ],
)
def test_what_makes_no_sense_in_a_pod(wanted: Job, message: str) -> None:
    with pytest.raises(InputError) as caught:
        rendered([wanted], SETTINGS, "ab12")
    assert message in str(caught.value)


SHELLS = [shell for shell in (["dash"], ["bash", "--posix"], ["busybox", "sh"]) if shutil.which(shell[0])]


@pytest.mark.parametrize("shell", SHELLS, ids=" ".join)
def test_a_sidecar_runs_its_script_once_and_then_waits_to_be_stopped(tmp_path: Path, shell: list[str]) -> None:
    script = tmp_path / "a robot.sh"
    script.write_text('echo run >> "$(dirname "$0")/log"; exit 3\n')
    _, _, once, name, _, _ = sidecar(job())["args"]
    command = [*shell, "-c", once, name, str(script), str(tmp_path / "a mark")]
    assert subprocess.run(command, timeout=60, check=False).returncode == 3
    with subprocess.Popen(command) as again:  # as Kubernetes does
        children = Path(f"/proc/{again.pid}/task/{again.pid}/children")
        wait_until(lambda: children.read_text() != "", "it waits, by a child that sleeps")
        assert again.poll() is None
        again.send_signal(signal.SIGTERM)
        assert again.wait(60) == 0
    assert (tmp_path / "log").read_text() == "run\n"
