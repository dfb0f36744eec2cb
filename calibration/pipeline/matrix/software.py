"""The team's own calibration, which runs in its container in the place of our engine.

Its command is told everything by placeholders: ``{dataset}`` the folder of the dataset as it is,
``{start}`` the same with the cell's noisy starting guess as its transforms, ``{output}`` the folder
whose files are brought out, and ``{system}``, ``{translation_noise}`` (m), ``{rotation_noise}`` (rad),
``{seed}`` for software that makes its own noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from calibration.errors import InputError
from calibration.execution.document import container_from
from calibration.execution.job import OUTPUT, Artifact, Container, Job, Mount, Network
from calibration.execution.job_check import check_job
from calibration.execution.placeholders import fill
from calibration.execution.ros import RosVersion, with_ros

SOFTWARE = "software"
"""The method of its cells."""
DATASET, START = "/calibration/dataset", "/calibration/start"
"""Where it finds the two folders, read-only."""
PLACEHOLDERS = ("dataset", "start", "output", "system", "translation_noise", "rotation_noise", "seed")
EVERYTHING = Artifact(f"{OUTPUT}/*")
OWN_KEYS = frozenset({"ros", "table", "calibrated", "network"})
"""The keys of ``software`` in calibration.yml that are not the container's."""


@dataclass(frozen=True)
class Software:
    """What runs in every cell."""

    container: Container
    """Its command still has the placeholders; an empty image stands for the one that the pipeline builds."""
    ros: RosVersion = "none"
    network: Network = "private"
    table: str | None = None
    """A pattern for the path of its table among the artifacts; None for the only CSV file."""
    calibrated: str | None = None
    """A pattern for the path of its calibrated dataset, which is then held against the truth."""

    def with_image(self, image: str) -> "Software":
        """The same in this image, unless it names its own."""
        return self if self.container.image else replace(self, container=replace(self.container, image=image))


def software_from(entry: Mapping[str, Any], folder: Path, where: str) -> Software:
    """Read an entry ``software`` of calibration.yml, which follows the schema.

    Raises:
        InputError: a value is wrong; names the key.
    """
    container = {key: value for key, value in entry.items() if key not in OWN_KEYS}
    own: dict[str, Any] = {key: str(v) if key == "ros" else v for key, v in entry.items() if key in OWN_KEYS}
    software = Software(container_from("calibration", container, folder, where), **own)
    if not software.container.command:
        raise InputError(f"{where}: missing command, which calibrates {{start}} and writes its table to {{output}}")
    values = {**dict.fromkeys(PLACEHOLDERS, "0"), "output": OUTPUT}
    job = job_of(software.with_image("any"), "software", values, (), where)
    try:
        check_job(job)  # what is wrong is found before anything runs
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return software


def adjusted_software(software: Software | None, entry: Mapping[str, Any], folder: Path) -> Software:
    """The software of a system with what a command's options say, as keys of ``software``, in front.

    Raises:
        InputError: a value is wrong, or there is no image or no command.
    """
    where = "the software in containers"
    if software is None:
        if "image" not in entry or "command" not in entry:
            raise InputError(f"{where}: image and command belong together: what runs, and in which image")
        return software_from(entry, folder, where)
    complete = {"image": software.container.image, "command": list(software.container.command), **entry}
    asked = software_from(complete, folder, where)
    limits = software.container.limits
    if "memory" in entry:
        limits = replace(limits, memory=asked.container.limits.memory)
    if "timeout" in entry:
        limits = replace(limits, seconds=asked.container.limits.seconds)
    container = replace(software.container, image=asked.container.image, command=asked.container.command, limits=limits)
    if "artifacts" in entry:
        container = replace(container, artifacts=asked.container.artifacts)
    return replace(software, container=container, **{key: getattr(asked, key) for key in OWN_KEYS if key in entry})


def job_of(software: Software, name: str, values: Mapping[str, str], mounts: tuple[Mount, ...], where: str) -> Job:
    """The job of a software with its placeholders filled in.

    Raises:
        InputError: there is no such placeholder.
    """
    container = software.container
    paths = fill([artifact.path for artifact in container.artifacts], values, f"{where}.artifacts")
    artifacts = tuple(replace(artifact, path=path) for artifact, path in zip(container.artifacts, paths, strict=True))
    filled = replace(
        container,
        command=fill(container.command, values, f"{where}.command"),
        artifacts=artifacts or (EVERYTHING,),
        mounts=(*container.mounts, *mounts),
    )
    return with_ros(Job(name, (filled,), software.network), software.ros)
