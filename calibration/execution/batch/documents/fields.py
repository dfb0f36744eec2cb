"""JSON that came over S3, read field by field: what is not there, too much or of another kind is refused by name."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from calibration import json_file
from calibration.errors import WorldError
from calibration.workflow.text import shorten

_T = TypeVar("_T")
_MOST_SECONDS = 1e9


def parse_json(data: bytes, most: int, where: str) -> object:
    """Parse a document of at most ``most`` bytes.

    Raises:
        WorldError: it is larger, or no JSON.
    """
    if len(data) > most:
        raise WorldError(f"{where}: found {len(data)} bytes, at most {most} were expected")
    try:
        return json_file.parse_json(data)
    except (ValueError, RecursionError) as error:
        raise WorldError(f"{where}: this is no JSON: {shorten(str(error), 200)}") from None


class Fields:
    """The fields of an object; each is asked for once, and `end` refuses what nobody has asked for."""

    def __init__(self, document: object, where: str) -> None:
        """Take an object.

        Raises:
            WorldError: it is none.
        """
        if not isinstance(document, dict):
            raise WorldError(f"{where}: found {_shown(document)}, expected an object")
        self.where = where
        self._left = dict(document)

    def wrong(self, name: str, found: object, expected: str) -> WorldError:
        """What to raise about a field."""
        return WorldError(f"{self.where}: {name}: found {_shown(found)}, expected {expected}")

    def end(self) -> None:
        """Say that there must be nothing more.

        Raises:
            WorldError: there is.
        """
        for name in self._left:
            raise WorldError(f"{self.where}: the field {_shown(name)} is not known")

    def text(self, name: str, longest: int = 4096) -> str:
        """Take a text."""
        expected = f"a text of at most {longest} characters"
        return str(self._take(name, lambda v: isinstance(v, str) and len(v) <= longest, expected))

    def optional_text(self, name: str, longest: int = 4096) -> str | None:
        """Take a text, or null."""
        return None if self._is_null(name) else self.text(name, longest)

    def yes_or_no(self, name: str) -> bool:
        """Take a truth value."""
        return bool(self._take(name, lambda v: isinstance(v, bool), "true or false"))

    def integer(self, name: str, least: int = 0, most: int = 2**63 - 1) -> int:
        """Take a whole number."""
        expected = f"a whole number from {least} to {most}"
        return int(self._take(name, lambda v: type(v) is int and least <= v <= most, expected))

    def optional_integer(self, name: str, least: int = 0, most: int = 2**63 - 1) -> int | None:
        """Take a whole number, or null."""
        return None if self._is_null(name) else self.integer(name, least, most)

    def seconds(self, name: str) -> float:
        """Take a time, not below 0."""
        return float(self._take(name, _is_time, "a time in seconds"))

    def optional_seconds(self, name: str) -> float | None:
        """Take a time, or null."""
        return None if self._is_null(name) else self.seconds(name)

    def texts(self, name: str, most: int = 10_000, longest: int = 2**20) -> tuple[str, ...]:
        """Take a list of texts."""
        return self._list(name, most, lambda v: isinstance(v, str) and len(v) <= longest, f"{most} texts")

    def optional_texts(self, name: str) -> tuple[str, ...] | None:
        """Take a list of texts, or null."""
        return None if self._is_null(name) else self.texts(name)

    def integers(self, name: str, least: int, most: int) -> tuple[int, ...]:
        """Take a list of whole numbers."""
        return self._list(
            name, 1000, lambda v: type(v) is int and least <= v <= most, f"1000 numbers from {least} to {most}"
        )

    def variables(self, name: str) -> Mapping[str, str]:
        """Take an object of texts."""
        fits = lambda v: isinstance(v, dict) and all(isinstance(text, str) for text in v.values())  # noqa: E731
        return dict(self._take(name, fits, "an object of texts"))

    def objects(self, name: str, most: int, read: Callable[["Fields"], _T]) -> tuple[_T, ...]:
        """Take a list of objects, each read by ``read``, which need not call `end`."""
        found = self._list(name, most, lambda _: True, f"{most} objects")
        return tuple(self._read(name, each, read) for each in found)

    def optional_object(self, name: str, read: Callable[["Fields"], _T]) -> _T | None:
        """Take an object, or null."""
        if self._is_null(name):
            return None
        return self._read(name, self._take(name, lambda _: True, ""), read)

    def _is_null(self, name: str) -> bool:
        if self._left.get(name, ...) is None:
            del self._left[name]
            return True
        return False

    def _list(self, name: str, most: int, fits: Callable[[Any], bool], expected: str) -> tuple[Any, ...]:
        found = self._take(name, lambda v: isinstance(v, list) and len(v) <= most, f"a list of at most {expected}")
        for each in found:
            if not fits(each):
                raise self.wrong(name, each, f"a list of at most {expected}")
        return tuple(found)

    def _read(self, name: str, document: object, read: Callable[["Fields"], _T]) -> _T:
        fields = Fields(document, f"{self.where}: {name}")
        result = read(fields)
        fields.end()
        return result

    def _take(self, name: str, fits: Callable[[Any], bool], expected: str) -> Any:
        if name not in self._left:
            raise WorldError(f"{self.where}: the field '{name}' is missing")
        value = self._left.pop(name)
        if not fits(value):
            raise self.wrong(name, value, expected)
        return value


def _is_time(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= _MOST_SECONDS


def _shown(value: object) -> str:
    return shorten(repr(value), 80)
