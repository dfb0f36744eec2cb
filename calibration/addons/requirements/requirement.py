"""A requirement: a small state machine, fed with the messages of its topics, that says at the end what it found."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from calibration.addons.requirements.message_fields import FieldTree
from calibration.base import shorten
from calibration.base.records import field, result

NS_PER_S = 10**9
MAX_VALUES_SHOWN = 8
"""Limit of the values of a message in a counterexample."""
MAX_VALUE_CHARACTERS = 60
Status: TypeAlias = Literal["met", "not met", "vacuous"]
"""Vacuous: nothing came to which the requirement says something."""


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
