"""Containers and variables that ROS needs beside a job's: a master for ROS 1 alone, and a recorder of messages.

The recorder is ready before the others start, and closed when they have ended.
"""

import re
from dataclasses import replace
from typing import Annotated, Literal

from calibration.base import InputError
from calibration.base.records import Converted, between, field, matching, record
from calibration.ci.execution.job import Artifact, Bytes, Container, Job, Readiness, describe_bytes
from calibration.ci.execution.outcome import End, JobOutcome

RosVersion = Literal["none", "1", "2"]
Ros = Annotated[RosVersion, Converted(Literal["none", "1", "2", 1, 2], lambda version, _: str(version))]
"""Type of a record's field: the version, also as a number."""
ROS_HELP = "1: a ROS master is started, with variables for all containers. 2: a separate domain."
MASTER_NAME = "master"
"""Name of the container with the ROS master."""
MASTER_PORT = 11311
_LOOPBACK_ADDRESS = "127.0.0.1"
_MASTER_URI = r"(?P<before>https?://)(?P<host>[^/:]+)(?P<after>.*)"


def with_ros(job: Job, version: RosVersion) -> Job:
    """Add containers and variables for a version of ROS; variables of the user are kept.

    1: a container with a master, for which the others wait, in the image of the first container, and the variables
    by which nodes find it and each other. 2: no master; a domain, and a
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
        image=job.containers[0].image,
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


RECORDER_NAME = "recorder"
MESSAGES_FOLDER = "messages"
"""Folder of the bag among the artifacts of a job."""
_PLACE = f"/tmp/{MESSAGES_FOLDER}"  # noqa: S108 (in the recorder's own container)
_BAG_NAME = "robot"
DEFAULT_BAG_BYTES = 1 << 30
_TOO_LARGE = 3
"""Exit code of a recorder that has stopped because its bag is too large."""
RECORDER_SCRIPT = f"""\
folder=$1 limit=$2; shift 2
mkdir -p "$folder"
set -m  # a group of its own, to which SIGINT goes, and which bash does not start with SIGINT ignored
"$@" &
recorder=$!
set +m
trap 'kill -INT -- -$recorder' TERM INT
code=0
while kill -0 -- -$recorder 2> /dev/null; do  # the group: rosbag ends before its child, which closes the bag
  if [ "$code" = 0 ] && [ "$(du -sk "$folder" | cut -f1)" -gt "$limit" ]; then
    echo "the bag is larger than $limit KiB" >&2
    code={_TOO_LARGE}
    kill -INT -- -$recorder
  fi
  sleep 0.2 &
  wait $!
done
[ "$code" = 0 ] || exit "$code"
wait $recorder
"""
"""Passes the end of the job on as SIGINT, at which ROS closes a bag, and waits; bounds the bag.

Its arguments are the folder of the bag, its largest size in KiB, and the command that records.
"""


@record
class Recording:
    """Recording of the messages of a job's containers, by ROS's own recorder in their image."""

    topics: tuple[Annotated[str, matching("/[A-Za-z0-9_/]+", "the name of a topic, such as /scan")], ...] = field(
        "The topics: then none of their messages is missed. By default all, from when they are seen.", default=()
    )
    size: Bytes = field("The largest bag: a larger one makes the collection fail (1g).", default=DEFAULT_BAG_BYTES)
    image: str = field("Image with rosbag, or ros2 bag (that of the first container).", default="")
    rosbridge: Annotated[int, between(1, 65535)] | None = field(
        "Port of a rosbridge server in one of the containers: a message that alone contradicts a requirement over this "
        "bag ends them early (Docker only).",
        default=None,
    )


def with_recorder(job: Job, recording: Recording | None, version: RosVersion) -> Job:
    """Add a recorder, for which the other containers wait; its bag is an artifact, `MESSAGES_FOLDER`.

    Raises:
        InputError: the job is none of ROS, or a container has the recorder's name.
    """
    if recording is None:
        return job
    if version == "none":
        raise InputError(f"job '{job.name}': record needs ros: 1 or 2, found none")
    if RECORDER_NAME in {container.name for container in job.containers}:
        raise InputError(f"job '{job.name}': with record no other container may have the name '{RECORDER_NAME}'")
    place = f"{_PLACE}/{_BAG_NAME}" + (".bag" if version == "1" else "")
    tool = ("rosbag", "record", "-O", place) if version == "1" else ("ros2", "bag", "record", "-o", place)
    begun = f"{place}*" if version == "1" else f"{place}/*"
    recorder = Container(
        name=RECORDER_NAME,
        image=recording.image or job.containers[0].image,
        command=(
            *("bash", "-c", RECORDER_SCRIPT, RECORDER_NAME, _PLACE, str(recording.size >> 10), *tool),
            *(recording.topics or ("-a",)),
        ),
        readiness=Readiness(command=("bash", "-c", f"compgen -G '{begun}' > /dev/null")),
        essential=False,
        artifacts=(Artifact(_PLACE),),
    )
    others = tuple(replace(each, after=(*dict.fromkeys((RECORDER_NAME, *each.after)),)) for each in job.containers)
    size = job.artifact_bytes + 2 * recording.size  # what is written until the recorder has stopped comes on top
    return replace(job, containers=(*others, recorder), artifact_bytes=size)


def recorder_reasons(outcome: JobOutcome, recording: Recording | None) -> tuple[str, ...]:
    """Return why a recording is not whole: its recorder ended before the job was over."""
    ends = [each for each in outcome.containers if each.name == RECORDER_NAME and recording is not None]
    found = []
    for each in ends:
        if each.end == End.EXITED and each.exit_code == _TOO_LARGE and recording is not None:
            size = describe_bytes(recording.size)
            found.append(f"{RECORDER_NAME}: the bag has reached {size}: record fewer topics, or a larger size")
        elif each.end not in (End.STOPPED, End.TIMED_OUT):
            code = "" if each.exit_code is None else f" with code {each.exit_code}"
            found.append(f"{RECORDER_NAME}: it ended before the applications: {each.end}{code}")
    return tuple(found)
