"""Settings and jobs shared by tests, and validation of requests by AWS's own schema."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from botocore.session import Session
from botocore.validate import ParamValidator

from calibration.addons.aws_batch.settings import BatchSettings
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job, Limits, Mount, Readiness

ACCOUNT = "123456789012"
REGISTRY = f"{ACCOUNT}.dkr.ecr.eu-west-1.amazonaws.com"
SETTINGS = BatchSettings(
    region="eu-west-1",
    queue="robots",
    bucket="team-robots",
    tools_image=f"{REGISTRY}/calibration-ci:1",
    job_role=f"arn:aws:iam::{ACCOUNT}:role/calibration-job",
    execution_role=f"arn:aws:iam::{ACCOUNT}:role/calibration-execution",
)
EC2 = replace(SETTINGS, platform="ec2")
TOKEN_ARN = f"arn:aws:secretsmanager:eu-west-1:{ACCOUNT}:secret:token-AbCdEf"


def container(name: str = "robot", **changes: Any) -> Container:
    settings: dict[str, Any] = {"image": f"{REGISTRY}/robot:1", "command": ("calibrate",)}
    return Container(name, **{**settings, **changes})


def job(*containers: Container, name: str = "j", **changes: Any) -> Job:
    return Job(name, containers or (container(),), **changes)


def simulation(folder: Path) -> Job:
    """Return a job of two containers with everything that Fargate supports."""
    for name in ("data", "scratch"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    return job(
        container(
            "simulation",
            image=f"{REGISTRY}/simulation@sha256:{'0' * 64}",
            readiness=Readiness(port=11345),
            limits=Limits(memory=3 * 1024**3 + 1, cpus=2),
            mounts=(Mount(folder / "data", "/data/"),),
            essential=False,
        ),
        container(
            "robot",
            user="1000",
            after=("simulation",),
            environment={"TOKEN": "s3cret", "SEED": "1"},
            secrets=frozenset({"TOKEN"}),
            mounts=(Mount(folder / "scratch", "/scratch", writable=True), Mount(folder / "data", "/data")),
            artifacts=(Artifact(f"{OUTPUT}/*.csv"),),
        ),
    )


def complaints(operation: str, request: dict[str, Any]) -> str:
    """Return botocore's validation errors of a request to AWS Batch."""
    shape = Session().get_service_model("batch").operation_model(operation).input_shape
    report: str = ParamValidator().validate(request, shape).generate_report()
    return report


def unknown_keys(operation: str, request: dict[str, Any]) -> list[str]:
    """Return keys that AWS Batch does not know, at any depth of a request."""

    def walk(value: Any, shape: Any, where: str) -> list[str]:
        if shape.type_name == "structure":
            known = shape.members
            found = [f"{where}.{key}" for key in value if key not in known]
            return found + [
                each for key in value if key in known for each in walk(value[key], known[key], f"{where}.{key}")
            ]
        if shape.type_name == "list":
            return [each for item in value for each in walk(item, shape.member, where)]
        enum = getattr(shape, "enum", None)
        return [f"{where}={value}"] if enum and value not in enum else []

    return walk(request, Session().get_service_model("batch").operation_model(operation).input_shape, operation)
