"""Schemas of several files as one, and what a user hears whose document does not follow."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from calibration.errors import InputError
from calibration.json_schema import bundled, check_document
from calibration.pipeline.configuration import SCHEMA

OTHER = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "$defs": {
        "container": {"type": "object", "properties": {"image": {"$ref": "#/$defs/name"}}},
        "name": {"type": "string"},
        "tree": {"type": "object", "additionalProperties": {"$ref": "#/$defs/tree"}},
    },
}


@pytest.fixture
def schema(tmp_path: Path) -> dict[str, Any]:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "job.schema.json").write_text(json.dumps(OTHER))
    main = {
        "type": "object",
        "properties": {
            "a": {
                "$ref": "other/job.schema.json#/$defs/container",
                "properties": {"ros": {"enum": [1, 2]}},
                "unevaluatedProperties": False,
            },
            "b": {"$ref": "#/$defs/own"},
            "t": {"$ref": "other/job.schema.json#/$defs/tree"},
        },
        "additionalProperties": False,
        "$defs": {"own": {"type": "integer"}},
    }
    (tmp_path / "main.schema.json").write_text(json.dumps(main))
    return bundled(tmp_path / "main.schema.json")


def test_a_bundle_needs_no_other_file(schema: dict[str, Any]) -> None:
    jsonschema.Draft202012Validator.check_schema(schema)
    assert ".schema.json" not in json.dumps(schema)
    check_document({"a": {"image": "x", "ros": 1}, "b": 3, "t": {"t": {"t": {}}}}, schema, "file", {})


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"a": {"image": 3}}, "file: a.image: 3 is not of type 'string'"),
        ({"a": {"imag": "x"}}, "file: a: unknown key 'imag': did you mean 'image'? (known: ros, image)"),
        ({"b": "x"}, "file: b: 'x' is not of type 'integer'"),
        ({"c": 1}, "file: unknown key 'c' (known: a, b, t)"),
        ({"t": {"t": 1}}, "file: t.t: 1 is not of type 'object'"),
        ([], "file: [] is not of type 'object'"),
    ],
)
def test_one_line_names_the_key(schema: dict[str, Any], document: object, message: str) -> None:
    with pytest.raises(InputError) as raised:
        check_document(document, schema, "file", {})
    assert str(raised.value) == message


def test_advice_takes_the_place_of_what_a_schema_cannot_say(schema: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"^file: a\.ros: 1 or 2$"):
        check_document({"a": {"ros": 3}}, schema, "file", {"enum": "1 or 2"})


def test_the_schema_of_the_configuration_is_one() -> None:
    whole = bundled(SCHEMA)
    jsonschema.Draft202012Validator.check_schema(whole)
    assert {"container", "image"} <= set(json.dumps(whole).replace('"', " ").split())
    assert '"../' not in json.dumps(whole)
