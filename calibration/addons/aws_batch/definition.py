"""Shapes of jobs, without side effects: sizes of tasks, the request ``RegisterJobDefinition``, and costs.

Hours of processors and memory are always reported; money only if the user has given prices, which change and differ
by region. On EC2 the hours are those that the jobs reserve: costs of instances depend on the compute environment.
"""

import hashlib
import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from calibration.addons.aws_batch.settings import BatchSettings, Platform, Prices
from calibration.addons.aws_batch.wire import (
    JOB_FOLDER,
    MOUNTS_FOLDER,
    PREPARE_CONTAINER,
    WATCH_CONTAINER,
    mount_targets,
)
from calibration.base import InputError, count_of
from calibration.ci.execution.job import OUTPUT, Container, Job, Relaxations

TOOLS_MEMORY = 512
"""Memory of each of our containers, MiB."""
_OUR_COUNT = 2
_CPU_STEP = {"fargate": 0.25, "ec2": 1.0}
"""Smallest share of a processor for a container, and its increment; EC2 needs whole ones."""
_MEMORY_OF_CPUS = {
    0.25: (512, 1024, 2048),
    0.5: (1024, 2048, 3072, 4096),
    1.0: tuple(range(2048, 8193, 1024)),
    2.0: tuple(range(4096, 16385, 1024)),
    4.0: tuple(range(8192, 30721, 1024)),
    8.0: tuple(range(16384, 61441, 4096)),
    16.0: tuple(range(32768, 122881, 8192)),
    32.0: (61440, 122880, 249856),
}
"""Allowed memory (MiB) of a task by its processors; Batch applies it to the sums over the containers."""


@dataclass(frozen=True)
class Resources:
    """Resources of a container or a task."""

    cpus: float
    memory: int
    """MiB."""


@dataclass(frozen=True)
class TaskSize:
    """Resources of a task and its containers."""

    total: Resources
    containers: tuple[Resources, ...]
    """Resources of the job's containers, in order."""
    prepare: Resources
    watch: Resources


def task_size(asked: Sequence[Resources], platform: Platform) -> TaskSize:
    """Compute the size of the task for a job.

    On Fargate it is the smallest size that contains the containers; surplus memory is assigned to our own container,
    because memory of the job's containers is a limit.

    Args:
        asked: requested resources of each container of the job.
        platform: Fargate has fixed sizes, EC2 whole processors.

    Raises:
        InputError: it exceeds the largest task on Fargate; the message contains the sums.
    """
    step = _CPU_STEP[platform]
    shares = [max(1, math.ceil(resources.cpus / step)) for resources in asked]
    cpus = max(sum(shares), len(shares) + _OUR_COUNT) * step
    memory = sum(resources.memory for resources in asked) + _OUR_COUNT * TOOLS_MEMORY
    total = _fargate_size(cpus, memory) if platform == "fargate" else Resources(cpus, memory)
    rest = round(total.cpus / step) - _OUR_COUNT - sum(shares)
    while rest < 0:  # reduce the largest share, so that every container keeps one
        shares[shares.index(max(shares))] -= 1
        rest += 1
    shares[shares.index(max(shares))] += rest
    return TaskSize(
        total=total,
        containers=tuple(
            Resources(share * step, resources.memory) for share, resources in zip(shares, asked, strict=True)
        ),
        prepare=Resources(step, TOOLS_MEMORY),
        watch=Resources(step, TOOLS_MEMORY + total.memory - memory),
    )


def _fargate_size(cpus: float, memory: int) -> Resources:
    for size, memories in _MEMORY_OF_CPUS.items():
        if size >= cpus and memories[-1] >= memory:
            return Resources(size, next(each for each in memories if each >= memory))
    largest, memories = list(_MEMORY_OF_CPUS.items())[-1]
    raise InputError(
        f"its containers ask for {cpus:g} CPUs and {memory} MiB (with {_OUR_COUNT * TOOLS_MEMORY} for our tools), but "
        f"a task on Fargate has at most {largest:g} and {memories[-1]}: ask for less, or use platform ec2"
    )


_BYTES_PER_MIB = 1024**2


@dataclass(frozen=True)
class MountShape:
    """Mount of a volume in a container."""

    volume: int
    """Index in the job's `Shape.volumes`."""
    target: str
    writable: bool


@dataclass(frozen=True)
class ContainerShape:
    """Properties of a container that are part of the job definition."""

    name: str
    image: str
    resources: Resources
    """Requested resources."""
    user: str | None = None
    secrets: tuple[str, ...] = ()
    """Names of the variables."""
    mounts: tuple[MountShape, ...] = ()
    relaxations: Relaxations = field(default_factory=Relaxations)


@dataclass(frozen=True)
class Shape:
    """Properties of a job that are part of the job definition."""

    containers: tuple[ContainerShape, ...]
    volumes: tuple[str, ...] = ()
    """Mount targets."""

    @property
    def digest(self) -> str:
        """Hash of the shape, reproducible across runs and machines."""
        return _digest_of(asdict(self))


@dataclass(frozen=True)
class ShapeGroup:
    """Jobs of a run with the same shape."""

    name: str
    shape: Shape
    jobs: tuple[int, ...]
    """Indices in the jobs of the run; the position here is the index in the group."""


def shape_of(job: Job, settings: BatchSettings) -> Shape:
    """Return the shape of a job."""
    volumes = mount_targets(job)
    return Shape(tuple(_container_shape(each, volumes, settings) for each in job.containers), volumes)


def group_by_shape(jobs: Sequence[Job], settings: BatchSettings) -> tuple[ShapeGroup, ...]:
    """Group the jobs of a run by shape, in the order of each group's first job.

    The name of a group is derived from the shape: the same jobs give the same groups.
    """
    places: dict[Shape, list[int]] = {}
    for place, job in enumerate(jobs):
        places.setdefault(shape_of(job, settings), []).append(place)
    return tuple(ShapeGroup(shape.digest[:12], shape, tuple(found)) for shape, found in places.items())


def _container_shape(container: Container, volumes: Sequence[str], settings: BatchSettings) -> ContainerShape:
    limits = container.limits
    memory = settings.memory if limits.memory is None else limits.memory
    targets = {mount.target.rstrip("/"): mount.writable for mount in container.mounts}
    return ContainerShape(
        name=container.name,
        image=container.image,
        resources=Resources(settings.cpus if limits.cpus is None else limits.cpus, math.ceil(memory / _BYTES_PER_MIB)),
        user=container.user,
        secrets=tuple(sorted(container.secrets)),
        mounts=tuple(
            MountShape(volumes.index(target), target, writable) for target, writable in sorted(targets.items())
        ),
        relaxations=container.relaxations,
    )


DIGEST_TAG = "ci.calibration.definition"
"""Tag with the hash of the rest of the definition; it shows whether a new revision is needed."""
LOG_PREFIX = "calibration"
"""Prefix of log streams: ``calibration/CONTAINER/TASK``."""
MAX_DEFINITION_BYTES = 24 * 1024
"""AWS's size limit of a definition."""
_START_SECONDS = 3600
"""Time-out of containers that wait for the inputs on EC2; on Fargate it is fixed at three minutes."""
_STOP_SECONDS = 120
"""Time for our container to upload results when the job is terminated: the maximum on Fargate."""
_UNFIT_FOR_NAME = re.compile(r"[^A-Za-z0-9]+")
_TAG_AND_DIGEST = re.compile(r"(:[^:/@]+)?(@.*)?$")
_RETRY_STRATEGY = (
    {"onStatusReason": "Host EC2*", "action": "RETRY"},
    {"onStatusReason": "Your Spot Task was interrupted*", "action": "RETRY"},
    # a failure that matches no rule is retried, so these three match every failure with any of the properties
    {"onStatusReason": "*", "action": "EXIT"},
    {"onReason": "*", "action": "EXIT"},
    {"onExitCode": "*", "action": "EXIT"},
)


def definition_name(shape: Shape, settings: BatchSettings) -> str:
    """Return the name of the definition; other image versions and sizes are revisions of the same name."""
    images = [_TAG_AND_DIGEST.sub("", container.image) for container in shape.containers]
    names = [container.name for container in shape.containers]
    mark = hashlib.sha256(json.dumps([settings.prefix, names, images]).encode()).hexdigest()[:8]
    return f"calibration-{_UNFIT_FOR_NAME.sub('-', '-'.join(names)).strip('-')[:80]}-{mark}"


def job_definition(shape: Shape, settings: BatchSettings) -> dict[str, Any]:
    """Return the request to register the definition, with its hash in the tag `DIGEST_TAG`.

    Raises:
        InputError: the task exceeds the largest size, a secret has no ARN, or the definition exceeds AWS's limit.
    """
    fargate = settings.platform == "fargate"
    request: dict[str, Any] = {
        "jobDefinitionName": definition_name(shape, settings),
        "type": "container",
        "platformCapabilities": [settings.platform.upper()],
        "ecsProperties": {"taskProperties": [_task_properties(shape, settings)]},
        "retryStrategy": {"attempts": settings.attempts, "evaluateOnExit": [dict(rule) for rule in _RETRY_STRATEGY]},
        "propagateTags": True,
    }
    if fargate:
        request["ecsProperties"]["taskProperties"][0] |= _fargate_properties(settings)
    request["tags"] = {**settings.tags, DIGEST_TAG: _digest_of([request, dict(settings.tags)])}
    if (size := len(json.dumps(request).encode())) > MAX_DEFINITION_BYTES:
        secrets = sum(len(container.secrets) for container in shape.containers)
        raise InputError(
            f"its job definition has {size} bytes, AWS Batch accepts {MAX_DEFINITION_BYTES}: it has "
            f"{len(shape.volumes)} mounts and {secrets} secrets: join some of them"
        )
    return request


def _digest_of(document: object) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _fargate_properties(settings: BatchSettings) -> dict[str, Any]:
    properties: dict[str, Any] = {
        "networkConfiguration": {"assignPublicIp": "ENABLED" if settings.public_ip else "DISABLED"},
        "runtimePlatform": {"operatingSystemFamily": "LINUX", "cpuArchitecture": settings.architecture.upper()},
    }
    if settings.disk is not None:
        properties["ephemeralStorage"] = {"sizeInGiB": settings.disk}
    return properties


def _task_properties(shape: Shape, settings: BatchSettings) -> dict[str, Any]:
    size = task_size([container.resources for container in shape.containers], settings.platform)
    job, output = _mount_point("job", JOB_FOLDER), _mount_point("output", OUTPUT)
    inputs = [_mount_point(f"mount-{i}", f"{MOUNTS_FOLDER}/{i}") for i in range(len(shape.volumes))]
    prepare = _tools_container("prepare", size.prepare, [job, output, *inputs], settings)
    watch = _tools_container("watch", size.watch, [job, output], settings)
    if settings.platform == "ec2":
        prepare["startTimeout"] = _START_SECONDS
    task: dict[str, Any] = {
        "containers": [
            {"name": PREPARE_CONTAINER, "essential": False, **prepare},
            *(
                {
                    **_job_container(container, resources, settings),
                    "mountPoints": [job, output, *_mount_points(container)],
                }
                for container, resources in zip(shape.containers, size.containers, strict=True)
            ),
            {
                "name": WATCH_CONTAINER,
                "essential": True,
                **watch,
                "dependsOn": _after_prepare(),
                "stopTimeout": _STOP_SECONDS,
            },
        ],
        "volumes": [{"name": name} for name in ("job", "output", *(f"mount-{i}" for i in range(len(shape.volumes))))],
        "taskRoleArn": settings.job_role,
    }
    if settings.execution_role is not None:
        task["executionRoleArn"] = settings.execution_role
    return task


def _after_prepare() -> list[dict[str, str]]:
    return [{"containerName": PREPARE_CONTAINER, "condition": "SUCCESS"}]


def _tools_container(
    verb: str, resources: Resources, mounts: list[dict[str, Any]], settings: BatchSettings
) -> dict[str, Any]:
    """Return one of our containers; it runs as root, to read files of any user and set permissions of volumes."""
    return {
        "image": settings.tools_image,
        "command": ["python3", "-m", "calibration.addons.aws_batch.inside", verb],
        "user": "root",
        "mountPoints": mounts,
        **_common_properties(resources, settings),
    }


def _job_container(container: ContainerShape, resources: Resources, settings: BatchSettings) -> dict[str, Any]:
    """Return a container of the job, without its mounts; its command is in the script on the job's volume."""
    properties: dict[str, Any] = {
        "name": container.name,
        "essential": False,
        "image": container.image,
        "command": ["/bin/sh", f"{JOB_FOLDER}/{container.name}.sh"],
        "dependsOn": _after_prepare(),
        **_common_properties(resources, settings),
    }
    if container.user is not None:
        properties["user"] = container.user
    if container.secrets:
        properties["secrets"] = [_secret_reference(name, container.name, settings) for name in container.secrets]
    relaxed = container.relaxations
    if relaxed.devices:
        properties["linuxParameters"]["devices"] = [{"hostPath": device} for device in relaxed.devices]
    if relaxed.gpus:
        properties["resourceRequirements"].append({"type": "GPU", "value": "1"})
    if relaxed.privileged:
        properties["privileged"] = True
    return properties


def _common_properties(resources: Resources, settings: BatchSettings) -> dict[str, Any]:
    return {
        "resourceRequirements": [
            {"type": "VCPU", "value": f"{resources.cpus:g}"},
            {"type": "MEMORY", "value": str(resources.memory)},
        ],
        "linuxParameters": {"initProcessEnabled": True},  # forwards signals and reaps zombies
        "logConfiguration": {
            "logDriver": "awslogs",
            "options": {
                "awslogs-group": settings.log_group,
                "awslogs-region": settings.region,
                "awslogs-stream-prefix": LOG_PREFIX,
            },
        },
    }


def _mount_point(volume: str, path: str, read_only: bool = False) -> dict[str, Any]:
    return {"sourceVolume": volume, "containerPath": path, "readOnly": read_only}


def _mount_points(container: ContainerShape) -> list[dict[str, Any]]:
    return [_mount_point(f"mount-{mount.volume}", mount.target, not mount.writable) for mount in container.mounts]


def _secret_reference(name: str, container: str, settings: BatchSettings) -> dict[str, str]:
    if name not in settings.secrets:
        raise InputError(
            f"container '{container}': secrets: {name} has no ARN: put it into Secrets Manager or Parameter Store, and "
            "its ARN under secrets of aws-batch"
        )
    return {"name": name, "valueFrom": settings.secrets[name]}


_SECONDS_PER_HOUR = 3600.0
_FARGATE_LEAST = 60
"""Seconds: Fargate bills at least one minute."""


@dataclass(frozen=True)
class Usage:
    """Billed time and reserved resources."""

    seconds: float = 0.0
    """Sum over all tasks."""
    vcpu_hours: float = 0.0
    gb_hours: float = 0.0

    def __add__(self, other: "Usage") -> "Usage":
        return Usage(self.seconds + other.seconds, self.vcpu_hours + other.vcpu_hours, self.gb_hours + other.gb_hours)

    def price(self, prices: Prices) -> float:
        """Return the price."""
        return self.vcpu_hours * prices.vcpu_hour + self.gb_hours * prices.gb_hour

    def text(self, prices: Prices | None) -> str:
        """Format for messages: ``1.2 vCPU-hours and 2.4 GB-hours, 0.06 USD``."""
        hours = f"{self.vcpu_hours:.3g} vCPU-hours and {self.gb_hours:.3g} GB-hours"
        return hours if prices is None else f"{hours}, {self.price(prices):.2f} {prices.currency}"


@dataclass(frozen=True)
class Estimate:
    """Upper bound of the costs of jobs, if each runs once until its time limit."""

    usage: Usage
    unlimited: int = 0
    """Number of jobs without a time limit, which are not included."""

    def text(self, settings: BatchSettings) -> str:
        """Format for messages, including what is not covered."""
        text = f"at most {self.usage.text(settings.prices)}, if no host is lost"
        if settings.platform == "ec2":
            text += " and instances are filled"
        if self.unlimited:
            text += f"; not including {count_of(self.unlimited, 'job')} without a time limit"
        return text


def estimate(jobs: Sequence[tuple[Job, Shape]], settings: BatchSettings) -> Estimate:
    """Return an upper bound of the costs of jobs; most end long before their time limit.

    Args:
        jobs: jobs with their shapes.
        settings: settings of the backend.

    Raises:
        InputError: a job needs more than the largest task.
    """
    sizes = {shape: total_size(shape, settings.platform) for shape in {shape for _, shape in jobs}}
    limited = [(job.seconds, sizes[shape]) for job, shape in jobs if job.seconds is not None]
    usage = [usage_of(seconds, size, settings.platform) for seconds, size in limited]
    return Estimate(_sum_usages(usage), len(jobs) - len(limited))


def billed(attempts: Iterable[tuple[int | None, int | None]], size: Resources, platform: Platform) -> Usage:
    """Return the billed usage of a job's attempts.

    Args:
        attempts: ``startedAt`` and ``stoppedAt`` of each, in milliseconds, from DescribeJobs; attempts without
            a start or end are not counted.
        size: size of the task.
        platform: Fargate bills each attempt for at least one minute.
    """
    return _sum_usages(
        usage_of((stopped - started) / 1000, size, platform)
        for started, stopped in attempts
        if started is not None and stopped is not None and stopped >= started
    )


def usage_of(seconds: float, size: Resources, platform: Platform) -> Usage:
    """Return the billed usage of a task of this duration: whole seconds, on Fargate at least 60."""
    paid = max(math.ceil(seconds), _FARGATE_LEAST if platform == "fargate" else 0)
    return Usage(paid, size.cpus * paid / _SECONDS_PER_HOUR, size.memory / 1024 * paid / _SECONDS_PER_HOUR)


def total_size(shape: Shape, platform: Platform) -> Resources:
    """Return the resources that a task for a job of this shape reserves.

    Raises:
        InputError: it needs more than the largest task.
    """
    return task_size([container.resources for container in shape.containers], platform).total


def _sum_usages(usages: Iterable[Usage]) -> Usage:
    return sum(usages, Usage())
