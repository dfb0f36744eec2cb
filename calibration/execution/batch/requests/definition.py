"""The job definition of a shape: a pure function to the request ``RegisterJobDefinition``."""

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

from calibration.errors import InputError
from calibration.execution.batch.requests.shape import ContainerShape, Shape
from calibration.execution.batch.requests.task_size import Resources, task_size
from calibration.execution.batch.settings import BatchSettings
from calibration.execution.batch.wire import JOB_FOLDER, MOUNTS_FOLDER, PREPARE, WATCH
from calibration.execution.job import OUTPUT

DIGEST_TAG = "ci.calibration.definition"
"""The tag of a definition with the hash of all else in it: it tells whether a new revision is needed."""
LOG_PREFIX = "calibration"
"""Of the log streams: ``calibration/CONTAINER/TASK``."""
MOST_BYTES = 24 * 1024
"""Of a definition; AWS takes no larger one."""
_START_SECONDS = 3600
"""How long the containers wait for the inputs on EC2. Fargate has three minutes, and no way to ask for more."""
_STOP_SECONDS = 120
"""What the container that uploads is given when the job is terminated: the most that Fargate gives."""
_UNFIT_FOR_NAME = re.compile(r"[^A-Za-z0-9]+")
_VERSION = re.compile(r"(:[^:/@]+)?(@.*)?$")
_RETRIES = (
    {"onStatusReason": "Host EC2*", "action": "RETRY"},
    {"onStatusReason": "Your Spot Task was interrupted*", "action": "RETRY"},
    # what matches none is tried again, so everything else has to match, whichever of these it has
    {"onStatusReason": "*", "action": "EXIT"},
    {"onReason": "*", "action": "EXIT"},
    {"onExitCode": "*", "action": "EXIT"},
)


def definition_name(shape: Shape, settings: BatchSettings) -> str:
    """The name of the definition, of which another image or size is another revision."""
    images = [_VERSION.sub("", container.image) for container in shape.containers]
    names = [container.name for container in shape.containers]
    mark = hashlib.sha256(json.dumps([settings.prefix, names, images]).encode()).hexdigest()[:8]
    return f"calibration-{_UNFIT_FOR_NAME.sub('-', '-'.join(names)).strip('-')[:80]}-{mark}"


def job_definition(shape: Shape, settings: BatchSettings) -> dict[str, Any]:
    """The request that registers the definition; its tag `DIGEST_TAG` says what is in it.

    Raises:
        InputError: no task is so large, a secret has no ARN, or the definition is longer than AWS takes.
    """
    fargate = settings.platform == "fargate"
    request: dict[str, Any] = {
        "jobDefinitionName": definition_name(shape, settings),
        "type": "container",
        "platformCapabilities": [settings.platform.upper()],
        "ecsProperties": {"taskProperties": [_task(shape, settings)]},
        "retryStrategy": {"attempts": settings.attempts, "evaluateOnExit": [dict(rule) for rule in _RETRIES]},
        "propagateTags": True,
    }
    if fargate:
        request["ecsProperties"]["taskProperties"][0] |= _fargate_properties(settings)
    request["tags"] = {**settings.tags, DIGEST_TAG: _digest(request, settings.tags)}
    if (size := len(json.dumps(request).encode())) > MOST_BYTES:
        raise InputError(
            f"its job definition has {size} bytes, AWS Batch takes {MOST_BYTES}: it has {len(shape.volumes)} mounts "
            f"and {sum(len(container.secrets) for container in shape.containers)} secrets: join some of them"
        )
    return request


def _digest(request: Mapping[str, Any], tags: Mapping[str, str]) -> str:
    return hashlib.sha256(json.dumps([request, dict(tags)], sort_keys=True).encode()).hexdigest()


def _fargate_properties(settings: BatchSettings) -> dict[str, Any]:
    properties: dict[str, Any] = {
        "networkConfiguration": {"assignPublicIp": "ENABLED" if settings.public_ip else "DISABLED"},
        "runtimePlatform": {"operatingSystemFamily": "LINUX", "cpuArchitecture": settings.architecture.upper()},
    }
    if settings.disk is not None:
        properties["ephemeralStorage"] = {"sizeInGiB": settings.disk}
    return properties


def _task(shape: Shape, settings: BatchSettings) -> dict[str, Any]:
    size = task_size([container.resources for container in shape.containers], settings.platform)
    job, output = _mount("job", JOB_FOLDER), _mount("output", OUTPUT)
    inputs = [_mount(f"mount-{i}", f"{MOUNTS_FOLDER}/{i}") for i in range(len(shape.volumes))]
    prepare = _tools("prepare", size.prepare, [job, output, *inputs], settings)
    watch = _tools("watch", size.watch, [job, output], settings)
    if settings.platform == "ec2":
        prepare["startTimeout"] = _START_SECONDS
    task: dict[str, Any] = {
        "containers": [
            {"name": PREPARE, "essential": False, **prepare},
            *(
                {**_container(container, resources, settings), "mountPoints": [job, output, *_mounts(container)]}
                for container, resources in zip(shape.containers, size.containers, strict=True)
            ),
            {"name": WATCH, "essential": True, **watch, "dependsOn": _after_prepare(), "stopTimeout": _STOP_SECONDS},
        ],
        "volumes": [{"name": name} for name in ("job", "output", *(f"mount-{i}" for i in range(len(shape.volumes))))],
        "taskRoleArn": settings.job_role,
    }
    if settings.execution_role is not None:
        task["executionRoleArn"] = settings.execution_role
    return task


def _after_prepare() -> list[dict[str, str]]:
    return [{"containerName": PREPARE, "condition": "SUCCESS"}]


def _tools(verb: str, resources: Resources, mounts: list[dict[str, Any]], settings: BatchSettings) -> dict[str, Any]:
    """One of our containers; it is root, as files of any user have to be read and the volumes' rights set."""
    return {
        "image": settings.tools_image,
        "command": ["python3", "-m", "calibration.execution.batch.inside", verb],
        "user": "root",
        "mountPoints": mounts,
        **_common(resources, settings),
    }


def _container(container: ContainerShape, resources: Resources, settings: BatchSettings) -> dict[str, Any]:
    """A container of the job, without its mounts; what it runs stands in the script that it finds on a volume."""
    properties: dict[str, Any] = {
        "name": container.name,
        "essential": False,
        "image": container.image,
        "command": ["/bin/sh", f"{JOB_FOLDER}/{container.name}.sh"],
        "dependsOn": _after_prepare(),
        **_common(resources, settings),
    }
    if container.user is not None:
        properties["user"] = container.user
    if container.secrets:
        properties["secrets"] = [_secret(name, container.name, settings) for name in container.secrets]
    relaxed = container.relaxations
    if relaxed.devices:
        properties["linuxParameters"]["devices"] = [{"hostPath": device} for device in relaxed.devices]
    if relaxed.gpus:
        properties["resourceRequirements"].append({"type": "GPU", "value": "1"})
    if relaxed.privileged:
        properties["privileged"] = True
    return properties


def _common(resources: Resources, settings: BatchSettings) -> dict[str, Any]:
    return {
        "resourceRequirements": [
            {"type": "VCPU", "value": f"{resources.cpus:g}"},
            {"type": "MEMORY", "value": str(resources.memory)},
        ],
        "linuxParameters": {"initProcessEnabled": True},  # hands signals on, and buries the dead
        "logConfiguration": {
            "logDriver": "awslogs",
            "options": {
                "awslogs-group": settings.log_group,
                "awslogs-region": settings.region,
                "awslogs-stream-prefix": LOG_PREFIX,
            },
        },
    }


def _mount(volume: str, path: str, read_only: bool = False) -> dict[str, Any]:
    return {"sourceVolume": volume, "containerPath": path, "readOnly": read_only}


def _mounts(container: ContainerShape) -> list[dict[str, Any]]:
    return [_mount(f"mount-{mount.volume}", mount.target, not mount.writable) for mount in container.mounts]


def _secret(name: str, container: str, settings: BatchSettings) -> dict[str, str]:
    if name not in settings.secrets:
        raise InputError(
            f"container '{container}': secrets: {name} has no ARN: put it into Secrets Manager or Parameter Store, and "
            "its ARN under secrets of aws-batch"
        )
    return {"name": name, "valueFrom": settings.secrets[name]}
