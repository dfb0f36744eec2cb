"""Parts of a Rigelfile, read with errors that say where; what nobody has read is noted as not carried over."""

import re
from collections.abc import Callable, Mapping
from typing import Any

from calibration.errors import InputError
from calibration.rigel.notes import Notes
from calibration.rigel.substitution import plain
from calibration.workflow.text import shorten


def mapping_at(value: object, where: str) -> dict[str, Any]:
    """A mapping; an empty one for nothing.

    Raises:
        InputError: it is something else.
    """
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f"{where}: found {shown(value)}, a mapping was expected")
    return value


def list_at(value: object, where: str) -> list[Any]:
    """A list; an empty one for nothing, and one of one for a single mapping, as old Rigelfiles have it.

    Raises:
        InputError: it is something else.
    """
    if value is None:
        return []
    if isinstance(value, dict):
        return [value]
    if not isinstance(value, list):
        raise InputError(f"{where}: found {shown(value)}, a list was expected")
    return value


def text_at(value: object, where: str) -> str:
    """A text; a number or a truth value as it is written.

    Raises:
        InputError: it is a list, a mapping or nothing.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | int | float):
        return str(value)
    raise InputError(f"{where}: found {shown(value)}, a text was expected")


def truth_at(value: object, where: str) -> bool:
    """A truth value.

    Raises:
        InputError: it is none.
    """
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.lower() in ("true", "false"):
        return value.lower() == "true"
    raise InputError(f"{where}: found {shown(value)}, true or false was expected")


def shown(value: object) -> str:
    """A value for a message."""
    return shorten(re.sub(r"\\ue000[VSD](.*?)\\ue001", r"${\1}", repr(value)))


class Fields:
    """The fields of a mapping; each is taken once, and :meth:`rest` notes those that nobody has taken."""

    def __init__(self, value: object, where: str, notes: Notes, spelling: Callable[[str], str] = str) -> None:
        """Take a mapping, or nothing.

        Args:
            value: as it was read.
            where: it stands, for messages.
            notes: what cannot be carried over is added to these.
            spelling: gives the one spelling of a key by which fields are taken here.

        Raises:
            InputError: it is something else. The other methods raise it too, for a field of the wrong kind.
        """
        self.where, self.notes, self.spelling = where, notes, spelling
        self._left = {spelling(key): (key, entry) for key, entry in mapping_at(value, where).items()}
        self._written = {taken: key for taken, (key, _) in self._left.items()}

    def __bool__(self) -> bool:
        return bool(self._left)

    def __contains__(self, key: str) -> bool:
        return key in self._left

    def at(self, key: str) -> str:
        """Where a field is, as it is spelled there."""
        return f"{self.where}.{self._written.get(key, key)}".removeprefix(".")

    def names(self) -> list[str]:
        """The keys of the fields that nobody has taken."""
        return list(self._left)

    def take(self, key: str, default: Any = None) -> Any:
        """A field as it is."""
        return self._left.pop(key, (key, default))[1]

    def fields(self, key: str) -> "Fields":
        """A mapping in it; the only one of a list."""
        value, where = self.take(key), self.at(key)
        if isinstance(value, list) and len(value) == 1:
            value, where = value[0], f"{where}.0"
        return Fields(value, where, self.notes, self.spelling)

    def items(self, key: str, default: Any = None) -> list[Any]:
        """A list; an empty one for nothing."""
        return list_at(self.take(key, default), self.at(key))

    def several(self, key: str) -> list["Fields"]:
        """The mappings of a list."""
        where = self.at(key)
        return [Fields(entry, f"{where}.{i}", self.notes, self.spelling) for i, entry in enumerate(self.items(key))]

    def mapping(self, key: str) -> Mapping[str, Any]:
        """A mapping whose keys are the user's own."""
        return mapping_at(self.take(key), self.at(key))

    def text(self, key: str, default: str = "") -> str:
        """A text."""
        value = self.take(key)
        return default if value is None else text_at(value, self.at(key))

    def texts(self, key: str, default: Any = None) -> list[str]:
        """The texts of a list."""
        return [text_at(item, self.at(key)) for item in self.items(key, default)]

    def plain(self, key: str, default: str = "") -> str:
        """A text for a place without placeholders."""
        return plain(self.text(key, default), self.notes, self.at(key))

    def plains(self, key: str, default: Any = None) -> list[str]:
        """The texts of a list, for a place without placeholders."""
        return [plain(text, self.notes, self.at(key)) for text in self.texts(key, default)]

    def truth(self, key: str, default: bool | None = None) -> bool | None:
        """Whether something is so."""
        value = self.take(key)
        return default if value is None else truth_at(value, self.at(key))

    def refuse(self, reasons: Mapping[str, str]) -> None:
        """Note fields that are not carried over, each with the reason."""
        for key, why in reasons.items():
            if self.take(key):
                self.notes.lost(self.at(key), why)

    def rest(self, why: str = "there is no such setting here") -> None:
        """Note the fields that nobody has taken."""
        for key in list(self._left):
            self.notes.lost(self.at(key), why)
        self._left.clear()
