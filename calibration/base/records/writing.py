"""Conversion of records to documents and to text."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.base.records.declaration import fields_of, is_record, settings_of

_PLAIN_TYPES = frozenset({str, int, float, bool, type(None)})


def document_of(record: Any, *, defaults: bool = True) -> dict[str, Any]:
    """Return the document of a record: mappings, lists, texts, numbers.

    None is omitted, or null in a record with ``nulls``.

    Args:
        record: the record.
        defaults: whether values that are the default of their field are written.
    """
    kind: Any = type(record)
    nulls = settings_of(kind).nulls
    document: dict[str, Any] = {}
    for each in fields_of(kind):
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
    if is_record(kind):
        return document_of(value, defaults=defaults)
    if isinstance(value, Mapping):
        return {key: value_of(each, defaults=defaults) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [value_of(each, defaults=defaults) for each in value]
    return str(value) if isinstance(value, Path) else value
