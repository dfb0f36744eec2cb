"""A team's own programs in containers, in place of ours.

`Software` is a calibration in place of our engine's. Its command has placeholders: ``{dataset}`` is the folder of the
dataset as it is, ``{start}`` the same with the cell's noisy initial guess as its transforms, ``{output}`` the folder
whose files are copied back, and ``{system}``, ``{translation_noise}`` (m), ``{rotation_noise}`` (rad), ``{seed}`` for
software that generates its own noise.

`Applications` simulate a robot and collect its data, each in a container, all in one network: the paper's two
launch files. A simulation application publishes the sensors' data and moves the pattern, and a robot application labels
and saves collections. A player requests one pose after the other: ours, or one of the team's containers. In their
commands ``{output}`` is their shared folder, ``{motion}`` the motion sequence, ``{system}`` the name of the system,
``{seed}`` the seed, ``{scenario}`` the number of the collection, from 0, if there are several.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from calibration.base import InputError
from calibration.base.records import (
    ByName,
    Converted,
    Place,
    between,
    changed,
    field,
    length,
    matching,
    read,
    record,
)
from calibration.ci.execution.job import (
    NETWORK_HELP,
    OUTPUT,
    Artifact,
    Container,
    Job,
    Mount,
    Network,
    Seconds,
    fill,
    with_secrets,
)
from calibration.ci.execution.job_check import check_job
from calibration.ci.execution.ros import ROS_HELP, Recording, Ros, with_recorder, with_ros

SOFTWARE_METHOD = "software"
"""Method of its cells."""
DATASET_FOLDER, START_FOLDER = "/calibration/dataset", "/calibration/start"
"""Paths of the two folders in the container, read-only."""
SOFTWARE_PLACEHOLDERS = ("dataset", "start", "output", "system", "translation_noise", "rotation_noise", "seed")
ALL_OUTPUT = Artifact(f"{OUTPUT}/*")
DATASET_PATTERN, NO_DATASET = "*.json", "none"
"""Default name of its calibrated dataset, and the value for none."""
Text = Annotated[str, length(1)]


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
    table: Text | None = field("A pattern for the path of its table among the artifacts (*.csv).", default=None)
    calibrated: Text = field(
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
    values = {**dict.fromkeys(SOFTWARE_PLACEHOLDERS, "0"), "output": OUTPUT}
    job = job_of(software.with_image("any"), "software", values, (), where)
    with _found_at(place):
        check_job(job)
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


INPUT_FOLDER = "/calibration/in"
"""Read-only folder in all containers."""
MOTION_PATH, PLAYER_PATH = f"{INPUT_FOLDER}/motion.json", f"{INPUT_FOLDER}/player.py"
REPORT_PATH = f"{OUTPUT}/.player.json"
"""Report of our player on each pose."""
DEFAULT_SECONDS = 3600.0


_Name = matching("[a-z0-9][a-z0-9-]{0,62}", "small letters, digits and -")
_Topic = Annotated[str, matching("/?[A-Za-z0-9_/]+", "the name of a topic or a service")]


@record
class Ros1Player:
    """Our player for ROS 1: a script that only needs rospy in its image."""

    kind: Literal["ros1"] = field("ros1, the only one.")
    image: str = field("Image that it runs in (that of the first container).", default="")
    after: tuple[str, ...] = field("The containers that have to be ready before (all).", default=())
    pose_topic: _Topic = field(
        "Where the pattern's pose is published (geometry_msgs/PoseStamped).", default="/pattern/pose"
    )
    frame: Text = field("The frame of the pose.", default="world")
    service: _Topic = field(
        "Service that saves a collection; of any type with an empty request.", default="/collect_data/save_collection"
    )
    settle: Annotated[float, between(0, 600)] = field("Seconds between the pose and the call.", default=0.5)


def _player_from(value: str | Ros1Player, _: Place) -> Ros1Player:
    return Ros1Player("ros1") if isinstance(value, str) else value


@record
class Applications:
    """Applications that simulate and collect, in place of our own simulation."""

    containers: Annotated[tuple[Container, ...], ByName(_Name)] = field(
        "The applications that simulate and collect, in the place of our own: each runs in its container, all in one "
        "network. In their commands {output}, {motion}, {system}, {seed} and {scenario} are filled in.",
        default=(),
    )
    """An empty image name means the one that the pipeline builds."""
    image: str = field(
        "Image of the containers that name none; by default the one that the pipeline builds.",
        default="",
        option="Default image of the applications; or image with calibration-ci for scenarios.",
    )
    player: Annotated[Ros1Player, Converted(Literal["ros1"] | Ros1Player, _player_from)] | None = field(
        "What moves the pattern and asks for collections: ros1 for ours, in the image of the applications; by default "
        "one of the containers does.",
        default=None,
        option="ros1: our player moves the pattern and asks for collections.",
    )
    ros: Ros = field(ROS_HELP, default="none", option="1 starts a ROS master beside the applications.")
    record: Recording | None = field(
        "Recording of the applications' messages: the bag is in the folder messages beside the dataset. {} for all "
        "topics.",
        default=None,
        option=False,
    )
    network: Network = field(NETWORK_HELP, default="private")
    seconds: Seconds = field(
        "A longer collection is stopped, and has failed.",
        default=DEFAULT_SECONDS,
        key="timeout",
        option="Time limit of the applications, or of a scenario in a container: 10m (1h).",
    )
    dataset: Text = field(
        "The folder of the dataset; outside of {output} that of the last container.", default="{output}/dataset"
    )

    def with_image(self, image: str) -> "Applications":
        """Return the applications with this image for containers that name none."""
        containers = tuple(c if c.image else replace(c, image=image) for c in self.containers)
        return replace(self, containers=containers)


def checked_applications(applications: Applications, place: Place) -> Applications:
    """Return the applications as they run, with the values of their secrets, after a check of their job.

    Raises:
        InputError: a secret is not set, or the job is invalid; names the key.
    """
    named = applications.with_image(applications.image)
    containers = tuple(with_secrets(each, str(place.below("containers").below(each.name))) for each in named.containers)
    applications = replace(named, containers=containers)
    if applications.player is not None and applications.ros != "1":
        raise place.below("player").fault("ros1 needs a ROS master; add ros: 1")
    with _found_at(place):
        check_job(collection_job(applications.with_image("any"), "applications", "any", 1))
    return applications


def collection_job(
    applications: Applications, name: str, system: str, seed: int, scenario: int = 0, inputs: Path | None = None
) -> Job:
    """Return the job that collects one dataset.

    Args:
        applications: the containers.
        name: of the job, and of its folder.
        system: the system's name.
        seed: of its noise, for applications that add noise.
        scenario: the number of the collection among those of the seed.
        inputs: the folder mounted as `INPUT_FOLDER`; None if the team's player has its own motion.

    Raises:
        InputError: a command has an unknown placeholder.
    """
    values = _placeholder_values(system, seed, scenario)
    mounts = () if inputs is None else (Mount(inputs.resolve(), INPUT_FOLDER),)
    containers = [
        replace(
            container,
            command=fill(container.command, values, f"containers.{container.name}.command"),
            mounts=(*container.mounts, *mounts),
        )
        for container in applications.containers
    ]
    if applications.player is not None:
        # roslaunch exits with 0 when a node has died: whatever its exit code, it is too early
        containers = [replace(container, success=()) for container in containers]
        containers.append(_player_container(applications, applications.player, mounts))
    brought = [Artifact(dataset_place(applications, system, seed, scenario))]
    if applications.player is not None:
        brought.append(Artifact(REPORT_PATH, required=False))
    containers[-1] = replace(containers[-1], artifacts=(*containers[-1].artifacts, *brought))
    job = Job(name, tuple(containers), applications.network, applications.seconds)
    return with_ros(with_recorder(job, applications.record, applications.ros), applications.ros)


def dataset_place(applications: Applications, system: str, seed: int, scenario: int = 0) -> str:
    """Return the path of the dataset of a `collection_job`, in its containers.

    Raises:
        InputError: there is an unknown placeholder.
    """
    [place] = fill([applications.dataset], _placeholder_values(system, seed, scenario), "dataset")
    return place.rstrip("/")


def _placeholder_values(system: str, seed: int, scenario: int) -> dict[str, str]:
    return {"output": OUTPUT, "motion": MOTION_PATH, "system": system, "seed": str(seed), "scenario": str(scenario)}


def _player_container(applications: Applications, player: Ros1Player, mounts: tuple[Mount, ...]) -> Container:
    options = {
        "--motion": MOTION_PATH,
        "--report": REPORT_PATH,
        "--pose-topic": player.pose_topic,
        "--frame": player.frame,
        "--service": player.service,
        "--settle": f"{player.settle:g}",
    }
    return Container(
        name="player",
        image=player.image or applications.containers[0].image,
        command=("python3", "-u", PLAYER_PATH, *(part for option in options.items() for part in option)),
        mounts=mounts,
        after=player.after or tuple(container.name for container in applications.containers),
    )


@contextmanager
def _found_at(place: Place) -> Iterator[None]:
    """Name the place of errors that are found before anything runs."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}: {error}") from None
