"""The emulator held against boto3, and against what AWS's documents say."""

import copy
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from .emulator.attempt import Attempt, Ended
from .emulator.faults import child, named
from .emulator.instant import ended, failed_to_start, host_lost
from .emulator.scheduler import TIMED_OUT
from .fixtures import BUCKET, QUEUE, Aws, started_aws
from .services import Services

HALF = [{"type": "VCPU", "value": "0.5"}, {"type": "MEMORY", "value": "1024"}]
OUT_OF_MEMORY = "OutOfMemoryError: Container killed due to memory usage"
LOST_HOSTS_ONLY = {
    "attempts": 3,
    "evaluateOnExit": [{"onStatusReason": "Host EC2*", "action": "RETRY"}, {"onReason": "*", "action": "EXIT"}],
}


def container(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "image": "robot:1", "resourceRequirements": copy.deepcopy(HALF), **more}


def definition(*containers: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A job definition of two containers on Fargate, unless others are given."""
    given = list(containers) or [
        container("prepare", essential=False, environment=[{"name": "A", "value": "1"}, {"name": "B", "value": "2"}]),
        container("watch", dependsOn=[{"containerName": "prepare", "condition": "SUCCESS"}]),
    ]
    task = {"containers": given, "executionRoleArn": "arn:aws:iam::123456789012:role/run", "volumes": [{"name": "job"}]}
    return {
        "jobDefinitionName": "world",
        "type": "container",
        "platformCapabilities": ["FARGATE"],
        "ecsProperties": {"taskProperties": [task]},
        **more,
    }


def submit(aws: Aws, size: int | None = None, register: dict[str, Any] | None = None, **more: Any) -> str:
    """Register a definition, submit a job of it, and return its id."""
    batch = aws.client("batch")
    arn = batch.register_job_definition(**(register or definition()))["jobDefinitionArn"]
    array = {} if size is None else {"arrayProperties": {"size": size}}
    job = batch.submit_job(**{"jobName": "sweep", "jobQueue": QUEUE, "jobDefinition": arn} | array | more)
    identity: str = job["jobId"]
    return identity


def describe(aws: Aws, *ids: str) -> list[dict[str, Any]]:
    batch = aws.client("batch")
    jobs: list[dict[str, Any]] = batch.describe_jobs(jobs=list(ids))["jobs"]
    return jobs


def run(aws: Aws, function: Callable[[Attempt], Ended | None], **more: Any) -> dict[str, Any]:
    """Run one job to its end and describe it."""
    aws.batch.runner.function = function
    identity = submit(aws, **more)
    aws.batch.wait()
    return describe(aws, identity)[0]


def told(job: dict[str, Any], name: str) -> dict[str, Any]:
    containers: list[dict[str, Any]] = job["ecsProperties"]["taskProperties"][0]["containers"]
    return next(each for each in containers if each["name"] == name)


def refused(aws: Aws, operation: str, **request: Any) -> tuple[str, int, str]:
    """The code, the HTTP status and the message with which a call is refused."""
    from botocore.exceptions import ClientError

    batch = aws.client("batch")
    with pytest.raises(ClientError) as caught:
        getattr(batch, operation)(**request)
    answer = caught.value.response
    return answer["Error"]["Code"], answer["ResponseMetadata"]["HTTPStatusCode"], answer["Error"]["Message"]


def refused_submission(aws: Aws, **request: Any) -> str:
    """The message with which a job of the definition ``world`` is refused."""
    return refused(aws, "submit_job", **{"jobName": "sweep", "jobQueue": QUEUE, "jobDefinition": "world", **request})[2]


def waits(attempt: Attempt) -> Ended:
    """Run until it is stopped."""
    assert attempt.stop.wait(20)
    return ended(attempt, {"watch": 143})


# one job


def test_a_job_that_succeeds(batch_emulator: Aws) -> None:
    job = run(batch_emulator, lambda attempt: ended(attempt, seconds=61), tags={"run": "a"})
    assert (job["status"], job["statusReason"]) == ("SUCCEEDED", "Essential container in task exited")
    assert job["stoppedAt"] - job["startedAt"] == 61_000
    assert job["tags"] == {"run": "a"}
    assert job["container"] == {}
    assert told(job, "watch")["exitCode"] == 0
    assert told(job, "watch")["logStreamName"].startswith("world/watch/")
    assert [each["statusReason"] for each in job["attempts"]] == ["Essential container in task exited"]


@pytest.mark.parametrize(("failing", "status"), [("watch", "FAILED"), ("prepare", "SUCCEEDED")])
def test_only_the_essential_container_decides(batch_emulator: Aws, failing: str, status: str) -> None:
    job = run(
        batch_emulator,
        lambda attempt: ended(attempt, {failing: 3}, {failing: OUT_OF_MEMORY}),
    )
    assert job["status"] == status
    assert (told(job, failing)["exitCode"], told(job, failing)["reason"]) == (3, OUT_OF_MEMORY)
    assert len(job["attempts"]) == 1


def test_what_a_task_is_told(batch_emulator: Aws) -> None:
    seen: list[Attempt] = []
    override = {"name": "prepare", "environment": [{"name": "B", "value": "3"}], "command": ["go"]}
    identity = submit(batch_emulator, 2, ecsPropertiesOverride={"taskProperties": [{"containers": [override]}]})
    batch_emulator.batch.wait()
    batch_emulator.batch.runner.function = seen.append
    assert not seen  # those ran before
    identity = submit(batch_emulator, 2, ecsPropertiesOverride={"taskProperties": [{"containers": [override]}]})
    batch_emulator.batch.wait()
    attempt = next(each for each in seen if each.index == 1)
    assert attempt.container("prepare")["command"] == ["go"]
    assert attempt.environment("prepare") == {
        "A": "1",
        "B": "3",
        "AWS_BATCH_JOB_ID": f"{identity}:1",
        "AWS_BATCH_JOB_ATTEMPT": "1",
        "AWS_BATCH_JOB_ARRAY_INDEX": "1",
        "AWS_BATCH_JOB_ARRAY_SIZE": "2",
        "AWS_BATCH_JQ_NAME": QUEUE,
        "AWS_BATCH_CE_NAME": "robots-hosts",
    }
    run(batch_emulator, seen.append)
    assert "AWS_BATCH_JOB_ARRAY_INDEX" not in seen[-1].environment("watch")


def test_the_log_goes_where_the_definition_says(batch_emulator: Aws) -> None:
    log = {"logDriver": "awslogs", "options": {"awslogs-group": "/robots", "awslogs-stream-prefix": "run-1"}}
    seen: list[Attempt] = []
    run(batch_emulator, seen.append, register=definition(container("only", logConfiguration=log), container("other")))
    assert seen[0].log_stream("only") == ("/robots", f"run-1/only/{seen[0].task_id}")
    assert seen[0].log_stream("other") == ("/aws/batch/job", f"world/other/{seen[0].task_id}")


def test_a_job_that_cannot_start_has_no_start(batch_emulator: Aws) -> None:
    job = run(batch_emulator, lambda _: failed_to_start("CannotPullContainerError: no such image"))
    assert (job["status"], job["statusReason"]) == ("FAILED", "CannotPullContainerError: no such image")
    assert "startedAt" not in job["attempts"][0]


def test_a_mistake_in_the_tests_function_is_seen(aws_services: Services) -> None:
    def wrong(_: Attempt) -> None:
        raise ValueError("mistaken")

    with pytest.raises(AssertionError, match="ValueError: mistaken"), started_aws(aws_services, wrong) as aws:
        assert run(aws, wrong)["status"] == "FAILED"


# arrays


def test_an_array_counts_its_children(batch_emulator: Aws) -> None:
    go = threading.Event()

    def function(attempt: Attempt) -> Ended:
        go.wait(240)
        return ended(attempt, {"watch": int(attempt.index == 2)})

    batch_emulator.batch.runner.function = function
    identity = submit(batch_emulator, 6)
    with batch_emulator.batch.jobs.lock:
        assert batch_emulator.batch.jobs.lock.wait_for(lambda: batch_emulator.batch.scheduler.most_at_once == 4, 60)
    array = describe(batch_emulator, identity)[0]
    summary = array["arrayProperties"]["statusSummary"]
    assert (array["status"], summary["RUNNABLE"], summary["RUNNING"] + summary["STARTING"]) == ("PENDING", 2, 4)
    assert "startedAt" not in array
    go.set()
    batch_emulator.batch.wait()
    array, failed, other = describe(batch_emulator, identity, f"{identity}:2", f"{identity}:3")
    assert (array["status"], array["statusReason"]) == ("FAILED", "Array Child Job failed")
    assert (array["arrayProperties"]["statusSummary"]["SUCCEEDED"], array["arrayProperties"]["size"]) == (5, 6)
    assert (failed["status"], failed["arrayProperties"]["index"]) == ("FAILED", 2)
    assert (other["status"], other["jobArn"].rpartition("/")[2]) == ("SUCCEEDED", f"{identity}:3")


def test_children_are_listed_in_pages(batch_emulator: Aws) -> None:
    identity = submit(batch_emulator, 25)
    batch_emulator.batch.wait()
    batch = batch_emulator.client("batch")
    paginator = batch.get_paginator("list_jobs")
    asked = {"arrayJobId": identity, "jobStatus": "SUCCEEDED", "PaginationConfig": {"PageSize": 10}}
    pages = [page["jobSummaryList"] for page in paginator.paginate(**asked)]
    assert [len(page) for page in pages] == [10, 10, 5]
    assert sorted(job["arrayProperties"]["index"] for page in pages for job in page) == list(range(25))
    assert batch.list_jobs(arrayJobId=identity)["jobSummaryList"] == []  # where no state is asked for: those that run
    first = batch.list_jobs(jobQueue=QUEUE, jobStatus="SUCCEEDED")["jobSummaryList"][0]
    assert first["jobId"] == identity  # a queue lists arrays, not their children
    assert "tags" not in first


def test_ten_thousand_jobs(batch_emulator: Aws) -> None:
    seen: list[int | None] = []
    batch_emulator.batch.runner.function = lambda attempt: seen.append(attempt.index)
    identity = submit(batch_emulator, 10_000)
    batch_emulator.batch.wait(120)
    assert sorted(index for index in seen if index is not None) == list(range(10_000))
    assert describe(batch_emulator, identity)[0]["status"] == "SUCCEEDED"


# retries, lost hosts, time


def test_a_lost_host_is_tried_again(batch_emulator: Aws) -> None:
    batch_emulator.faults.lose_host(child(1), attempts=(1, 2))
    identity = submit(batch_emulator, 3, definition(retryStrategy=LOST_HOSTS_ONLY))
    batch_emulator.batch.wait()
    lost, other = describe(batch_emulator, f"{identity}:1", f"{identity}:2")
    reasons = [each["statusReason"] for each in lost["attempts"]]
    assert [reason[:18] for reason in reasons] == ["Host EC2 (instance", "Host EC2 (instance", "Essential containe"]
    ends = [each["taskProperties"][0]["containers"][1] for each in lost["attempts"]]
    assert [end.get("exitCode") for end in ends] == [None, None, 0]
    assert (lost["status"], len(other["attempts"])) == ("SUCCEEDED", 1)


def test_a_host_that_is_lost_too_often(batch_emulator: Aws) -> None:
    batch_emulator.faults.lose_host(named("sweep"), attempts=(1, 2, 3, 4))
    job = run(batch_emulator, lambda _: None, register=definition(retryStrategy=LOST_HOSTS_ONLY))
    assert (job["status"], len(job["attempts"]), job["statusReason"][:8]) == ("FAILED", 3, "Host EC2")


def test_a_host_may_be_lost_after_the_work(batch_emulator: Aws) -> None:
    done: list[int] = []

    def function(attempt: Attempt) -> Ended | None:
        done.append(attempt.number)
        return host_lost() if attempt.number == 1 else None

    job = run(batch_emulator, function, register=definition(retryStrategy=LOST_HOSTS_ONLY))
    assert (done, job["status"]) == ([1, 2], "SUCCEEDED")


def test_a_host_is_lost_while_the_function_waits(batch_emulator: Aws) -> None:
    batch_emulator.faults.lose_host(named("sweep"), seconds=0.05)

    def function(attempt: Attempt) -> Ended | None:
        return ended(attempt) if attempt.number == 2 or attempt.stop.wait(20) else None

    job = run(batch_emulator, function, register=definition(retryStrategy=LOST_HOSTS_ONLY))
    assert [each["statusReason"][:8] for each in job["attempts"]] == ["Host EC2", "Essentia"]


def test_a_host_of_fargates_spot_is_lost(batch_emulator: Aws) -> None:
    batch_emulator.faults.lose_host(named("sweep"), reason="Your Spot Task was interrupted.")
    job = run(batch_emulator, lambda _: None)
    assert (job["status"], job["statusReason"]) == ("FAILED", "Your Spot Task was interrupted.")


def test_the_first_condition_that_fits_decides(batch_emulator: Aws) -> None:
    def conditions(*given: dict[str, str]) -> dict[str, Any]:
        return definition(retryStrategy={"attempts": 2, "evaluateOnExit": list(given)})

    def attempts(*given: dict[str, str]) -> int:
        failed = lambda attempt: ended(attempt, {"watch": 13}, {"watch": "Out of patience"})  # noqa: E731
        return len(run(batch_emulator, failed, register=conditions(*given))["attempts"])

    assert attempts({"onExitCode": "1*", "action": "EXIT"}, {"onReason": "*", "action": "RETRY"}) == 1
    assert attempts({"onExitCode": "14", "action": "EXIT"}, {"onReason": "Out*", "action": "RETRY"}) == 2
    assert attempts({"onExitCode": "13", "onReason": "In*", "action": "EXIT"}) == 2  # none fits: tried again
    assert attempts({"onStatusReason": "Essential*", "action": "EXIT"}) == 1
    assert len(run(batch_emulator, lambda attempt: ended(attempt, {"watch": 1}))["attempts"]) == 1  # no strategy


def test_a_job_that_runs_too_long_is_not_tried_again(aws_services: Services) -> None:
    register = definition(timeout={"attemptDurationSeconds": 60}, retryStrategy={"attempts": 3})
    with started_aws(aws_services, time_scale=0.002) as aws:
        job = run(aws, waits, register=register)
    assert (job["status"], job["statusReason"], len(job["attempts"])) == ("FAILED", TIMED_OUT, 1)


def test_a_job_that_gets_no_host(batch_emulator: Aws) -> None:
    batch_emulator.faults.stick(child(1), "MISCONFIGURATION:JOB_RESOURCE_REQUIREMENT - no instance is large enough")
    identity = submit(batch_emulator, 2)
    with batch_emulator.batch.jobs.lock:
        done = batch_emulator.batch.jobs.lock.wait_for(
            lambda: batch_emulator.batch.jobs.jobs[identity].counts["SUCCEEDED"] == 1, 10
        )
    assert done
    stuck = describe(batch_emulator, f"{identity}:1")[0]
    assert (stuck["status"], stuck["statusReason"][:16]) == ("RUNNABLE", "MISCONFIGURATION")
    batch_emulator.faults.clear()
    batch_emulator.batch.wait()
    assert describe(batch_emulator, identity)[0]["status"] == "SUCCEEDED"


# ends by request


def test_terminating_an_array_ends_all_of_it(batch_emulator: Aws) -> None:
    batch_emulator.batch.runner.function = waits
    identity = submit(batch_emulator, 9, definition(retryStrategy={"attempts": 3}))
    batch = batch_emulator.client("batch")
    batch.terminate_job(jobId=f"{identity}:8", reason="one of them")
    batch.terminate_job(jobId=identity, reason="interrupted")
    batch.terminate_job(jobId=identity, reason="again")
    batch.terminate_job(jobId="unknown", reason="nobody minds")
    batch_emulator.batch.wait()
    jobs = describe(batch_emulator, *(f"{identity}:{index}" for index in range(9)))
    assert {job["status"] for job in jobs} == {"FAILED"}
    assert [job["statusReason"] for job in jobs] == ["interrupted"] * 8 + ["one of them"]
    assert all(job["isTerminated"] and len(job["attempts"]) <= 1 for job in jobs)
    assert refused(batch_emulator, "terminate_job", jobId=identity, reason="x" * 1025)[0] == "ClientException"


def test_a_job_that_is_terminated_gets_no_other_host(batch_emulator: Aws) -> None:
    batch_emulator.faults.lose_host(named("sweep"), seconds=0.05)

    def function(attempt: Attempt) -> Ended:
        found = waits(attempt)
        batch_emulator.client("batch").terminate_job(jobId=attempt.job.id, reason="interrupted")
        return found

    job = run(batch_emulator, function, register=definition(retryStrategy=LOST_HOSTS_ONLY))
    assert (job["status"], len(job["attempts"]), job["isTerminated"]) == ("FAILED", 1, True)


def test_cancelling_leaves_what_runs(batch_emulator: Aws) -> None:
    batch_emulator.batch.runner.function = waits
    identity = submit(batch_emulator, 6)
    with batch_emulator.batch.jobs.lock:
        assert batch_emulator.batch.jobs.lock.wait_for(
            lambda: batch_emulator.batch.jobs.jobs[identity].counts["RUNNING"] == 4, 60
        )
    batch = batch_emulator.client("batch")
    batch.cancel_job(jobId=identity, reason="too many")
    batch.cancel_job(jobId="unknown", reason="nobody minds")
    array = describe(batch_emulator, identity)[0]["arrayProperties"]["statusSummary"]
    assert (array["RUNNING"], array["FAILED"]) == (4, 2)
    batch.terminate_job(jobId=identity, reason="the rest")
    batch_emulator.batch.wait()


def test_closing_ends_what_runs(aws_services: Services) -> None:
    with started_aws(aws_services, waits) as aws:
        submit(aws, 9)
        jobs = aws.batch
    time.sleep(0.05)
    assert not [job for job in jobs.every_job() if job.status == "RUNNING"]


# definitions


def test_revisions(batch_emulator: Aws) -> None:
    batch = batch_emulator.client("batch")
    for number in range(1, 12):
        assert batch.register_job_definition(**definition(tags={"hash": str(number)}))["revision"] == number
    batch.deregister_job_definition(jobDefinition="world:11")
    every = batch.describe_job_definitions(jobDefinitionName="world")["jobDefinitions"]
    assert {each["revision"]: each["status"] for each in every}[11] == "INACTIVE"
    active = batch.describe_job_definitions(jobDefinitionName="world", status="ACTIVE", maxResults=6)
    assert len(active["jobDefinitions"]) == 6
    rest = batch.describe_job_definitions(jobDefinitionName="world", status="ACTIVE", nextToken=active["nextToken"])
    found = [each["revision"] for each in active["jobDefinitions"] + rest["jobDefinitions"]]
    assert found == [1, 10, 2, 3, 4, 5, 6, 7, 8, 9]  # in no order that means anything
    named = batch.describe_job_definitions(jobDefinitions=["world:3", every[0]["jobDefinitionArn"], "other:1"])
    tags = {each["revision"]: each["tags"] for each in named["jobDefinitions"]}
    assert tags == {3: {"hash": "3"}, 1: {"hash": "1"}}
    newest = batch.submit_job(jobName="sweep", jobQueue=QUEUE, jobDefinition="world")["jobId"]
    assert describe(batch_emulator, newest)[0]["jobDefinition"].endswith("world:10")
    for request in ({"jobDefinitions": ["world:1"] * 101}, {"jobDefinitions": ["world:1"], "status": "ACTIVE"}):
        assert refused(batch_emulator, "describe_job_definitions", **request)[0] == "ClientException"
    assert "revision" in refused(batch_emulator, "deregister_job_definition", jobDefinition="world")[2]
    assert "not active" in refused_submission(batch_emulator, jobDefinition="world:11")


def changed(path: str, value: Any) -> dict[str, Any]:
    """A good definition with one thing changed: a path of keys and indices; None removes."""
    found = copy.deepcopy(definition())
    *parts, last = path.split(".")
    place: Any = found
    for part in parts:
        place = place[int(part) if part.isdigit() else part]
    if value is None:
        del place[last]
    else:
        place[int(last) if last.isdigit() else last] = value
    return found


TASK = "ecsProperties.taskProperties.0"
WATCH = f"{TASK}.containers.1"


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("jobDefinitionName", "a world", "jobDefinitionName"),
        ("type", "multinode", "several containers"),
        ("containerProperties", {"image": "a"}, "containerProperties"),
        ("ecsProperties.taskProperties", [], "0 tasks"),
        ("platformCapabilities", ["EC2", "FARGATE"], "platformCapabilities"),
        ("retryStrategy", {"attempts": 11}, "attempts: 11"),
        ("retryStrategy", {"evaluateOnExit": [{"action": "EXIT"}]}, "required with evaluateOnExit"),
        ("retryStrategy", {"attempts": 1, "evaluateOnExit": [{"action": "EXIT"}] * 6}, "6 conditions"),
        ("retryStrategy", {"attempts": 1, "evaluateOnExit": [{"onReason": "*x", "action": "EXIT"}]}, "no pattern"),
        ("retryStrategy", {"attempts": 1, "evaluateOnExit": [{"onReason": "a", "action": "STOP"}]}, "none of"),
        ("timeout", {"attemptDurationSeconds": 59}, "at least 60"),
        (f"{WATCH}.command", ["x" * 25_000], "at most 24576"),
        ("tags", {"aws:mine": "x"}, "tags"),
        ("tags", {"a": "#"}, "a letter that tags must not have"),
        ("tags", {str(number): "" for number in range(51)}, "at most 50"),
        (f"{TASK}.containers", [container(str(number)) for number in range(11)], "11, 1 to 10"),
        (f"{WATCH}.name", "prepare", "names"),
        (f"{WATCH}.essential", False, "at least one has to be essential"),
        (f"{TASK}.volumes", [{"name": "job"}, {"name": "job"}], "volumes: names"),
        (f"{TASK}.volumes", [{"name": "job", "host": {"sourcePath": "/"}}], "sourcePath"),
        (f"{WATCH}.resourceRequirements", [{"type": "VCPU", "value": "0.5"}], "MEMORY None"),
        (f"{WATCH}.resourceRequirements.1.value", "1.5", "no number of MiB"),
        (f"{WATCH}.resourceRequirements.1.value", "3", "at least 4 MiB"),
        (f"{WATCH}.resourceRequirements.1.value", "1025", "no task of 1 vCPU and 2049 MiB"),
        ("platformCapabilities", ["EC2"], "whole numbers on EC2"),
        (f"{WATCH}.image", "a b", "image"),
        (f"{WATCH}.dependsOn.0.containerName", "nobody", "'nobody'"),
        (f"{WATCH}.dependsOn.0.condition", "HEALTHY", "HEALTHY"),
        (f"{TASK}.containers.0.dependsOn", [{"containerName": "watch", "condition": "SUCCESS"}], "watch is essential"),
        (f"{TASK}.containers.0.dependsOn", [{"containerName": "watch", "condition": "START"}], "wait for each other"),
        (f"{WATCH}.mountPoints", [{"sourceVolume": "other", "containerPath": "/a"}], "no volume 'other'"),
        (f"{WATCH}.mountPoints", [{"sourceVolume": "job", "containerPath": "a"}], "mountPoints"),
        (f"{WATCH}.stopTimeout", 121, "stopTimeout"),
        (f"{WATCH}.privileged", True, "neither privileges"),
        (f"{WATCH}.linuxParameters", {"sharedMemorySize": 64}, "sharedMemorySize"),
        (f"{WATCH}.environment", [{"name": "A", "value": "1"}] * 2, "a name twice"),
        (f"{WATCH}.secrets", [{"name": "AWS_BATCH_X", "valueFrom": "arn"}], "Batch's own"),
        (f"{TASK}.executionRoleArn", None, "executionRoleArn"),
        (f"{TASK}.ipcMode", "task", "ipcMode"),
        (f"{TASK}.ephemeralStorage", {"sizeInGiB": 20}, "sizeInGiB"),
    ],
)
def test_definitions_that_batch_refuses(batch_emulator: Aws, path: str, value: Any, message: str) -> None:
    code, status, found = refused(batch_emulator, "register_job_definition", **changed(path, value))
    assert (code in ("ClientException", "ValidationException"), status) == (True, 400)
    assert message in found


def test_a_definition_for_instances(batch_emulator: Aws) -> None:
    batch_emulator.batch.add_queue("instances", "SPOT")
    whole = [{"type": "VCPU", "value": "3"}, {"type": "MEMORY", "value": "3000"}]
    more = {"privileged": True, "linuxParameters": {"sharedMemorySize": 64}, "resourceRequirements": whole}
    register = definition({**container("only"), **more}, platformCapabilities=["EC2"])
    submit(batch_emulator, None, register, jobQueue="instances")
    batch_emulator.batch.wait()
    assert "hosts are FARGATE" in refused_submission(batch_emulator)
    register["ecsProperties"]["taskProperties"][0]["platformVersion"] = "LATEST"
    assert "for Fargate" in refused(batch_emulator, "register_job_definition", **register)[2]


# submitting


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"jobName": "a/b"}, "jobName"),
        ({"jobQueue": "nowhere"}, "JobQueue nowhere not found"),
        ({"jobQueue": "closed"}, "not enabled"),
        ({"jobDefinition": "nothing"}, "not found or not active"),
        ({"arrayProperties": {"size": 1}}, "2 to 10000"),
        ({"arrayProperties": {"size": 10_001}}, "2 to 10000"),
        ({"timeout": {"attemptDurationSeconds": 5}}, "at least 60"),
        ({"retryStrategy": {"attempts": 0}}, "attempts: 0"),
        ({"shareIdentifier": "robots"}, "shareIdentifier"),
        ({"parameters": {"a": "b"}}, "does not know parameters"),
        ({"dependsOn": [{"jobId": "a"}]}, "does not know dependsOn"),
        ({"ecsPropertiesOverride": {"taskProperties": [{"containers": [{"name": "x"}]}]}}, "container 'x'"),
        ({"ecsPropertiesOverride": {"taskProperties": [{}, {}]}}, "at most one task"),
        (
            {
                "ecsPropertiesOverride": {
                    "taskProperties": [
                        {"containers": [{"name": "watch", "environment": [{"name": "AWS_BATCH_A", "value": ""}]}]}
                    ]
                }
            },
            "Batch's own",
        ),
        ({"tags": {f"{number:0100}": "x" * 256 for number in range(50)} | {"z": "y" * 20_000}}, "at most 50"),
        (
            {
                "ecsPropertiesOverride": {
                    "taskProperties": [{"containers": [{"name": "watch", "command": ["x" * 31_000]}]}]
                }
            },
            "30 KiB",
        ),
    ],
)
def test_jobs_that_batch_refuses(batch_emulator: Aws, request_: dict[str, Any], message: str) -> None:
    batch_emulator.batch.add_queue("closed", state="DISABLED")
    batch = batch_emulator.client("batch")
    batch.register_job_definition(**definition())
    request = {"jobName": "sweep", "jobQueue": QUEUE, "jobDefinition": "world", **request_}
    code, status, found = refused(batch_emulator, "submit_job", **request)
    assert (code in ("ClientException", "ValidationException"), status) == (True, 400)
    assert message in found
    assert not batch_emulator.batch.every_job()


def test_a_queue_with_a_scheduling_policy(batch_emulator: Aws) -> None:
    batch_emulator.batch.add_queue("fair", scheduling_policy="arn:aws:batch:eu-west-1:123456789012:scheduling-policy/x")
    submit(batch_emulator, jobQueue="fair", shareIdentifier="robots")
    assert "shareIdentifier" in refused_submission(batch_emulator, jobQueue="fair")
    batch = batch_emulator.client("batch")
    assert batch.describe_job_queues(jobQueues=["fair"])["jobQueues"][0]["schedulingPolicyArn"].endswith("/x")


# asking


def test_queues_and_their_hosts(batch_emulator: Aws) -> None:
    batch_emulator.batch.add_queue("spot", "FARGATE_SPOT", status="INVALID", environment_state="DISABLED")
    batch = batch_emulator.client("batch")
    queues = batch.describe_job_queues(jobQueues=[QUEUE, batch_emulator.batch.jobs.arn("job-queue", "spot"), "none"])
    first, second = queues["jobQueues"]
    assert (first["state"], first["status"], second["status"]) == ("ENABLED", "VALID", "INVALID")
    hosts = batch.describe_compute_environments(
        computeEnvironments=[second["computeEnvironmentOrder"][0]["computeEnvironment"]]
    )["computeEnvironments"]
    assert [(each["state"], each["computeResources"]["type"]) for each in hosts] == [("DISABLED", "FARGATE_SPOT")]
    assert len(batch.describe_compute_environments()["computeEnvironments"]) == 2
    assert len(batch.describe_job_queues(maxResults=1)["jobQueues"]) == 1


def test_jobs_are_found_by_filters(batch_emulator: Aws) -> None:
    identity = submit(batch_emulator, jobName="Sweep-1")
    time.sleep(0.002)
    other = submit(batch_emulator, jobName="other")
    batch_emulator.batch.wait()
    batch = batch_emulator.client("batch")

    def found(name: str, value: str) -> list[str]:
        jobs = batch.list_jobs(jobQueue=QUEUE, filters=[{"name": name, "values": [value]}])["jobSummaryList"]
        return [job["jobId"] for job in jobs]

    created = describe(batch_emulator, identity)[0]["createdAt"]
    assert found("JOB_NAME", "sweep*") == found("JOB_NAME", "SWEEP-1") == [identity]
    assert found("JOB_DEFINITION", "world") == [other, identity]
    assert found("JOB_DEFINITION", "wor*") == [other, identity]
    assert found("AFTER_CREATED_AT", str(created)) == [other]
    assert found("BEFORE_CREATED_AT", str(created + 1)) == [identity]
    for request in (
        {"jobQueue": QUEUE, "filters": [{"name": "TAG", "values": ["a"]}]},
        {"jobQueue": QUEUE, "filters": [{"name": "JOB_NAME", "values": ["a"]}] * 2},
        {"jobQueue": "nowhere"},
        {"arrayJobId": "nothing"},
        {"multiNodeJobId": "nothing"},
        {"jobQueue": QUEUE, "arrayJobId": identity},
        {"jobQueue": QUEUE, "nextToken": "mine"},
    ):
        assert refused(batch_emulator, "list_jobs", **request)[0] == "ClientException"


def test_at_most_a_hundred_jobs_are_described_and_unknown_ones_left_out(batch_emulator: Aws) -> None:
    identity = submit(batch_emulator, 2)
    batch_emulator.batch.wait()
    assert refused(batch_emulator, "describe_jobs", jobs=[identity] * 101)[0] == "ClientException"
    asked = ("nothing", f"{identity}:2", f"{identity}:x", f"{identity}:1")
    assert [job["jobId"] for job in describe(batch_emulator, *asked)] == [f"{identity}:1"]


def test_a_job_may_be_unknown_for_a_while(batch_emulator: Aws) -> None:
    batch_emulator.batch.unseen = 2
    identity = submit(batch_emulator)
    assert [len(describe(batch_emulator, identity)) for _ in range(3)] == [0, 0, 1]
    assert batch_emulator.batch.unseen == 2


def test_tags(batch_emulator: Aws) -> None:
    identity = submit(batch_emulator, tags={"run": "a"})
    batch = batch_emulator.client("batch")
    arn = describe(batch_emulator, identity)[0]["jobArn"]
    batch.tag_resource(resourceArn=arn, tags={"more": "b c"})
    batch.untag_resource(resourceArn=arn, tagKeys=["run"])
    assert batch.list_tags_for_resource(resourceArn=arn)["tags"] == {"more": "b c"}
    queue = batch_emulator.batch.jobs.arn("job-queue", QUEUE)
    assert batch.list_tags_for_resource(resourceArn=queue)["tags"] == {}
    assert refused(batch_emulator, "list_tags_for_resource", resourceArn=arn + "x")[0] == "ClientException"
    many = {str(number): "" for number in range(50)}
    assert "50 tags" in refused(batch_emulator, "tag_resource", resourceArn=arn, tags=many)[2]


# what is no call


def test_another_region_has_nothing(batch_emulator: Aws) -> None:
    submit(batch_emulator)
    batch = batch_emulator.client("batch", region="us-east-1")
    assert batch.describe_job_queues(jobQueues=[QUEUE])["jobQueues"] == []


@pytest.mark.parametrize(
    ("method", "path", "body", "authorization", "status", "code"),
    [
        ("POST", "/v1/describejobs", b"{}", "", 403, "MissingAuthenticationTokenException"),
        ("POST", "/v1/describejobs", b"{", "signed", 400, "SerializationException"),
        ("POST", "/v1/describejobs", b'{"jobs": [1]}', "signed", 400, "ValidationException"),
        ("POST", "/v1/describejobs", b'{"jobs": [], "more": 1}', "signed", 400, "ValidationException"),
        ("POST", "/v1/listservicejobs", b"{}", "signed", 501, "NotImplemented"),
        ("GET", "/v1/describejobs", b"", "signed", 404, "UnknownOperationException"),
        ("POST", "/v2/anything", b"", "signed", 404, "UnknownOperationException"),
    ],
)
def test_requests_that_no_client_of_aws_sends(
    batch_emulator: Aws, method: str, path: str, body: bytes, authorization: str, status: int, code: str
) -> None:
    import requests

    signed = "AWS4-HMAC-SHA256 Credential=A/20260101/eu-west-1/batch/aws4_request"
    headers = {"Authorization": authorization.replace("signed", signed)}
    answer = requests.request(method, batch_emulator.batch.endpoint + path, data=body, headers=headers, timeout=60)
    assert (answer.status_code, answer.headers["x-amzn-errortype"]) == (status, code)


def test_answers_of_a_wrong_form_are_mistakes(aws_services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    from .emulator import calls

    monkeypatch.setattr(calls, "describe_job", lambda job: {"jobId": 7})
    with pytest.raises(AssertionError, match=r"DescribeJobs: .*jobName"), started_aws(aws_services) as aws:
        assert refused(aws, "describe_jobs", jobs=[submit(aws)])[1] == 500


# faults


def test_faults_come_when_they_are_asked_for(batch_emulator: Aws) -> None:
    faults = batch_emulator.faults
    identity = submit(batch_emulator)
    faults.throttle("DescribeJobs", times=1, after=1)
    assert describe(batch_emulator, identity)
    assert refused(batch_emulator, "describe_jobs", jobs=[identity])[:2] == ("TooManyRequestsException", 429)
    assert describe(batch_emulator, identity)
    faults.server_error(times=1)
    assert refused(batch_emulator, "list_jobs", jobQueue=QUEUE)[:2] == ("ServerException", 500)
    faults.deny("TerminateJob")
    assert refused(batch_emulator, "terminate_job", jobId=identity, reason="a")[:2] == ("AccessDeniedException", 403)
    faults.expire()
    assert refused(batch_emulator, "describe_jobs", jobs=[identity])[:2] == ("ExpiredTokenException", 403)
    faults.clear()
    assert describe(batch_emulator, identity)
    assert faults.had == {"DescribeJobs": 2, "ListJobs": 1, "TerminateJob": 1}
    assert (batch_emulator.batch.calls["DescribeJobs"], len(batch_emulator.batch.requests)) == (5, 5)


@pytest.mark.parametrize(("answered", "jobs"), [(False, 0), (True, 1)])
def test_an_answer_that_is_lost(batch_emulator: Aws, answered: bool, jobs: int) -> None:
    from botocore.exceptions import HTTPClientError

    batch_emulator.faults.drop("SubmitJob", answered=answered)
    with pytest.raises(HTTPClientError):
        submit(batch_emulator)
    assert len(batch_emulator.batch.every_job()) == jobs


def test_a_late_answer(batch_emulator: Aws) -> None:
    batch_emulator.faults.slow("DescribeJobQueues", 0.2)
    batch = batch_emulator.client("batch")
    start = time.monotonic()
    assert batch.describe_job_queues(jobQueues=[QUEUE])["jobQueues"]
    assert time.monotonic() - start >= 0.2


def test_one_throttled_call_is_asked_again(batch_emulator: Aws) -> None:
    import boto3

    batch_emulator.faults.throttle("DescribeJobQueues", times=2)
    batch = boto3.client("batch")  # by the environment
    assert batch.describe_job_queues(jobQueues=[QUEUE])["jobQueues"]
    batch.close()
    assert batch_emulator.batch.calls["DescribeJobQueues"] == 3


def test_nothing_of_a_test_is_left_for_the_next(batch_emulator: Aws) -> None:
    assert batch_emulator.services.keys(BUCKET) == []
    assert batch_emulator.batch.every_job() == []
