"""Access to parts of a Rigelfile, with the position in errors; fields that were not read are noted as not converted."""

import re
from collections.abc import Callable, Mapping
from typing import Any

from calibration.addons.rigel.notes import Notes
from calibration.addons.rigel.substitution import plain
from calibration.base.errors import InputError
from calibration.base.text import shorten


def mapping_at(value: object, where: str) -> dict[str, Any]:
    """Return a mapping; an empty one for None.

    Raises:
        InputError: it is of another type.
    """
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f"{where}: found {shown(value)}, a mapping was expected")
    return value


def list_at(value: object, where: str) -> list[Any]:
    """Return a list; empty for None, and of one item for a single mapping, as in old Rigelfiles.

    Raises:
        InputError: it is of another type.
    """
    if value is None:
        return []
    if isinstance(value, dict):
        return [value]
    if not isinstance(value, list):
        raise InputError(f"{where}: found {shown(value)}, a list was expected")
    return value


def text_at(value: object, where: str) -> str:
    """Return a text; a number or a boolean is converted.

    Raises:
        InputError: it is a list, a mapping or None.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | int | float):
        return str(value)
    raise InputError(f"{where}: found {shown(value)}, a text was expected")


def truth_at(value: object, where: str) -> bool:
    """Return a boolean.

    Raises:
        InputError: it is of another type.
    """
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.lower() in ("true", "false"):
        return value.lower() == "true"
    raise InputError(f"{where}: found {shown(value)}, true or false was expected")


def shown(value: object) -> str:
    """Format a value for a message."""
    return shorten(re.sub(r"\\ue000[VSD](.*?)\\ue001", r"${\1}", repr(value)))


class Fields:
    """Fields of a mapping, each taken at most once; :meth:`rest` notes those that were not taken."""

    def __init__(self, value: object, where: str, notes: Notes, spelling: Callable[[str], str] = str) -> None:
        """Wrap a mapping or None.

        Args:
            value: the parsed value.
            where: its position, for messages.
            notes: receives the fields that cannot be converted.
            spelling: normalises a key to the spelling used here.

        Raises:
            InputError: it is of another type. The other methods raise it too, for a field of the wrong type.
        """
        self.where, self.notes, self.spelling = where, notes, spelling
        self._left = {spelling(key): (key, entry) for key, entry in mapping_at(value, where).items()}
        self._written = {taken: key for taken, (key, _) in self._left.items()}

    def __bool__(self) -> bool:
        return bool(self._left)

    def __contains__(self, key: str) -> bool:
        return key in self._left

    def at(self, key: str) -> str:
        """Return the position of a field, in its original spelling."""
        return f"{self.where}.{self._written.get(key, key)}".removeprefix(".")

    def names(self) -> list[str]:
        """Return the keys of the fields that were not taken."""
        return list(self._left)

    def take(self, key: str, default: Any = None) -> Any:
        """Take a field, unconverted."""
        return self._left.pop(key, (key, default))[1]

    def fields(self, key: str) -> "Fields":
        """Take a mapping, or the single mapping of a list."""
        value, where = self.take(key), self.at(key)
        if isinstance(value, list) and len(value) == 1:
            value, where = value[0], f"{where}.0"
        return Fields(value, where, self.notes, self.spelling)

    def items(self, key: str, default: Any = None) -> list[Any]:
        """Take a list; empty for None."""
        return list_at(self.take(key, default), self.at(key))

    def several(self, key: str) -> list["Fields"]:
        """Take a list of mappings."""
        where = self.at(key)
        return [Fields(entry, f"{where}.{i}", self.notes, self.spelling) for i, entry in enumerate(self.items(key))]

    def mapping(self, key: str) -> Mapping[str, Any]:
        """Take a mapping with arbitrary keys."""
        return mapping_at(self.take(key), self.at(key))

    def text(self, key: str, default: str = "") -> str:
        """Take a text."""
        value = self.take(key)
        return default if value is None else text_at(value, self.at(key))

    def texts(self, key: str, default: Any = None) -> list[str]:
        """Take a list of texts."""
        return [text_at(item, self.at(key)) for item in self.items(key, default)]

    def plain(self, key: str, default: str = "") -> str:
        """Take a text for a field that supports no placeholders."""
        return plain(self.text(key, default), self.notes, self.at(key))

    def plains(self, key: str, default: Any = None) -> list[str]:
        """Take a list of texts for a field that supports no placeholders."""
        return [plain(text, self.notes, self.at(key)) for text in self.texts(key, default)]

    def truth(self, key: str, default: bool | None = None) -> bool | None:
        """Take a boolean."""
        value = self.take(key)
        return default if value is None else truth_at(value, self.at(key))

    def refuse(self, reasons: Mapping[str, str]) -> None:
        """Note fields as not converted, each with the reason."""
        for key, why in reasons.items():
            if self.take(key):
                self.notes.lost(self.at(key), why)

    def rest(self, why: str = "there is no such setting here") -> None:
        """Note the fields that were not taken."""
        for key in list(self._left):
            self.notes.lost(self.at(key), why)
        self._left.clear()
