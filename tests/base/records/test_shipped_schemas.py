"""The JSON Schemas that are written from records: `make actions` writes them."""

import json
from typing import Any

import jsonschema
import pytest

from calibration.commands.schema import SHIPPED_SCHEMAS, generated
from tests.actions.write_inputs import schema_file


@pytest.mark.parametrize("name", SHIPPED_SCHEMAS)
def test_what_ships_is_what_the_record_says(name: str) -> None:
    assert schema_file(name).read_text() == generated(name), "run make actions"


@pytest.mark.parametrize("name", SHIPPED_SCHEMAS)
def test_it_is_a_schema_that_describes_every_key(name: str) -> None:
    schema = json.loads(generated(name))
    jsonschema.Draft202012Validator.check_schema(schema)
    assert not [key for key, entry in properties(schema) if not entry.get("description")]


def properties(schema: Any) -> list[tuple[str, Any]]:
    if isinstance(schema, list):
        return [found for each in schema for found in properties(each)]
    if not isinstance(schema, dict):
        return []
    own = list(schema.get("properties", {}).items())
    return own + [found for each in schema.values() for found in properties(each)]
