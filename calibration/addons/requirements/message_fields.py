"""Fields of a message, read from its bytes: only those that are wanted, by the definition of its type.

Types of the team's own are read too. The library rosbags generates program code from definitions, which a bag's may not
reach; here a definition is only walked, and every size that a message states is held against its bytes.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from calibration.base import InputError, did_you_mean

FieldTree: TypeAlias = Mapping[str, "FieldTree"]
"""Wanted fields by name, each with those wanted of it; of an empty tree all are wanted."""
Definitions: TypeAlias = Mapping[str, tuple[Sequence[Any], Sequence[Any]]]
"""Constants and fields of each type, as the library rosbags parses them."""
MAX_TYPES_NESTED = 20
"""Limit of types inside one another; a definition may name itself."""
MAX_ITEMS = 1_000_000
"""Limit of the values in one message that are walked one by one: messages in it, and items of arrays of these."""
_NUMPY_CODE = {
    "bool": "?",
    "byte": "i1",
    "char": "u1",
    "octet": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_STRUCT_CODE = dict(zip(["?", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8"], "?BbHhIiQqfd", strict=True))
"""Letters of the module struct, whose sizes are the same on every machine with an order of bytes."""
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
"""Kinds of a field's type, numbers of the library's ``Nodetype``."""
_Read: TypeAlias = Callable[["_Bytes"], Any]


class MessageError(Exception):
    """A message does not have the bytes that its type says."""


class _Bytes:
    """Position in the bytes of a message."""

    __slots__ = ("data", "items", "order", "origin", "position")

    def __init__(self, data: bytes, position: int, order: str) -> None:
        self.data = data
        self.position = position
        self.origin = position
        self.order = order
        self.items = 0

    def align(self, size: int) -> None:
        """Move to the next multiple of a size, from the end of the encapsulation header."""
        self.position += -(self.position - self.origin) % size

    def take(self, size: int) -> int:
        """Move beyond some bytes, and return where they begin."""
        begin = self.position
        self.position = begin + size
        if self.position > len(self.data):
            raise MessageError(f"found {len(self.data)} bytes, expected at least {self.position}")
        return begin

    def count(self, items: int) -> int:
        """Count items that are walked one by one."""
        self.items += items
        if self.items > MAX_ITEMS:
            raise MessageError(f"found more than {MAX_ITEMS} items in arrays, expected fewer")
        return items


@dataclass(frozen=True)
class _Walker:
    """How a value is read, and how it is skipped."""

    read: _Read
    skip: Callable[[_Bytes], None]


class FieldReader:
    """Reader of the wanted fields of messages of one type.

    Args:
        kind: the type, such as "sensor_msgs/msg/Imu".
        definitions: of it, and of the types in it.
        wanted: the fields.
        ros: version of ROS, 1 or 2: how the bytes are laid out.

    Raises:
        InputError: a definition is missing, or a wanted field; the message says what there is.
    """

    def __init__(self, kind: str, definitions: Definitions, wanted: FieldTree, ros: int) -> None:
        self._definitions = definitions
        self._cdr = ros == 2
        self._whole: dict[tuple[str, bool], _Walker] = {}
        """Walkers of types of which all is read, or nothing."""
        self._read = self._struct(kind, wanted, 0).read if wanted else None

    def fields(self, data: bytes) -> dict[str, Any]:
        """Return the wanted fields of a message: numbers, texts, arrays of numpy, lists, and dicts of fields.

        Raises:
            MessageError: it is too short.
        """
        if self._read is None:
            return {}
        try:
            found: dict[str, Any] = self._read(
                _Bytes(data, 4, "<" if data[1] & 1 else ">") if self._cdr else _Bytes(data, 0, "<")
            )
        except (IndexError, struct.error):
            raise MessageError(f"found {len(data)} bytes, expected more") from None
        return found

    def _struct(self, kind: str, wanted: FieldTree | None, depth: int) -> _Walker:
        """Return what reads a message: ``wanted`` is None where it is skipped only."""
        key = (kind, wanted is None)
        if not wanted and depth and key in self._whole:
            return self._whole[key]
        if depth > MAX_TYPES_NESTED:
            raise InputError(f"{kind}: found more than {MAX_TYPES_NESTED} types inside one another, expected fewer")
        if kind not in self._definitions:
            raise InputError(f"{kind}: there is no definition of this type in the bag, and it is none of ROS's own")
        constants, fields = self._definitions[kind]
        values = {name: value for name, _, value in constants}
        names = [name for name, _ in fields]
        for name in wanted or ():
            if name not in values and name not in names:
                known = ", ".join(names) or "none"
                raise InputError(f"{kind}: it has no field '{name}'{did_you_mean(name, names)} (fields: {known})")
        given = {name: values[name] for name in wanted or () if name in values and name not in names}
        steps: list[tuple[str | None, _Read]] = []
        skips: list[Callable[[_Bytes], None]] = []
        for name, node in fields:
            needed = wanted is not None and (not wanted or name in wanted)
            walker = self._field(node, (wanted or {}).get(name, {}) if needed else None, depth)
            steps.append((name, walker.read) if needed else (None, walker.skip))
            skips.append(walker.skip)
        while depth == 0 and steps and steps[-1][0] is None:  # nothing follows a whole message
            steps.pop()

        def read(source: _Bytes) -> dict[str, Any]:
            source.count(1)
            found = dict(given)
            for name, step in steps:
                if name is None:
                    step(source)
                else:
                    found[name] = step(source)
            return found

        def skip(source: _Bytes) -> None:
            source.count(1)
            for step in skips:
                step(source)

        walker = _Walker(read, skip)
        if not wanted and depth:
            self._whole[key] = walker
        return walker

    def _field(self, node: Any, wanted: FieldTree | None, depth: int) -> _Walker:
        code, about = int(node[0]), node[1]
        if code == _NAME:
            return self._struct(about, wanted, depth + 1)
        if code == _BASE:
            if wanted:
                raise InputError(f"found '{next(iter(wanted))}' of a {about[0]}, which has no fields")
            return self._text() if about[0] == "string" else self._number(about[0])
        item, size = about
        fixed = size if code == _ARRAY else None
        if int(item[0]) == _BASE and item[1][0] != "string":
            if wanted:
                raise InputError(f"found '{next(iter(wanted))}' of an array of {item[1][0]}, which has no fields")
            return self._numbers(item[1][0], fixed)
        return self._items(self._field(item, wanted, depth), fixed)

    def _number(self, kind: str) -> _Walker:
        if kind not in _NUMPY_CODE:
            raise InputError(f"a field of type {kind} is not read")
        size = np.dtype(_NUMPY_CODE[kind]).itemsize
        code = _STRUCT_CODE[_NUMPY_CODE[kind]]
        formats = {order: struct.Struct(order + code) for order in "<>"}
        cdr = self._cdr

        def read(source: _Bytes) -> Any:
            if cdr:
                source.align(size)
            return formats[source.order].unpack_from(source.data, source.take(size))[0]

        def skip(source: _Bytes) -> None:
            if cdr:
                source.align(size)
            source.take(size)

        return _Walker(read, skip)

    def _length(self) -> Callable[[_Bytes], int]:
        return self._number("uint32").read

    def _text(self) -> _Walker:
        length, end = self._length(), 1 if self._cdr else 0

        def skip(source: _Bytes) -> None:
            source.take(length(source))

        def read(source: _Bytes) -> str:
            size = length(source)
            begin = source.take(size)
            return source.data[begin : begin + max(size - end, 0)].decode("utf-8", "replace")

        return _Walker(read, skip)

    def _numbers(self, kind: str, fixed: int | None) -> _Walker:
        if kind not in _NUMPY_CODE:
            raise InputError(f"an array of type {kind} is not read")
        length, code, cdr = self._length(), _NUMPY_CODE[kind], self._cdr
        size = np.dtype(code).itemsize

        def begin(source: _Bytes) -> tuple[int, int]:
            count = length(source) if fixed is None else fixed
            if cdr and count:
                source.align(size)
            return count, source.take(count * size)

        def read(source: _Bytes) -> Any:
            count, first = begin(source)
            return np.frombuffer(source.data, source.order + code, count, first)

        def skip(source: _Bytes) -> None:
            begin(source)

        return _Walker(read, skip)

    def _items(self, item: _Walker, fixed: int | None) -> _Walker:
        length = self._length()

        def count(source: _Bytes) -> int:
            return source.count(length(source) if fixed is None else fixed)

        def read(source: _Bytes) -> list[Any]:
            return [item.read(source) for _ in range(count(source))]

        def skip(source: _Bytes) -> None:
            for _ in range(count(source)):
                item.skip(source)

        return _Walker(read, skip)


def merged_trees(trees: Sequence[FieldTree]) -> FieldTree:
    """Return the tree of what at least one of several trees wants."""
    if not all(trees):
        return {}
    names = dict.fromkeys(name for tree in trees for name in tree)
    return {name: merged_trees([tree[name] for tree in trees if name in tree]) for name in names}


def tree_of_path(path: str) -> FieldTree:
    """Return the tree of one field: ``pose.position.x``."""
    name, _, rest = path.partition(".")
    return {name: tree_of_path(rest) if rest else {}}
