"""Recorder of ROS messages beside the containers of a job: ready before they start, and closed when they have ended."""

from dataclasses import replace
from typing import Annotated

from calibration.base.errors import InputError
from calibration.base.records import between, field, matching, record
from calibration.ci.execution.job import Artifact, Container, Job, Readiness
from calibration.ci.execution.outcome import End, JobOutcome
from calibration.ci.execution.ros import RosVersion
from calibration.ci.execution.sizes import Bytes, describe_bytes

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
