"""Jobs of one shape: those that can be children of one array, as they differ only in what they read from S3."""

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

from calibration.execution.batch.documents.job_document import mount_targets
from calibration.execution.batch.requests.task_size import Resources
from calibration.execution.batch.settings import BatchSettings
from calibration.execution.job import Container, Job, Relaxations

_MIB = 1024**2


@dataclass(frozen=True)
class MountShape:
    """Where a container sees a volume."""

    volume: int
    """Its place among the job's `Shape.volumes`."""
    target: str
    writable: bool


@dataclass(frozen=True)
class ContainerShape:
    """What of a container stands in the job definition."""

    name: str
    image: str
    resources: Resources
    """As it asks for them."""
    user: str | None = None
    secrets: tuple[str, ...] = ()
    """Names of variables."""
    mounts: tuple[MountShape, ...] = ()
    relaxations: Relaxations = field(default_factory=Relaxations)


@dataclass(frozen=True)
class Shape:
    """What of a job stands in the job definition."""

    containers: tuple[ContainerShape, ...]
    volumes: tuple[str, ...] = ()
    """The targets of its mounts."""

    @property
    def digest(self) -> str:
        """The same for the same shape, whenever and wherever."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Group:
    """The jobs of a run that have one shape."""

    name: str
    shape: Shape
    jobs: tuple[int, ...]
    """Their places among the jobs of the run; a job's index in the group is its place in this."""


def shape_of(job: Job, settings: BatchSettings) -> Shape:
    """What the job definition of a job has to say."""
    volumes = mount_targets(job)
    return Shape(tuple(_container_shape(each, volumes, settings) for each in job.containers), volumes)


def group_by_shape(jobs: Sequence[Job], settings: BatchSettings) -> tuple[Group, ...]:
    """Sort the jobs of a run into groups, in the order of each one's first job.

    A group's name says its shape: the same jobs give the same groups again.
    """
    places: dict[Shape, list[int]] = {}
    for place, job in enumerate(jobs):
        places.setdefault(shape_of(job, settings), []).append(place)
    return tuple(Group(shape.digest[:12], shape, tuple(found)) for shape, found in places.items())


def _container_shape(container: Container, volumes: Sequence[str], settings: BatchSettings) -> ContainerShape:
    limits = container.limits
    memory = settings.memory if limits.memory is None else limits.memory
    targets = {mount.target.rstrip("/"): mount.writable for mount in container.mounts}
    return ContainerShape(
        name=container.name,
        image=container.image,
        resources=Resources(settings.cpus if limits.cpus is None else limits.cpus, math.ceil(memory / _MIB)),
        user=container.user,
        secrets=tuple(sorted(container.secrets)),
        mounts=tuple(
            MountShape(volumes.index(target), target, writable) for target, writable in sorted(targets.items())
        ),
        relaxations=container.relaxations,
    )
