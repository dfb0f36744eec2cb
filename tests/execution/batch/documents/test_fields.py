import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.errors import WorldError
from calibration.execution.batch.documents.fields import Fields, parse_json


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"x" * 101, "f: found 101 bytes, at most 100 were expected"),
        (b"{", "f: this is no JSON: Expecting property name"),
        (b'{"a": NaN}', "f: this is no JSON: NaN is no number"),
        (b"-Infinity", "f: this is no JSON: -Infinity is no number"),
        (b"\xff", "f: this is no JSON: "),
        (b"[" * 100, "f: this is no JSON: "),
    ],
)
def test_what_is_no_json(data: bytes, message: str) -> None:
    with pytest.raises(WorldError) as caught:
        parse_json(data, 100, "f")
    assert message in str(caught.value)


def test_what_is_nested_too_deeply() -> None:
    with pytest.raises(WorldError, match="this is no JSON: "):
        parse_json(b"[" * 200_000 + b"]" * 200_000, 10**6, "f")


@pytest.mark.parametrize(
    ("method", "arguments", "good", "bad"),
    [
        ("text", (3,), ["", "abc"], ["abcd", 1, None, ["a"]]),
        ("optional_text", (3,), ["abc", None], ["abcd", 1]),
        ("yes_or_no", (), [True, False], [1, "true", None]),
        ("integer", (1, 3), [1, 3], [0, 4, 1.0, True, "1", None]),
        ("optional_integer", (), [0, None], [-1, 0.5, False]),
        ("seconds", (), [0, 1.5, 3600], [-1, True, "1", None, 1e999, 10**400]),
        ("optional_seconds", (), [None, 1.0], [-0.1, [1]]),
        ("texts", (2, 1), [("a", "b"), ()], [("a", "b", "c"), ("ab",), (1,), "ab", None]),
        ("optional_texts", (), [None, ("a",)], [(None,)]),
        ("integers", (0, 255), [(0, 255)], [(256,), (-1,), (True,), (1.0,), 3]),
        ("variables", (), [{"a": "b"}, {}], [{"a": 1}, [], None]),
    ],
)
def test_each_kind_takes_what_it_says(
    method: str, arguments: tuple[int, ...], good: list[object], bad: list[object]
) -> None:
    for value in good:
        fields = Fields({"x": list(value) if isinstance(value, tuple) else value}, "f")
        assert getattr(fields, method)("x", *arguments) == value
        fields.end()
    for value in bad:
        fields = Fields({"x": list(value) if isinstance(value, tuple) else value}, "f")
        with pytest.raises(WorldError, match=r"^f: x: found .*, expected "):
            getattr(fields, method)("x", *arguments)
    with pytest.raises(WorldError, match="the field 'x' is missing"):
        getattr(Fields({}, "f"), method)("x", *arguments)


def test_objects_in_objects() -> None:
    document = {"many": [{"a": 1}, {"a": 2}], "one": {"a": 3}, "none": None}
    fields = Fields(document, "f")
    assert fields.objects("many", 2, lambda each: each.integer("a")) == (1, 2)
    assert fields.optional_object("one", lambda each: each.integer("a")) == 3
    assert fields.optional_object("none", lambda each: each.integer("a")) is None
    fields.end()
    assert len(document) == 3  # nothing is changed
    for wrong, message in (
        ([{"a": 1, "b": 2}], "f: many: the field 'b' is not known"),
        ([{"a": 1}] * 3, "f: many: found .*, expected a list of at most 2 objects"),
        ([1], "f: many: found 1, expected an object"),
    ):
        with pytest.raises(WorldError, match=message):
            Fields({"many": wrong}, "f").objects("many", 2, lambda each: each.integer("a"))
    with pytest.raises(WorldError, match="the field 'one' is missing"):
        Fields({}, "f").optional_object("one", lambda each: each.integer("a"))


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.text(), lambda inner: st.lists(inner), max_leaves=5))
def test_whatever_it_is_the_message_is_a_line(value: object) -> None:
    with pytest.raises(WorldError) as caught:
        Fields({"x": value}, "f").integer("x", 1, 0)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400
