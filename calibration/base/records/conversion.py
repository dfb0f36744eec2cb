"""Conversion of documents to records, and back; an error is one line with file, key, found and expected value."""

import json
import math
import typing
from collections.abc import Mapping
from dataclasses import MISSING, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar

from calibration.base.errors import CalibrationError, InputError
from calibration.base.records import declaration
from calibration.base.text import did_you_mean

_PLAIN_TYPES = frozenset({str, int, float, bool, type(None)})


def document_of(record: Any, *, defaults: bool = True) -> dict[str, Any]:
    """Return the document of a record: mappings, lists, texts, numbers.

    None is omitted, or null in a record with ``nulls``.

    Args:
        record: the record.
        defaults: whether values that are the default of their field are written.
    """
    kind: Any = type(record)
    nulls = declaration.settings_of(kind).nulls
    document: dict[str, Any] = {}
    for each in declaration.fields_of(kind):
        value = getattr(record, each.name)
        if not defaults and not each.flat and value == each.default:
            continue
        if each.flat:
            document |= {} if value is None else document_of(value, defaults=defaults)
        elif value is not None or (nulls and not each.omitted):
            document[each.key] = value_of(value, defaults=defaults)
    return document


def text_of(record: Any) -> str:
    """Return a record's document as JSON text, indented by two."""
    return json.dumps(document_of(record), indent=2, allow_nan=False) + "\n"


def value_of(value: Any, *, defaults: bool = True) -> Any:
    """Return the document value of a record's value; a number that is not finite, which JSON lacks, is null.

    Args:
        value: the value.
        defaults: as in `document_of`.
    """
    kind = type(value)
    if kind is float and not math.isfinite(value):
        return None
    if kind in _PLAIN_TYPES:  # nearly all are
        return value
    if declaration.is_record(kind):
        return document_of(value, defaults=defaults)
    if isinstance(value, Mapping):
        return {key: value_of(each, defaults=defaults) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [value_of(each, defaults=defaults) for each in value]
    return str(value) if isinstance(value, Path) else value


_Record = TypeVar("_Record")
_NOUN_OF_TYPE = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    Path: "a path",
    dict: "keys",
}


def read(
    kind: type[_Record],
    document: object,
    where: str,
    folder: Path | None = None,
    error: type[CalibrationError] = InputError,
    **more: Any,
) -> _Record:
    """Read a document as a record.

    Args:
        kind: the record.
        document: parsed document: mappings, lists, texts, numbers, booleans.
        where: prefix of messages: the file, and the key in it if the document is a part of one.
        folder: base folder of relative paths; None leaves them unchanged.
        error: class of the error; `InfrastructureError` for documents that are not written by users.
        more: values of fields that are not part of the document, such as ``name``.

    Raises:
        InputError: one line that names the file, the key, what was found and what was expected.
    """
    found: _Record = _read_record(kind, document, declaration.Place(where, folder=folder or Path(), error=error), more)
    return found


def changed(record: _Record, document: Mapping[str, Any], where: str, folder: Path | None = None) -> _Record:
    """Return a record with the values of a document in place of its own.

    Args:
        record: the record.
        document: some of its keys, including those of flat records.
        where: prefix of messages.
        folder: base folder of relative paths; None leaves them unchanged.

    Raises:
        InputError: as `read`.
    """
    place = declaration.Place(where, folder=folder or Path())
    values: dict[str, Any] = {}
    kind: Any = type(record)
    for each in declaration.fields_of(kind):
        if each.flat:
            values[each.name] = changed(getattr(record, each.name), document, where, folder)
        elif each.key in document and not each.computed:
            values[each.name] = read_as(each.type, document[each.key], place.below(each.key))
    made: _Record = replace(typing.cast("Any", record), **values)
    return made


def read_as(kind: Any, value: object, place: declaration.Place) -> Any:
    """Read a value as any type that a field of a record may have.

    Raises:
        InputError: as `read`.
    """
    base, extras = _split_annotated(kind)
    for extra in extras:
        if isinstance(extra, declaration.Converted):
            made = extra.make(read_as(extra.accepts, value, place), place)
            return _check_constraints(made, value, base, extras, place)
        if isinstance(extra, declaration.ByName):
            return _by_name(typing.get_args(base)[0], value, extra, place)
    return _check_constraints(_read_unchecked(base, value, extras, place), value, base, extras, place)


def _split_annotated(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return a type without ``Annotated``, and the content of that, innermost first."""
    if typing.get_origin(kind) is typing.Annotated:
        base, *extras = typing.get_args(kind)
        inner, more = _split_annotated(base)
        return inner, (*more, *extras)
    return kind, ()


def _read_unchecked(kind: Any, value: object, extras: tuple[Any, ...], place: declaration.Place) -> Any:
    origin = typing.get_origin(kind)
    if origin in (typing.Union, UnionType):
        return _read_union(kind, value, extras, place)
    if not fits(kind, value):
        raise _type_error(value, kind, extras, place)
    if declaration.is_record(kind):
        return _read_record(kind, value, place, {})
    if origin is tuple:
        item = typing.get_args(kind)[0]
        return tuple(read_as(item, each, place.below(i)) for i, each in enumerate(typing.cast("list[Any]", value)))
    if origin is not None and origin is not typing.Literal:
        names, item = typing.get_args(kind)
        mapping = typing.cast("dict[Any, Any]", value)
        return {
            str(_read_key(names, key, place)): read_as(item, each, place.below(key)) for key, each in mapping.items()
        }
    if kind is Path:
        return place.folder / str(value)
    return kind(value) if kind in (int, float) else value


def _read_key(kind: Any, key: object, place: declaration.Place) -> Any:
    try:
        return read_as(kind, key, place)
    except CalibrationError:
        if typing.get_origin(kind) is typing.Literal:
            raise place.fault(declaration.unknown_key(key, typing.get_args(kind))) from None
        expected = ", ".join(
            each.expected for each in _split_annotated(kind)[1] if isinstance(each, declaration.Constraint)
        )
        raise place.fault(f"found the key {declaration.shown(key)}, expected {expected or 'a text'}") from None


def _check_constraints(result: Any, value: object, kind: Any, extras: tuple[Any, ...], place: declaration.Place) -> Any:
    """Return the result after checking all constraints."""
    for extra in extras:
        if isinstance(extra, declaration.Constraint) and not extra.holds(result):
            if extra.secret:
                raise place.fault(f"expected {extra.expected}")
            raise _type_error(value, kind, extras, place)
    return result


def _type_error(value: object, kind: Any, extras: tuple[Any, ...], place: declaration.Place) -> CalibrationError:
    limits = [each for each in extras if isinstance(each, declaration.Constraint)]
    whole = next((each.expected for each in limits if each.whole), None)
    expected = whole or " ".join([expectation(kind), *(each.expected for each in limits)])
    if any(each.secret for each in limits):
        return place.fault(f"expected {expected}")
    hint = ""
    if typing.get_origin(kind) is typing.Literal and isinstance(value, str):
        hint = did_you_mean(value, [each for each in typing.get_args(kind) if isinstance(each, str)])
    if kind is str and isinstance(value, int | float):
        hint = ": put it in quotes"
    return place.unexpected(value, expected + hint)


def _read_union(kind: Any, value: object, extras: tuple[Any, ...], place: declaration.Place) -> Any:
    members = [each for each in typing.get_args(kind) if each is not NoneType]
    if len(members) > 1:
        fitting = [each for each in members if fits(each, value)]
        members = [each for each in fitting if _is_literal_of(each, value)] or fitting
    if not members:
        raise _type_error(value, kind, extras, place)
    return read_as(members[0], value, place)


def _is_literal_of(kind: Any, value: object) -> bool:
    return typing.get_origin(kind) is typing.Literal and value in typing.get_args(kind)


def fits(kind: Any, value: object) -> bool:
    """Return whether a value has the form that a type is read from; its content may still be invalid."""
    base, extras = _split_annotated(kind)
    if (other := next((each for each in extras if isinstance(each, declaration.Converted)), None)) is not None:
        return fits(other.accepts, value)
    origin = typing.get_origin(base)
    if origin in (typing.Union, UnionType):
        return any(fits(each, value) for each in typing.get_args(base))
    if origin is typing.Literal:
        return any(type(value) is type(each) and value == each for each in typing.get_args(base))
    if declaration.is_record(base) or base is dict or any(isinstance(each, declaration.ByName) for each in extras):
        return isinstance(value, dict)
    if origin is tuple or base is list:
        return isinstance(value, list)
    if origin is not None:
        return isinstance(value, dict)
    if base in (int, float):
        return declaration.is_number(value) and (base is float or value == int(typing.cast("float", value)))
    return value != "" and isinstance(value, str) if base is Path else isinstance(value, base)


def expectation(kind: Any) -> str:
    """Describe the expected value of a type for a message: ``a number``."""
    base, extras = _split_annotated(kind)
    for extra in extras:
        if isinstance(extra, declaration.Converted):
            return expectation(extra.accepts)
        if isinstance(extra, declaration.Constraint) and extra.whole:
            return extra.expected
    origin = typing.get_origin(base)
    if origin in (typing.Union, UnionType):
        return _join_with_or([expectation(each) for each in typing.get_args(base) if each is not NoneType])
    if origin is typing.Literal:
        return _join_with_or([str(each) for each in typing.get_args(base)])
    if declaration.is_record(base):
        return f"keys: {', '.join(declaration.flat_fields(base))}"
    return _NOUN_OF_TYPE.get(base) or ("a list" if origin is tuple or base is list else "keys and values")


def _join_with_or(texts: list[str]) -> str:
    texts = list(dict.fromkeys(texts))
    return " or ".join(filter(None, (", ".join(texts[:-1]), texts[-1])))


def _by_name(kind: Any, value: object, extra: declaration.ByName, place: declaration.Place) -> tuple[Any, ...]:
    if not isinstance(value, dict) or not value:
        raise place.unexpected(value, "a mapping of names, at least one")
    for name in value:
        if not isinstance(name, str) or (extra.names and not extra.names.holds(name)):
            expected = extra.names.expected if extra.names else "a text"
            hint = "" if isinstance(name, str) else ": put it in quotes"
            raise place.fault(f"found the name {declaration.shown(name)}, expected {expected}{hint}")
    return tuple(_read_record(kind, each, place.below(name), {"name": name}) for name, each in value.items())


def _read_record(kind: Any, document: object, place: declaration.Place, more: Mapping[str, Any]) -> Any:
    if not isinstance(document, dict):
        raise place.unexpected(document, expectation(kind))
    known = declaration.flat_fields(kind)
    for key in document:
        if key not in known and declaration.settings_of(kind).unknown == "refuse":
            raise place.fault(declaration.unknown_key(key, list(known)))
    _check_rules(kind, document, place)
    return _build_record(kind, document, place, more)


def _check_rules(kind: Any, document: Mapping[str, Any], place: declaration.Place) -> None:
    nulls = declaration.settings_of(kind).nulls
    keys = [key for key, value in document.items() if value is not None or not nulls]
    for rule in declaration.settings_of(kind).rules:
        if (fault := rule.fault(keys)) is not None:
            raise place.fault(fault)


def _may_be_null(each: declaration.Declared) -> bool:
    return not each.required or NoneType in typing.get_args(each.type)


def _build_record(kind: Any, document: Mapping[str, Any], place: declaration.Place, more: Mapping[str, Any]) -> Any:
    """Build the record from those keys of the document that are its own."""
    values = dict(more)
    nulls = declaration.settings_of(kind).nulls
    for each in declaration.fields_of(kind):
        if each.computed:
            continue
        if each.flat:
            flat, converted = declaration.flat_record(each)
            if each.default is None and not declaration.flat_fields(flat).keys() & document.keys():
                continue
            _check_rules(flat, document, place)
            made = _build_record(flat, document, place, {})
            values[each.name] = converted.make(made, place) if converted else made
        elif each.key in document and not (nulls and document[each.key] is None and _may_be_null(each)):
            values[each.name] = read_as(each.type, document[each.key], place.below(each.key))
        elif each.key in document and NoneType in typing.get_args(each.type):
            values[each.name] = None
        elif each.implied is not MISSING:
            values[each.name] = read_as(each.type, each.implied, place.below(each.key))
        elif each.default is MISSING:
            raise place.fault(f"missing key '{each.key}'")
    try:
        return kind(**values)
    except declaration.Misfit as misfit:
        raise place.misfit(misfit) from None
