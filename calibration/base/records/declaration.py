"""Declaration of records: frozen dataclasses whose fields define the content of a document."""

import dataclasses
import math
import re
import typing
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar, dataclass_transform

from calibration.base.errors import CalibrationError, InputError
from calibration.base.text import did_you_mean, shorten

_MAX_LISTED_NUMBERS = 3
"""Limit of the numbers of a list in a message."""


class Misfit(ValueError):  # noqa: N818 (it becomes an error for users where the place is known)
    """Error for values that are valid alone and contradict each other; ``key`` is the one to change."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


@dataclass(frozen=True)
class Place:
    """Position in a document, for messages, with the context of reading."""

    where: str
    """The file, and the key in it if the document is a part of one."""
    keys: tuple[str, ...] = ()
    folder: Path = Path()
    """Base folder of relative paths."""
    error: type[CalibrationError] = InputError

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.where, ".".join(self.keys))))

    def below(self, key: object) -> "Place":
        """Return the position of a key or an item in this one."""
        return replace(self, keys=(*self.keys, str(key)))

    def fault(self, message: str) -> CalibrationError:
        """Return the error with this message."""
        return self.error(f"{self}: {message}")

    def unexpected(self, value: object, expected: str) -> CalibrationError:
        """Return the error with the found and the expected value."""
        return self.fault(f"found {shown(value)}, expected {expected}")

    def misfit(self, misfit: Misfit) -> CalibrationError:
        """Return the error about contradicting values."""
        return (self.below(misfit.key) if misfit.key else self).fault(str(misfit))


def shown(value: object) -> str:
    """Format a value for a message, shortened."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, dict):
        return f"a mapping of {len(value)} keys" if value else "an empty mapping"
    if isinstance(value, list) and not (1 < len(value) <= _MAX_LISTED_NUMBERS and all(map(is_number, value))):
        return f"a list of {len(value)}" if value else "an empty list"
    return shorten(repr(value))


def is_number(value: object) -> bool:
    """Whether a value is a finite number, not true or false."""
    try:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # integers beyond the range of floats
        return False


@dataclass(frozen=True, eq=False)
class Constraint:
    """Condition on a value of the right type."""

    holds: Callable[[Any], bool]
    expected: str
    """Text after "expected" in messages: ``a number of at least 0``; for numbers and lists without the type."""
    schema: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """The condition as keywords of JSON Schema."""
    whole: bool = False
    """Whether ``expected`` names the type too, so that messages do not."""
    secret: bool = False
    """Whether a wrong value may be a secret and must not be repeated in a message."""


@dataclass(frozen=True, eq=False)
class Converted:
    """Value whose form in the document differs from that in the record.

    ``make`` takes the value read as ``accepts``, and the position for messages; it raises an error for users.
    """

    accepts: Any
    make: Callable[[Any, Place], Any]
    described_as: Any = dataclasses.field(default=None, kw_only=True)
    """Additional keywords of the schema, beyond ``accepts``."""


@dataclass(frozen=True, eq=False)
class ByName:
    """Tuple of records that is a mapping in the document, whose keys are their dataclass_field ``name``."""

    names: Constraint | None = None


def between(least: float, most: float) -> Constraint:
    """Constrain numbers to ``least`` to ``most``, both included."""
    schema = {"minimum": least, "maximum": most}
    return Constraint(lambda value: least <= value <= most, f"from {least:g} to {most:g}", schema)


def at_least(least: float) -> Constraint:
    """Constrain numbers to at least ``least``."""
    return Constraint(lambda value: value >= least, f"of at least {least:g}", {"minimum": least})


def above(limit: float, most: float | None = None) -> Constraint:
    """Constrain numbers to more than ``limit``, and at most ``most``."""
    schema = {"exclusiveMinimum": limit} | ({} if most is None else {"maximum": most})
    text = f"above {limit:g}" if most is None else f"above {limit:g} and of at most {most:g}"
    return Constraint(lambda value: limit < value and (most is None or value <= most), text, schema)


def matching(pattern: str, expected: str, *, secret: bool = False) -> Constraint:
    """Constrain text to full matches of a regular expression."""
    schema = {"pattern": f"^(?:{pattern})$" if "|" in pattern else f"^{pattern}$"}
    fits = lambda value: re.fullmatch(pattern, value) is not None  # noqa: E731 (compiled for the first value)
    return Constraint(fits, expected, schema, whole=True, secret=secret)


def length(least: int = 0, most: int | None = None) -> Constraint:
    """Constrain the length of text, lists and mappings to ``least`` to ``most``."""

    def holds(value: Any) -> bool:
        return least <= len(value) and (most is None or len(value) <= most)

    if most is None:
        expected = "that is not empty" if least == 1 else f"of at least {least}"
    else:
        expected = f"of {least}" if least == most else f"of {least} to {most}" if least else f"of at most {most}"
    return Constraint(holds, expected, {"length": (least, most)})


UNIQUE = Constraint(lambda value: len(set(value)) == len(value), "without duplicates", {"uniqueItems": True})
"""Lists without duplicates."""


_Class = TypeVar("_Class", bound=type)
_Getter = TypeVar("_Getter", bound=Callable[[Any], Any])
_SETTINGS_ATTRIBUTE = "__record__"
_METADATA_KEY = "record"


@dataclass(frozen=True)
class Rule:
    """Condition on the keys of a document."""

    fault: Callable[[Collection[str]], str | None]
    """Function that returns the error in these keys; None if there is none."""
    schema: Mapping[str, Any]
    """The condition as keywords of JSON Schema."""


@dataclass(frozen=True)
class Settings:
    """Properties of a record as a whole."""

    case: Literal["kebab", "snake"] = "kebab"
    nulls: bool = False
    """Whether None is written as null, and null is read as an absent key; else null is rejected."""
    unknown: Literal["refuse", "ignore"] = "refuse"
    rules: tuple[Rule, ...] = ()


@dataclass(frozen=True)
class Declared:
    """Field of a record that is part of its document."""

    name: str
    key: str
    type: Any
    """Type, including the content of ``Annotated``."""
    help: str
    default: Any
    """Default value; `dataclasses.MISSING` if the key is required."""
    implied: Any
    """Document value equivalent to an absent key; `dataclasses.MISSING` if ``default`` is the value itself."""
    flat: bool
    option: bool | str
    """Whether the field is an option of a command; or the help of the option, if it differs."""
    omitted: bool
    """Whether the key is omitted for None, also in a record with ``nulls``."""
    formerly: str = ""
    """Former name of the option, which still works."""
    computed: bool = False
    """Whether it is a property, which is written and not read."""

    @property
    def required(self) -> bool:
        """Whether the key is required."""
        return self.default is MISSING and self.implied is MISSING and not self.flat


def field(
    help: str = "",  # noqa: A002 (click's word)
    *,
    default: Any = MISSING,
    default_factory: Any = MISSING,
    implied: Any = MISSING,
    key: str | None = None,
    unit: str | None = None,
    flat: bool = False,
    option: bool | str = True,
    omitted: bool = False,
    formerly: str = "",
    repr: bool = True,  # noqa: A002 (dataclasses' word)
) -> Any:
    """Declare a field of a record.

    Args:
        help: description in one sentence, for schemas, options and tables.
        default: value if the key is absent.
        default_factory: function that makes the default; the record itself in a flat field.
        implied: document value equivalent to an absent key, such as a path relative to the file.
        key: key in the document, if it differs from the field's name.
        unit: unit of the value; added to the help.
        flat: whether the keys of the nested record are keys of the outer record; with
            `Converted`, the keys of the record that it accepts. An optional flat record is present if one of its keys
            is.
        option: whether a command has an option for it; or the help of the option, if it differs.
        omitted: whether the key is omitted for None, also in a record with ``nulls``.
        formerly: former name of the option, which still works.
        repr: whether it is part of the record's ``repr``; False for possible secrets.
    """
    text = f"{help.removesuffix('.')}, {unit}." if unit else help
    declared = {"key": key, "help": text, "implied": implied, "flat": flat, "option": option, "omitted": omitted}
    declared["formerly"] = formerly
    metadata = {_METADATA_KEY: declared}
    if default_factory is not MISSING:
        return dataclasses.field(default_factory=default_factory, metadata=metadata, repr=repr)
    return dataclasses.field(default=default, metadata=metadata, repr=repr)


def computed(key: str | None = None) -> Callable[[_Getter], _Getter]:
    """Declare a property, written below ``@property``, as part of the document: its docstring's first line is the help.

    Args:
        key: key in the document, if it differs from the property's name.
    """

    def declare(getter: _Getter) -> _Getter:
        setattr(getter, _METADATA_KEY, key or getter.__name__)
        return getter

    return declare


@typing.overload
def record(cls: _Class, /) -> _Class: ...
@typing.overload
def record(
    *,
    case: Literal["kebab", "snake"] = "kebab",
    nulls: bool = False,
    unknown: Literal["refuse", "ignore"] = "refuse",
    rules: tuple[Rule, ...] = (),
    **options: bool,
) -> Callable[[_Class], _Class]: ...
@dataclass_transform(frozen_default=True, field_specifiers=(field, dataclasses.field))
def record(cls: Any = None, /, **settings: Any) -> Any:
    """Make a class a record: a frozen dataclass that can be read, written and described as a schema.

    Args:
        cls: the class; its docstring describes the document.
        settings: see `Settings`; all others are those of `dataclasses.dataclass`.
    """

    def declare(cls: Any) -> Any:
        own = {name: settings[name] for name in Settings.__dataclass_fields__.keys() & settings.keys()}
        others = {name: value for name, value in settings.items() if name not in own}
        made = dataclass(frozen=True, **others)(cls)
        setattr(made, _SETTINGS_ATTRIBUTE, Settings(**own))
        return made

    return declare if cls is None else declare(cls)


@typing.overload
def result(cls: _Class, /) -> _Class: ...
@typing.overload
def result(**options: bool) -> Callable[[_Class], _Class]: ...
@dataclass_transform(frozen_default=True, field_specifiers=(field, dataclasses.field))
def result(cls: Any = None, /, **options: Any) -> Any:
    """Make a class a record of results: keys in snake_case, null for None; unknown keys of newer versions are ignored.

    Args:
        cls: the class; its docstring describes the document.
        options: those of `dataclasses.dataclass`.
    """
    declare = record(case="snake", nulls=True, unknown="ignore", **options)
    return declare if cls is None else declare(cls)


def with_fields(fields: Mapping[str, tuple[Any, Any]]) -> Callable[[_Class], _Class]:
    """Add fields to a class, below ``@record``, which are known only at run time, such as those of add-ons.

    Args:
        fields: type and `field` by name.
    """

    def add(cls: _Class) -> _Class:
        cls.__annotations__ = {**cls.__annotations__, **{name: kind for name, (kind, _) in fields.items()}}
        for name, (_, declared) in fields.items():
            setattr(cls, name, declared)
        return cls

    return add


def is_record(kind: Any) -> bool:
    """Return whether a type is a record."""
    return isinstance(kind, type) and hasattr(kind, _SETTINGS_ATTRIBUTE)


def settings_of(kind: Any) -> Settings:
    """Return the properties of a record as a whole."""
    found: Settings = getattr(kind, _SETTINGS_ATTRIBUTE)
    return found


@cache
def fields_of(kind: Any) -> tuple[Declared, ...]:
    """Return the fields of a record that are part of its document, in order, then its computed properties."""
    types = typing.get_type_hints(kind, include_extras=True)
    kebab = settings_of(kind).case == "kebab"
    found = []
    for each in dataclasses.fields(kind):
        if (declared := each.metadata.get(_METADATA_KEY)) is None:
            continue
        default = each.default if each.default_factory is MISSING else each.default_factory()
        key = declared["key"] or (each.name.replace("_", "-") if kebab else each.name)
        details = {name: declared[name] for name in ("help", "implied", "flat", "option", "omitted", "formerly")}
        found.append(Declared(each.name, key, types[each.name], default=default, **details))
    return (*found, *_computed_fields(kind))


def _computed_fields(kind: Any) -> list[Declared]:
    members = {name: member for base in reversed(kind.__mro__) for name, member in vars(base).items()}
    found = []
    for name, member in members.items():
        getter = member.func if isinstance(member, cached_property) else getattr(member, "fget", None)
        if (key := getattr(getter, _METADATA_KEY, None)) is not None:
            help_, result = (getter.__doc__ or "").split("\n")[0], typing.get_type_hints(getter, include_extras=True)
            found.append(
                Declared(name, key, result["return"], help_, MISSING, MISSING, False, False, False, computed=True)
            )
    return found


def flat_fields(kind: Any) -> dict[str, Declared]:
    """Return the fields by key; flat records are replaced by their fields."""
    found: dict[str, Declared] = {}
    for each in fields_of(kind):
        found |= flat_fields(flat_record(each)[0]) if each.flat else {each.key: each}
    return found


def flat_record(each: Declared) -> tuple[Any, Converted | None]:
    """Return the record whose keys a flat field has, and its conversion, if there is one."""
    extras = typing.get_args(each.type)[1:] if typing.get_origin(each.type) is typing.Annotated else ()
    converted = next((extra for extra in extras if isinstance(extra, Converted)), None)
    return (converted.accepts if converted else bare(each.type)), converted


def bare(kind: Any) -> Any:
    """Return a type without the content of ``Annotated``, and without None beside a record."""
    if typing.get_origin(kind) is typing.Annotated:
        return bare(typing.get_args(kind)[0])
    return next(filter(is_record, typing.get_args(kind)), kind)


def excludes(first: str, second: str) -> Rule:
    """Rule that two keys exclude each other."""
    return Rule(
        lambda keys: f"{first} and {second} exclude each other" if {first, second} <= set(keys) else None,
        {"not": {"required": [first, second]}},
    )


def needs(key: str, other: str, why: str = "") -> Rule:
    """Rule that a key requires another one."""
    fault = why or f"{key} needs {other}: say {other} too"
    return Rule(
        lambda keys: fault if key in keys and other not in keys else None, {"dependentRequired": {key: [other]}}
    )


def one_of(*names: str, why: str) -> Rule:
    """Rule that at least one of some keys is present; ``why`` is the message."""
    return Rule(
        lambda keys: None if any(name in keys for name in names) else why,
        {"anyOf": [{"required": [name]} for name in names]},
    )


def exactly_one(*names: str) -> Rule:
    """Rule that exactly one of some keys is present."""

    def fault(keys: Collection[str]) -> str | None:
        found = [name for name in names if name in keys]
        return (
            None if len(found) == 1 else f"found {' and '.join(found) or 'nothing'}, expected one of {', '.join(names)}"
        )

    return Rule(fault, {"oneOf": [{"required": [name]} for name in names]})


def unknown_key(key: object, known: Collection[str]) -> str:
    """Return the message about an unknown key."""
    return f"unknown key {shorten(repr(key))}{did_you_mean(str(key), known)} (known: {', '.join(known)})"
