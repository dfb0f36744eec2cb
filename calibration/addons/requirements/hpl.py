"""Properties of HPL: their text read by the library hpl-specs, with errors at line and column."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from calibration.addons.requirements.message_fields import FieldTree, merged_trees
from calibration.addons.requirements.predicates import (
    THIS,
    Evaluate,
    Known,
    MismatchError,
    NoValueError,
    evaluated,
    paths,
)
from calibration.addons.requirements.requirement import NS_PER_S, Message
from calibration.base import InputError, one_line, shorten
from calibration.base.optional import optional

MAX_TEXT_CHARACTERS = 10_000
"""Limit of the text of a property; its parser takes a time that grows with its depth."""
MAX_DEPTH = 50
"""Limit of brackets and words such as `not` inside one another; the library is recursive."""
MAX_EXPECTED_SHOWN = 16
MAX_NAME_CHARACTERS = 200
_SIGN_OF_TERMINAL = {
    "$END": "the end",
    "CHANNEL_NAME": "a topic",
    "CNAME": "a name",
    "NUMBER": "a number",
    "TIME_UNIT": "s or ms",
    "COLON": "':'",
    "LBRACE": "'{'",
    "RBRACE": "'}'",
    "LPAR": "'('",
    "RPAR": "')'",
    "COMMA": "','",
    "DOT": "'.'",
    "HASH": "'#'",
    "VAR_REF": "@ALIAS",
    "ESCAPED_STRING": "a text in quotes",
    "TRUE": "True",
    "FALSE": "False",
    "L_RANGE_INC": "'['",
    "L_RANGE_EXC": "'!['",
    "R_RANGE_INC": "']'",
    "R_RANGE_EXC": "']!'",
    "LSQB": "'['",
    "RELATIONAL_OPERATOR": "= != < <= > >= in",
    "ADD_OPERATOR": "+ -",
    "MULT_OPERATOR": "* /",
    "RSQB": "']'",
    "POWER_OPERATOR": "**",
    "MINUS_OPERATOR": "-",
    "IF_OPERATOR": "implies",
    "QUANT_OPERATOR": "forall or exists",
}


@dataclass(frozen=True)
class SimpleEvent:
    """Messages of a topic for which a predicate holds."""

    topic: str
    alias: str | None
    predicate: Evaluate | None
    """None if it holds for every message."""
    wanted: Mapping[str, FieldTree]
    """Fields that the predicate reads, by the alias of the message, `THIS` for its own."""
    never: bool
    """Whether the predicate holds for no message."""

    def matches(self, message: Message, known: Known) -> bool:
        """Return whether the predicate holds; not where it has no value.

        Raises:
            MismatchError: it does not fit the message.
        """
        if self.predicate is None:
            return True
        try:
            return self.predicate({**known, THIS: message.fields}) is True
        except NoValueError:
            return False


class Event:
    """One of several simple events, of different topics."""

    def __init__(self, simple: tuple[SimpleEvent, ...]) -> None:
        self.simple = {each.topic: each for each in simple}

    @property
    def aliases(self) -> frozenset[str]:
        """Names of its messages in the predicates of other events."""
        return frozenset(each.alias for each in self.simple.values() if each.alias)

    @property
    def never(self) -> bool:
        """Whether it happens never."""
        return all(each.never for each in self.simple.values())

    @property
    def is_of_any_message(self) -> bool:
        """Whether one of its topics has no predicate."""
        return any(each.predicate is None for each in self.simple.values())

    def reads(self, aliases: frozenset[str]) -> bool:
        """Return whether a predicate reads a message of one of these names."""
        return any(alias in aliases for each in self.simple.values() for alias in each.wanted)

    def matches(self, message: Message, known: Known) -> bool:
        """Return whether a message is one of its."""
        simple = self.simple.get(message.topic)
        return simple is not None and simple.matches(message, known)

    def naming(self, message: Message) -> dict[str, Any]:
        """Return the message's fields by its alias, for the predicates of other events."""
        alias = self.simple[message.topic].alias
        return {} if alias is None else {alias: message.fields}


@dataclass(frozen=True)
class Property:
    """Property of HPL: a pattern of events in a scope."""

    text: str
    name: str
    """Its id or title, else its text."""
    pattern: str
    """EXISTENCE, ABSENCE, RESPONSE, REQUIREMENT or PREVENTION."""
    behaviour: Event
    trigger: Event | None
    within: int | None
    """Time limit, ns."""
    activator: Event | None
    terminator: Event | None

    @property
    def is_of_one_message(self) -> bool:
        """Whether one message alone can contradict it, and its order and time do not matter: ``globally: no /b``."""
        is_everywhere = self.activator is None and self.terminator is None and self.within is None
        return self.pattern == "ABSENCE" and is_everywhere

    @property
    def events(self) -> tuple[Event, ...]:
        """All its events."""
        return tuple(each for each in (self.activator, self.trigger, self.behaviour, self.terminator) if each)

    @property
    def wanted(self) -> dict[str, FieldTree]:
        """Return the fields that it needs of each topic."""
        topic_of_alias = [(each.alias, each.topic) for event in self.events for each in event.simple.values()]
        trees: dict[str, list[FieldTree]] = {each.topic: [] for event in self.events for each in event.simple.values()}
        for event in self.events:
            for each in event.simple.values():
                for alias, tree in each.wanted.items():
                    for topic in [each.topic] if alias == THIS else [t for name, t in topic_of_alias if name == alias]:
                        trees[topic].append(tree)
        return {topic: merged_trees(found) if found else {} for topic, found in trees.items()}


@cache
def _parser() -> Any:
    return optional("hpl.parser", "HPL").property_parser()


def parse_property(text: str, where: str) -> Property:
    """Parse a property.

    Args:
        text: of one property.
        where: where it is written, for messages.

    Raises:
        InputError: it cannot be parsed, the message has line, column and what was expected; or it can never fail.
        InfrastructureError: the library is not installed.
    """
    parser = _parser()
    if len(text) > MAX_TEXT_CHARACTERS or _depth(text) > MAX_DEPTH:
        raise InputError(
            f"{where}: found a property of {len(text)} characters, {_depth(text)} deep, expected at most "
            f"{MAX_TEXT_CHARACTERS}, {MAX_DEPTH} deep"
        )
    try:
        tree = parser.parse(text)
        found = _property(tree, text)
    except RecursionError:
        raise InputError(f"{where}: found a property that is too deep, expected a shorter one") from None
    except MismatchError as error:
        raise InputError(f"{where}: {shorten(text)}: {error}") from None
    except Exception as error:
        raise InputError(f"{where}: {_parser_error(error, text)}") from None
    _check_that_it_can_fail(found, where)
    return found


def _depth(text: str) -> int:
    """Return how many brackets of a text are open at most, with the words that nest without one."""
    without_texts = re.sub(r'"(?:[^"\\]|\\.)*"', "", text)
    depth = most = 0
    for sign in without_texts:
        depth += (sign in "([{") - (sign in ")]}")
        most = max(most, depth)
    return most + max(len(re.findall(r"\b(?:not|forall|exists)\b|-", without_texts)), without_texts.count(".") // 4)


def _parser_error(error: Exception, text: str) -> str:
    """Return what the library found, in one line."""
    cause: Any = error.__context__
    if (line := getattr(cause, "line", None)) is None:  # types that do not fit, unknown aliases and functions
        reason = re.sub(r"Token\('\w+', ('(?:[^'\\]|\\.)*')\)", r"\1", one_line(str(error)))
        return f"{shorten(text)}: {shorten(reason, 300)}"
    names = getattr(cause, "accepts", None) or getattr(cause, "allowed", None) or getattr(cause, "expected", None) or ()
    expected = sorted({_SIGN_OF_TERMINAL.get(name, _word_of_terminal(name)) for name in names})
    token = str(getattr(cause, "token", None) or getattr(cause, "char", ""))
    found = shorten(repr(token), 40) if token else "the end"
    listed = ", ".join(expected[:MAX_EXPECTED_SHOWN]) + (", ..." if len(expected) > MAX_EXPECTED_SHOWN else "")
    return f"line {line}, column {cause.column}: found {found}, expected {listed or 'something else'}"


def _word_of_terminal(name: str) -> str:
    return name.removeprefix("_KW_").removesuffix("_OPERATOR").lower()


def _property(tree: Any, text: str) -> Property:
    pattern = tree.pattern
    name = tree.metadata.get("id") or tree.metadata.get("title") or one_line(text)
    bounded = pattern.has_max_time
    return Property(
        text=shorten(one_line(text), MAX_NAME_CHARACTERS),
        name=shorten(str(name).strip('"'), MAX_NAME_CHARACTERS),
        pattern=pattern.pattern_type.name,
        behaviour=_event(pattern.behaviour),
        trigger=_event(pattern.trigger) if pattern.trigger is not None else None,
        within=round(pattern.max_time * NS_PER_S) if bounded else None,
        activator=_event(tree.scope.activator) if tree.scope.activator is not None else None,
        terminator=_event(tree.scope.terminator) if tree.scope.terminator is not None else None,
    )


def _event(tree: Any) -> Event:
    return Event(tuple(_simple_event(each) for each in tree.simple_events()))


def _simple_event(tree: Any) -> SimpleEvent:
    name = str(tree.name)
    if name.startswith("~"):
        raise MismatchError(f"found the private name {name}, expected a topic such as /node/{name.strip('~/')}")
    condition = tree.predicate.condition
    wanted: dict[str, list[FieldTree]] = {}
    for alias, field_tree in paths(condition):
        if field_tree:
            wanted.setdefault(alias, []).append(field_tree)
    constant = None
    if tree.predicate.is_vacuous:
        constant = tree.predicate.is_true
    elif not wanted:
        constant = _constant_value(evaluated(condition))
    return SimpleEvent(
        topic=name if name.startswith("/") else f"/{name}",
        alias=str(tree.alias) if tree.alias else None,
        predicate=None if constant else evaluated(condition),
        wanted={alias: merged_trees(trees) for alias, trees in wanted.items()},
        never=constant is False,
    )


def _constant_value(predicate: Evaluate) -> bool:
    try:
        return predicate({}) is True
    except NoValueError:
        return False


def _check_that_it_can_fail(found: Property, where: str) -> None:
    """Refuse a property that no message contradicts, or that none satisfies.

    Raises:
        InputError: it is one.
    """
    of_trigger = found.pattern in ("RESPONSE", "PREVENTION")
    needed = [found.activator, found.trigger if of_trigger else None]
    needed += [found.behaviour if found.pattern in ("ABSENCE", "PREVENTION", "REQUIREMENT") else None]
    if any(event is not None and event.never for event in needed):
        raise InputError(f"{where}: {shorten(found.text)}: it can never fail: found a predicate that is always False")
    if found.behaviour.never:
        raise InputError(f"{where}: {shorten(found.text)}: it can never be met: found a predicate that is always False")
