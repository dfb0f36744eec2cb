"""Text of HPL: errors have line, column and what was expected; a property that can never fail is refused."""

import math

import numpy as np
import pytest

from calibration.addons.requirements.hpl import MAX_DEPTH, MAX_TEXT_CHARACTERS, parse_property
from calibration.addons.requirements.requirement import Message
from calibration.base import InputError


@pytest.mark.parametrize(
    ("text", "place", "found", "expected"),
    [
        ("globally: /a causs /b", "line 1, column 14", "'causs'", "causes, forbids, requires"),
        ("globaly: some /x", "line 1, column 1", "'globaly'", "globally"),
        ("globally: some /x {y > }", "line 1, column 24", "'}'", "a name"),
        ("globally: some /x within 3", "line 1, column 26", "the end", "s or ms"),
        ("globally: some /x {x > 3", "line 1, column 24", "the end", "'}'"),
        ("globally:\n  some /x\n  %", "line 3, column 3", "'%'", "within"),
        ("", "line 1, column 1", "the end", "globally"),
        ("globally: no /x {x = max(1, 2)}", "line 1, column 27", "','", "')'"),
    ],
)
def test_what_cannot_be_parsed_is_named_with_its_place(text: str, place: str, found: str, expected: str) -> None:
    with pytest.raises(InputError) as raised:
        parse_property(text, "calibration.yml: requirements.hpl[0]")
    message = str(raised.value)
    assert message.startswith(f"calibration.yml: requirements.hpl[0]: {place}: found {found}, expected ")
    assert expected in message.partition(", expected ")[2]
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('globally: no /x {"a" > 3}', "String"),
        ("globally: no /x {@A.y = 1}", "undefined event 'A'"),
        ("globally: (/a or /a) causes /b", "channel '/a' appears multiple times"),
        ("globally: some /x {3}", "boolean"),
        ("globally: no /x {foo(y) = 1}", "'foo' is not a valid function"),
        ('globally: no /x {x = 1 and x = "a"}', "String"),
        ("globally: no ~x", "private name ~x"),
        ("globally: no /x {not " * 1 + "not " * 3000 + "y}", f"at most {MAX_TEXT_CHARACTERS}"),
        ("globally: no /x {" + "(" * 200 + "y" + ")" * 200 + "}", f"{MAX_DEPTH} deep"),
        ("globally: no /x {" + "a." * 3000 + "y}", f"{MAX_DEPTH} deep"),
    ],
)
def test_what_the_library_refuses_is_one_line(text: str, found: str) -> None:
    with pytest.raises(InputError) as raised:
        parse_property(text, "hpl")
    assert found in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "text",
    [
        "globally: no /x {False}",
        "globally: no /x {1 > 2}",
        "globally: /a {False} causes /b",
        "globally: /a forbids /b {1 = 2}",
        "globally: /b {False} requires /a",
        "after /a {2 < 1}: some /b",
        "globally: some /b {False}",
    ],
)
def test_a_property_that_can_never_fail_or_be_met_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="it can never"):
        parse_property(text, "hpl")


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("x = 2", True),
        ("x != 2", False),
        ("-x = 0 - 2", True),
        ("x ** 2 = 4 and x * 3 = 6 and x / 4 = 0.5", True),
        ("x / 0 = 1", False),
        ("not x / 0 = 1", False),
        ("(x - 10) ** 0.5 = 1", False),
        ("x in {1, 2}", True),
        ("x in ![2 to 3]", False),
        ("x in [0 to 2]!", False),
        ("x in r", True),
        ('s = "it\\"s" or s = "a"', True),
        ("len(r) = 3 and sum(r) = 6 and max(r) = 3 and min(r) = 1 and prod(r) = 6", True),
        ("forall i in r: r[@i] > 0", True),
        ("exists i in r: r[@i] = 3", True),
        ("exists v in {1, 3}: @v = x", False),
        ("forall i in [0 to 2]: r[@i] = @i + 1", True),
        ("r[3] = 0", False),
        ("abs(-x) = 2 and sqrt(x + 2) = 2 and deg(PI) = 180 and floor(2.5) = 2 and ceil(2.5) = 3", True),
        ("yaw(q) > 1.57 and yaw(q) < 1.58 and abs(roll(q)) < 0.001 and abs(pitch(q)) < 0.001", True),
        ("b implies x > 5", False),
        ("b iff x = 2", True),
        ("not b or x < 5", True),
        ("x < NAN or x > NAN", False),
    ],
)
def test_predicates_have_the_values_that_mathematics_gives_them(condition: str, holds: bool) -> None:
    found = parse_property(f"globally: some /x {{{condition}}}", "hpl")
    half = math.sqrt(0.5)
    fields = {"x": 2, "s": "a", "b": True, "r": np.array([1, 2, 3]), "q": {"x": 0.0, "y": 0.0, "z": half, "w": half}}
    assert found.behaviour.matches(Message("/x", 0, fields, 0), {}) is holds


def test_the_fields_that_a_property_needs_are_those_that_it_names() -> None:
    found = parse_property("after /p as P: /a as A {x > @P.y.z} causes (/b {r[@A.i] = 1} or /c)", "hpl")
    assert found.wanted == {"/p": {"y": {"z": {}}}, "/a": {"x": {}, "i": {}}, "/b": {"r": {}}, "/c": {}}


def test_the_name_is_the_id_the_title_or_the_text() -> None:
    assert parse_property('# id: p1 # title: "First" globally: some /x', "hpl").name == "p1"
    assert parse_property('# title: "First" globally: some /x', "hpl").name == "First"
    assert parse_property("globally:\n  some /x", "hpl").name == "globally: some /x"
