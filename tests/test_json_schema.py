"""What a user hears whose document does not follow a schema."""

import pytest

from calibration.errors import InputError
from calibration.json_schema import check_document

SCHEMA = {
    "type": "object",
    "properties": {"a": {"$ref": "#/$defs/container"}, "b": {"$ref": "#/$defs/own"}, "t": {"type": "object"}},
    "additionalProperties": False,
    "$defs": {
        "own": {"type": "integer"},
        "container": {
            "type": "object",
            "properties": {"ros": {"enum": [1, 2]}, "image": {"type": "string"}},
            "additionalProperties": False,
        },
    },
}


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"a": {"image": 3}}, "file: a.image: 3 is not of type 'string'"),
        ({"a": {"imag": "x"}}, "file: a: unknown key 'imag': did you mean 'image'? (known: ros, image)"),
        ({"b": "x"}, "file: b: 'x' is not of type 'integer'"),
        ({"c": 1}, "file: unknown key 'c' (known: a, b, t)"),
        ([], "file: [] is not of type 'object'"),
    ],
)
def test_one_line_names_the_key(document: object, message: str) -> None:
    with pytest.raises(InputError) as raised:
        check_document(document, SCHEMA, "file")
    assert str(raised.value) == message
