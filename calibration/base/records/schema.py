"""JSON Schemas of records, for editors and for readers of our output."""

import json
import typing
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from pathlib import Path
from types import NoneType, UnionType
from typing import Any

from calibration.base.records import declaration
from calibration.base.records.conversion import value_of

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_SCHEMA_OF_TYPE = {
    str: "string",
    int: "integer",
    float: "number",
    bool: "boolean",
    Path: "string",
    dict: "object",
    list: "array",
}
_RECORD_KEY = "$record"
"""Temporary key with the name of the record, removed from the final schema."""
_OF_A_FIELD = ("description", "default")
_LENGTH_SUFFIX = {"string": "Length", "array": "Items", "object": "Properties"}


def schema_text(kind: type, title: str, head: type | None = None) -> str:
    """Return the published schema of a record; records that occur several times are in ``$defs``.

    Args:
        kind: the record.
        title: title of the schema.
        head: record whose keys precede those of the first in the same document.
    """
    schema = _of_record(kind, head) if head else _schema_of(kind)
    counts = Counter(_find_bodies(schema))
    shared = {body: json.loads(body)[_RECORD_KEY] for body, count in counts.items() if count > 1}
    shared = {body: name for body, name in shared.items() if list(shared.values()).count(name) == 1}
    definitions = {name: _refer_to_shared(json.loads(body), shared, inside=True) for body, name in shared.items()}
    whole = {"$schema": SCHEMA_DIALECT, "title": title, **_refer_to_shared(schema, shared, inside=True)}
    if definitions:
        whole["$defs"] = dict(sorted(definitions.items()))
    return json.dumps(whole, indent=2, ensure_ascii=False) + "\n"


def schema_of(kind: Any) -> dict[str, Any]:
    """Return the schema of a record, or of any other type of a field."""
    found: dict[str, Any] = _refer_to_shared(_schema_of(kind), {})
    return found


def _record_body(node: Mapping[str, Any]) -> str:
    """Return the schema of a record without the description of the field that contains it."""
    return json.dumps({key: value for key, value in node.items() if key not in _OF_A_FIELD})


def _find_bodies(node: Any) -> Iterator[str]:
    """Return all occurrences of a record's schema."""
    if isinstance(node, Mapping):
        if _RECORD_KEY in node:
            yield _record_body(node)
        for each in node.values():
            yield from _find_bodies(each)
    elif isinstance(node, list):
        for each in node:
            yield from _find_bodies(each)


def _refer_to_shared(node: Any, shared: Mapping[str, str], *, inside: bool = False) -> Any:
    """Replace shared records by references to their names; ``inside`` for the top level of one of them."""
    if isinstance(node, list):
        return [_refer_to_shared(each, shared) for each in node]
    if not isinstance(node, Mapping):
        return node
    if not inside and _RECORD_KEY in node and (name := shared.get(_record_body(node))):
        return {**{key: node[key] for key in _OF_A_FIELD if key in node}, "$ref": f"#/$defs/{name}"}
    return {key: _refer_to_shared(value, shared) for key, value in node.items() if key != _RECORD_KEY}


def _schema_of(kind: Any) -> dict[str, Any]:
    """Return the schema, in which records are still marked with their names."""
    if declaration.is_record(kind):
        return _of_record(kind)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return _apply_annotations(arguments[0], arguments[1:])
    if origin in (typing.Union, UnionType):
        return _union_schema([_schema_of(each) for each in arguments if each is not NoneType])
    if origin is typing.Literal:
        return {"enum": list(arguments)}
    if origin in (tuple, list):
        return {"type": "array", "items": _schema_of(arguments[0])}
    if origin is not None:
        names = {key: value for key, value in _schema_of(arguments[0]).items() if key != "type"}
        schema: dict[str, Any] = {"type": "object"} | ({"propertyNames": names} if names else {})
        return schema | {"additionalProperties": _schema_of(arguments[1])}
    return {"type": _SCHEMA_OF_TYPE[kind]} | ({"minLength": 1} if kind is Path else {})


def _apply_annotations(base: Any, extras: tuple[Any, ...]) -> dict[str, Any]:
    special = next((each for each in extras if isinstance(each, declaration.Converted | declaration.ByName)), None)
    if isinstance(special, declaration.ByName):
        schema: dict[str, Any] = {"type": "object", "minProperties": 1}
        schema |= {"propertyNames": dict(special.names.schema)} if special.names else {}
        return schema | {"additionalProperties": _schema_of(typing.get_args(base)[0])}
    if special is not None:
        return _schema_of(special.described_as or special.accepts)
    schema = _schema_of(base)
    for extra in extras:
        if isinstance(extra, declaration.Constraint):
            schema |= _length_keywords(extra.schema, schema.get("type"))
    return schema


def _length_keywords(keywords: Mapping[str, Any], kind: Any) -> dict[str, Any]:
    if "length" not in keywords:
        return dict(keywords)
    noun = _LENGTH_SUFFIX[str(kind)]
    limits = zip(("min", "max"), keywords["length"], strict=True)
    return {f"{side}{noun}": limit for side, limit in limits if limit}


def _union_schema(members: list[dict[str, Any]]) -> dict[str, Any]:
    if len(members) == 1:
        return members[0]
    if all(member.keys() == {"type"} for member in members):
        kinds = [member["type"] for member in members]
        return {"type": [name for kind in kinds for name in (kind if isinstance(kind, list) else [kind])]}
    return {"anyOf": members}


def _of_record(kind: Any, head: Any = None) -> dict[str, Any]:
    settings = declaration.settings_of(kind)
    schema: dict[str, Any] = {
        _RECORD_KEY: kind.__name__,
        "description": " ".join((kind.__doc__ or "").split("\n\n")[0].split()),
        "type": "object",
    }
    if settings.unknown == "refuse":
        schema["additionalProperties"] = False
    properties: dict[str, Any] = {}
    required: list[str] = []
    rules: list[Mapping[str, Any]] = []
    for each in (head, kind) if head else (kind,):
        _collect_properties(each, properties, required, rules)
    if required:
        schema["required"] = required
    schema |= _combine_rules(rules)
    return {**schema, "properties": properties}


def _collect_properties(
    kind: Any, properties: dict[str, Any], required: list[str], rules: list[Mapping[str, Any]]
) -> None:
    """Return the properties of a record, including those of flat records."""
    rules += [rule.schema for rule in declaration.settings_of(kind).rules]
    nulls = declaration.settings_of(kind).nulls
    for each in declaration.fields_of(kind):
        if each.flat:
            _collect_properties(
                declaration.flat_record(each)[0], properties, [] if each.default is None else required, rules
            )
            continue
        if each.required and each.key not in properties:
            required.append(each.key)
        properties[each.key] = _property_schema(each, nulls)


def _property_schema(each: declaration.Declared, nulls: bool) -> dict[str, Any]:
    schema = _schema_of(each.type)
    if nulls and not each.omitted and NoneType in typing.get_args(each.type):
        schema = _union_schema([schema, {"type": "null"}])
    if each.help:
        schema = {"description": each.help, **{key: value for key, value in schema.items() if key != "description"}}
    default = value_of(each.default) if each.implied is MISSING else each.implied
    if isinstance(default, str | int | float | list) and default != [] and not isinstance(each.default, Path):
        schema["default"] = default
    return schema


def _combine_rules(rules: list[Mapping[str, Any]]) -> dict[str, Any]:
    """Return rules as keywords; conflicting keywords are combined by ``allOf``."""
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
