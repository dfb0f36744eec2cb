"""Records as documents and as text."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.records.declaration import fields_of, is_record, settings_of


def document_of(record: Any) -> dict[str, Any]:
    """The document that a record is read from: mappings, lists, texts, numbers.

    What is None is left out, or null in a record with ``nulls``.
    """
    kind: Any = type(record)
    nulls = settings_of(kind).nulls
    document: dict[str, Any] = {}
    for each in fields_of(kind):
        value = getattr(record, each.name)
        if each.flat:
            document |= {} if value is None else document_of(value)
        elif value is not None or (nulls and not each.omitted):
            document[each.key] = value_of(value)
    return document


def text_of(record: Any) -> str:
    """The text of a record's document: JSON with an indent of two."""
    return json.dumps(document_of(record), indent=2, allow_nan=False) + "\n"


def value_of(value: Any) -> Any:
    """A value of a record as it stands in a document."""
    if is_record(type(value)):
        return document_of(value)
    if isinstance(value, Mapping):
        return {key: value_of(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [value_of(each) for each in value]
    return str(value) if isinstance(value, Path) else value
