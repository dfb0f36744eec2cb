"""Jobs as Kubernetes takes them: Indexed Jobs whose pods have the containers, volumes and files of a task on AWS Batch.

The inputs and results lie in S3 as there (`calibration.execution.batch.wire`). The pod's only main container is the
one that watches: its end ends the pod, and its verdict is in ``outcome.json``. The containers of the job are sidecars
(init containers that go on), which end with it. Kubernetes starts a sidecar that has ended anew: it then only waits.

Needs Kubernetes 1.29 (1.33 without feature gates): sidecars, and failures counted by index.
"""

import hashlib
import re
from collections.abc import Sequence
from typing import Any

import yaml

from calibration.errors import InputError
from calibration.execution.batch.inside.signs import STATE
from calibration.execution.batch.requests.shape import ContainerShape, Group, Shape, group_by_shape
from calibration.execution.batch.requests.submission import Chunk, attempt_seconds, chunks
from calibration.execution.batch.requests.task_checks import check_task
from calibration.execution.batch.requests.task_size import TOOLS_MEMORY, Resources
from calibration.execution.batch.settings import BatchSettings
from calibration.execution.batch.wire import (
    ATTEMPT,
    FIRST,
    INDEX,
    JOB_FOLDER,
    LOCATION,
    MOUNTS_FOLDER,
    PREPARE,
    REGION,
    WATCH,
    Location,
)
from calibration.execution.job import OUTPUT, Job

SERVICE_ACCOUNT = "calibration"
"""The pods' account, which the cluster's administrator gives the role of the job (``aws-policy --for job``)."""
SECRET = "calibration"  # noqa: S105 (a name)
"""The Secret with the variables that are secret, by their names."""
RUN_LABEL = "ci.calibration/run"
"""On all that is made, with the `name_of` the run."""
_LONGEST = 52
"""Of our names: those of a Job's pods are longer by an index and a random part, and have at most 63 characters."""
_PARALLEL = 256
"""Pods of a Job at once; the others wait without a pod."""
_TOOLS_CPUS = 0.25
_INDEX_ANNOTATION = "metadata.annotations['batch.kubernetes.io/job-completion-index']"
_ONCE = """\
if [ -e "$2" ]; then trap 'exit 0' TERM; while :; do sleep 1 & wait $!; done; fi
: > "$2" && exec /bin/sh "$1"
"""
"""Runs a script and leaves a mark; where there is that already, the script has ended, and this waits for the pod."""
_TOOLS_CAPABILITIES = ("DAC_OVERRIDE", "FOWNER")
"""Of ours, which read files of any user and set the volumes' rights."""
_SHARED = {"job": JOB_FOLDER, "output": OUTPUT}
_ARCHITECTURES = {"x86_64": "amd64", "arm64": "arm64"}
_UNFIT = re.compile(r"[^a-z0-9]+")
_USER = re.compile(r"(?P<user>[0-9]{1,9})(:(?P<group>[0-9]{1,9}))?")


class _Dumper(yaml.SafeDumper):
    """Writes what stands twice twice: a reference in a manifest helps nobody."""

    def ignore_aliases(self, _data: Any) -> bool:
        return True


def rendered(jobs: Sequence[Job], settings: BatchSettings, run: str) -> str:
    """The manifests of a run, as a file for ``kubectl apply``.

    Args:
        jobs: as they would go to AWS Batch.
        settings: name the bucket, our image, and what containers get that say nothing.
        run: its name, as in the bucket.

    Raises:
        InputError: a job makes no sense in a pod.
    """
    documents = [
        kubernetes_job(jobs, group, chunk, settings, run)
        for group in check_and_group(jobs, settings)
        for chunk in chunks(range(len(group.jobs)))
    ]
    head = (
        f"# Jobs of run {run}, whose inputs lie in s3://{settings.bucket}/{settings.prefix}, and whose results go "
        "there.\n"
        f"# Needs: the ServiceAccount {SERVICE_ACCOUNT} with the rights of `calibration aws-policy --for job`"
    )
    if any(container.secrets for job in jobs for container in job.containers):
        head += f",\n# and the Secret {SECRET} with the variables that are secret"
    text = yaml.dump_all(documents, Dumper=_Dumper, sort_keys=False, explicit_start=True, width=120)
    return f"{head}.\n{text}"


def check_and_group(jobs: Sequence[Job], settings: BatchSettings) -> tuple[Group, ...]:
    """The jobs by their shapes.

    Raises:
        InputError: one makes no sense in a pod.
    """
    for job in jobs:
        check_task(job, "on Kubernetes")
        if job.network == "host":
            raise InputError(f"job '{job.name}': on Kubernetes a pod has a network of its own: say network: private")
        for container in job.containers:
            where = f"job '{job.name}', container '{container.name}': on Kubernetes"
            if container.relaxations.devices:
                raise InputError(f"{where} there are no devices without a plugin for them: drop devices")
            if container.user is not None and not _USER.fullmatch(container.user):
                raise InputError(f"{where} a user is a number, found '{container.user}': say its number, as 1000:1000")
    return group_by_shape(jobs, settings)


def kubernetes_job(
    jobs: Sequence[Job], group: Group, chunk: Chunk, settings: BatchSettings, run: str
) -> dict[str, Any]:
    """The manifest for some jobs of one shape.

    Args:
        jobs: of the run.
        group: those of one shape.
        chunk: those of the group.
        settings: as for `rendered`.
        run: its name.
    """
    location = Location(settings.bucket, settings.prefix, run, group.name)
    members = [jobs[group.jobs[chunk.index(child)]] for child in range(chunk.count)]
    labels = {"app.kubernetes.io/name": "calibration-ci", RUN_LABEL: name_of(run)}
    pod = _pod(group.shape, {LOCATION: location.text, FIRST: str(chunk.first), REGION: settings.region}, settings)
    if (seconds := attempt_seconds(members)) is not None:
        pod["activeDeadlineSeconds"] = seconds
    return {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": {"name": name_of(f"calibration-{run}-{group.name}-{chunk.first}"), "labels": labels},
        "spec": {
            "completionMode": "Indexed",
            "completions": chunk.count,
            "parallelism": min(chunk.count, _PARALLEL),
            "backoffLimitPerIndex": settings.attempts - 1,
            "maxFailedIndexes": chunk.count,
            "podFailurePolicy": {
                "rules": [
                    # a lost host counts, and is tried again; whatever else fails is not
                    {"action": "Count", "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]},
                    {"action": "FailIndex", "onExitCodes": {"operator": "NotIn", "values": [0]}},
                ]
            },
            "template": {"metadata": {"labels": labels}, "spec": pod},
        },
    }


def _pod(shape: Shape, variables: dict[str, str], settings: BatchSettings) -> dict[str, Any]:
    inputs = {f"mount-{i}": f"{MOUNTS_FOLDER}/{i}" for i in range(len(shape.volumes))}
    volumes = [*_SHARED, *inputs]
    return {
        "restartPolicy": "Never",
        "serviceAccountName": SERVICE_ACCOUNT,
        "automountServiceAccountToken": False,
        "enableServiceLinks": False,
        "nodeSelector": {"kubernetes.io/os": "linux", "kubernetes.io/arch": _ARCHITECTURES[settings.architecture]},
        "initContainers": [
            _tools(PREPARE, "prepare", _SHARED | inputs, variables, settings),
            *map(_container, shape.containers),
        ],
        "containers": [_tools(WATCH, "watch", _SHARED, variables, settings)],
        "terminationGracePeriodSeconds": 120,
        "volumes": [{"name": name, "emptyDir": {}} for name in volumes],
    }


def _tools(
    name: str, verb: str, mounts: dict[str, str], variables: dict[str, str], settings: BatchSettings
) -> dict[str, Any]:
    return {
        "name": name,
        "image": settings.tools_image,
        "command": ["python3", "-m", "calibration.execution.batch.inside", verb],
        "env": [
            *({"name": key, "value": value} for key, value in variables.items()),
            {"name": ATTEMPT, "value": "1"},
            {"name": INDEX, "valueFrom": {"fieldRef": {"fieldPath": _INDEX_ANNOTATION}}},
        ],
        "volumeMounts": [{"name": volume, "mountPath": path} for volume, path in mounts.items()],
        "resources": _resources(Resources(_TOOLS_CPUS, TOOLS_MEMORY)),
        "securityContext": {
            "runAsUser": 0,
            "allowPrivilegeEscalation": False,
            "capabilities": {"drop": ["ALL"], "add": list(_TOOLS_CAPABILITIES)},
        },
    }


def _container(container: ContainerShape) -> dict[str, Any]:
    script = f"{JOB_FOLDER}/{container.name}.sh"
    mark = f"{JOB_FOLDER}/{STATE}/{container.name}/started"
    mounts: list[dict[str, Any]] = [{"name": volume, "mountPath": path} for volume, path in _SHARED.items()]
    mounts += [
        {"name": f"mount-{mount.volume}", "mountPath": mount.target, "readOnly": not mount.writable}
        for mount in container.mounts
    ]
    resources = _resources(container.resources)
    if container.relaxations.gpus:
        resources["limits"]["nvidia.com/gpu"] = "1"
    return {
        "name": name_of(container.name),
        "image": container.image,
        "restartPolicy": "Always",  # a sidecar
        "args": ["/bin/sh", "-c", _ONCE, "sh", script, mark],  # after the image's own entrypoint, as on AWS Batch
        "env": [
            {"name": key, "valueFrom": {"secretKeyRef": {"name": SECRET, "key": key}}} for key in container.secrets
        ],
        "volumeMounts": mounts,
        "resources": resources,
        "securityContext": _security(container),
    }


def _resources(resources: Resources) -> dict[str, Any]:
    """Processors as a share, memory as a limit, as on AWS Batch."""
    memory = f"{resources.memory}Mi"
    return {"requests": {"cpu": f"{resources.cpus:g}", "memory": memory}, "limits": {"memory": memory}}


def _security(container: ContainerShape) -> dict[str, Any]:
    relaxed = container.relaxations
    context: dict[str, Any] = {}
    if relaxed.privileged:
        context["privileged"] = True
    else:
        context["allowPrivilegeEscalation"] = relaxed.new_privileges
        context["capabilities"] = {"drop": ["ALL"]}
        if relaxed.capabilities:
            context["capabilities"]["add"] = list(relaxed.capabilities)
    if (user := _USER.fullmatch(container.user or "")) is not None:
        context["runAsUser"] = int(user["user"])
        if user["group"] is not None:
            context["runAsGroup"] = int(user["group"])
    return context


def name_of(text: str) -> str:
    """A name that Kubernetes takes, with room for what it adds; another for another text."""
    plain = _UNFIT.sub("-", text.lower()).strip("-")
    if plain == text and len(text) <= _LONGEST:
        return text
    mark = hashlib.sha256(text.encode()).hexdigest()[:8]
    return f"{plain[: _LONGEST - 9].strip('-')}-{mark}".strip("-")
