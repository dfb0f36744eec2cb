"""Patterns of HPL as state machines: existence, absence, response, requirement and prevention, in a scope.

The scope is the open interval of messages after the activator, or from the begin of the bag, to before the terminator,
or to the end of the bag. ``after ... until ...`` may open again. A message that closes a scope is outside of it. A
message answers only earlier ones, never itself. ``within`` includes its limit. What is open at the end of the bag, and
whose time is not over, is not counted, unless it is all that there is.
"""

from collections import deque
from collections.abc import Collection
from typing import Any

from calibration.addons.requirements.hpl import Property
from calibration.addons.requirements.predicates import MismatchError
from calibration.addons.requirements.requirement import Judgement, Message, Requirement, duration
from calibration.base import InputError, did_you_mean

MAX_WAITING_BYTES = 1 << 26
"""Limit of the messages that one requirement keeps, as later predicates read them."""
_BYTES_OF_A_MESSAGE = 1000
"""What a kept message takes beside its arrays."""


class _Kept:
    """Messages that wait, with a limit of their memory."""

    def __init__(self) -> None:
        self.messages: deque[Message] = deque()
        self._bytes = 0

    def add(self, message: Message) -> None:
        """Add a message.

        Raises:
            MismatchError: there are too many.
        """
        self._bytes += message.size + _BYTES_OF_A_MESSAGE
        if self._bytes > MAX_WAITING_BYTES:
            raise MismatchError(
                f"found {len(self.messages)} messages that wait at once, {MAX_WAITING_BYTES >> 20} MiB at most are "
                "kept: add a shorter 'within'"
            )
        self.messages.append(message)

    def keep(self, messages: list[Message]) -> None:
        """Keep these only."""
        self.messages = deque(messages)
        self._bytes = sum(message.size + _BYTES_OF_A_MESSAGE for message in messages)

    def drop_before(self, time: int) -> None:
        """Drop the messages from before a time."""
        while self.messages and self.messages[0].time < time:
            self._bytes -= self.messages.popleft().size + _BYTES_OF_A_MESSAGE


class _Pattern:
    """What must hold in each interval of the scope; it is stopped and started again with the scope."""

    def __init__(self, found: Property) -> None:
        self.behaviour = found.behaviour
        self.within = found.within
        self.violation: tuple[str, tuple[Message, ...]] | None = None
        self.checked = False
        """Whether something came to which it says something, and was right."""
        self.unanswered: tuple[str, tuple[Message, ...]] | None = None
        """What was open at the end of the bag, and had time left."""

    def start(self, begin: int, scope: tuple[Message, ...]) -> None:
        """Begin an interval, after the message that opens it."""
        self.begin = begin
        self.scope = scope
        self.reset()

    def is_late(self, time: int, since: int) -> bool:
        """Return whether the time limit from a moment is over."""
        return self.within is not None and time - since > self.within

    def limit(self) -> str:
        """Return the time limit as text."""
        return "" if self.within is None else f" within {duration(self.within)}"

    def leave_open(self, what: str, messages: tuple[Message, ...], since: int, end: int) -> None:
        """Note what is open at the end of the bag: a violation, unless its time since a moment is not over."""
        if self.within is not None and since + self.within > end:
            self.unanswered = (what, messages)
        else:
            self.violation = (what, messages)

    def reset(self) -> None:
        """Forget the messages of the last interval."""
        raise NotImplementedError

    def take(self, message: Message, known: dict[str, Any]) -> None:
        """Take a message in the interval."""
        raise NotImplementedError

    def pass_time(self, time: int) -> None:
        """Take notice that a time has come."""

    def stop(self, terminator: Message) -> None:
        """End the interval at the message that closes it."""

    def finish(self, end: int) -> None:
        """End the interval at the end of the bag."""


class _Existence(_Pattern):
    def reset(self) -> None:
        self.waits = True

    def pass_time(self, time: int) -> None:
        if self.waits and self.is_late(time, self.begin):
            self.violation = (f"no such message{self.limit()}", self.scope)

    def take(self, message: Message, known: dict[str, Any]) -> None:
        if self.waits and self.behaviour.matches(message, known):
            self.waits, self.checked = False, True

    def stop(self, terminator: Message) -> None:
        if self.waits:
            self.violation = ("no such message until the scope ended", (*self.scope, terminator))

    def finish(self, end: int) -> None:
        if self.waits:
            self.leave_open("no such message until the bag ended", self.scope, self.begin, end)


class _Absence(_Pattern):
    def reset(self) -> None:
        self.checked = self.checked or self.behaviour.is_of_any_message

    def take(self, message: Message, known: dict[str, Any]) -> None:
        if message.topic not in self.behaviour.simple or self.is_late(message.time, self.begin):
            return
        self.checked = True
        if self.behaviour.matches(message, known):
            self.violation = ("such a message", (*self.scope, message))


class _OfTwoEvents(_Pattern):
    """Pattern of a trigger and a behaviour, one of which may read the other's message."""

    def __init__(self, found: Property) -> None:
        super().__init__(found)
        if found.trigger is None:
            raise AssertionError("the library refuses such a pattern without a trigger")
        self.trigger = found.trigger
        self.reads_trigger = self.behaviour.reads(self.trigger.aliases)
        self.reads_behaviour = self.trigger.reads(self.behaviour.aliases)
        self.kept = _Kept()

    def reset(self) -> None:
        self.kept.keep([])


class _Response(_OfTwoEvents):
    def pass_time(self, time: int) -> None:
        if self.kept.messages and self.is_late(time, self.kept.messages[0].time):
            self.violation = (f"no answer{self.limit()}", (self.kept.messages[0],))

    def take(self, message: Message, known: dict[str, Any]) -> None:
        waiting = self.kept.messages
        if waiting and message.topic in self.behaviour.simple:
            if self.reads_trigger:
                left = [m for m in waiting if not self.behaviour.matches(message, known | self.trigger.naming(m))]
                self.checked = self.checked or len(left) < len(waiting)
                self.kept.keep(left)
            elif self.behaviour.matches(message, known):
                self.checked = True
                self.kept.keep([])
        # without a reading predicate, what answers the earliest answers all, and the earliest is late first
        if (self.reads_trigger or not self.kept.messages) and self.trigger.matches(message, known):
            self.kept.add(message)

    def stop(self, terminator: Message) -> None:
        if self.kept.messages:
            self.violation = ("no answer until the scope ended", (self.kept.messages[0], terminator))

    def finish(self, end: int) -> None:
        if self.kept.messages:
            first = self.kept.messages[0]
            self.leave_open("no answer until the bag ended", (first,), first.time, end)


class _Requirement(_OfTwoEvents):
    def take(self, message: Message, known: dict[str, Any]) -> None:
        if self.within is not None:
            self.kept.drop_before(message.time - self.within)
        if self.behaviour.matches(message, known):
            self.checked = True
            named = known | self.behaviour.naming(message)
            earlier = self.kept.messages
            if not (any(self.trigger.matches(m, named) for m in earlier) if self.reads_behaviour else earlier):
                self.violation = (f"nothing that it requires before it{self.limit()}", (message,))
        if self.reads_behaviour:
            if message.topic in self.trigger.simple:
                self.kept.add(message)
        elif self.trigger.matches(message, known):
            self.kept.keep([message])


class _Prevention(_OfTwoEvents):
    def take(self, message: Message, known: dict[str, Any]) -> None:
        if self.within is not None:
            self.kept.drop_before(message.time - self.within)
        if message.topic in self.behaviour.simple:
            for earlier in self.kept.messages:
                if self.behaviour.matches(message, known | self.trigger.naming(earlier)):
                    self.violation = (f"what it forbids{self.limit()}", (earlier, message))
                    return
        if self.trigger.matches(message, known):
            self.checked = True
            if self.reads_trigger:
                self.kept.add(message)
            else:
                self.kept.keep([message])


_PATTERNS: dict[str, type[_Pattern]] = {
    "EXISTENCE": _Existence,
    "ABSENCE": _Absence,
    "RESPONSE": _Response,
    "REQUIREMENT": _Requirement,
    "PREVENTION": _Prevention,
}


class HplRequirement(Requirement):
    """Property of HPL over the messages of a bag."""

    def __init__(
        self, found: Property, place: tuple[tuple[str, ...], str | None], topics: Collection[str] | None = None
    ) -> None:
        super().__init__(found.name, found.text, found.wanted, place)
        missing = [topic for topic in self.wanted if topics is not None and topic not in topics]
        self.missing = "".join(f", no topic {topic} in the bag{did_you_mean(topic, topics or ())}" for topic in missing)
        self.has_behaviour = any(topic not in missing for topic in found.behaviour.simple)
        self.property = found
        self.pattern = _PATTERNS[found.pattern](found)
        self.is_open = False
        self.was_open = False
        self.known: dict[str, Any] = {}

    @property
    def is_refuted(self) -> bool:
        """Whether a message came that must never come."""
        return self.property.is_of_one_message and self.pattern.violation is not None

    def start(self, begin: int) -> None:
        """Begin; without an activator the scope is open from here."""
        super().start(begin)
        if self.property.activator is None:
            self._open(begin, ())

    def feed(self, message: Message) -> None:
        """Take the next message.

        Raises:
            InputError: a predicate does not fit it, or too many messages wait.
        """
        if self.pattern.violation is not None:
            return
        try:
            self._take(message)
        except MismatchError as error:
            raise InputError(f"{self.name}: {message.topic} at {self.seconds(message.time)}: {error}") from None

    def close(self, end: int) -> Judgement:
        """Judge what is open, and return what was found first."""
        pattern = self.pattern
        if self.is_open and pattern.violation is None:
            pattern.pass_time(end)
            if pattern.violation is None:
                pattern.finish(end)
        if pattern.violation is not None:
            found, messages = pattern.violation
            return self.not_met(f"{found}{self.missing}", *messages)
        if pattern.checked and not self.has_behaviour and self.property.pattern == "ABSENCE":
            return self.vacuous(self.missing.removeprefix(", "))
        if pattern.checked:
            return self.met()
        if pattern.unanswered is not None:
            found, messages = pattern.unanswered
            return self.not_met(f"{found}, which was before its time was over{self.missing}", *messages)
        if not self.was_open:
            return self.vacuous(f"nothing that opens its scope{self.missing}")
        return self.vacuous(f"no message to which it says something{self.missing}")

    def _open(self, begin: int, scope: tuple[Message, ...]) -> None:
        self.is_open = self.was_open = True
        self.pattern.start(begin, scope)

    def _take(self, message: Message) -> None:
        of = self.property
        if self.is_open:
            self.pattern.pass_time(message.time)
            if self.pattern.violation is not None:
                return
            if of.terminator is not None and of.terminator.matches(message, self.known):
                self.is_open = False
                self.pattern.stop(message)
            else:
                self.pattern.take(message, self.known)
        elif of.activator is not None and of.activator.matches(message, {}):
            self.known = of.activator.naming(message)
            self._open(message.time, (message,))
