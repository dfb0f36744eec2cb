"""The applications that simulate a robot and collect its data, each in a container, all in one network.

The paper's two launch files: a simulation application that publishes what the sensors see and moves
the pattern, and a robot application that labels and saves collections. A player asks for one pose after
the other: ours, or one of the team's containers. In their commands ``{output}`` is the folder that all
of them share, ``{motion}`` the motion sequence, ``{system}`` the name of the system, ``{seed}`` the seed,
``{scenario}`` the number of the collection, from 0, where there are several.
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
from calibration.execution.sizes import parse_seconds

INPUTS = "/calibration/in"
"""A folder that all of them see, read-only."""
MOTION, PLAYER = f"{INPUTS}/motion.json", f"{INPUTS}/player.py"
REPORT = f"{OUTPUT}/.player.json"
"""Where our player says what came of each pose."""
PLACEHOLDERS = ("output", "motion", "system", "seed", "scenario")
SECONDS = 3600.0


@dataclass(frozen=True)
class Ros1Player:
    """Our player for ROS 1: a script that needs nothing but rospy in the image that it runs in."""

    image: str = ""
    """That of the first application unless given."""
    after: tuple[str, ...] = ()
    """The containers that have to be ready before; all unless given."""
    pose_topic: str = "/pattern/pose"
    """Where it publishes the pattern's pose (geometry_msgs/PoseStamped)."""
    frame: str = "world"
    service: str = "/collect_data/save_collection"
    """What it calls at every pose; any type with an empty request."""
    settle: float = 0.5
    """Between the pose and the call, s."""


@dataclass(frozen=True)
class Applications:
    """The containers of a collection."""

    containers: tuple[Container, ...]
    """Their commands still have the placeholders; an empty image stands for the one that the pipeline builds."""
    player: Ros1Player | None = None
    """None where one of the containers plays."""
    ros: RosVersion = "none"
    network: Network = "private"
    seconds: float = SECONDS
    """A longer collection is stopped."""
    dataset: str = "{output}/dataset"
    """The folder of the dataset in the containers."""

    def with_image(self, image: str) -> "Applications":
        """The same, in this image where a container names none."""
        containers = tuple(c if c.image else replace(c, image=image) for c in self.containers)
        return replace(self, containers=containers)


def applications_from(entry: Mapping[str, Any], folder: Path, where: str) -> Applications:
    """Read what an entry of ``simulation`` in calibration.yml, which follows the schema, says of containers.

    Raises:
        InputError: a value is wrong; names the key.
    """
    containers = tuple(
        container_from(name, {"image": entry.get("image", ""), **container}, folder, f"{where}.containers.{name}")
        for name, container in entry["containers"].items()
    )
    player = entry.get("player")
    settings = {} if isinstance(player, str) else {k: v for k, v in (player or {}).items() if k != "kind"}
    names: dict[str, Any] = {
        key.replace("-", "_"): tuple(v) if isinstance(v, list) else v for key, v in settings.items()
    }
    applications = Applications(
        containers,
        player=Ros1Player(**names) if player is not None else None,
        ros=_ros(entry),
        network=entry.get("network", "private"),
        seconds=parse_seconds(entry["timeout"], f"{where}.timeout") if "timeout" in entry else SECONDS,
        dataset=entry.get("dataset", Applications.dataset),
    )
    if applications.player is not None and applications.ros != "1":
        raise InputError(f"{where}.player: ros1 needs a ROS master; add ros: 1")
    try:  # what is wrong is found before anything runs
        check_job(collection_job(applications.with_image("any"), "applications", "any", 1))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return applications


def _ros(entry: Mapping[str, Any]) -> RosVersion:
    versions: dict[str, RosVersion] = {"none": "none", "1": "1", "2": "2"}
    return versions[str(entry.get("ros", "none"))]


def collection_job(
    applications: Applications, name: str, system: str, seed: int, scenario: int = 0, inputs: Path | None = None
) -> Job:
    """The job that collects one dataset.

    Args:
        applications: what runs.
        name: of the job, and of its folder.
        system: the system's name.
        seed: of its noise, for those that make some.
        scenario: the number of the collection among those of the seed.
        inputs: the folder that they see as `INPUTS`; None where the team's player has its own motion.

    Raises:
        InputError: a command has a placeholder that there is not.
    """
    values = _values(system, seed, scenario)
    mounts = () if inputs is None else (Mount(inputs.resolve(), INPUTS),)
    containers = [
        replace(
            container,
            command=fill(container.command, values, f"containers.{container.name}.command"),
            mounts=(*container.mounts, *mounts),
        )
        for container in applications.containers
    ]
    if applications.player is not None:
        # roslaunch answers 0 when a node has died: whatever it answers, it is too early
        containers = [replace(container, success=()) for container in containers]
        containers.append(_player(applications, applications.player, mounts))
    brought = [Artifact(dataset_place(applications, system, seed, scenario))]
    if applications.player is not None:
        brought.append(Artifact(REPORT, required=False))
    containers[-1] = replace(containers[-1], artifacts=(*containers[-1].artifacts, *brought))
    return with_ros(Job(name, tuple(containers), applications.network, applications.seconds), applications.ros)


def dataset_place(applications: Applications, system: str, seed: int, scenario: int = 0) -> str:
    """Where the dataset of a `collection_job` is, in its containers.

    Raises:
        InputError: there is no such placeholder.
    """
    [place] = fill([applications.dataset], _values(system, seed, scenario), "dataset")
    return place.rstrip("/")


def _values(system: str, seed: int, scenario: int) -> dict[str, str]:
    """Of the `PLACEHOLDERS`."""
    return {"output": OUTPUT, "motion": MOTION, "system": system, "seed": str(seed), "scenario": str(scenario)}


def _player(applications: Applications, player: Ros1Player, mounts: tuple[Mount, ...]) -> Container:
    options = {
        "--motion": MOTION,
        "--report": REPORT,
        "--pose-topic": player.pose_topic,
        "--frame": player.frame,
        "--service": player.service,
        "--settle": f"{player.settle:g}",
    }
    return Container(
        name="player",
        image=player.image or applications.containers[0].image,
        command=("python3", "-u", PLAYER, *(part for option in options.items() for part in option)),
        mounts=mounts,
        after=player.after or tuple(container.name for container in applications.containers),
    )
