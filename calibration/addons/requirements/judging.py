"""Requirements judged over a bag: read once, in the order of recording, and of it only what they name."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from calibration.addons.requirements.frames import FrameRequirement
from calibration.addons.requirements.hpl import parse_property
from calibration.addons.requirements.message_fields import FieldReader, FieldTree, MessageError, merged_trees
from calibration.addons.requirements.patterns import HplRequirement
from calibration.addons.requirements.presence import NodeSeen, ServiceSeen
from calibration.addons.requirements.requirement import NS_PER_S, Judgement, Message, Requirement
from calibration.addons.requirements.settings import MAX_REQUIREMENTS, RequirementSettings
from calibration.addons.requirements.topics import topic_requirements
from calibration.base.errors import InputError
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
