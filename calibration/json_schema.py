"""JSON Schemas that refer to each other's files, as one; and documents held to them, with errors for users."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.errors import InputError
from calibration.workflow.text import did_you_mean, shorten


def bundled(path: Path) -> dict[str, Any]:
    """The schema in a file, with the files that it refers to (by relative paths) among its ``$defs``."""
    definitions: dict[str, Any] = {}
    schema = _with_local_references(json.loads(path.read_text()), path.resolve(), "", definitions)
    return {**schema, "$defs": {**schema.get("$defs", {}), **definitions}}


def _with_local_references(node: Any, path: Path, prefix: str, definitions: dict[str, Any]) -> Any:
    """A part of the schema in ``path``, which will stand at ``prefix`` (``#/$defs/name``, or nothing for the root)."""
    if isinstance(node, list):
        return [_with_local_references(item, path, prefix, definitions) for item in node]
    if not isinstance(node, dict):
        return node
    changed = {key: _with_local_references(value, path, prefix, definitions) for key, value in node.items()}
    if isinstance(reference := node.get("$ref"), str):
        file, _, pointer = reference.partition("#")
        name = Path(file).name.removesuffix(".schema.json")
        if file and name not in definitions:
            other = (path.parent / file).resolve()
            definitions[name] = {}  # a file may refer to itself by way of others
            definitions[name] = _with_local_references(
                json.loads(other.read_text()), other, f"#/$defs/{name}", definitions
            )
        changed["$ref"] = (f"#/$defs/{name}" if file else prefix or "#") + pointer
    return changed


def check_document(document: object, schema: Mapping[str, Any], where: str, advice: Mapping[str, str]) -> None:
    """Hold a document to a schema.

    Args:
        document: as it was parsed.
        schema: one that refers to no other file.
        where: what messages begin with: the file.
        advice: what to say where the schema cannot say so itself, by the keyword that is broken; in a part of the
            document only, by its first key and the keyword: ``simulation anyOf``.

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
    raise InputError(f"{where}: {place + ': ' if place else ''}{_message(error, schema, advice)}")


def _message(error: Any, schema: Mapping[str, Any], advice: Mapping[str, str]) -> str:
    if error.validator in ("additionalProperties", "unevaluatedProperties"):
        known = _properties(error.schema, schema)
        unknown = next((key for key in error.instance if key not in known), None)
        if unknown is not None:
            return f"unknown key '{unknown}'{did_you_mean(str(unknown), known)} (known: {', '.join(known)})"
    part = f"{error.absolute_path[0]} {error.validator}" if error.absolute_path else ""
    return advice.get(part) or advice.get(error.validator) or shorten(error.message, 200)


def _properties(part: Mapping[str, Any], schema: Mapping[str, Any]) -> list[str]:
    """The names of all properties that a part of a schema describes, itself or by reference."""
    names = list(part.get("properties", {}))
    if isinstance(reference := part.get("$ref"), str):
        target: Any = schema
        for step in reference.removeprefix("#").strip("/").split("/"):
            target = target[step] if step else target
        names += _properties(target, schema)
    return list(dict.fromkeys(names))
