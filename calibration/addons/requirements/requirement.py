"""A requirement: a small state machine, fed with the messages of its topics, that says at the end what it found.

Those of one topic are here: its rate, gaps, latency, and the values of its fields.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from calibration.addons.requirements.message_fields import FieldTree, tree_of_path
from calibration.addons.requirements.settings import FieldLimits, TopicRequirements
from calibration.base import InputError, shorten
from calibration.base.records import field, result

NS_PER_S = 10**9
MAX_VALUES_SHOWN = 8
"""Limit of the values of a message in a counterexample."""
MAX_VALUE_CHARACTERS = 60
Status: TypeAlias = Literal["met", "not met", "vacuous"]
"""Vacuous: nothing came to which the requirement says something."""
_STAMP: FieldTree = {"header": {"stamp": {}}}
_NO_MESSAGE = "no message on it"


@dataclass(frozen=True, slots=True)
class Message:
    """Message of a bag with the fields that requirements name."""

    topic: str
    time: int
    """When it was recorded, ns."""
    fields: Mapping[str, Any]
    size: int
    """Its bytes."""


@result(kw_only=True)
class Witness:
    """Message of a counterexample."""

    topic: str = field("Its topic.")
    stamp: float = field("When it was recorded, since 1970.", unit="s")
    after: float = field("The same since the bag begins.", unit="s")
    values: Mapping[str, str] = field("Fields that the requirement names, as text.")

    def __str__(self) -> str:
        values = ", ".join(f"{name} = {value}" for name, value in self.values.items())
        return f"{self.topic} at {self.after:.3f} s ({self.stamp:.3f})" + (f": {values}" if values else "")


@result(kw_only=True)
class Judgement:
    """What a requirement found in a bag."""

    name: str = field("The requirement.")
    status: Status = field("met, not met, or vacuous: nothing came to which it says something.")
    expected: str = field("What was required.")
    found: str = field("What was found in its place; why it is vacuous.", default="")
    witnesses: tuple[Witness, ...] = field("Messages that show it.", default=())

    def __str__(self) -> str:
        text = f"{self.name}: found {self.found}"
        if self.expected != self.name:
            text += f", expected {self.expected}"
        return "; ".join((text, *map(str, self.witnesses)))


class Requirement(ABC):
    """State machine over the messages of some topics, in the order in which they were recorded.

    Args:
        name: of the requirement, in reports.
        expected: what is required, in a few words.
        wanted: topics of which it is fed all messages, with the fields that it needs; empty for none.
        place: its keys in calibration.yml below the section, and a text below these, if it is in a list.
    """

    def __init__(
        self, name: str, expected: str, wanted: Mapping[str, FieldTree], place: tuple[tuple[str, ...], str | None]
    ) -> None:
        self.name = name
        self.expected = expected
        self.wanted = wanted
        self.place = place
        self.begin = 0
        """When the bag begins, ns."""

    def start(self, begin: int) -> None:
        """Begin, before the first message."""
        self.begin = begin

    @property
    def is_refuted(self) -> bool:
        """Whether one message alone contradicts it, whatever came before or comes later, or was missed, and when."""
        return False

    @abstractmethod
    def feed(self, message: Message) -> None:
        """Take the next message of one of its topics."""

    @abstractmethod
    def close(self, end: int) -> Judgement:
        """Judge, at the end of the bag, ns."""

    def met(self) -> Judgement:
        """Return the judgement where it is met."""
        return Judgement(name=self.name, status="met", expected=self.expected)

    def vacuous(self, why: str) -> Judgement:
        """Return the judgement where nothing came to which it says something."""
        return Judgement(name=self.name, status="vacuous", expected=self.expected, found=why)

    def not_met(self, found: str, *messages: Message) -> Judgement:
        """Return the judgement where messages, or their absence, contradict it."""
        witnesses = tuple(self._witness(message) for message in messages)
        return Judgement(name=self.name, status="not met", expected=self.expected, found=found, witnesses=witnesses)

    def seconds(self, time: int) -> str:
        """Return a time since the bag begins, for messages."""
        return f"{(time - self.begin) / NS_PER_S:.3f} s"

    def _witness(self, message: Message) -> Witness:
        return Witness(
            topic=message.topic,
            stamp=message.time / NS_PER_S,
            after=(message.time - self.begin) / NS_PER_S,
            values=_values(message.fields, self.wanted.get(message.topic, {})),
        )


def _values(fields: Mapping[str, Any], wanted: FieldTree) -> dict[str, str]:
    """Return fields as text by their paths, as many as are shown."""
    found: dict[str, str] = {}
    waiting: list[tuple[str, Any, FieldTree]] = [("", fields, wanted)] if wanted else []
    while waiting and len(found) < MAX_VALUES_SHOWN:
        path, value, below = waiting.pop(0)
        if isinstance(value, Mapping):
            names: Mapping[str, Any] = below or value
            waiting[:0] = [(f"{path}.{name}" if path else name, value[name], below.get(name, {})) for name in names]
        else:
            found[path] = shown_value(value)
    return found


def shown_value(value: Any) -> str:
    """Return a field's value as text, cut where it is long."""
    if isinstance(value, list | np.ndarray):
        return f"{len(value)} items"
    text = f"{value:.9g}" if isinstance(value, float) else repr(value) if isinstance(value, str) else str(value)
    return shorten(text, MAX_VALUE_CHARACTERS)


def duration(time: float) -> str:
    """Return a duration in ns as text: 100 ms, 2 s."""
    return f"{time / 1e6:g} ms" if time < NS_PER_S else f"{time / NS_PER_S:g} s"


class _OfTopic(Requirement):
    """Requirement on one topic."""

    def __init__(self, topic: str, what: str, expected: str, wanted: FieldTree, keys: tuple[str, ...]) -> None:
        super().__init__(f"{topic}: {what}", expected, {topic: wanted}, (("topics", topic, *keys), None))
        self.topic = topic


class FirstMessage(_OfTopic):
    """Its first message comes within a time."""

    def __init__(self, topic: str, limit: float) -> None:
        super().__init__(topic, "first message", f"within {limit:g} s from the begin of the bag", {}, ("within",))
        self.limit = round(limit * NS_PER_S)
        self.first: Message | None = None

    def feed(self, message: Message) -> None:
        """Take the next message."""
        self.first = self.first or message

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.first is None:
            return self.not_met(f"{_NO_MESSAGE} until the bag ended after {self.seconds(end)}")
        if self.first.time - self.begin > self.limit:
            return self.not_met(f"the first after {self.seconds(self.first.time)}", self.first)
        return self.met()


class Rate(_OfTopic):
    """Its mean rate from the first to the last message is within limits."""

    def __init__(self, topic: str, least: float | None, most: float | None) -> None:
        text = " and ".join(
            f"at {word} {limit:g} Hz" for word, limit in (("least", least), ("most", most)) if limit is not None
        )
        super().__init__(topic, "rate", text, {}, ("min-rate" if least is not None else "max-rate",))
        self.least, self.most = least or 0.0, math.inf if most is None else most
        self.count = 0
        self.first: Message | None = None
        self.last: Message | None = None

    def feed(self, message: Message) -> None:
        """Take the next message."""
        self.count += 1
        self.first, self.last = self.first or message, message

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.first is None or self.last is None:
            return self.not_met(_NO_MESSAGE)
        if self.count == 1:
            return self.not_met("one message only", self.first)
        span = self.last.time - self.first.time
        rate = (self.count - 1) * NS_PER_S / span if span else math.inf
        if self.least <= rate <= self.most:
            return self.met()
        return self.not_met(f"{rate:.4g} Hz over {self.count} messages", self.first, self.last)


class Gap(_OfTopic):
    """There is no long gap between its messages, nor from the last one to the end of the bag."""

    def __init__(self, topic: str, limit: float) -> None:
        super().__init__(topic, "gap", f"at most {duration(limit * NS_PER_S)}", {}, ("max-gap",))
        self.limit = round(limit * NS_PER_S)
        self.last: Message | None = None
        self.longest: tuple[int, Message, Message | None] | None = None

    def feed(self, message: Message) -> None:
        """Take the next message."""
        if self.last is not None:
            self._look_at(message.time - self.last.time, self.last, message)
        self.last = message

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.last is None:
            return self.not_met(_NO_MESSAGE)
        self._look_at(end - self.last.time, self.last, None)
        if self.longest is None:
            return self.met()
        gap, before, after = self.longest
        if after is None:
            return self.not_met(f"{duration(gap)} from the last one to the end of the bag", before)
        return self.not_met(duration(gap), before, after)

    def _look_at(self, gap: int, before: Message, after: Message | None) -> None:
        if gap > self.limit and (self.longest is None or gap > self.longest[0]):
            self.longest = gap, before, after


class Latency(_OfTopic):
    """The time from the stamp in its messages to their recording is short."""

    def __init__(self, topic: str, limit: float) -> None:
        super().__init__(topic, "latency", f"at most {duration(limit * NS_PER_S)}", _STAMP, ("max-latency",))
        self.limit = round(limit * NS_PER_S)
        self.worst: tuple[float, Message] | None = None
        self.count = 0

    def feed(self, message: Message) -> None:
        """Take the next message."""
        self.count += 1
        stamp = nanoseconds(message.fields["header"]["stamp"])
        latency = message.time - stamp if stamp else math.inf
        if latency > self.limit and (self.worst is None or latency > self.worst[0]):
            self.worst = latency, message

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.worst is not None:
            latency, message = self.worst
            return self.not_met("a stamp of 0" if math.isinf(latency) else duration(latency), message)
        return self.met() if self.count else self.not_met(_NO_MESSAGE)


class FieldValue(_OfTopic):
    """Every value of a field is within limits, or equal to a value."""

    def __init__(self, topic: str, path: str, limits: FieldLimits) -> None:
        parts = [
            f"{word} {shown_value(limit)}"
            for word, limit in (("at least", limits.min), ("at most", limits.max), ("equal to", limits.equals))
            if limit is not None
        ]
        super().__init__(topic, path, " and ".join(parts), tree_of_path(path), ("fields", path))
        self.names, self.limits = path.split("."), limits
        self.count = 0
        self.wrong: tuple[str, Message] | None = None

    @property
    def is_refuted(self) -> bool:
        """Whether a value is outside."""
        return self.wrong is not None

    def feed(self, message: Message) -> None:
        """Take the next message."""
        self.count += 1
        if self.wrong is not None:
            return
        wrong = next((each for each in self._values(message.fields, 0) if not self._fits(each, message)), None)
        if wrong is not None:
            self.wrong = shown_value(wrong), message

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.wrong is not None:
            found, message = self.wrong
            return self.not_met(found, message)
        return self.met() if self.count else self.not_met(_NO_MESSAGE)

    def _values(self, found: Any, depth: int) -> Iterator[Any]:
        if isinstance(found, Mapping) and depth < len(self.names):
            yield from self._values(found[self.names[depth]], depth + 1)
        elif isinstance(found, list):
            for each in found:
                yield from self._values(each, depth)
        elif isinstance(found, np.ndarray):
            yield from self._outside(found).tolist()
        else:
            yield found

    def _outside(self, array: Any) -> Any:
        """Return the items of an array of numbers that do not fit, all at once."""
        of = self.limits
        if isinstance(of.equals, str):
            return array[:1]
        fits = np.ones(len(array), bool)
        fits &= array >= of.min if of.min is not None else True
        fits &= array <= of.max if of.max is not None else True
        fits &= array == of.equals if of.equals is not None else True
        return array[~fits]

    def _fits(self, value: Any, message: Message) -> bool:
        of = self.limits
        is_text, wants_text = isinstance(value, str), isinstance(of.equals, str)
        if isinstance(value, Mapping) or is_text != wants_text:
            kind = "a message" if isinstance(value, Mapping) else "a text" if is_text else "a number"
            raise InputError(
                f"requirements.topics.{self.topic}.fields.{'.'.join(self.names)}: found {kind} in {message.topic}, "
                f"expected {'a text' if wants_text else 'a number'}"
            )
        if is_text:
            return bool(value == of.equals)
        return (
            (of.min is None or value >= of.min)
            and (of.max is None or value <= of.max)
            and (of.equals is None or value == of.equals)
        )


class TypeOfTopic(_OfTopic):
    """Its messages have a type; fed with none, as the bag's list of topics says it."""

    def __init__(self, topic: str, kind: str, types: Mapping[str, str]) -> None:
        super().__init__(topic, "type", kind, {}, ("type",))
        self.found = types.get(topic)
        package, _, name = kind.rpartition("/")
        self.kind = f"{package.removesuffix('/msg')}/msg/{name}"

    def feed(self, message: Message) -> None:
        """Take no message."""

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.found is None:
            return self.not_met("no such topic in the bag")
        return self.met() if self.found == self.kind else self.not_met(self.found)


def nanoseconds(stamp: Mapping[str, int]) -> int:
    """Return a stamp in ns."""
    return stamp["sec"] * NS_PER_S + stamp["nanosec"]


def topic_requirements(topic: str, of: TopicRequirements, types: Mapping[str, str]) -> Iterator[Requirement]:
    """Yield the requirements on a topic.

    Args:
        topic: its name.
        of: what must hold.
        types: types of the bag's topics.
    """
    if of.type is not None:
        yield TypeOfTopic(topic, of.type, types)
    if of.within is not None:
        yield FirstMessage(topic, of.within)
    if of.min_rate is not None or of.max_rate is not None:
        yield Rate(topic, of.min_rate, of.max_rate)
    if of.max_gap is not None:
        yield Gap(topic, of.max_gap)
    if of.max_latency is not None:
        yield Latency(topic, of.max_latency)
    for path, limits in of.fields.items():
        yield FieldValue(topic, path, limits)
