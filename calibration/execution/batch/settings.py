"""Where in AWS jobs run, as the section ``aws-batch`` of calibration.yml says it.

Its JSON Schema is ``batch.schema.json`` beside this module.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal

from calibration.errors import InputError
from calibration.execution.sizes import parse_bytes, parse_seconds
from calibration.json_schema import bundled, check_document

SCHEMA = Path(__file__).with_name("batch.schema.json")
SECTION = "aws-batch"
"""The key of calibration.yml."""
Platform = Literal["fargate", "ec2"]
"""fargate: each task has a network and a machine of its own. ec2: instances of the compute environment, for GPUs,
privileges and shared memory; tasks share the instance's network, so their ports may clash."""
Architecture = Literal["x86_64", "arm64"]
_ADVICE = {
    "dependentRequired": "priority orders the jobs of a share: say share too",
    "secrets pattern": "expected the ARN of a secret or parameter: arn:aws:secretsmanager:REGION:ACCOUNT:secret:NAME",
    "job-role pattern": "expected the ARN of a role: arn:aws:iam::ACCOUNT:role/NAME",
    "execution-role pattern": "expected the ARN of a role: arn:aws:iam::ACCOUNT:role/NAME",
    "region pattern": "expected the name of a region such as eu-west-1",
    "bucket pattern": "expected the name of an S3 bucket, without s3:// and folders (these are the prefix)",
    "queue pattern": "expected the name or the ARN of a job queue",
    "prefix pattern": "expected folders such as team/calibration: no / at its ends, no part that begins with a dot",
    "tags pattern": "expected letters, digits and _ . : / = + - @, in no key aws: or ci.calibration. at its start",
}
_FARGATE_KEYS = ("disk", "public-ip")
_EC2_KEYS = ("shared-hosts",)


@dataclass(frozen=True)
class Prices:
    """What an hour costs, as the user gives it: prices change, and differ by region."""

    vcpu_hour: float
    gb_hour: float
    currency: str = "USD"


@dataclass(frozen=True)
class BatchSettings:
    """Everything that the job model does not say and AWS Batch has to know."""

    region: str
    queue: str
    """The name or ARN of a job queue; whether its hosts are Spot is its compute environment's doing."""
    bucket: str
    tools_image: str
    """An image with Python and ``calibration-ci[aws]``: what prepares a task and brings its results out."""
    job_role: str
    """The ARN of the role of the containers: it reads and writes below ``prefix``."""
    execution_role: str | None = None
    """The ARN of the role that pulls images and writes logs; Fargate needs one."""
    prefix: str = "calibration"
    """Of all keys in the bucket."""
    platform: Platform = "fargate"
    architecture: Architecture = "x86_64"
    spot: bool = False
    """Whether the queue is expected to give Spot hosts; refused where it does not."""
    attempts: int = 3
    """How often a job is tried when its host was lost; a failure of the software is never tried again."""
    cpus: float = 1.0
    """Of a container that says none."""
    memory: int = 2 * 1024**3
    """Bytes, of a container that says none."""
    disk: int | None = None
    """GiB for a task on Fargate, 21 to 200; None for the 20 that every task has."""
    public_ip: bool = False
    """Fargate in a subnet without NAT needs one, to pull images."""
    shared_hosts: bool = True
    """Whether an EC2 instance may hold more than one job at once, which then share its ports."""
    deadline: float | None = None
    """Seconds for all jobs of a run; None for no limit but the jobs' own."""
    stuck: float = 1800.0
    """Seconds after which a job that waits for a host (RUNNABLE) is given up."""
    secrets: Mapping[str, str] = field(default_factory=dict)
    """ARNs (Secrets Manager, Parameter Store) of the variables that are secret: their values never pass through us."""
    tags: Mapping[str, str] = field(default_factory=dict)
    priority: int | None = None
    share: str | None = None
    """The share identifier, where the queue has a scheduling policy."""
    log_group: str = "/aws/batch/job"
    prices: Prices | None = None


def settings_from(entry: object, where: str) -> BatchSettings:
    """Read the section ``aws-batch``.

    Args:
        entry: the section, its variables filled in.
        where: what messages begin with: the file and the key.

    Raises:
        InputError: a key is unknown or missing, a value wrong, or two do not go together.
    """
    if not isinstance(entry, Mapping):
        raise InputError(f"{where}: found {entry!r:.80}, expected keys: region, queue, bucket, tools-image, job-role")
    check_document(entry, _schema(), where, _ADVICE)
    _check_lines(entry, where)
    values: dict[str, Any] = {key.replace("-", "_"): value for key, value in entry.items()}
    if "memory" in values:
        values["memory"] = parse_bytes(values["memory"], f"{where}.memory")
    for key in ("deadline", "stuck"):
        if key in values:
            values[key] = parse_seconds(values[key], f"{where}.{key}")
    if "prices" in values:
        values["prices"] = Prices(**{key.replace("-", "_"): value for key, value in values["prices"].items()})
    settings = BatchSettings(**values)
    _check_together(settings, entry, where)
    return settings


@cache
def _schema() -> dict[str, Any]:
    """That of the section itself."""
    return {"$ref": "#/$defs/settings", "$defs": bundled(SCHEMA)["$defs"]}


def _check_lines(entry: Mapping[str, Any], where: str) -> None:
    """Refuse texts with a line end at their end, which the schema's ``$`` lets pass."""
    for key, value in entry.items():
        if isinstance(value, Mapping):
            _check_lines(value, f"{where}.{key}")
        elif isinstance(value, str) and not value.isprintable():
            raise InputError(f"{where}.{key}: found {value!r}, expected one line")


def _check_together(settings: BatchSettings, entry: Mapping[str, Any], where: str) -> None:
    """Refuse values that are right alone and wrong together."""
    fargate = settings.platform == "fargate"
    for key in _EC2_KEYS if fargate else _FARGATE_KEYS:
        if key in entry:
            other = "ec2" if fargate else "fargate"
            raise InputError(f"{where}.{key}: platform {settings.platform} has no such thing: drop it, or say {other}")
    if settings.execution_role is None and (fargate or settings.secrets):
        what = "fargate pulls images and writes logs" if fargate else "secrets are read"
        raise InputError(f"{where}.execution-role: it is missing: {what} with this role")
    if settings.queue.startswith("arn:") and (found := settings.queue.split(":")[3]) != settings.region:
        raise InputError(f"{where}.queue: it is in {found}, but region says {settings.region}")
    accounts = {arn.split(":")[4] for arn in (settings.job_role, settings.execution_role) if arn is not None}
    if len(accounts) > 1:
        raise InputError(
            f"{where}.execution-role: it is of another account than job-role: {', '.join(sorted(accounts))}"
        )
