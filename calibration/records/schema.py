"""JSON Schemas of records, for editors and for programs that read what we write."""

import json
import typing
from collections.abc import Mapping
from dataclasses import MISSING
from pathlib import Path
from types import NoneType, UnionType
from typing import Any

from calibration.records.constraints import ByName, Constraint, Converted
from calibration.records.declaration import Declared, fields_of, is_record, settings_of
from calibration.records.writing import value_of

DIALECT = "https://json-schema.org/draft/2020-12/schema"
_TYPES = {
    str: "string",
    int: "integer",
    float: "number",
    bool: "boolean",
    Path: "string",
    dict: "object",
    list: "array",
}
_LENGTHS = {"string": "Length", "array": "Items", "object": "Properties"}


def schema_text(kind: type, title: str) -> str:
    """The text of the schema of a record, as it ships."""
    return json.dumps({"$schema": DIALECT, "title": title, **schema_of(kind)}, indent=2, ensure_ascii=False) + "\n"


def schema_of(kind: Any) -> dict[str, Any]:
    """The schema of a record, or of any type that a field of a record may have."""
    if is_record(kind):
        return _of_record(kind)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return _annotated(arguments[0], arguments[1:])
    if origin in (typing.Union, UnionType):
        return _union([schema_of(each) for each in arguments if each is not NoneType])
    if origin is typing.Literal:
        return {"enum": list(arguments)}
    if origin is tuple:
        return {"type": "array", "items": schema_of(arguments[0])}
    if origin is not None:
        names = {key: value for key, value in schema_of(arguments[0]).items() if key != "type"}
        schema: dict[str, Any] = {"type": "object"} | ({"propertyNames": names} if names else {})
        return schema | {"additionalProperties": schema_of(arguments[1])}
    return {"type": _TYPES[kind]} | ({"minLength": 1} if kind is Path else {})


def _annotated(base: Any, extras: tuple[Any, ...]) -> dict[str, Any]:
    special = next((each for each in extras if isinstance(each, Converted | ByName)), None)
    if isinstance(special, ByName):
        schema: dict[str, Any] = {"type": "object", "minProperties": 1}
        schema |= {"propertyNames": dict(special.names.schema)} if special.names else {}
        return schema | {"additionalProperties": schema_of(typing.get_args(base)[0])}
    if special is not None:
        return schema_of(special.described_as or special.accepts)
    schema = schema_of(base)
    for extra in extras:
        if isinstance(extra, Constraint):
            schema |= _keywords(extra.schema, schema.get("type"))
    return schema


def _keywords(keywords: Mapping[str, Any], kind: Any) -> dict[str, Any]:
    if "length" not in keywords:
        return dict(keywords)
    noun = _LENGTHS[str(kind)]
    limits = zip(("min", "max"), keywords["length"], strict=True)
    return {f"{side}{noun}": limit for side, limit in limits if limit}


def _union(members: list[dict[str, Any]]) -> dict[str, Any]:
    if len(members) == 1:
        return members[0]
    if all(member.keys() == {"type"} for member in members):
        return {"type": [member["type"] for member in members]}
    return {"anyOf": members}


def _of_record(kind: Any) -> dict[str, Any]:
    settings = settings_of(kind)
    schema: dict[str, Any] = {"description": " ".join((kind.__doc__ or "").split("\n\n")[0].split()), "type": "object"}
    if settings.unknown == "refuse":
        schema["additionalProperties"] = False
    properties: dict[str, Any] = {}
    required: list[str] = []
    rules: list[Mapping[str, Any]] = []
    _collect(kind, properties, required, rules)
    if required:
        schema["required"] = required
    schema |= _together(rules)
    return {**schema, "properties": properties}


def _collect(kind: Any, properties: dict[str, Any], required: list[str], rules: list[Mapping[str, Any]]) -> None:
    """The properties of a record, and of the records that are flat in it."""
    rules += [rule.schema for rule in settings_of(kind).rules]
    nulls = settings_of(kind).nulls
    for each in fields_of(kind):
        if each.flat:
            _collect(each.type, properties, required, rules)
            continue
        properties[each.key] = _property(each, nulls)
        if each.required:
            required.append(each.key)


def _property(each: Declared, nulls: bool) -> dict[str, Any]:
    schema = schema_of(each.type)
    if nulls and NoneType in typing.get_args(each.type):
        schema = _union([schema, {"type": "null"}])
    if each.help:
        schema = {"description": each.help, **{key: value for key, value in schema.items() if key != "description"}}
    default = value_of(each.default) if each.implied is MISSING else each.implied
    if isinstance(default, str | int | float | list) and default != [] and not isinstance(each.default, Path):
        schema["default"] = default
    return schema


def _together(rules: list[Mapping[str, Any]]) -> dict[str, Any]:
    """Rules as keywords; those that would hide each other stand in ``allOf``."""
    merged: dict[str, Any] = {}
    rest = []
    for rule in rules:
        if "dependentRequired" in rule:
            merged.setdefault("dependentRequired", {}).update(rule["dependentRequired"])
        elif merged.keys() & rule.keys():
            rest.append(dict(rule))
        else:
            merged |= rule
    return merged | ({"allOf": rest} if rest else {})
