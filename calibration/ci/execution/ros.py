"""Containers and variables that ROS needs; a master only for ROS 1."""

import re
from dataclasses import replace
from typing import Annotated, Literal

from calibration.base.errors import InputError
from calibration.base.records import Converted
from calibration.ci.execution.job import Container, Job, Readiness

RosVersion = Literal["none", "1", "2"]
Ros = Annotated[RosVersion, Converted(Literal["none", "1", "2", 1, 2], lambda version, _: str(version))]
"""Type of a record's field: the version, also as a number."""
ROS_HELP = "1: a ROS master is started, with variables for all containers. 2: a separate domain."
MASTER_NAME = "master"
"""Name of the container with the ROS master."""
MASTER_PORT = 11311
_LOOPBACK_ADDRESS = "127.0.0.1"
_MASTER_URI = r"(?P<before>https?://)(?P<host>[^/:]+)(?P<after>.*)"


def with_ros(job: Job, version: RosVersion, image: str | None = None) -> Job:
    """Add containers and variables for a version of ROS; variables of the user are kept.

    1: a container with a master, for which the others wait, in ``image`` (by default that of the first
    container), and the variables by which nodes find it and each other. 2: no master; a domain, and a
    private network even for a single container, because nodes find each other by multicast and
    must not find those of other jobs. The folder for logs of ROS 2 is writable for all users.

    Raises:
        InputError: a container has the master's name, or a ROS master needs another network of the job.
    """
    if version == "none":
        return job
    if version == "2":
        environment = {
            "ROS_DOMAIN_ID": "0",
            "ROS_LOG_DIR": "/tmp/ros-log",  # noqa: S108 (in a container of its own)
            # containers share no memory, which Fast DDS assumes for participants on the same host
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        }
        containers = tuple(_with_environment(container, environment) for container in job.containers)
        return replace(job, containers=containers, own_network=True)
    if job.network not in ("private", "internal"):
        raise InputError(f"job '{job.name}': ROS 1 needs the network private or internal, found {job.network}")
    if MASTER_NAME in {container.name for container in job.containers}:
        raise InputError(f"job '{job.name}': with ROS 1 no other container may have the name '{MASTER_NAME}'")
    master = Container(
        name=MASTER_NAME,
        image=image or job.containers[0].image,
        command=("roscore", "-p", str(MASTER_PORT)),
        readiness=Readiness(port=MASTER_PORT),
        essential=False,
    )
    nodes = (
        replace(container, after=(*dict.fromkeys((MASTER_NAME, *container.after)),)) for container in job.containers
    )
    return replace(job, containers=tuple(_as_node(container) for container in (master, *nodes)))


def on_one_address(job: Job) -> Job:
    """Adjust ROS variables for containers that share one address, as in a task on AWS Batch or a pod.

    Names of containers in these variables are replaced by the loopback address.
    """
    names = {container.name for container in job.containers}

    def moved(container: Container) -> Container:
        environment = dict(container.environment)
        if environment.get("ROS_HOSTNAME") in names:
            environment["ROS_HOSTNAME"] = _LOOPBACK_ADDRESS
        master = re.fullmatch(_MASTER_URI, environment.get("ROS_MASTER_URI", ""))
        if master is not None and master["host"] in names:
            environment["ROS_MASTER_URI"] = f"{master['before']}{_LOOPBACK_ADDRESS}{master['after']}"
        return replace(container, environment=environment)

    return replace(job, containers=tuple(map(moved, job.containers)))


def _as_node(container: Container) -> Container:
    environment = {
        "ROS_MASTER_URI": f"http://{MASTER_NAME}:{MASTER_PORT}",
        "ROS_HOSTNAME": container.name,
    }
    return _with_environment(container, environment)


def _with_environment(container: Container, environment: dict[str, str]) -> Container:
    return replace(container, environment={**environment, **container.environment})
