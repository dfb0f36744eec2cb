"""Queues, definitions and images: checks before submission, and search in a queue."""

import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.__main__ import main
from calibration.addons.aws_batch import submitting
from calibration.addons.aws_batch.backend import BatchBackend
from calibration.addons.aws_batch.checks import check_queue, likely_reasons, with_digests
from calibration.addons.aws_batch.definition import Resources
from calibration.addons.aws_batch.session import Aws
from calibration.addons.aws_batch.submitting import ensure, find_in_queue, find_old, owner_of, run_tags, terminate
from calibration.base import InfrastructureError, InputError
from calibration.ci.execution.docker.labels import Owner
from calibration.ci.execution.job import Limits
from tests.addons.aws_batch.client import SETTINGS, Tasks, container, job, jobs, running, wait_for
from tests.addons.aws_batch.emulator.faults import named
from tests.addons.aws_batch.fixtures import QUEUE, REGION
from tests.addons.aws_batch.fixtures import Aws as FakeAws

pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def aws(batch_emulator: FakeAws) -> Iterator[Aws]:
    aws = Aws(REGION)
    yield aws
    aws.close()


@pytest.mark.parametrize(
    ("queue", "settings", "message"),
    [
        ({"state": "DISABLED"}, {}, "queue 'q': it is DISABLED and VALID: no job would start"),
        ({"status": "INVALID"}, {}, "queue 'q': it is ENABLED and INVALID"),
        ({"environment_state": "DISABLED"}, {}, "none of its compute environments accepts jobs: compute environment"),
        ({"environment_status": "INVALID"}, {}, "is ENABLED and INVALID"),
        ({"kind": "EC2"}, {}, "its hosts are EC2, but platform is fargate: set ec2, or name another queue"),
        ({}, {"platform": "ec2"}, "its hosts are FARGATE, but platform is ec2: set fargate"),
        ({}, {"spot": True}, "spot is required, but its hosts are FARGATE"),
        ({"max_cpus": 2}, {}, r"a job needs 4 vCPUs, but its compute environments have at most 2 \(maxvCpus\)"),
        ({"kind": "FARGATE_SPOT"}, {"spot": True}, ""),
        ({"kind": "SPOT"}, {"spot": True, "platform": "ec2"}, ""),
        ({"kind": "FARGATE_SPOT"}, {}, ""),
    ],
)
def test_queues(
    aws: Aws, batch_emulator: FakeAws, queue: dict[str, Any], settings: dict[str, Any], message: str
) -> None:
    batch_emulator.batch.add_queue("q", **queue)
    given = replace(SETTINGS, queue="q", **settings)
    needs = [Resources(1, 2048), Resources(4, 8192)]
    if not message:
        check_queue(aws, given, needs)
        return
    with pytest.raises(InputError, match=message):
        check_queue(aws, given, needs)


def test_no_such_queue(aws: Aws) -> None:
    with pytest.raises(InputError, match="queue 'nosuch': there is none in eu-west-1: check its name and the region"):
        check_queue(aws, replace(SETTINGS, queue="nosuch"), [])


def answering(aws: Aws, monkeypatch: pytest.MonkeyPatch, queue: dict[str, Any], *environments: dict[str, Any]) -> None:
    """Let AWS describe a queue that the emulator does not support."""
    fine = {"state": "ENABLED", "status": "VALID"}
    order = [{"computeEnvironment": "e"} for _ in environments]
    told = [{"computeEnvironmentName": "e", **fine, **each} for each in environments]
    monkeypatch.setattr(
        aws.batch, "describe_job_queues", lambda **_: {"jobQueues": [fine | {"computeEnvironmentOrder": order} | queue]}
    )
    monkeypatch.setattr(aws.batch, "describe_compute_environments", lambda **_: {"computeEnvironments": told})


def test_queues_of_other_kinds(aws: Aws, monkeypatch: pytest.MonkeyPatch) -> None:
    answering(aws, monkeypatch, {}, {"containerOrchestrationType": "EKS"})
    with pytest.raises(InputError, match=r"is of Kubernetes \(EKS\), expected one of ECS"):
        check_queue(aws, SETTINGS, [])
    answering(aws, monkeypatch, {})
    with pytest.raises(InputError, match="none of its compute environments accepts jobs: it has none"):
        check_queue(aws, SETTINGS, [])
    answering(aws, monkeypatch, {}, {"type": "UNMANAGED"})
    check_queue(aws, replace(SETTINGS, platform="ec2"), [Resources(99, 1)])
    answering(aws, monkeypatch, {"status": "INVALID", "statusReason": "no\nrole"}, {})
    with pytest.raises(InputError, match=r"it is ENABLED and INVALID \(no role\)"):
        check_queue(aws, SETTINGS, [])


def test_likely_reasons_contain_errors_of_the_queue(aws: Aws, monkeypatch: pytest.MonkeyPatch) -> None:
    environment = {"status": "INVALID", "statusReason": "role is gone", "computeResources": {"maxvCpus": 0}}
    answering(aws, monkeypatch, {"state": "DISABLED"}, environment)
    reasons = likely_reasons(aws, replace(SETTINGS, platform="ec2", spot=True), ["x"])
    assert reasons[:3] == [
        "the queue is DISABLED and VALID",
        "compute environment 'e' is ENABLED and INVALID (role is gone)",
        "compute environment 'e' may have no vCPUs (maxvCpus: 0)",
    ]
    assert any("instance types" in reason for reason in reasons)
    assert "no Spot capacity at the moment" in reasons
    answering(aws, monkeypatch, {})
    assert "public-ip" not in str(likely_reasons(aws, replace(SETTINGS, public_ip=True), ["x"]))
    answering(aws, monkeypatch, {}, {})
    assert "no capacity" in likely_reasons(aws, SETTINGS, ["x"])[0]


def test_reasons_that_cannot_be_found_out(aws: Aws, batch_emulator: FakeAws) -> None:
    batch_emulator.faults.deny("DescribeJobQueues")
    assert likely_reasons(aws, SETTINGS, ["x"])[0].startswith("the cause is unknown: queue 'robots': AWS: batch:")


def definition(memory: int) -> dict[str, Any]:
    from calibration.addons.aws_batch.definition import job_definition, shape_of

    return job_definition(shape_of(job("x", container(limits=Limits(memory=memory * 1024**2))), SETTINGS), SETTINGS)


def test_a_definition_has_a_new_revision_only_where_it_differs(
    aws: Aws,
    batch_emulator: FakeAws,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arns = [ensure(aws, definition(memory)) for memory in (1024, 1024, 2048, 1024, 3072)]
    assert [arn.rpartition(":")[2] for arn in arns] == ["1", "1", "2", "1", "3"]
    foreign = {key: value for key, value in definition(1024).items() if key != "tags"} | {"jobDefinitionName": "other"}
    for _ in range(2):
        aws.batch.register_job_definition(**foreign)
    assert find_old(aws) == [arns[0], arns[2]]
    monkeypatch.chdir(tmp_path)
    assert main(["cleanup", "--cloud", "--definitions", "--region", REGION, "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert shown == f"job definition\n{arns[0]}\n{arns[2]}\n2 old revisions would be deregistered\n"
    assert main(["cleanup", "--cloud", "--definitions", "--region", REGION]) == 0
    assert capsys.readouterr().out.endswith("2 old revisions deregistered\n")
    assert find_old(aws) == []
    assert main(["cleanup", "--cloud", "--definitions", "--region", REGION]) == 0
    assert capsys.readouterr().out == "nothing deregistered\n"
    assert ensure(aws, definition(3072)) == arns[-1]
    assert ensure(aws, definition(1024)).endswith(":4")  # its old revision is not active


def test_definitions_on_many_pages(aws: Aws, monkeypatch: pytest.MonkeyPatch) -> None:
    request = definition(1024)
    found = {"jobDefinitionArn": "wanted", "tags": request["tags"]}
    pages = {
        None: {"jobDefinitions": [{"jobDefinitionArn": "other"}], "nextToken": "2"},
        "2": {"jobDefinitions": [found]},
    }
    monkeypatch.setattr(aws.batch, "describe_job_definitions", lambda nextToken=None, **_: pages[nextToken])
    assert ensure(aws, request) == "wanted"


def test_images_of_ecr_are_named_by_their_digest(aws: Aws, batch_emulator: FakeAws) -> None:
    import json

    host = "123456789012.dkr.ecr.eu-west-1.amazonaws.com"
    ecr = batch_emulator.client("ecr")
    ecr.create_repository(repositoryName="team/robot")
    manifest = json.dumps({"schemaVersion": 2, "mediaType": "application/vnd.docker.distribution.manifest.v2+json"})
    digest = ecr.put_image(repositoryName="team/robot", imageManifest=manifest, imageTag="latest")["image"]["imageId"][
        "imageDigest"
    ]
    ecr.close()
    name = f"{host}/team/robot"
    there, exact = f"{name}@{digest}", f"{name}@sha256:{'0' * 64}"
    assert with_digests(aws, [name, f"{name}:latest", exact, "debian:12"]) == {
        name: there,
        f"{name}:latest": there,
        exact: exact,
        "debian:12": "debian:12",
    }
    for missing in (f"{name}:nosuch", f"{host}/team/nosuch"):
        with pytest.raises(InputError, match=f"image {missing}: it is not in ECR: push it"):
            with_digests(aws, [missing])
    batch_emulator.services.faults.refuse("DescribeImages", 403, "AccessDeniedException", "no")
    with pytest.raises(InputError, match="ecr:DescribeImages: AccessDeniedException: the role or user needs"):
        with_digests(aws, [name])


def test_jobs_that_make_no_sense_are_refused_before_anything_is_sent(batch_emulator: FakeAws, tmp_path: Path) -> None:
    with BatchBackend(SETTINGS) as backend:
        for given, workers, message in [
            ([job("a"), job("a")], None, "another job of the run"),
            ([job("a")], 0, "jobs: found 0"),
            ([job("a", network="none")], None, "on AWS Batch"),
        ]:
            with pytest.raises(InputError, match=message):
                backend.run(given, tmp_path, workers)
    assert batch_emulator.batch.calls == {}
    with pytest.raises(InputError, match="run 'a/b': expected letters"):
        BatchBackend(SETTINGS, "a/b")
    with pytest.raises(InputError, match="resume: give the name of the run"):
        BatchBackend(SETTINGS, resume=True)


def test_tags_tell_who_started_a_job() -> None:
    tags = run_tags("night")
    assert owner_of(tags) == Owner.this_process()
    assert all(
        set(value) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+-=._:/@ ")
        for value in tags.values()
    )
    assert owner_of({}) is None
    dead = {**tags, "ci.calibration.owner.started": "1"}
    owner = owner_of(dead)
    assert owner is not None
    assert owner.is_dead


PROGRAM = """
import os, sys
from pathlib import Path
from calibration.addons.aws_batch.backend import BatchBackend
from tests.addons.aws_batch.client import SETTINGS, jobs

for _ in BatchBackend(SETTINGS, sys.argv[1]).__enter__().run(jobs(3), Path(sys.argv[2])):
    pass
"""


def test_cleanup_terminates_leftovers_of_killed_runs(
    batch_emulator: FakeAws, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    Tasks(batch_emulator, lambda task, attempt: attempt.stop.wait(240) and None)
    batch_emulator.faults.stick(named("calibration-night-x"))
    where = ["--queue", QUEUE, "--region", REGION]
    batch = batch_emulator.client("batch")
    killed = subprocess.Popen([sys.executable, "-c", PROGRAM, "night.1", str(tmp_path / "a")], env=os.environ)
    alive = BatchBackend(SETTINGS, "night")
    follower = threading.Thread(target=lambda: list(alive.run(jobs(3), tmp_path / "b")))
    follower.start()
    foreign = ""
    try:
        wait_for(lambda: len(running(batch_emulator)) == 2)
        killed.kill()
        definition = batch.describe_job_definitions()["jobDefinitions"][0]["jobDefinitionArn"]
        foreign = batch.submit_job(jobName="calibration-night-x", jobQueue=QUEUE, jobDefinition=definition)["jobId"]
        killed.wait()
        assert main(["cleanup", "--cloud", "--dry-run", *where]) == 0
        ended, kept = capsys.readouterr().out.split("1 job or array in AWS Batch would be ended\n")
        assert "night.1" in ended
        assert "night " not in ended
        assert re.search(rf"night .*active, process {os.getpid()}\n1 kept: ", kept)
        assert len(running(batch_emulator)) == 3

        config = tmp_path / "calibration.yml"
        config.write_text(
            f"aws-batch: {{region: {REGION}, queue: {QUEUE}, bucket: robots-results, tools-image: tools,\n"
            "  job-role: 'arn:aws:iam::123456789012:role/j', execution-role: 'arn:aws:iam::123456789012:role/e'}\n"
        )
        assert main(["cleanup", "--cloud", "--config", str(config)]) == 0
        assert "1 job or array in AWS Batch ended" in capsys.readouterr().out
        wait_for(lambda: len(running(batch_emulator)) == 2)  # a job ends some time after it was told to
        assert main(["cleanup", "--cloud", "--run", "night.1", *where]) == 0
        assert capsys.readouterr().out == "nothing in AWS Batch ended\n"
        monkeypatch.chdir(tmp_path)
        assert main(["cleanup", "--cloud", "--run", "night"]) == 0  # a running one
        assert main(["cleanup", "--cloud", "--all", *where]) == 0
        wait_for(lambda: running(batch_emulator) == [foreign])  # a foreign job with a similar name
    finally:
        killed.kill()
        killed.wait()
        for identifier in running(batch_emulator):
            batch.terminate_job(jobId=identifier, reason="test")
        batch.close()
        follower.join(60)
        alive.aws.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--queue", "q"], "queue is of use with --cloud only"),
        (["--cloud", "--config", "nosuch.yml"], "nosuch.yml"),
        (["--cloud", "--queue", "q", "--region", REGION, "--run", "a", "--all"], "run and all exclude each other"),
    ],
)
def test_cleanup_that_makes_no_sense(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cleanup", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_jobs_that_do_not_end(aws: Aws, batch_emulator: FakeAws, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(submitting, "_SETTLING_SECONDS", 0.1)
    batch_emulator.faults.stick(lambda _: True)
    batch = batch_emulator.client("batch")
    arn = batch.register_job_definition(**definition(1024))["jobDefinitionArn"]
    ids = [batch.submit_job(jobName="a", jobQueue=QUEUE, jobDefinition=arn)["jobId"] for _ in range(6)]
    monkeypatch.setattr(aws.batch, "terminate_job", lambda **_: {})
    with pytest.raises(InfrastructureError, match="6 jobs in AWS Batch are not terminated, such as "):
        terminate(aws, ids, "test")
    monkeypatch.undo()
    batch_emulator.faults.deny("TerminateJob", times=4)
    with pytest.raises(InputError, match="batch:TerminateJob: AccessDeniedException"):
        terminate(aws, ids, "test")
    assert batch_emulator.batch.calls["TerminateJob"] == 4  # then it gives up
    assert find_in_queue(aws, QUEUE) == []  # without a run
    for identifier in ids:
        batch.terminate_job(jobId=identifier, reason="test")
    batch.close()


def test_leftovers_on_many_pages(aws: Aws, batch_emulator: FakeAws, tmp_path: Path) -> None:
    batch_emulator.faults.stick(lambda _: True)
    batch = batch_emulator.client("batch")
    arn = batch.register_job_definition(**definition(1024))["jobDefinitionArn"]
    for number in range(105):
        batch.submit_job(jobName=f"calibration-many-{number}", jobQueue=QUEUE, jobDefinition=arn, tags=run_tags("many"))
    batch.close()
    found = find_in_queue(aws, QUEUE, "many")
    assert len({each.id for each in found}) == 105
    terminate(aws, [each.id for each in found], "test")
    assert find_in_queue(aws, QUEUE, "many") == []
    assert jobs(0) == []
