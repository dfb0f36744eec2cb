"""Documents held to JSON Schemas, with errors for users."""

from collections.abc import Mapping
from typing import Any

from calibration.errors import InputError
from calibration.workflow.text import did_you_mean, shorten


def check_document(document: object, schema: Mapping[str, Any], where: str) -> None:
    """Hold a document to a schema.

    Args:
        document: as it was parsed.
        schema: one that refers to no other file.
        where: what messages begin with: the file.

    Raises:
        InputError: one line that names the key, what was found and what is expected.
    """
    import jsonschema  # slow to import, and not needed by all commands

    validator = jsonschema.Draft202012Validator(schema)
    errors = sorted(validator.iter_errors(document), key=lambda e: list(map(str, e.path)))
    if not errors:
        return
    error = jsonschema.exceptions.best_match(errors)
    place = ".".join(str(part) for part in error.absolute_path)
    raise InputError(f"{where}: {place + ': ' if place else ''}{_message(error, schema)}")


def _message(error: Any, schema: Mapping[str, Any]) -> str:
    if error.validator in ("additionalProperties", "unevaluatedProperties"):
        known = _properties(error.schema, schema)
        unknown = next((key for key in error.instance if key not in known), None)
        if unknown is not None:
            return f"unknown key '{unknown}'{did_you_mean(str(unknown), known)} (known: {', '.join(known)})"
    return shorten(error.message, 200)


def _properties(part: Mapping[str, Any], schema: Mapping[str, Any]) -> list[str]:
    """The names of all properties that a part of a schema describes, itself or by reference."""
    names = list(part.get("properties", {}))
    if isinstance(reference := part.get("$ref"), str):
        target: Any = schema
        for step in reference.removeprefix("#").strip("/").split("/"):
            target = target[step] if step else target
        names += _properties(target, schema)
    return list(dict.fromkeys(names))
