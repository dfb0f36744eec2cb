"""Requests of a collection: a dataset, or many, by our own simulation or by the team's applications.

A team's applications simulate a robot and collect its data, each in a container, all in one network: the paper's two
launch files. A simulation application publishes the sensors' data and moves the pattern, and a robot application labels
and saves collections. A player requests one pose after the other: ours, or one of the team's containers. In their
commands ``{output}`` is their shared folder, ``{motion}`` the motion sequence, ``{system}`` the name of the system,
``{seed}`` the seed, ``{scenario}`` the number of the collection, from 0, if there are several.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from calibration.base import InputError, records
from calibration.base.records import field, record
from calibration.ci.execution.backends import CONTAINER_BACKENDS, BackendName, ContainerBackend, ExecutionTarget
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
from calibration.engine.diagnosis.limits import Limit
from calibration.pipeline.system import Text, Truth
from calibration.robot.simulation.motion import GENERATED_PREFIX

INPUT_FOLDER = "/calibration/in"
"""Read-only folder in all containers."""
MOTION_PATH, PLAYER_PATH = f"{INPUT_FOLDER}/motion.json", f"{INPUT_FOLDER}/player.py"
REPORT_PATH = f"{OUTPUT}/.player.json"
"""Report of our player on each pose."""
COMMAND_PLACEHOLDERS = ("output", "motion", "system", "seed", "scenario")
DEFAULT_SECONDS = 3600.0


_Name = records.matching("[a-z0-9][a-z0-9-]{0,62}", "small letters, digits and -")
_Topic = Annotated[str, records.matching("/?[A-Za-z0-9_/]+", "the name of a topic or a service")]


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
    settle: Annotated[float, records.between(0, 600)] = field("Seconds between the pose and the call.", default=0.5)


def _player_from(value: str | Ros1Player, _: records.Place) -> Ros1Player:
    return Ros1Player("ros1") if isinstance(value, str) else value


@record
class Applications:
    """Applications that simulate and collect, in place of our own simulation."""

    containers: Annotated[tuple[Container, ...], records.ByName(_Name)] = field(
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
    player: Annotated[Ros1Player, records.Converted(Literal["ros1"] | Ros1Player, _player_from)] | None = field(
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


def checked_applications(applications: Applications, place: records.Place) -> Applications:
    """Return the applications as they run, with the values of their secrets, after a check of their job.

    Raises:
        InputError: a secret is not set, or the job is invalid; names the key.
    """
    named = applications.with_image(applications.image)
    containers = tuple(with_secrets(each, str(place.below("containers").below(each.name))) for each in named.containers)
    applications = replace(named, containers=containers)
    if applications.player is not None and applications.ros != "1":
        raise place.below("player").fault("ros1 needs a ROS master; add ros: 1")
    try:  # errors are found before anything runs
        check_job(collection_job(applications.with_image("any"), "applications", "any", 1))
    except InputError as error:
        raise InputError(f"{place}: {error}") from None
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
    """Return the values of the `COMMAND_PLACEHOLDERS`."""
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


MAX_SCENARIOS = 100_000
KEYS_OF_APPLICATIONS = ("player", "ros", "record", "network", "timeout", "dataset", "image", "truth")
"""Keys that only collections by the team's applications have."""

Share = Annotated[float, records.between(0, 1)]


def _motion_in_folder(text: str, place: records.Place) -> str:
    return text if text.startswith(GENERATED_PREFIX) else str(place.folder / text)


@record(rules=(records.one_of("translation-mm", "rotation-deg", why="expected translation-mm or rotation-deg"),))
class CollectionLimits:
    """Limits of the errors of sensors and joints against the truth."""

    translation_mm: Limit | None = field(
        "Limit of the largest error of a sensor, and of a joint's length, in mm (5).", default=None
    )
    rotation_deg: Limit | None = field("Limit of the largest rotation error, in degrees (0.3).", default=None)


USUAL_LIMITS = CollectionLimits(translation_mm=5.0, rotation_deg=0.3)


@record
class CollectionChecks:
    """Limits for a collected dataset; None for no limit."""

    minimum_collections: Annotated[int, records.at_least(1)] = field(
        "Fewer make it fail.", default=3, option="Fewer collections that are kept make it fail (3)."
    )
    minimum_detection_rate: Share | None = field("Share of the poses that every sensor detects, 0 to 1.", default=None)
    minimum_coverage: Share | None = field("Share of every image that the corners cover, 0 to 1.", default=None)
    limits: CollectionLimits = field(
        "The largest errors of sensors and joints against the truth that pass (5 mm, 0.3 degrees).",
        default_factory=CollectionLimits,
        option=False,
    )

    def with_usual_limits(self) -> "CollectionChecks":
        """Return the checks with `USUAL_LIMITS` in place of limits that are not given."""
        translation, rotation = self.limits.translation_mm, self.limits.rotation_deg
        limits = CollectionLimits(
            USUAL_LIMITS.translation_mm if translation is None else translation,
            USUAL_LIMITS.rotation_deg if rotation is None else rotation,
        )
        return replace(self, limits=limits)


@record(
    rules=(
        records.one_of("system", "containers", why="expected a system, or containers that simulate and collect"),
        *(records.needs(key, "containers") for key in KEYS_OF_APPLICATIONS),
    )
)
class CollectionRequest:
    """Dataset to collect in simulation, and to calibrate."""

    system: Path | None = field(
        "The folder of a system (robot.urdf, config.yml, simulation.yml), relative to this file.",
        default=None,
        option=False,
    )
    """With applications optional: its sensors are expected in the dataset, and its robot is the truth."""
    applications: Applications = field(flat=True, default_factory=Applications)
    """Without containers it is a collection by our own simulation: in local processes, or, with an image that has this
    package, in a container for each scenario."""
    truth: Truth | None = field(
        "What the calibrated dataset is compared with: a file, 'dataset' for the transforms in it, 'none'; by default "
        "the system's.",
        default=None,
        option="Ground truth of the applications' dataset: a file, dataset or none (the system's).",
    )
    backend: BackendName | None = field(
        "embedded: our own simulation. docker, aws-batch: where the containers run; by default where the others do.",
        default=None,
        option=False,
    )
    robot: Path | None = field(
        "Another robot description (URDF or xacro).",
        default=None,
        option="URDF or xacro, in place of the system's robot.urdf.",
    )
    config: Path | None = field(
        "Another calibration configuration.",
        default=None,
        option="ATOM's calibration configuration, in place of the system's config.yml.",
    )
    motion: Annotated[str, records.Converted(Text, _motion_in_folder)] | None = field(
        "A motion sequence (JSON), or generate:N; by default the system's motion.json.",
        default=None,
        option="Motion sequence (JSON), or generate:N; by default the system's motion.json.",
    )
    seed: Annotated[int, records.at_least(0)] = field(
        "Seed of the noise and of a generated motion.",
        default=1,
        option="Seed of the noise, of a generated motion, of the scenarios (1).",
    )
    checks: CollectionChecks = field(flat=True, default_factory=CollectionChecks)
    name: str = ""
    """Name of the entry; by default the system's."""
    stillness: float | None = None
    """Limit of a pattern's motion while the sensors measure, m; None for the default."""
    scenario_set: Path | None = None
    """Scenarios that change the system of our own simulation; None for the system as described."""
    number: int = 0
    """Number of the collection among those of the seed, or of the scenario in the set."""
    target: ExecutionTarget | None = None
    """Execution target of the containers; None for this machine's engine."""

    def checked(self, backend: ContainerBackend, place: records.Place) -> "CollectionRequest":
        """Return the request as it runs; its containers use this backend unless it names its own.

        Raises:
            InputError: the containers are invalid, or there are none for the backend; names the key.
        """
        contained = bool(self.applications.containers)
        found: BackendName = self.backend or (backend if contained else "embedded")
        if (found in CONTAINER_BACKENDS) != contained:
            raise place.below("backend").fault(
                f"found {found}; containers run with {' or '.join(CONTAINER_BACKENDS)}, and these need containers"
            )
        applications = checked_applications(self.applications, place) if contained else self.applications
        return replace(self, applications=applications, backend=found)

    @property
    def effective_checks(self) -> CollectionChecks:
        """Checks of the dataset: with the usual limits, unless there is no truth."""
        return self.checks if self.truth == "none" else self.checks.with_usual_limits()

    @property
    def folder(self) -> Path:
        """Folder of the system, which our own simulation always has."""
        assert self.system is not None  # noqa: S101 (a rule of the record)
        return self.system


@dataclass(frozen=True)
class ScenarioRequest:
    """Request of many datasets."""

    collection: CollectionRequest
    """The system, the scenario set and the seed, and the requirements; a motion, if it is the same for all."""
    count: int
    minimum_success_rate: float = 1.0
    """Minimum share of scenarios that pass."""
    applications: tuple[str, ...] = ()
    """Options of the command that describe the team's applications."""
