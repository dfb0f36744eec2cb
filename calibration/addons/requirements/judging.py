"""Requirements judged over a bag: read once, in the order of recording, and of it only what they name.

Those on frames, nodes and services are here too.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.addons.requirements.hpl import parse_property
from calibration.addons.requirements.message_fields import FieldReader, FieldTree, MessageError, merged_trees
from calibration.addons.requirements.patterns import HplRequirement
from calibration.addons.requirements.requirement import (
    NS_PER_S,
    Judgement,
    Message,
    Requirement,
    duration,
    nanoseconds,
    topic_requirements,
)
from calibration.addons.requirements.settings import MAX_REQUIREMENTS, FrameRequirements, RequirementSettings
from calibration.base import InputError
from calibration.robot.importing.bags.bag import Bag, open_bag


def judge_bag(
    settings: RequirementSettings, paths: Sequence[Path], where: str
) -> tuple[list[tuple[Requirement, Judgement]], float]:
    """Judge all requirements over a bag.

    Args:
        settings: the requirements.
        paths: the bag's files.
        where: where the requirements are written, for messages.

    Returns:
        The requirements with their judgements, and the seconds that the bag spans.

    Raises:
        InputError: the bag cannot be read, has no messages, or its types have no such fields; HPL cannot be parsed; or
            there are too many requirements.
        InfrastructureError: a library is not installed.
    """
    properties = [parse_property(text, f"{where}.hpl[{i}]") for i, text in enumerate(settings.hpl)]
    with open_bag(paths) as bag:
        span = bag.span
        if span is None:
            raise InputError(f"{bag.path}: found no messages in this bag, expected some to judge")
        found = [
            *_short_requirements(settings, bag),
            *(
                HplRequirement(each, (("hpl",), text), bag.topics)
                for each, text in zip(properties, settings.hpl, strict=True)
            ),
        ]
        if len(found) > MAX_REQUIREMENTS:
            raise InputError(f"{where}: found {len(found)} requirements, expected at most {MAX_REQUIREMENTS}")
        _feed_messages(found, bag, span[0], where)
        judgements = [(each, each.close(span[1])) for each in found]
    return judgements, (span[1] - span[0]) / NS_PER_S


def _short_requirements(settings: RequirementSettings, bag: Bag) -> Iterator[Requirement]:
    for topic, of_topic in settings.topics.items():
        yield from topic_requirements(topic, of_topic, bag.topics)
    for frame, of_frame in settings.frames.items():
        yield FrameRequirement(frame, of_frame)
    for node in settings.nodes:
        yield NodeSeen(node, bag.callers, bag.topics)
    for service in settings.services:
        yield ServiceSeen(service, bag.ros)


def _feed_messages(requirements: Sequence[Requirement], bag: Bag, begin: int, where: str) -> None:
    """Feed each requirement with the messages of its topics."""
    of_topic: dict[str, list[Requirement]] = {}
    for each in requirements:
        each.start(begin)
        for topic in each.wanted:
            of_topic.setdefault(topic, []).append(each)
    readers = {topic: _reader(topic, of_topic[topic], bag, where) for topic in of_topic if topic in bag.topics}
    for raw in bag.messages(readers):
        try:
            fields = readers[raw.topic].fields(raw.data)
        except MessageError as error:
            raise InputError(f"{bag.path}: {raw.topic}: a message of {bag.topics[raw.topic]}: {error}") from None
        message = Message(raw.topic, raw.recorded, fields, len(raw.data))
        for each in of_topic[raw.topic]:
            each.feed(message)


def _reader(topic: str, requirements: Sequence[Requirement], bag: Bag, where: str) -> FieldReader:
    trees: list[FieldTree] = [each.wanted[topic] for each in requirements if each.wanted[topic]]
    if not trees:
        return FieldReader(bag.topics[topic], {}, {}, bag.ros)
    definitions = bag.definitions(topic)
    for each in requirements:  # a wrong field is named with the requirement that names it
        try:
            FieldReader(bag.topics[topic], definitions, each.wanted[topic], bag.ros)
        except InputError as error:
            raise InputError(f"{where}: {each.name}: {topic}: {error}") from None
    return FieldReader(bag.topics[topic], definitions, merged_trees(trees), bag.ros)


TF_TOPIC, STATIC_TOPIC = "/tf", "/tf_static"
_TRANSFORMS: FieldTree = {
    "transforms": {"header": {"stamp": {}, "frame_id": {}}, "child_frame_id": {}},
}
MAX_FRAMES = 10_000
"""Limit of the frames of a bag that are followed."""


@dataclass(frozen=True, slots=True)
class _Link:
    """Newest transform of a frame."""

    parent: str
    stamp: int
    """Its stamp, ns; of a static one it does not count."""
    is_static: bool


class FrameRequirement(Requirement):
    """A frame is known within a time, and fresh from then on: its age is the time since the stamp of a transform.

    The frames from it up to the other one, or to the root, are followed; the age of each transform is looked at where
    the next one comes, and at the end.
    """

    def __init__(self, frame: str, of: FrameRequirements) -> None:
        target = f" to {of.to}" if of.to else ""
        limits = (("within", of.within), ("fresh to", of.max_age))
        text = " and ".join(f"{word} {duration(limit * NS_PER_S)}" for word, limit in limits if limit is not None)
        super().__init__(
            f"frame {frame}{target}",
            f"known {text}" if of.within is not None else text,
            {TF_TOPIC: _TRANSFORMS, STATIC_TOPIC: _TRANSFORMS},
            (("frames", frame), None),
        )
        self.frame = frame.strip("/")
        self.to = of.to.strip("/") if of.to else None
        self.within = None if of.within is None else round(of.within * NS_PER_S)
        self.max_age = None if of.max_age is None else round(of.max_age * NS_PER_S)
        self.links: dict[str, _Link] = {}
        self.known_since: int | None = None
        self.chain: frozenset[str] = frozenset()
        self.stale: tuple[str, int, int] | None = None
        """Frame whose transform was oldest, its age and when that was, ns."""

    def feed(self, message: Message) -> None:
        """Take the next message."""
        is_static = message.topic == STATIC_TOPIC
        changed = False
        for each in message.fields["transforms"]:
            child, parent = each["child_frame_id"].strip("/"), each["header"]["frame_id"].strip("/")
            old = self.links.get(child)
            if old is None and len(self.links) == MAX_FRAMES:
                continue
            if child in self.chain:
                self._look_at_age(child, message.time)
            self.links[child] = _Link(parent, nanoseconds(each["header"]["stamp"]), is_static)
            changed = changed or old is None or old.parent != parent
        if changed:
            chain = self._chain()
            self.chain = frozenset(chain or ())
            if chain is not None and self.known_since is None:
                self.known_since = message.time

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.known_since is None:
            return self.not_met(f"it unknown until the bag ended after {self.seconds(end)}: {self._known_frames()}")
        if self.within is not None and self.known_since - self.begin > self.within:
            return self.not_met(f"it known after {self.seconds(self.known_since)}")
        for child in self.chain:
            self._look_at_age(child, end)
        if self.stale is not None:
            child, age, time = self.stale
            return self.not_met(f"the transform of {child} {duration(age)} old at {self.seconds(time)}")
        return self.met()

    def _chain(self) -> list[str] | None:
        """Return the frames from it upwards that have transforms; None if it is not connected, or in a circle."""
        found: list[str] = []
        frame = self.frame
        while frame != self.to and frame in self.links and len(found) <= len(self.links):
            found.append(frame)
            frame = self.links[frame].parent
        if len(found) > len(self.links) or (self.to is not None and frame != self.to):
            return None
        is_root = self.to is None and any(link.parent == self.frame for link in self.links.values())
        return found if found or is_root else None

    def _look_at_age(self, child: str, time: int) -> None:
        link = self.links[child]
        age = time - link.stamp
        if self.max_age is None or link.is_static or age <= self.max_age:
            return
        if self.stale is None or age > self.stale[1]:
            self.stale = child, age, time

    def _known_frames(self) -> str:
        names = sorted({*self.links, *(link.parent for link in self.links.values())})
        return f"known are {', '.join(names[:10])}{', ...' if len(names) > 10 else ''}" if names else "tf is empty"


_NAME_OF_TOPIC: dict[str, str] = {"/rosout": "name", "/parameter_events": "node"}
"""Topics whose messages name a node, with the field that does."""
_EVENT_TOPIC = "/_service_event"


class NodeSeen(Requirement):
    """A node is seen: as a publisher of a ROS 1 bag, in /rosout, or in /parameter_events."""

    def __init__(self, node: str, callers: Collection[str], topics: Collection[str]) -> None:
        wanted: dict[str, FieldTree] = {topic: {name: {}} for topic, name in _NAME_OF_TOPIC.items() if topic in topics}
        super().__init__(f"node {node}", "to see it", wanted, (("nodes",), node))
        self.node = _plain(node)
        self.is_seen = self.node in {_plain(name) for name in callers}
        self.looked_at = bool(callers or wanted)

    def feed(self, message: Message) -> None:
        """Look at the node that a message names; in /rosout of ROS 2 dots are between namespaces."""
        if not self.is_seen:
            name = _plain(str(message.fields[_NAME_OF_TOPIC[message.topic]]))
            self.is_seen = self.node in (name, name.replace(".", "/"))

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.is_seen:
            return self.met()
        return self.not_met("it nowhere" if self.looked_at else "nothing that names nodes: record /rosout too")


class ServiceSeen(Requirement):
    """A service of ROS 2 is called: its introspection publishes an event."""

    def __init__(self, service: str, ros: int) -> None:
        if ros == 1:
            raise InputError(f"requirements.services: found {service}, but a bag of ROS 1 has no calls of services")
        super().__init__(
            f"service {service}", "a call of it", {f"/{_plain(service)}{_EVENT_TOPIC}": {}}, (("services",), service)
        )
        self.is_seen = False

    def feed(self, message: Message) -> None:
        """Take an event of the service."""
        self.is_seen = True

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        return self.met() if self.is_seen else self.not_met("none: is its introspection configured?")


def _plain(name: str) -> str:
    return name.strip("/")
