#!/usr/bin/env python3
"""Play a motion of a calibration pattern in a ROS 1 system, and request that each pose is saved.

For each pose: publish it on a topic, wait until everything has settled, call the service that saves a collection.
Exits with 0 if all poses are played and at least one was saved, and with 1 on any failure.

This file runs alone in the team's image, with its rospy and messages, from Python 3.6 on.
"""

# Python 3.6 does not know the newer forms of types:
# ruff: noqa: UP006, UP035, UP045

import argparse
import importlib
import json
import math
import signal
import socket
import sys
import threading
import time
from io import BytesIO
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Tuple

Pose = Tuple[float, ...]
"""Position x, y, z and quaternion x, y, z, w."""
LONGEST = 300
"""Limit of a logged message's length."""


class PlayError(Exception):
    """The motion cannot be played; one line."""


class Answer:
    """Response of the service to one request."""

    def __init__(self, saved: bool, message: str) -> None:
        self.saved = saved
        self.message = message


class Report:
    """Report on each pose, written atomically after every pose."""

    def __init__(self, path: Optional[str], count: int) -> None:
        """Create the report of a motion with this many poses; without a path no file is written."""
        self.path = Path(path) if path else None
        self.count = count
        self.poses: List[Dict[str, Any]] = []
        self.write()

    def add(self, answer: Answer, seconds: float) -> None:
        """Add the next pose."""
        number = len(self.poses) + 1
        self.poses.append({"pose": number, "saved": answer.saved, "answer": answer.message})
        self.write()
        verdict = "saved" if answer.saved else "not saved"
        detail = f": {answer.message}" if answer.message else ""
        log(f"pose {number}/{self.count}: {verdict}{detail} ({seconds:.1f} s)")

    def write(self) -> None:
        """Write the file atomically."""
        if self.path is not None:
            new = self.path.with_name(self.path.name + ".new")
            new.write_text(json.dumps(self.poses, indent=2))
            new.replace(self.path)

    @property
    def saved(self) -> int:
        """Number of saved poses."""
        return sum(pose["saved"] for pose in self.poses)


def read_poses(path: str) -> List[Pose]:
    """Read the poses of a motion sequence, in order.

    Raises:
        PlayError: the file cannot be read, or is not a motion.
    """
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        poses = [_pose(document[str(number + 1)]) for number in range(len(document))]
    except KeyError as error:
        raise PlayError(f"{path}: is no motion sequence: missing {error}") from error
    except (OSError, ValueError, TypeError) as error:
        raise PlayError(f"{path}: is no motion sequence: {error}") from error
    if not poses:
        raise PlayError(f"{path}: has no pose")
    return poses


def _pose(entry: Any) -> Pose:
    numbers = [entry["position"][axis] for axis in "xyz"] + [entry["orientation"][axis] for axis in "xyzw"]
    pose = tuple(float(number) for number in numbers)
    if not all(math.isfinite(number) for number in pose):
        raise ValueError("found a number that is not finite")
    return pose


def play(poses: List[Pose], ros: "Ros", settle: float, report: Report) -> None:
    """Play all poses; each settles for `settle` seconds before it is saved."""
    for pose in poses:
        began = time.time()
        ros.move(pose)
        ros.wait(settle)
        report.add(ros.save(), time.time() - began)


def as_answer(response: Any) -> Answer:
    """Convert a service's response by its ``success`` and ``message``; without these fields it counts as saved."""
    return Answer(bool(getattr(response, "success", True)), one_line(str(getattr(response, "message", ""))))


def one_line(text: str) -> str:
    """Return foreign text without line ends and control characters, shortened."""
    printable = "".join(c if c.isprintable() else " " for c in text)
    return printable if len(printable) <= LONGEST else printable[: LONGEST - 3] + "..."


def within(seconds: float, call: Callable[[], Any], what: str, go_on: Callable[[], None] = lambda: None) -> Any:
    """Call a function that may hang, with a time limit.

    Raises:
        PlayError: it does not return in time; or whatever ``go_on`` raises, which is called repeatedly.
    """
    outcome: List[Tuple[Optional[BaseException], Any]] = []

    def run() -> None:
        try:
            outcome.append((None, call()))
        except BaseException as error:  # re-raised in the caller
            outcome.append((error, None))

    thread = threading.Thread(target=run)
    thread.daemon = True
    thread.start()
    end = time.time() + seconds
    while thread.is_alive() and time.time() < end:
        thread.join(min(0.05, seconds))
        go_on()
    if not outcome:
        raise PlayError(f"{what} did not answer within {seconds:g} s")
    error, result = outcome[0]
    if error is not None:
        raise error
    return result


class Ros:  # pragma: no cover (runs where ROS is: tests/integration/simulation)
    """ROS 1 system: the pattern's topic and the service that saves."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        """Connect, and wait for topic and service.

        Raises:
            PlayError: one of them is missing, or the service has an unexpected type.
        """
        self.rospy: Any = importlib.import_module("rospy")
        self.rosgraph: Any = importlib.import_module("rosgraph")
        messages: Any = importlib.import_module("geometry_msgs.msg")
        self.deadline = time.time() + arguments.timeout
        self.timeout = arguments.timeout
        self.stopped_by = 0
        uri = self.rosgraph.get_master_uri()
        self._until(self.rosgraph.is_master_online, f"no ROS master answers at {uri}")
        # rospy's own handler may deadlock on a lock that the interrupted code holds
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        self.rospy.init_node("calibration_player", anonymous=True, disable_signals=True)
        self.service = self.rospy.resolve_name(arguments.service)
        self.topic = self.rospy.resolve_name(arguments.pose_topic)
        self.pose = messages.PoseStamped()
        self.pose.header.frame_id = arguments.frame
        self.publisher = self.rospy.Publisher(self.topic, messages.PoseStamped, queue_size=1, latch=True)
        self._until(self.publisher.get_num_connections, f"nobody listens to {self.topic}")
        service_type = self._until(self._service_type, f"no service {self.service}")
        self.call = self.rospy.ServiceProxy(self.service, self._service_class(service_type))

    def _until(self, holds: Callable[[], Any], otherwise: str) -> Any:
        """Wait until a function returns a true value, and return it."""
        while True:
            value = holds()
            if value:
                return value
            if time.time() > self.deadline:
                raise PlayError(f"{otherwise} within {self.timeout:g} s")
            self.wait(0.05)

    def _service_type(self) -> str:
        """Return the type of the service, from its server; empty if there is no response."""
        network: Any = importlib.import_module("rosgraph.network")
        try:
            uri = self.rosgraph.Master(self.rospy.get_name()).lookupService(self.service)
            with socket.create_connection(self.rospy.core.parse_rosrpc_uri(uri), timeout=5) as connection:
                header = {"probe": "1", "md5sum": "*", "callerid": self.rospy.get_name(), "service": self.service}
                network.write_ros_handshake_header(connection, header)
                return str(network.read_ros_handshake_header(connection, BytesIO(), 2048).get("type", ""))
        except (self.rosgraph.MasterException, network.ROSHandshakeException, OSError):
            return ""

    def _service_class(self, name: str) -> Any:
        """Return the class of a service type, whose request must be empty."""
        found = importlib.import_module("roslib.message").get_service_class(name)
        if found is None:
            raise PlayError(f"{self.service} is a {name}, which is not installed in this image")
        fields = ", ".join(found._request_class.__slots__)
        if fields:
            raise PlayError(f"{self.service} is a {name} and wants {fields}; expected one with an empty request")
        return found

    def move(self, pose: Pose) -> None:
        """Publish a pose."""
        self.pose.header.stamp = self.rospy.Time.now()
        p, q = self.pose.pose.position, self.pose.pose.orientation
        p.x, p.y, p.z, q.x, q.y, q.z, q.w = pose
        try:
            self.publisher.publish(self.pose)
        except self.rospy.ROSException as error:
            self.go_on()
            raise PlayError(f"{self.topic}: the pose cannot be published: {error}") from error
        if not self.publisher.get_num_connections():
            self.go_on()  # a shutdown closes the connections too
            raise PlayError(f"nobody listens to {self.topic} any more: the simulation has ended")

    def _stop(self, number: int, _: Any) -> None:
        self.stopped_by = number

    def go_on(self) -> None:
        """Raise if a signal has been received, or ROS shuts down."""
        if self.stopped_by:
            name = signal.Signals(self.stopped_by).name
            raise PlayError(f"stopped by {name} before the motion was played")
        if self.rospy.is_shutdown():
            raise PlayError("ROS shut down before the motion was played")

    def wait(self, seconds: float) -> None:
        """Sleep, unless ROS shuts down."""
        end = time.time() + seconds
        while time.time() < end:
            self.go_on()
            time.sleep(min(0.05, max(0.0, end - time.time())))

    def save(self) -> Answer:
        """Call the service."""
        try:
            return as_answer(within(self.timeout, self.call, self.service, self.go_on))
        except self.rospy.ServiceException as error:
            self.go_on()
            raise PlayError(f"{self.service} failed: {error}") from error


def arguments_of(argv: Optional[List[str]]) -> argparse.Namespace:
    """Parse the command line; that of the process for None."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motion", required=True, help="motion sequence (JSON)")
    parser.add_argument("--report", help="report on each pose (JSON)")
    parser.add_argument("--pose-topic", default="/pattern/pose", help="geometry_msgs/PoseStamped (%(default)s)")
    parser.add_argument("--frame", default="world", help="frame of the poses (%(default)s)")
    parser.add_argument("--service", default="/collect_data/save_collection", help="saves what is seen (%(default)s)")
    parser.add_argument("--settle", type=_seconds, default=0.5, help="seconds from a pose to its saving (%(default)s)")
    parser.add_argument(
        "--timeout", type=_seconds, default=60.0, help="seconds to wait for the system, and for an answer (%(default)s)"
    )
    return parser.parse_args(argv)


def _seconds(text: str) -> float:
    seconds = float(text)
    if not 0 <= seconds <= 86400:
        raise ValueError
    return seconds


def log(text: str) -> None:
    """Print a line and flush."""
    print(text, flush=True)


def main(argv: Optional[List[str]] = None, connect: Callable[[argparse.Namespace], Any] = Ros) -> int:
    """Play a motion; return 0 if at least one pose was saved."""
    arguments = arguments_of(argv)
    began = time.time()
    try:
        poses = read_poses(arguments.motion)
        report = Report(arguments.report, len(poses))
        play(poses, connect(arguments), arguments.settle, report)
        if not report.saved:
            raise PlayError(f"none of the {len(poses)} poses was saved")
    except Exception as error:  # of any kind: the job needs a one-line failure
        what = str(error) if isinstance(error, PlayError) else f"{type(error).__name__}: {error}"
        print(f"player: {one_line(what)}", file=sys.stderr, flush=True)
        return 1
    log(f"{report.saved} of {report.count} poses saved in {time.time() - began:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
