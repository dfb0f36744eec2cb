"""Requirements on one topic: when its first message comes, its type, rate, gaps and latency, values of its fields."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from calibration.addons.requirements.message_fields import FieldTree, tree_of_path
from calibration.addons.requirements.requirement import (
    NS_PER_S,
    Judgement,
    Message,
    Requirement,
    duration,
    shown_value,
)
from calibration.addons.requirements.settings import FieldLimits, TopicRequirements
from calibration.base import InputError

_STAMP: FieldTree = {"header": {"stamp": {}}}
_NO_MESSAGE = "no message on it"


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
