"""Live watch by rosbridge: a message that alone contradicts a requirement ends the containers early.

It makes nothing green, and the verdict stays that over the bag. rosbridge may drop, delay and reorder messages, a topic
may be subscribed too late, and a simulated clock is not ours. So nothing is concluded from a missing message, from an
order or from a time: only from values of a field, and from HPL's ``globally: no /b``.

The client is a few lines over websockets. The library roslibpy has no limit of a message's size, and a Twisted reactor
for the whole process, which cannot be started twice.
"""

import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from calibration.addons.requirements.hpl import parse_property
from calibration.addons.requirements.message_fields import FieldTree
from calibration.addons.requirements.patterns import HplRequirement
from calibration.addons.requirements.requirement import FieldValue, Message, Requirement
from calibration.addons.requirements.settings import RequirementSettings
from calibration.base import InputError, one_line, parse_json, shorten
from calibration.base.optional import optional
from calibration.ci.execution.supervision import BeginWatch

MAX_MESSAGE_BYTES = 1 << 24
"""Limit of a message as JSON; a larger one ends the watch, with a note."""
MAX_QUEUED_MESSAGES = 16
"""Limit of received messages that wait; beyond it the connection is not read, and rosbridge's own queue fills."""
MAX_QUEUED_IN_ROSBRIDGE = 100
"""Messages of a topic that rosbridge keeps for us; it drops older ones."""
MAX_INTEGER = 1 << 64
"""Limit of an integer's size; ROS has none that is larger."""
CONNECT_SECONDS = 2.0
RETRY_SECONDS = 1.0
"""Seconds between attempts to connect, and to subscribe to a topic of which nothing came: rosbridge refuses one that
is not published yet."""
_POLL_SECONDS = 0.2
_SECONDS_TO_CLOSE = 10.0
_ROS1_NAMES = {"sec": "secs", "nanosec": "nsecs"}
"""How rosbridge names the fields of a time in ROS 1, by the names that bags are read with."""


def live_watch(settings: RequirementSettings, name: str, port: int) -> BeginWatch | None:
    """Return the watch for the containers of an entry of ``simulation``; None if its bag is not what is judged.

    Raises:
        InputError: a property cannot be parsed.
        InfrastructureError: a library is not installed.
    """
    if settings.recorded_by != name:
        return None
    optional("websockets", "record.rosbridge")
    requirements_of_one_message(settings)  # errors are found before anything runs
    return lambda addresses, note: RosbridgeWatch(requirements_of_one_message(settings), port, addresses, note)


def requirements_of_one_message(settings: RequirementSettings) -> list[Requirement]:
    """Return the requirements that one message alone can contradict, new ones at each call.

    Raises:
        InputError: a property cannot be parsed.
        InfrastructureError: the parser is not installed.
    """
    properties = [(text, parse_property(text, f"requirements.hpl[{i}]")) for i, text in enumerate(settings.hpl)]
    return [
        *(FieldValue(topic, path, of) for topic, each in settings.topics.items() for path, of in each.fields.items()),
        *(HplRequirement(found, (("hpl",), text)) for text, found in properties if found.is_of_one_message),
    ]


class NoFieldsError(Exception):
    """A message as JSON lacks a field, or the value of one, as of NaN and infinity."""


class RosbridgeWatch:
    """Follows requirements by a rosbridge server in one of a job's containers, in a thread of its own.

    Args:
        requirements: those that one message alone can contradict.
        port: the server's.
        addresses: returns the addresses of the containers that run.
        note: writes a line to the log.
    """

    def __init__(
        self,
        requirements: Sequence[Requirement],
        port: int,
        addresses: Callable[[], Sequence[str]],
        note: Callable[[str], None],
    ) -> None:
        self.reason = ""
        """The first contradiction; empty as long as there is none."""
        self._of_topic: dict[str, list[Requirement]] = {}
        for each in requirements:
            for topic in each.wanted:
                self._of_topic.setdefault(topic, []).append(each)
        self._requirements, self._port, self._addresses, self._note = requirements, port, addresses, note
        self._silent = set(self._of_topic)
        """Topics of which no message has come."""
        self._refusal = ""
        """The last error that rosbridge has sent."""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="rosbridge", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the watch."""
        self._closing.set()
        self._thread.join(_SECONDS_TO_CLOSE)

    def _follow(self) -> None:
        """Run until a contradiction, the end of the connection, or the end of the watch."""
        if not self._of_topic:
            self._note("nothing is watched: no requirement is one that a message alone contradicts")
            return
        connection = self._connect_until_closing()
        if connection is None:
            self._note(f"nothing was watched: no rosbridge answered at port {self._port}")
            return
        self._note(f"rosbridge answers, watched are {', '.join(self._of_topic)}")
        for each in self._requirements:
            each.start(time.time_ns())
        try:
            with connection:
                self._receive(connection)
        except optional("websockets", "rosbridge").ConnectionClosed as error:
            self._note(f"nothing more is watched: the connection to rosbridge was closed: {error}")
        if self._silent:
            self._note(f"no message came of {', '.join(sorted(self._silent))}{self._refusal}")

    def _connect_until_closing(self) -> Any:
        """Return the first connection that is accepted; None if the watch ended before."""
        from websockets.exceptions import WebSocketException  # the package is optional
        from websockets.sync.client import connect

        while not self._closing.wait(RETRY_SECONDS):
            for address in self._addresses():
                try:
                    return connect(
                        f"ws://{address}:{self._port}",
                        compression=None,
                        proxy=None,
                        open_timeout=CONNECT_SECONDS,
                        close_timeout=CONNECT_SECONDS,
                        max_size=MAX_MESSAGE_BYTES,
                        max_queue=MAX_QUEUED_MESSAGES,
                    )
                except (OSError, WebSocketException):  # not there yet, or none of rosbridge
                    continue
        return None

    def _receive(self, connection: Any) -> None:
        subscribe_at = 0.0
        while not self.reason and not self._closing.is_set():
            if time.monotonic() >= subscribe_at:
                subscribe_at = time.monotonic() + RETRY_SECONDS
                for topic in sorted(self._silent):
                    wanted = {"op": "subscribe", "id": topic, "topic": topic, "queue_length": MAX_QUEUED_IN_ROSBRIDGE}
                    connection.send(json.dumps(wanted))
            try:
                self._take(connection.recv(timeout=_POLL_SECONDS))
            except TimeoutError:
                continue

    def _take(self, data: str | bytes) -> None:
        """Feed a message of rosbridge to the requirements."""
        try:
            found = parse_json(data)
            content = found["msg"]
            if found["op"] == "status":
                self._refusal = f"; rosbridge says: {shorten(one_line(str(content)), 200)}"
                return
            topic = found["topic"]
            requirements = self._of_topic[topic] if found["op"] == "publish" else []
        except (ValueError, RecursionError, KeyError, TypeError):  # another operation, or no rosbridge at all
            return
        self._silent.discard(topic)
        for each in list(requirements):
            self._feed(each, topic, content, len(data))

    def _feed(self, requirement: Requirement, topic: str, content: Any, size: int) -> None:
        now = time.time_ns()
        try:
            fields = fields_of_json(content, requirement.wanted[topic], isinstance(requirement, FieldValue))
            requirement.feed(Message(topic, now, fields, size))
        except NoFieldsError:
            return  # the bag has the value
        except (InputError, RecursionError) as error:
            self._of_topic[topic].remove(requirement)
            self._note(f"{requirement.name}: not watched on {topic} any more: {shorten(one_line(str(error)), 200)}")
        if requirement.is_refuted:
            self.reason = f"ended early by rosbridge: {requirement.close(now)}"


def fields_of_json(content: Any, wanted: FieldTree, arrays_are_float32: bool) -> Any:
    """Return the wanted fields of a message as JSON, in the form of those that are read from a bag.

    Args:
        content: the message.
        wanted: the fields.
        arrays_are_float32: make numbers in a list an array of float32. Limits are rounded to an array's type where
            they are compared: so a value that is within them in the bag is so here, whatever its type is there.

    Raises:
        NoFieldsError: one is missing or null, or an integer is none of ROS.
    """
    if isinstance(content, list):
        items = [fields_of_json(each, wanted, arrays_are_float32) for each in content]
        if arrays_are_float32 and items and all(isinstance(each, int | float) for each in items):
            with np.errstate(over="ignore"):
                return np.array(items, np.float32)
        return items
    if isinstance(content, Mapping):
        names = {name: name if name in content else _ROS1_NAMES.get(name, name) for name in wanted or content}
        return {
            name: fields_of_json(content.get(of), wanted.get(name, {}), arrays_are_float32)
            for name, of in names.items()
        }
    if content is None or wanted or (isinstance(content, int) and abs(content) > MAX_INTEGER):
        raise NoFieldsError
    return content
