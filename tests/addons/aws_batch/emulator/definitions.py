"""What AWS Batch refuses in a job definition, beyond the form of the request."""

import json
import re
from collections.abc import Iterator
from typing import Any

NAME = re.compile(r"[a-zA-Z0-9][a-zA-Z0-9_-]{0,127}")
UNKNOWN = ("containerProperties", "eksProperties", "nodeProperties", "parameters", "consumableResourceProperties")
CONDITIONS = {"START", "COMPLETE", "SUCCESS"}
PATTERNS = {
    "onStatusReason": r"[\w.:\s]{0,511}\*?",
    "onReason": r"[\w.:\s]{0,511}\*?",
    "onExitCode": r"\d*\*?",
}
"""Of evaluateOnExit."""
LARGEST = 24 * 1024
"""Bytes of a definition."""
GIB = 1024
FARGATE = {
    0.25: {512, 1 * GIB, 2 * GIB},
    0.5: set(range(1 * GIB, 4 * GIB + 1, GIB)),
    1: set(range(2 * GIB, 8 * GIB + 1, GIB)),
    2: set(range(4 * GIB, 16 * GIB + 1, GIB)),
    4: set(range(8 * GIB, 30 * GIB + 1, GIB)),
    8: set(range(16 * GIB, 60 * GIB + 1, 4 * GIB)),
    16: set(range(32 * GIB, 120 * GIB + 1, 8 * GIB)),
}
"""MiB that a task on Fargate may have, by its vCPUs; here the sums over its containers are held against it."""


def problems(request: dict[str, Any]) -> list[str]:
    """Return what is wrong, a line each."""
    return list(_problems(request))


def _problems(request: dict[str, Any]) -> Iterator[str]:
    if not NAME.fullmatch(request["jobDefinitionName"]):
        yield f"jobDefinitionName {request['jobDefinitionName']!r}"
    if request["type"] != "container" or "ecsProperties" not in request:
        yield "the emulator knows jobs of several containers (type container, ecsProperties) only"
        return
    if (size := len(json.dumps(request))) > LARGEST:
        yield f"the definition has {size} bytes, at most {LARGEST}"
    for other in UNKNOWN:
        if other in request:
            yield f"the emulator does not know {other}"
    tasks = request["ecsProperties"]["taskProperties"]
    if len(tasks) != 1:
        yield f"ecsProperties.taskProperties: {len(tasks)} tasks, it has to be one"
        return
    platforms = request.get("platformCapabilities", ["EC2"])
    if len(platforms) != 1:
        yield "platformCapabilities: one of EC2, FARGATE"
    yield from retry_problems(request.get("retryStrategy", {}))
    yield from timeout_problems(request.get("timeout", {}))
    yield from _tags(request.get("tags", {}))
    yield from _task(tasks[0], "FARGATE" in platforms)


def retry_problems(retry: dict[str, Any]) -> Iterator[str]:
    """Say what is wrong with a retryStrategy."""
    if not 1 <= retry.get("attempts", 1) <= 10:
        yield f"retryStrategy.attempts: {retry['attempts']}, 1 to 10"
    conditions = retry.get("evaluateOnExit", [])
    if conditions and "attempts" not in retry:
        yield "retryStrategy.attempts is required with evaluateOnExit"
    if len(conditions) > 5:
        yield f"retryStrategy.evaluateOnExit: {len(conditions)} conditions, at most 5"
    for condition in conditions:
        for key, pattern in PATTERNS.items():
            if key in condition and not re.fullmatch(pattern, condition[key], re.ASCII):
                yield f"retryStrategy.evaluateOnExit.{key}: {condition[key]!r} is no pattern"


def timeout_problems(timeout: dict[str, Any]) -> Iterator[str]:
    """Say what is wrong with a timeout."""
    if timeout.get("attemptDurationSeconds", 60) < 60:
        yield f"timeout.attemptDurationSeconds: {timeout['attemptDurationSeconds']}, at least 60"


def _tags(tags: dict[str, str]) -> Iterator[str]:
    for key, value in tags.items():
        if key.lower().startswith("aws:") or not 1 <= len(key) <= 128 or len(value) > 256:
            yield f"tags: {key!r}: {value!r}"
        if not re.fullmatch(r"[\w\s.:/=+\-@]*", key + value):
            yield f"tags: {key!r}: {value!r} has a letter that tags must not have"


def _task(task: dict[str, Any], fargate: bool) -> Iterator[str]:
    containers = task["containers"]
    if not 1 <= len(containers) <= 10:
        yield f"containers: {len(containers)}, 1 to 10"
    names = [container.get("name", "") for container in containers]
    essential = {container.get("name") for container in containers if container.get("essential", True)}
    if len(set(names)) < len(names) or not all(NAME.fullmatch(name) for name in names):
        yield f"containers: names {names}"
    if not essential:
        yield "containers: at least one has to be essential"
    volumes = [volume.get("name") for volume in task.get("volumes", [])]
    if len(set(volumes)) < len(volumes) or not all(NAME.fullmatch(volume or "") for volume in volumes):
        yield f"volumes: names {volumes}"
    sums = {"VCPU": 0.0, "MEMORY": 0.0}
    for container in containers:
        yield from _container(container, set(names), essential, set(volumes), sums, fargate)
    if cycle := _cycle(containers):
        yield f"containers: {cycle} wait for each other"
    if fargate:
        yield from _fargate(task, sums)
    elif any(key in task for key in ("networkConfiguration", "platformVersion", "ephemeralStorage", "runtimePlatform")):
        yield "networkConfiguration, platformVersion, ephemeralStorage and runtimePlatform are for Fargate"


def _container(
    container: dict[str, Any],
    names: set[str],
    essential: set[Any],
    volumes: set[Any],
    sums: dict[str, float],
    fargate: bool,
) -> Iterator[str]:
    where = f"containers.{container.get('name')}"
    resources = {each["type"]: each["value"] for each in container.get("resourceRequirements", [])}
    for kind in sums:
        try:
            sums[kind] += float(resources[kind])
        except (KeyError, ValueError):
            yield f"{where}.resourceRequirements: {kind} {resources.get(kind)!r}"
    if not re.fullmatch(r"[1-9]\d*", resources.get("MEMORY", "1")):
        yield f"{where}.resourceRequirements: MEMORY {resources['MEMORY']!r} is no number of MiB"
    elif int(resources.get("MEMORY", "4")) < 4:
        yield f"{where}.resourceRequirements: at least 4 MiB"
    if "VCPU" in resources and not fargate and not re.fullmatch(r"[1-9]\d*", resources["VCPU"]):
        yield f"{where}.resourceRequirements: VCPU {resources['VCPU']!r}: whole numbers on EC2"
    if not re.fullmatch(r"[\w.:/#@-]{1,255}", container["image"], re.ASCII):
        yield f"{where}.image: {container['image']!r}"
    for dependency in container.get("dependsOn", []):
        other, condition = dependency["containerName"], dependency["condition"]
        if other not in names or other == container.get("name"):
            yield f"{where}.dependsOn: {other!r}"
        if condition not in CONDITIONS:
            yield f"{where}.dependsOn: condition {condition!r}, one of {', '.join(sorted(CONDITIONS))}"
        elif condition != "START" and other in essential:
            yield f"{where}.dependsOn: {other} is essential, so its condition must not be {condition}"
    paths = [mount.get("containerPath") for mount in container.get("mountPoints", [])]
    if len(set(paths)) < len(paths) or not all(str(path).startswith("/") for path in paths):
        yield f"{where}.mountPoints: {paths}"
    for mount in container.get("mountPoints", []):
        if mount.get("sourceVolume") not in volumes:
            yield f"{where}.mountPoints: no volume {mount.get('sourceVolume')!r}"
    for key in ("startTimeout", "stopTimeout"):
        if not 2 <= container.get(key, 2) <= (120 if fargate else 10_000):
            yield f"{where}.{key}: {container[key]}"
    linux = container.get("linuxParameters", {})
    if fargate and (container.get("privileged") or set(linux) - {"initProcessEnabled"} or "GPU" in resources):
        yield f"{where}: neither privileges nor GPUs nor {sorted(linux)} on Fargate"
    variables = [each["name"] for each in container.get("environment", []) + container.get("secrets", [])]
    if len(set(variables)) < len(variables):
        yield f"{where}.environment: a name twice"
    if any(name.startswith("AWS_BATCH") for name in variables):
        yield f"{where}.environment: names that start with AWS_BATCH are Batch's own"


def _cycle(containers: list[dict[str, Any]]) -> list[str]:
    left = {each.get("name", ""): {d["containerName"] for d in each.get("dependsOn", [])} for each in containers}
    while free := {name for name, waits in left.items() if not waits & left.keys()}:
        left = {name: waits for name, waits in left.items() if name not in free}
    return sorted(left)


def _fargate(task: dict[str, Any], sums: dict[str, float]) -> Iterator[str]:
    if sums["MEMORY"] not in FARGATE.get(sums["VCPU"], ()):
        yield f"Fargate has no task of {sums['VCPU']:g} vCPU and {sums['MEMORY']:g} MiB"
    if "executionRoleArn" not in task:
        yield "executionRoleArn is required on Fargate"
    if any(volume.get("host", {}).get("sourcePath") for volume in task.get("volumes", [])):
        yield "volumes.host.sourcePath is not for Fargate"
    if "ipcMode" in task or "pidMode" in task:
        yield "ipcMode and pidMode are not for Fargate"
    if not 21 <= task.get("ephemeralStorage", {}).get("sizeInGiB", 21) <= 200:
        yield f"ephemeralStorage.sizeInGiB: {task['ephemeralStorage']['sizeInGiB']}, 21 to 200"
