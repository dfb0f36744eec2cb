"""What containers need so that ROS works between them: a master only where one is asked for."""

import re
from dataclasses import replace
from typing import Annotated, Literal

from calibration.errors import InputError
from calibration.execution.job import Container, Job, Readiness
from calibration.records import Converted

RosVersion = Literal["none", "1", "2"]
Ros = Annotated[RosVersion, Converted(Literal["none", "1", "2", 1, 2], lambda version, _: str(version))]
"""A field of a record: the version, also as a number."""
ROS_HELP = "1: a ROS master is started, and everybody told where it is. 2: a domain of its own."
MASTER = "master"
"""The name of the container with the ROS master."""
PORT = 11311
_LOOPBACK = "127.0.0.1"
_ADDRESS = re.compile(r"(?P<before>https?://)(?P<host>[^/:]+)(?P<after>.*)")


def with_ros(job: Job, version: RosVersion, image: str | None = None) -> Job:
    """Add what a version of ROS needs; a variable that the user has set stays as it is.

    1: a container with a master, which everybody else waits for, in ``image`` (that of the first container
    unless given), and the variables by which nodes find it and each other. 2: no master; a domain, and a
    network of the job's own even for a container alone, because nodes find each other by multicast and
    must not find those of another job. ROS 2 logs where every user may write.

    Raises:
        InputError: a container has the master's name, or a ROS master is asked for without a network of the job.
    """
    if version == "none":
        return job
    if version == "2":
        environment = {
            "ROS_DOMAIN_ID": "0",
            "ROS_LOG_DIR": "/tmp/ros-log",  # noqa: S108 (in a container of its own)
            # containers share no memory, whatever Fast DDS concludes from the machine that they are on
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        }
        containers = tuple(_with_environment(container, environment) for container in job.containers)
        return replace(job, containers=containers, own_network=True)
    if job.network not in ("private", "internal"):
        raise InputError(f"job '{job.name}': ROS 1 needs the network private or internal, found {job.network}")
    if MASTER in {container.name for container in job.containers}:
        raise InputError(f"job '{job.name}': with ROS 1 no other container may have the name '{MASTER}'")
    master = Container(
        name=MASTER,
        image=image or job.containers[0].image,
        command=("roscore", "-p", str(PORT)),
        readiness=Readiness(port=PORT),
        essential=False,
    )
    nodes = (replace(container, after=(*dict.fromkeys((MASTER, *container.after)),)) for container in job.containers)
    return replace(job, containers=tuple(_as_node(container) for container in (master, *nodes)))


def on_one_address(job: Job) -> Job:
    """Let containers find each other that share one address, as those of a task on AWS Batch or of a pod do.

    Where a ROS variable names a container of the job, it names the address of all of them instead.
    """
    names = {container.name for container in job.containers}

    def moved(container: Container) -> Container:
        environment = dict(container.environment)
        if environment.get("ROS_HOSTNAME") in names:
            environment["ROS_HOSTNAME"] = _LOOPBACK
        master = _ADDRESS.fullmatch(environment.get("ROS_MASTER_URI", ""))
        if master is not None and master["host"] in names:
            environment["ROS_MASTER_URI"] = f"{master['before']}{_LOOPBACK}{master['after']}"
        return replace(container, environment=environment)

    return replace(job, containers=tuple(map(moved, job.containers)))


def _as_node(container: Container) -> Container:
    environment = {
        "ROS_MASTER_URI": f"http://{MASTER}:{PORT}",
        "ROS_HOSTNAME": container.name,
    }
    return _with_environment(container, environment)


def _with_environment(container: Container, environment: dict[str, str]) -> Container:
    return replace(container, environment={**environment, **container.environment})
