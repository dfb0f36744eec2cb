"""Traces of messages for the state machine of a property."""

from collections.abc import Iterable
from functools import lru_cache

from calibration.addons.requirements.hpl import parse_property
from calibration.addons.requirements.patterns import HplRequirement
from calibration.addons.requirements.requirement import NS_PER_S, Judgement, Message

parsed_once = lru_cache(parse_property)


def judged(hpl: str, sent: Iterable[tuple[int, str, int]], end: int) -> Judgement:
    """Judge a property over messages: time in s, topic, x."""
    requirement = HplRequirement(parsed_once(hpl, "hpl"), (("hpl",), hpl))
    requirement.start(0)
    for time, topic, x in sent:
        if f"/{topic}" in requirement.wanted:
            requirement.feed(Message(f"/{topic}", time * NS_PER_S, {"x": x}, 8))
    return requirement.close(end * NS_PER_S)


def parsed_trace(text: str) -> tuple[list[tuple[int, str, int]], int]:
    """Return the messages and the end of a trace of `truth_tables`."""
    sent, end = [], 9
    for word in text.split():
        if word.startswith("."):
            end = int(word[1:])
        else:
            time, _, x = word[1:].partition(":")
            sent.append((int(time), word[0], int(x or 0)))
    return sent, end
