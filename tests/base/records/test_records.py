"""Records: one declaration for reading, writing and the schema."""

import json
import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InfrastructureError, InputError
from calibration.base.records import (
    UNIQUE,
    ByName,
    Converted,
    Misfit,
    Place,
    above,
    at_least,
    between,
    computed,
    document_of,
    excludes,
    field,
    length,
    matching,
    needs,
    one_of,
    read,
    read_as,
    record,
    result,
    text_of,
)
from calibration.base.records.conversion import value_of
from calibration.base.records.schema import schema_of, schema_text

NAME = matching("[a-z]+", "small letters")


@record
class Limits:
    """The largest values that pass."""

    rms_px: Annotated[float, at_least(0)] | None = field("Of the table.", default=None, unit="px")
    share: Annotated[float, between(0, 1)] = field("Of views.", default=0.5)


@record
class Options:
    """Settings of a calibration."""

    hold: Annotated[tuple[str, ...], UNIQUE] = field("What stays.", default=())
    loss: Literal["huber", "linear"] = field("Robust or not.", default="huber")


@record
class System:
    """A robot."""

    name: str
    dataset: Path = field("Its data.")
    limits: Limits = field("What passes.", default_factory=Limits)
    options: Options = field(flat=True, default_factory=Options)
    made_by: str | None = None


@record(
    rules=(excludes("seeds", "seed-list"), needs("table", "command"), one_of("systems", "seeds", why="say systems"))
)
class Document:
    """All of it."""

    systems: Annotated[tuple[System, ...], ByName(NAME)] = field("Robots by name.", default=())
    seeds: Annotated[int, at_least(1)] | None = field("How many.", default=None)
    seed_list: Annotated[tuple[int, ...], length(1)] | None = field("Which.", default=None)
    command: Annotated[
        tuple[str, ...], Converted(str | tuple[str, ...], lambda v, _: tuple(v.split()) if isinstance(v, str) else v)
    ] = field("What runs.", default=())
    table: str | None = field("Its table.", default=None)
    ros: Literal["none", 1, 2] = field("Which ROS.", default="none")
    size: Annotated[float, above(0)] = field("How large.", default=1.0)
    source: Path | None = field("From here.", key="from", default=None)
    tags: Mapping[Annotated[str, NAME], str | bool] = field("Whatever.", default_factory=dict)
    push: bool = field("Whether it goes out.", default=False)

    def __post_init__(self) -> None:
        if self.push and not self.systems:
            raise Misfit("nothing to push", "push")


WHOLE: dict[str, Any] = {
    "systems": {"a": {"dataset": "data", "limits": {"rms-px": 3}, "hold": ["left"], "loss": "linear"}},
    "seed-list": [3, 7],
    "command": ["run", "it"],
    "table": "*.csv",
    "ros": 1,
    "size": 2.5,
    "from": "here",
    "tags": {"a": "x", "b": True},
    "push": True,
}


def refused(document: object) -> str:
    with pytest.raises(InputError) as caught:
        read(Document, document, "file")
    assert not jsonschema.Draft202012Validator(schema_of(Document)).is_valid(document) or "push" in str(caught.value)
    return str(caught.value)


def test_a_whole_document() -> None:
    found = read(Document, WHOLE, "file", Path("/folder"))
    [system] = found.systems
    assert system == System("a", Path("/folder/data"), Limits(3.0), Options(("left",), "linear"))
    assert type(system.limits.rms_px) is float
    assert (found.seeds, found.seed_list, found.command) == (None, (3, 7), ("run", "it"))
    assert (found.source, found.tags, found.ros) == (Path("/folder/here"), {"a": "x", "b": True}, 1)
    jsonschema.validate(WHOLE, schema_of(Document), cls=jsonschema.Draft202012Validator)


def test_what_is_absent_has_its_default() -> None:
    assert read(Document, {"seeds": 2}, "file") == Document(seeds=2)
    assert read(Document, {"seeds": 2, "command": "run it"}, "file").command == ("run", "it")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"systems": {"a": {"dataset": "d", "limits": {"rms-px": -1}}}},
            "systems.a.limits.rms-px: found -1, expected a number of at least 0",
        ),
        (
            {"systems": {"a": {"dataset": "d", "limits": {"rms": 1}}}},
            "systems.a.limits: unknown key 'rms': did you mean 'rms-px'? (known: rms-px, share)",
        ),
        ({"systems": {"a": {"dataset": "d", "los": "huber"}}}, "systems.a: unknown key 'los': did you mean 'loss'?"),
        (
            {"systems": {"a": {"dataset": "d", "loss": "hubert"}}},
            "systems.a.loss: found 'hubert', expected huber or linear: did you mean 'huber'?",
        ),
        ({"systems": {"a": {}}}, "systems.a: missing key 'dataset'"),
        ({"systems": {"a": {"dataset": "d", "name": "b"}}}, "systems.a: unknown key 'name'"),
        ({"systems": {"A": {"dataset": "d"}}}, "systems: found the name 'A', expected small letters"),
        ({"systems": {}}, "systems: found an empty mapping, expected a mapping of names, at least one"),
        ({"systems": ["a"]}, "systems: found a list of 1, expected a mapping of names"),
        ({"systems": {"a": None}}, "systems.a: found null, expected keys: dataset"),
        (
            {"systems": {"a": {"dataset": "d", "hold": ["a", "a"]}}},
            "systems.a.hold: found a list of 2, expected a list without duplicates",
        ),
        ({"systems": {"a": {"dataset": "d", "hold": ["a", 3]}}}, "systems.a.hold.1: found 3, expected a text"),
        ({"systems": {"a": {"dataset": "d", "hold": "left"}}}, "systems.a.hold: found 'left', expected a list"),
        ({"seeds": True, "seed-list": None}, "seeds and seed-list exclude each other"),
        ({"seeds": 1.5}, "seeds: found 1.5, expected a whole number of at least 1"),
        ({"seeds": True}, "seeds: found true, expected a whole number of at least 1"),
        ({"seeds": None}, "seeds: found null, expected a whole number of at least 1"),
        (
            {"seed-list": [], "systems": {"a": {"dataset": "d"}}},
            "seed-list: found an empty list, expected a list that is not empty",
        ),
        ({"seeds": 1, "table": "x"}, "table needs command: say command too"),
        ({}, "say systems"),
        ({"seeds": 1, "command": 3}, "command: found 3, expected a text or a list"),
        ({"seeds": 1, "command": [3]}, "command.0: found 3, expected a text"),
        ({"seeds": 1, "ros": True}, "ros: found true, expected none, 1 or 2"),
        ({"seeds": 1, "size": "1e-3"}, "size: found '1e-3', expected a number above 0"),
        ({"seeds": 1, "tags": {"A": "x"}}, "tags: found the key 'A', expected small letters"),
        ({"seeds": 1, "tags": {"a": 3}}, "tags.a: found 3, expected a text or true or false"),
        ({"seeds": 1, "push": True}, "push: nothing to push"),
        ([], "found an empty list, expected keys: systems, seeds"),
    ],
)
def test_what_is_wrong(changes: Any, message: str) -> None:
    assert message in refused(changes)


@pytest.mark.parametrize("size", [math.nan, math.inf, 10**400])
def test_a_number_is_finite(size: float) -> None:
    with pytest.raises(InputError, match=r"size: found .*, expected a number above 0"):
        read(Document, {"seeds": 1, "size": size}, "file")


def test_a_pattern_is_for_the_whole_text() -> None:
    with pytest.raises(InputError, match="small letters"):
        read_as(Annotated[str, NAME], "abc\n", Place("file"))


def test_a_wrong_value_that_may_be_a_secret_is_not_repeated() -> None:
    with pytest.raises(InputError) as caught:
        read_as(Annotated[str, matching("arn:.*", "an ARN", secret=True)], "hunter2", Place("file"))
    assert str(caught.value) == "file: expected an ARN"


SCALARS = st.none() | st.booleans() | st.floats() | st.text(max_size=5)
KEYS = st.sampled_from([*WHOLE, "a", "dataset"])
DOCUMENTS = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4))


@given(DOCUMENTS)
def test_anything_else_is_one_line(document: object) -> None:
    said = "file: "
    try:
        read(Document, document, "file")
    except InputError as error:
        said = str(error)
    assert said.startswith("file: ")
    assert said.isprintable()


def test_what_is_written_is_read_again() -> None:
    found = read(Document, WHOLE, "file")
    assert document_of(found) == WHOLE | {
        "systems": [{"dataset": "data", "limits": {"rms-px": 3.0, "share": 0.5}, "hold": ["left"], "loss": "linear"}]
    }
    assert text_of(Limits(1.0)) == '{\n  "rms-px": 1.0,\n  "share": 0.5\n}\n'


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
def test_a_number_that_json_lacks_is_null(number: float) -> None:
    assert value_of({"one": (1.0, number)}) == {"one": [1.0, None]}


def test_results_have_nulls_and_may_have_more() -> None:
    @result
    class Result:
        """A result."""

        rms_px: float | None = field("Of the table.", default=None)

    assert read(Result, {"rms_px": None, "newer": 1}, "results.json") == Result(None)
    assert document_of(Result()) == {"rms_px": None}
    schema = schema_of(Result)
    jsonschema.validate({"rms_px": None, "newer": 1}, schema)
    jsonschema.validate({"rms_px": 1.5}, schema)
    with pytest.raises(InfrastructureError, match=r"results\.json: rms_px: found 'x', expected a number"):
        read(Result, {"rms_px": "x"}, "results.json", error=InfrastructureError)


@result
class Extra:
    """Keys that only some results have."""

    cost: float | None = field("Of it.", default=None)


@result
class Whole:
    """Results with keys that are computed, left out, or there together."""

    passed: int = field("How many passed.")
    rate: float | None = field("Of a minute.", default=None, omitted=True)
    extra: Extra | None = field(flat=True, default=None)

    @property
    @computed("verdict")
    def word(self) -> Literal["pass", "fail"]:
        """Pass if one passed."""
        return "pass" if self.passed else "fail"


@pytest.mark.parametrize(
    ("whole", "document"),
    [
        (Whole(1), {"passed": 1, "verdict": "pass"}),
        (Whole(0, 0.5, Extra()), {"passed": 0, "rate": 0.5, "cost": None, "verdict": "fail"}),
    ],
)
def test_keys_that_are_computed_left_out_or_there_together(whole: Whole, document: dict[str, Any]) -> None:
    assert document_of(whole) == document
    assert read(Whole, document | {"verdict": "another"}, "results.json") == whole  # what is computed is not read
    schema = json.loads(schema_text(Whole, "a title", Limits))
    jsonschema.validate(document | {"rms-px": 1}, schema)
    assert schema["required"] == ["passed", "verdict"]
    assert schema["properties"]["verdict"] == {"description": "Pass if one passed.", "enum": ["pass", "fail"]}


def test_the_schema_tells_editors_what_a_user_needs() -> None:
    schema = schema_of(Limits)
    assert schema["description"] == "The largest values that pass."
    assert schema["additionalProperties"] is False
    assert schema["properties"]["rms-px"] == {"description": "Of the table, px.", "type": "number", "minimum": 0}
    assert schema["properties"]["share"]["default"] == 0.5
    system = schema_of(Document)["properties"]["systems"]["additionalProperties"]
    assert system["required"] == ["dataset"]
    assert list(system["properties"]) == ["dataset", "limits", "hold", "loss"]


def test_declaring_a_record_imports_nothing_slow() -> None:
    code = "import sys, calibration.base.records; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "jsonschema", "pydantic", "yaml", "click"} & set(done.stdout.split())


@record
class Corner:
    """A corner of a box."""

    x: Annotated[float, at_least(0)] = field("To the right.")


@record
class TwoCorners:
    """A box."""

    first: Corner = field("The lower left.")
    last: Corner | None = field("The upper right.", default=None)


def test_a_record_in_several_places_is_described_once() -> None:
    text = schema_text(TwoCorners, "box")
    schema = json.loads(text)
    assert schema["properties"]["first"] == {"description": "The lower left.", "$ref": "#/$defs/Corner"}
    assert text.count("To the right.") == 1
    whole, referring = (jsonschema.Draft202012Validator(each) for each in (schema_of(TwoCorners), schema))
    for document in ({"first": {"x": 1}, "last": {"x": 2}}, {"first": {"x": -1}}, {"last": {"x": 1}}, {"first": 3}):
        assert whole.is_valid(document) == referring.is_valid(document)
