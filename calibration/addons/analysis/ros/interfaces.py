"""Files of messages, services and actions."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

_FIELD_LINE = re.compile(r"([\w/]+(?:<=\d+)?)((?:\[(?:<=)?\d*\])?)\s+(\w+)\s*(.*)")
_BOUND_OF_TEXT = re.compile(r"<=\d+")
FOLDER_OF_SUFFIX = {".msg": "msg", ".srv": "srv", ".action": "action"}


@dataclass(frozen=True)
class Field:
    """Field or constant of an interface."""

    type: str
    """Without the size of an array or text."""
    name: str
    line: int
    is_constant: bool


@dataclass(frozen=True)
class Unreadable:
    """Line of an interface that is no field."""

    text: str
    line: int


def lines_of(text: str) -> Iterator[Field | Unreadable]:
    """Yield what the lines of an interface declare."""
    for number, line in enumerate(text.split("\n"), 1):
        content = line.partition("#")[0].strip()
        if not content or content == "---":
            continue
        match = _FIELD_LINE.fullmatch(content)
        if match is None:
            yield Unreadable(content, number)
        else:
            yield Field(_BOUND_OF_TEXT.sub("", match[1]), match[3], number, match[4].startswith("="))


def fields_of(text: str) -> list[Field]:
    """Return the fields and constants of an interface."""
    return [each for each in lines_of(text) if isinstance(each, Field)]
