"""A second evaluator of HPL, which looks at a whole trace by the definition of each pattern, and keeps no state."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

Pattern = Literal["some", "no", "causes", "requires", "forbids"]


@dataclass(frozen=True)
class Sent:
    """Message of a trace."""

    time: int
    topic: str
    x: int


@dataclass(frozen=True)
class When:
    """Event: messages of topics, each with a condition on x: a sign, and a number or the alias of another event."""

    conditions: tuple[tuple[str, tuple[str, int | str] | None], ...]
    alias: str | None = None

    def text(self) -> str:
        parts = []
        for topic, condition in self.conditions:
            named = f" as {self.alias}" if self.alias and len(self.conditions) == 1 else ""
            right = "" if condition is None else condition[1]
            right = f"@{right}.x" if isinstance(right, str) else right
            parts.append(f"/{topic}{named}" + ("" if condition is None else f" {{x {condition[0]} {right}}}"))
        return parts[0] if len(parts) == 1 else f"({' or '.join(parts)})"

    def holds(self, sent: Sent, **others: int) -> bool:
        for topic, condition in self.conditions:
            if topic == sent.topic:
                if condition is None:
                    return True
                right = others[condition[1]] if isinstance(condition[1], str) else condition[1]
                return {"=": sent.x == right, ">": sent.x > right, "<": sent.x < right}[condition[0]]
        return False


@dataclass(frozen=True)
class Spec:
    """Property: the first event is the trigger of a response or prevention, and what a requirement is about."""

    pattern: Pattern
    events: tuple[When, ...]
    within: int | None
    after: When | None
    until: When | None

    def text(self) -> str:
        scope = "" if self.after is None else f"after {self.after.text()}"
        scope += "" if self.until is None else f" until {self.until.text()}"
        body = f" {self.pattern} ".join(event.text() for event in self.events)
        if len(self.events) == 1:
            body = f"{self.pattern} {body}"
        return f"{scope.strip() or 'globally'}: {body}" + ("" if self.within is None else f" within {self.within} s")


@dataclass(frozen=True)
class Interval:
    """Messages strictly inside a scope."""

    begin: int
    inside: list[Sent]
    is_closed: bool
    """Whether a message closed it, and not the end of the bag."""


def intervals(spec: Spec, trace: list[Sent]) -> Iterator[Interval]:
    """Yield the intervals of a scope."""
    place, begin = 0, 0
    while True:
        if spec.after is not None:
            opened = next((i for i in range(place, len(trace)) if spec.after.holds(trace[i])), None)
            if opened is None:
                return
            place, begin = opened + 1, trace[opened].time
        closed = next((i for i in range(place, len(trace)) if spec.until and spec.until.holds(trace[i])), None)
        yield Interval(begin, trace[place:closed], closed is not None)
        if closed is None or spec.after is None:
            return
        place = closed + 1


def obligations(spec: Spec, of: Interval, end: int) -> Iterator[str]:
    """Yield what became of each thing that must be or not be in an interval: right, wrong, or open at the end."""
    limit = spec.within if spec.within is not None else 10**9
    first, second = spec.events[0], spec.events[-1]

    def missing(since: int) -> str:
        return "open" if not of.is_closed and spec.within is not None and since + limit > end else "wrong"

    numbered = list(enumerate(of.inside))
    if spec.pattern == "some":
        yield "right" if any(first.holds(m) and m.time - of.begin <= limit for m in of.inside) else missing(of.begin)
    elif spec.pattern == "no":
        near = [m for m in of.inside if m.time - of.begin <= limit]
        if any(first.holds(m) for m in near):
            yield "wrong"
        elif any(condition is None for _, condition in first.conditions) or any(
            m.topic == topic for m in near for topic, _ in first.conditions
        ):
            yield "right"
    elif spec.pattern == "requires":
        for j, b in numbered:
            if first.holds(b):
                ok = any(second.holds(a, **named(first, b)) and b.time - a.time <= limit for a in of.inside[:j])
                yield "right" if ok else "wrong"
    else:
        for i, a in numbered:
            if first.holds(a):
                after = [b for b in of.inside[i + 1 :] if b.time - a.time <= limit]
                seen = any(second.holds(b, **named(first, a)) for b in after)
                if spec.pattern == "causes":
                    yield "right" if seen else missing(a.time)
                else:
                    yield "wrong" if seen else "right"


def named(event: When, sent: Sent) -> dict[str, int]:
    return {} if event.alias is None else {event.alias: sent.x}


def naive_status(spec: Spec, trace: list[Sent], end: int) -> str:
    """Return met, not met or vacuous."""
    found = {each for interval in intervals(spec, trace) for each in obligations(spec, interval, end)}
    if "wrong" in found or found == {"open"}:
        return "not met"
    return "met" if "right" in found else "vacuous"
