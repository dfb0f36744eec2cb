"""Command line options generated from the fields of a record: name, type, limits and help."""

import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar

import click

from calibration.base.records import Constraint, Converted, flat_fields, read
from calibration.commands.parameters import (
    boolean_option,
    count,
    integer,
    list_of,
    non_negative,
    number,
    path,
    share,
    text,
)

_Record = TypeVar("_Record")
_Callback = TypeVar("_Callback", bound=Callable[..., Any])


def option_keys(kind: type) -> tuple[str, ...]:
    """Return the keys of a record, including its flat records, that are command line options."""
    return tuple(key for key, each in flat_fields(kind).items() if each.option is not False)


def record_options(
    kind: type,
    *keys: str,
    names: Mapping[str, str] | None = None,
    helps: Mapping[str, str] | None = None,
    required: bool = False,
) -> Callable[[_Callback], _Callback]:
    """Decorate a command with options for fields of a record; booleans become flags.

    Args:
        kind: type of the record.
        keys: keys of the fields, in the order of the options; by default all of `option_keys`.
        names: names of options that differ from their keys, by key.
        helps: help of options that differs from the field's, by key.
        required: whether the options of required fields are required.
    """
    fields = flat_fields(kind)

    def declare(command: _Callback) -> _Callback:
        for key in reversed(keys or option_keys(kind)):
            own = fields[key].option
            sentence = (helps or {}).get(key) or (own if isinstance(own, str) else fields[key].help)
            name, base = f"--{(names or {}).get(key, key)}", fields[key].type
            if bool in (base, *typing.get_args(base)):
                boolean_option(name, help=sentence, default=None)(command)
            else:
                needed = required and fields[key].required
                click.option(name, type=_type_of(base), help=sentence, required=needed)(command)
        return command

    return declare


def given(kind: type, options: Mapping[str, Any], *keys: str, names: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Convert values of options of `record_options` to a document; empty and missing options are omitted."""
    document = {}
    for key in keys or option_keys(kind):
        value = options.get((names or {}).get(key, key).replace("-", "_"))
        if value not in (None, ()):
            document[key] = list(dict.fromkeys(value)) if isinstance(value, tuple) else value
    return {key: str(value) if isinstance(value, Path) else value for key, value in document.items()}


def chosen(kind: type[_Record], options: Mapping[str, Any], **more: Any) -> _Record:
    """Convert the options of a command to a record of its inputs.

    Args:
        kind: type of the record, all of whose fields are options.
        options: options of the command.
        more: values of fields that are not options.

    Raises:
        InputError: an option is missing, or its value is wrong.
    """
    return read(kind, given(kind, options), "options", **more)


def _type_of(kind: Any, limits: tuple[Constraint, ...] = ()) -> Any:
    """Return click's type for values of a field's type."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        special = next((each for each in arguments if isinstance(each, Converted)), None)
        own = tuple(each for each in arguments if isinstance(each, Constraint))
        return _type_of(special.accepts if special else arguments[0], (*limits, *own))
    if origin in (typing.Union, UnionType):
        return _type_of(next(each for each in arguments if each is not NoneType), limits)
    if origin is Literal:
        return click.Choice(list(dict.fromkeys(map(str, arguments))))
    if origin is tuple:
        return list_of(_type_of(arguments[0]))
    bounds = {name: value for limit in limits for name, value in limit.schema.items()}
    if kind is int:
        return count if bounds.get("minimum") == 1 else integer
    if kind is float:
        least, most = bounds.get("minimum"), bounds.get("maximum")
        return share if (least, most) == (0, 1) else non_negative if least == 0 else number
    return path if kind is Path else text
