"""Tasks of the emulator in real containers."""

from typing import TYPE_CHECKING, Any

import pytest

from tests.addons.aws_batch.emulator.containers import LABEL
from tests.addons.aws_batch.emulator.faults import child
from tests.addons.aws_batch.fixtures import BUCKET, Aws, aws_in_containers
from tests.docker_engine import PYTHON_IMAGE, wait_until

if TYPE_CHECKING:
    from docker import DockerClient

    from tests.addons.aws_batch.services import Services

RESOURCES = [{"type": "VCPU", "value": "1"}, {"type": "MEMORY", "value": "64"}]
LOST_HOSTS_ONLY = {
    "attempts": 2,
    "evaluateOnExit": [{"onStatusReason": "Host EC2*", "action": "RETRY"}, {"onReason": "*", "action": "EXIT"}],
}


@pytest.fixture
def aws(batch_in_containers: Aws, python_image: str) -> Aws:
    batch_in_containers.batch.add_queue("instances", "EC2")
    return batch_in_containers


def container(name: str, *command: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "image": PYTHON_IMAGE, "command": list(command), "resourceRequirements": RESOURCES, **more}


def shell(name: str, script: str, **more: Any) -> dict[str, Any]:
    return container(name, "sh", "-c", script, **more)


def after(name: str, condition: str) -> dict[str, Any]:
    return {"dependsOn": [{"containerName": name, "condition": condition}]}


def mounted(path: str, read_only: bool = False) -> dict[str, Any]:
    return {"mountPoints": [{"sourceVolume": "job", "containerPath": path, "readOnly": read_only}]}


def submit(aws: Aws, *containers: dict[str, Any], size: int | None = None, **more: Any) -> str:
    task = {"containers": list(containers), "volumes": [{"name": "job"}]}
    request = {"jobDefinitionName": "task", "type": "container", "ecsProperties": {"taskProperties": [task]}, **more}
    batch = aws.client("batch")
    arn = batch.register_job_definition(**request)["jobDefinitionArn"]
    array = {} if size is None else {"arrayProperties": {"size": size}}
    job = batch.submit_job(jobName="sweep", jobQueue="instances", jobDefinition=arn, **array)
    identity: str = job["jobId"]
    return identity


def describe(aws: Aws, identity: str) -> dict[str, Any]:
    job: dict[str, Any] = aws.client("batch").describe_jobs(jobs=[identity])["jobs"][0]
    return job


def run(aws: Aws, *containers: dict[str, Any], **more: Any) -> dict[str, Any]:
    identity = submit(aws, *containers, **more)
    aws.batch.wait()
    return describe(aws, identity)


def told(job: dict[str, Any], name: str) -> dict[str, Any]:
    containers: list[dict[str, Any]] = job["ecsProperties"]["taskProperties"][0]["containers"]
    return next(each for each in containers if each["name"] == name)


def lines(aws: Aws, job: dict[str, Any], name: str) -> list[str]:
    stream = told(job, name)["logStreamName"]
    logs = aws.client("logs")
    events = logs.get_log_events(logGroupName="/aws/batch/job", logStreamName=stream, startFromHead=True)["events"]
    return [event["message"] for event in events]


@pytest.mark.thorough
def test_containers_of_a_task_share_an_address_and_volumes(aws: Aws) -> None:
    server = "import http.server; http.server.HTTPServer(('127.0.0.1', 8000), http.server.SimpleHTTPRequestHandler)"
    asking = (
        "import socket, sys, time\n"
        "sys.stderr = sys.stdout\n"  # two streams come in no order
        "for _ in range(1500):\n"
        "    try: socket.create_connection(('localhost', 8000)); break\n"
        "    except OSError: time.sleep(0.02)\n"
        "else: raise SystemExit(9)\n"
        "print(open('/in/greeting').read(), end='', flush=True)\n"
        "open('/in/more', 'w')\n"
    )
    job = run(
        aws,
        shell("prepare", "echo hello > /job/greeting", essential=False, user="0", **mounted("/job")),
        container("server", "python3", "-c", f"{server}.serve_forever()", essential=False, stopTimeout=2),
        container("robot", "python3", "-c", asking, **after("prepare", "SUCCESS"), **mounted("/in", read_only=True)),
    )
    assert lines(aws, job, "robot")[0] == "hello"
    assert "Read-only file system" in lines(aws, job, "robot")[-1]
    assert (job["status"], told(job, "robot")["exitCode"]) == ("FAILED", 1)
    assert told(job, "server")["exitCode"] == 137  # the first process of a container takes no TERM unless it says so


def test_what_a_container_is_given(aws: Aws) -> None:
    arn = "arn:aws:secretsmanager:eu-west-1:123456789012:secret:token-a1b2c3"
    aws.batch.runner.secrets[arn] = "pl4nted"
    script = "id -u; echo $AWS_BATCH_JOB_ARRAY_INDEX $AWS_BATCH_JOB_ATTEMPT $AWS_BATCH_JOB_ID $NAME $TOKEN"
    environment = [{"name": "NAME", "value": "two words"}]
    secrets = [{"name": "TOKEN", "valueFrom": arn}]
    identity = submit(aws, shell("robot", script, user="1234", environment=environment, secrets=secrets), size=2)
    aws.batch.wait()
    job = describe(aws, f"{identity}:1")
    assert lines(aws, job, "robot") == ["1234", f"1 1 {identity}:1 two words pl4nted"]


def test_a_container_reaches_the_bucket(aws: Aws, tools_image: str) -> None:
    script = f"import boto3; boto3.client('s3').put_object(Bucket='{BUCKET}', Key='a/b', Body=b'results')"
    room = [{"type": "VCPU", "value": "1"}, {"type": "MEMORY", "value": "512"}]
    tools = container("tools", "python3", "-c", script, image=tools_image, resourceRequirements=room)
    assert run(aws, tools)["status"] == "SUCCEEDED"
    assert aws.services.get(BUCKET, "a/b") == b"results"


def test_the_tools_image_has_the_command(engine: "DockerClient", tools_image: str) -> None:
    output = engine.containers.run(tools_image, ["calibration", "version"], network_mode="none", remove=True)
    assert b"calibration-ci" in output
    assert b"boto3 not installed" not in output


def test_logs_are_there_while_it_runs(aws: Aws) -> None:
    identity = submit(aws, shell("robot", "echo begun; sleep 60", stopTimeout=2))
    wait_until(lambda: describe(aws, identity)["status"] == "RUNNING", "it runs")
    job = describe(aws, identity)
    wait_until(lambda: lines(aws, job, "robot") == ["begun"], "its line is there")
    aws.client("batch").terminate_job(jobId=identity, reason="enough")
    aws.batch.wait()
    job = describe(aws, identity)
    assert (job["status"], job["statusReason"], told(job, "robot")["exitCode"]) == ("FAILED", "enough", 137)


def test_a_container_may_end_in_order(aws: Aws) -> None:
    script = "trap 'echo bye; exit 7' TERM; echo begun; touch /job/begun; while :; do sleep 0.05; done"
    watch = "until [ -e /job/begun ]; do sleep 0.05; done"
    job = run(
        aws,
        shell("robot", script, essential=False, user="0", **mounted("/job")),
        shell("watch", watch, **after("robot", "START"), **mounted("/job")),
    )
    assert (job["status"], told(job, "robot")["exitCode"]) == ("SUCCEEDED", 7)
    assert lines(aws, job, "robot") == ["begun", "bye"]


def test_out_of_memory(aws: Aws) -> None:
    job = run(aws, container("robot", "python3", "-c", "x = bytearray(1 << 30)"))
    end = told(job, "robot")
    assert (end["exitCode"], end["reason"]) == (137, "OutOfMemoryError: Container killed due to memory usage")


@pytest.mark.parametrize(
    ("condition", "code", "runs"), [("SUCCESS", 0, True), ("SUCCESS", 3, False), ("COMPLETE", 3, True)]
)
def test_what_waits_for_another(aws: Aws, condition: str, code: int, runs: bool) -> None:
    job = run(
        aws,
        shell("prepare", f"exit {code}", essential=False),
        shell("robot", "true", **after("prepare", condition)),
    )
    assert (job["status"] == "SUCCEEDED") is runs
    assert told(job, "prepare")["exitCode"] == code
    assert ("exitCode" in told(job, "robot"), "startedAt" in job) == (runs, runs)


def test_nobody_waits_for_ever(
    engine: "DockerClient", reachable_services: "Services", base_image: str, python_image: str
) -> None:
    """The default is three minutes, also where the one before is busy."""
    with aws_in_containers(engine, reachable_services, base_image, time_scale=0.005) as aws:
        aws.batch.add_queue("instances", "EC2")
        busy = shell("prepare", "sleep 60", essential=False, stopTimeout=2)
        job = run(aws, busy, shell("robot", "true", **after("prepare", "SUCCESS")))
    assert (job["status"], job["statusReason"]) == ("FAILED", "Task failed to start")
    assert "timed out while waiting for container prepare" in told(job, "robot")["reason"]


def test_a_job_that_runs_too_long(
    engine: "DockerClient", reachable_services: "Services", base_image: str, python_image: str
) -> None:
    with aws_in_containers(engine, reachable_services, base_image, time_scale=0.01) as aws:
        aws.batch.add_queue("instances", "EC2")
        forever = shell("robot", "sleep 600", linuxParameters={"initProcessEnabled": True})
        job = run(aws, forever, timeout={"attemptDurationSeconds": 60})
    assert (job["status"], job["statusReason"]) == ("FAILED", "Job attempt duration exceeded timeout")
    assert told(job, "robot")["exitCode"] == 143


def test_a_lost_host_kills_and_another_takes_over(aws: Aws) -> None:
    aws.faults.lose_host(child(1), seconds=1)
    script = (
        "trap 'echo no time for this' TERM; echo begun $AWS_BATCH_JOB_ATTEMPT; "
        "[ $AWS_BATCH_JOB_ATTEMPT$AWS_BATCH_JOB_ARRAY_INDEX = 11 ] || exit 0; while :; do sleep 0.05; done"
    )
    identity = submit(aws, shell("robot", script), size=2, retryStrategy=LOST_HOSTS_ONLY)
    aws.batch.wait()
    job = describe(aws, f"{identity}:1")
    first, second = (attempt["taskProperties"][0]["containers"][0] for attempt in job["attempts"])
    assert job["status"] == "SUCCEEDED"
    assert (job["attempts"][0]["statusReason"][:8], "exitCode" in first, second["exitCode"]) == ("Host EC2", False, 0)
    assert first["logStreamName"] != second["logStreamName"]
    logs = aws.client("logs")
    lost = logs.get_log_events(logGroupName="/aws/batch/job", logStreamName=first["logStreamName"])["events"]
    assert [event["message"] for event in lost] in ([], ["begun 1"])  # nothing, where the machine is slow


def test_what_cannot_start(aws: Aws) -> None:
    missing = run(aws, shell("robot", "true", image="127.0.0.1:9/nothing:1"))
    assert (missing["status"], missing["statusReason"]) == ("FAILED", "Task failed to start")
    assert told(missing, "robot")["reason"].startswith("CannotPullContainerError")
    secret = run(aws, shell("robot", "true", secrets=[{"name": "TOKEN", "valueFrom": "arn:unknown"}]))
    assert "unable to retrieve secret arn:unknown" in told(secret, "robot")["reason"]
    program = run(aws, container("robot", "no-such-program"))
    assert (program["status"], told(program, "robot")["exitCode"]) == ("FAILED", 127)
    assert told(program, "robot")["reason"].startswith("CannotStartContainerError")


def test_limits_and_places(aws: Aws) -> None:
    more = {
        "readonlyRootFilesystem": True,
        "linuxParameters": {
            "initProcessEnabled": True,
            "sharedMemorySize": 8,
            "tmpfs": [{"containerPath": "/scratch", "size": 4, "mountOptions": []}],
        },
    }
    script = "cat /proc/1/comm; df -k --output=size /dev/shm /scratch | tail -n 2; touch /x 2>&1; echo end"
    job = run(aws, shell("robot", script, **more))
    text = " ".join(lines(aws, job, "robot")).split()
    assert text[:3] == ["docker-init", "8192", "4096"]
    assert "Read-only file system" in " ".join(text)


def test_nothing_is_left(
    engine: "DockerClient", reachable_services: "Services", base_image: str, python_image: str
) -> None:
    with aws_in_containers(engine, reachable_services, base_image) as aws:
        aws.batch.add_queue("instances", "EC2")
        identity = submit(aws, shell("robot", "sleep 60"), shell("other", "sleep 60"), size=3)
        wait_until(lambda: describe(aws, f"{identity}:1")["status"] == "RUNNING", "it runs")
        label = f"{LABEL}={aws.batch.runner.id}"
        assert len(engine.containers.list(filters={"label": label})) >= 3
    assert not engine.containers.list(all=True, ignore_removed=True, filters={"label": label})
    assert not engine.volumes.list(filters={"label": label})
