"""Parsed documents (JSON, YAML) from untrusted files, with one-line errors that locate the fault.

Also the data files that the collections of a dataset name: images and point clouds.
"""

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from calibration.base import InputError, RepeatedKeyError, parse_json, read_bytes
from calibration.base.arrays import Array

MAX_BYTES = 1 << 30
"""Limit of a file's size in bytes."""
LONGEST_KEY = 255
"""Limit of the characters of a key: names of sensors are part of file names, and of many lines for users."""


class Node:
    """Value in a document, with the keys that lead to it: errors name the file, the keys and the value found."""

    __slots__ = ("file", "keys", "value")

    def __init__(self, file: Path, keys: tuple[str, ...], value: Any) -> None:
        self.file = file
        self.keys = keys
        self.value = value

    def __getitem__(self, key: str) -> "Node":
        """Return the value of a required key."""
        value = self.mapping()
        if key not in value:
            raise self.fault(f"missing key '{key}'")
        return Node(self.file, (*self.keys, key), value[key])

    def get(self, key: str) -> "Node | None":
        """Return the value of an optional key; None if it is absent or null."""
        value = self.mapping().get(key)
        return None if value is None else Node(self.file, (*self.keys, key), value)

    def items(self) -> Iterator[tuple[str, "Node"]]:
        """Iterate over the keys and values of an object."""
        for key, value in self.mapping().items():
            if not isinstance(key, str):  # YAML keys may have any type
                raise self.fault(f"found the key {shown(key)}, expected text")
            if len(key) > LONGEST_KEY:
                raise self.fault(f"found a key of {len(key)} characters ({shown(key)}), expected at most {LONGEST_KEY}")
            if not is_unicode(key):
                raise self.fault(f"found the key {shown(key)}, which has half of a surrogate pair, expected Unicode")
            yield key, Node(self.file, (*self.keys, key), value)

    def elements(self) -> Iterator["Node"]:
        """Iterate over the elements of a list."""
        for i, value in enumerate(self.sequence()):
            yield Node(self.file, (*self.keys, str(i)), value)

    def mapping(self) -> dict[str, Any]:
        """Return the value as an object, or raise InputError."""
        if type(self.value) is not dict:
            raise self.unexpected("an object")
        return self.value

    def sequence(self) -> list[Any]:
        """Return the value as a list, or raise InputError."""
        if type(self.value) is not list:
            raise self.unexpected("a list")
        return self.value

    def text(self) -> str:
        """Return the value as text, or raise InputError."""
        if type(self.value) is not str:
            raise self.unexpected("text")
        if not is_unicode(self.value):
            raise self.unexpected("text in Unicode, without halves of surrogate pairs")
        return self.value

    def name(self) -> str:
        """Return the value as text that is not empty, or raise InputError."""
        if not self.text():
            raise self.unexpected("a name")
        return self.text()

    def flag(self) -> bool:
        """Return the value as a boolean, or raise InputError."""
        if type(self.value) is not bool:
            raise self.unexpected("true or false")
        return self.value

    def number(self) -> float:
        """Return the value as a finite number, or raise InputError."""
        try:
            if type(self.value) in (int, float) and math.isfinite(self.value):
                return float(self.value)
        except OverflowError:  # an integer beyond the range of floats
            pass
        raise self.unexpected("a finite number")

    def within(self, low: float, high: float) -> float:
        """Return the value as a number from ``low`` to ``high``, or raise InputError."""
        number = self.number()
        if not low <= number <= high:
            raise self.unexpected(f"a number from {low:g} to {high:g}")
        return number

    def whole(self, low: int, high: int) -> int:
        """Return the value as an integer from ``low`` to ``high``, or raise InputError."""
        number = self.number()
        if number != int(number) or not low <= number <= high:
            raise self.unexpected(f"a whole number from {low} to {high}")
        return int(number)

    def numbers(self, count: int) -> list[float]:
        """Return the value as a list of ``count`` finite numbers, or raise InputError."""
        if len(self.sequence()) != count:
            raise self.unexpected(f"a list of {count} numbers")
        if set(map(type, self.value)) == {float} and all(map(math.isfinite, self.value)):  # the usual case, faster
            return list(self.value)
        return [element.number() for element in self.elements()]

    def unexpected(self, expected: str) -> InputError:
        """Return the error for an unexpected value: what was found and what was expected."""
        return self.fault(f"found {shown(self.value)}, expected {expected}")

    def fault(self, message: str) -> InputError:
        """Return a one-line error with the location of this value and a message."""
        where = "/".join(_shorten_value(str(key)) for key in self.keys)  # keys of YAML may be numbers
        return InputError(f"{self.file}: {where}: {message}" if where else f"{self.file}: {message}")


def is_unicode(text: str) -> bool:
    r"""Return whether a text has no half of a surrogate pair (``"\ud800"``), which cannot be written in UTF-8."""
    if text.isascii():
        return True
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def finite_numbers(values: list[Any]) -> Array | None:
    """Convert a list to an array of finite numbers, checked all at once; None if an element is another value.

    Texts and booleans, which numpy takes for numbers, are other values. The caller looks for the element to report it.
    """
    if not set(map(type, values)) <= {int, float}:
        return None
    try:
        found: Array = np.array(values, float)
    except OverflowError:  # an integer beyond the range of floats
        return None
    return found if np.isfinite(found).all() else None


def read_json(path: Path, max_bytes: int = MAX_BYTES, what: str = "a JSON document") -> Node:
    """Read a JSON file of at most ``max_bytes`` and return its root; ``what`` describes it in messages.

    Raises:
        InputError: the file cannot be read, is not JSON, or its top level is not an object.
    """
    return parse_document(read_bytes(path, max_bytes, what), path)


def parse_document(data: bytes, path: Path) -> Node:
    """Return the root of a JSON document; the path is for messages.

    Raises:
        InputError: it is not JSON, or its top level is not an object.
    """
    root = Node(path, (), None)
    try:
        root.value = parse_json(data, finite=False)
    except json.JSONDecodeError as error:
        _refuse_json(root, error)
    except RepeatedKeyError as error:
        raise root.fault(str(error)) from None
    except UnicodeDecodeError as error:
        raise root.fault(f"byte {error.start}: found no UTF-8 text, expected JSON") from None
    except RecursionError:
        raise root.fault("nested too deeply") from None
    except (ValueError, MemoryError) as error:  # such as an integer of thousands of digits
        raise root.fault(f"cannot be read as JSON: {error}") from None
    root.mapping()
    return root


_JSON_WORDS = ("true", "false", "null", "NaN", "Infinity", "-Infinity", ".", "e+", "e-", "E+", "E-")
"""Words of JSON other than strings, digits and brackets."""


def _refuse_json(root: Node, error: json.JSONDecodeError) -> NoReturn:
    if not error.doc.strip():
        raise root.fault("found an empty file, expected JSON") from None
    place = f"line {error.lineno}, column {error.colno}"
    rest = error.doc[error.pos :].rstrip()
    if error.msg.startswith("Unterminated string") or any(word.startswith(rest) for word in _JSON_WORDS):
        raise root.fault(f"{place}: the file ends in the middle of its JSON; is it truncated?") from None
    raise root.fault(f"{place}: not JSON: {error.msg}") from None


def shown(value: Any) -> str:
    """Format a value of a document for an error message, shortened."""
    match value:
        case None | True | False:
            return {None: "null", True: "true", False: "false"}[value]
        case dict():
            return f"an object of {len(value)} keys" if value else "an empty object"
        case list():
            return f"a list of {len(value)}" if value else "an empty list"
        case int() if abs(value) > 10**20:
            return "a huge integer"
        case str():
            return f"'{_shorten_value(value)}'"
    return _shorten_value(str(value))


def _shorten_value(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:77]}..."


class MissingFileError(InputError):
    """A data file is missing; the message is its name."""


def locate_existing(name: Node) -> str:
    """Return the path of a ``data_file``, like `locate`, and check that it exists.

    Raises:
        MissingFileError: there is no such file.
        InputError: as `locate`.
    """
    path = locate(name)
    try:
        os.stat(path)  # noqa: PTH116 (called for every cloud)
    except FileNotFoundError:
        raise MissingFileError(name.text()) from None
    except (OSError, ValueError):  # the reader reports why it cannot be opened
        pass
    return path


def locate(name: Node) -> str:
    """Return the path of a ``data_file``, which must be in the dataset's folder, with symbolic links resolved.

    Raises:
        InputError: the name is not a relative path, or leaves the folder.
    """
    file, folder = name.name(), name.file.parent
    try:
        path = os.path.join(folder, file)  # noqa: PTH118 (called for every cloud)
        if "/" not in file and file not in (".", "..") and not os.path.islink(path):  # noqa: PTH114
            return path
        if not os.path.isabs(file) and ".." not in Path(file).parts:  # noqa: PTH117
            real = Path(path).resolve()
            if real.is_relative_to(folder.resolve()):
                return str(real)
    except (ValueError, OSError, RuntimeError):  # a NUL or a lone surrogate; too long; a loop of links
        pass
    raise name.fault(f"found {shown(file)}, expected a file in the dataset's folder")
