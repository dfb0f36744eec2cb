"""A team's own calibration software, run in a container in place of our engine.

Its command has placeholders: ``{dataset}`` is the folder of the dataset as it is,
``{start}`` the same with the cell's noisy initial guess as its transforms, ``{output}`` the folder
whose files are copied back, and ``{system}``, ``{translation_noise}`` (m), ``{rotation_noise}`` (rad),
``{seed}`` for software that generates its own noise.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from calibration.base import InputError
from calibration.base.records import Place, changed, field, length, read, record
from calibration.ci.execution.job import (
    NETWORK_HELP,
    OUTPUT,
    Artifact,
    Container,
    Job,
    Mount,
    Network,
    fill,
    with_secrets,
)
from calibration.ci.execution.job_check import check_job
from calibration.ci.execution.ros import ROS_HELP, Ros, with_ros

SOFTWARE_METHOD = "software"
"""Method of its cells."""
DATASET_FOLDER, START_FOLDER = "/calibration/dataset", "/calibration/start"
"""Paths of the two folders in the container, read-only."""
COMMAND_PLACEHOLDERS = ("dataset", "start", "output", "system", "translation_noise", "rotation_noise", "seed")
ALL_OUTPUT = Artifact(f"{OUTPUT}/*")
DATASET_PATTERN, NO_DATASET = "*.json", "none"
"""Default name of its calibrated dataset, and the value for none."""
Pattern = Annotated[str, length(1)]


@record
class Software:
    """The team's own calibration, in place of our engine, which then only computes a reference.

    In its command {dataset}, {start} (the dataset with the noisy initial guess), {output}, {system},
    {translation_noise}, {rotation_noise} and {seed} are replaced.
    """

    container: Container = field(flat=True, default_factory=Container)
    """The command still has the placeholders; an empty image name means the one that the pipeline builds."""
    ros: Ros = field(ROS_HELP, default="none")
    network: Network = field(NETWORK_HELP, default="private")
    table: Pattern | None = field("A pattern for the path of its table among the artifacts (*.csv).", default=None)
    calibrated: Pattern = field(
        "A pattern for the path of its calibrated dataset (*.json), which is compared with the optimum of the "
        "same labels; none if the software writes no dataset: then its table is not verified.",
        default=DATASET_PATTERN,
    )

    @property
    def leaves_dataset(self) -> bool:
        """Whether it writes a dataset, so that its result can be verified."""
        return self.calibrated != NO_DATASET

    def with_image(self, image: str) -> "Software":
        """Return the software with this image, unless it names its own."""
        return self if self.container.image else replace(self, container=replace(self.container, image=image))


def checked_software(software: Software, place: Place) -> Software:
    """Return the software as it runs, with the values of its secrets, after a check of its job.

    Raises:
        InputError: a secret is not set, or the job is invalid; names the key.
    """
    where = str(place)
    if not software.container.command:
        raise InputError(f"{where}: missing command, which calibrates {{start}} and writes its table to {{output}}")
    software = replace(software, container=with_secrets(software.container, where))
    values = {**dict.fromkeys(COMMAND_PLACEHOLDERS, "0"), "output": OUTPUT}
    job = job_of(software.with_image("any"), "software", values, (), where)
    try:
        check_job(job)  # errors are found before anything runs
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return software


def software_from(entry: Mapping[str, Any], folder: Path, where: str) -> Software:
    """Parse an entry ``software`` of calibration.yml.

    Raises:
        InputError: a value is wrong; names the key.
    """
    return checked_software(read(Software, entry, where, folder), Place(where))


def adjusted_software(software: Software | None, entry: Mapping[str, Any], folder: Path) -> Software:
    """Return the software of a system, overridden by a command's options in the form of ``software``.

    Raises:
        InputError: a value is wrong, or there is no image or no command.
    """
    where = "the software in containers"
    if software is None:
        if "image" not in entry or "command" not in entry:
            raise InputError(f"{where}: image and command belong together: what runs, and in which image")
        return software_from(entry, folder, where)
    return checked_software(changed(software, entry, where, folder), Place(where))


def job_of(software: Software, name: str, values: Mapping[str, str], mounts: tuple[Mount, ...], where: str) -> Job:
    """Return the job of a software with its placeholders replaced.

    Raises:
        InputError: there is an unknown placeholder.
    """
    container = software.container
    paths = fill([artifact.path for artifact in container.artifacts], values, f"{where}.artifacts")
    artifacts = tuple(replace(artifact, path=path) for artifact, path in zip(container.artifacts, paths, strict=True))
    filled = replace(
        container,
        name="calibration",
        command=fill(container.command, values, f"{where}.command"),
        artifacts=artifacts or (ALL_OUTPUT,),
        mounts=(*container.mounts, *mounts),
    )
    return with_ros(Job(name, (filled,), software.network), software.ros)
