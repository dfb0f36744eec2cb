from pathlib import Path

import pytest
from defusedxml.ElementTree import fromstring, parse
from hypothesis import given
from hypothesis import strategies as st

from calibration.workflow.junit import Case, Suite, junit_xml, write_junit


def test_suites_and_cases() -> None:
    xml = junit_xml(
        [
            Suite(
                "table.csv",
                (
                    Case("good", "g", seconds=1.25),
                    Case("bad", "g", failure="2 wrong\nthis & that", file="table.csv", line=3),
                    Case("crashed", error="engine"),
                    Case("left out", skipped="not asked"),
                ),
            ),
            Suite("empty", ()),
        ]
    )
    root = fromstring(xml)
    assert root.attrib == {"tests": "4", "failures": "1", "errors": "1", "skipped": "1"}
    table, empty = root
    assert table.attrib == {"name": "table.csv", "tests": "4", "failures": "1", "errors": "1", "skipped": "1"}
    assert empty.attrib["tests"] == "0"
    good, bad, crashed, left_out = table
    assert good.attrib == {"name": "good", "classname": "g", "time": "1.250"}
    assert bad.attrib == {"name": "bad", "classname": "g", "file": "table.csv", "line": "3"}
    assert bad[0].tag == "failure"
    assert bad[0].attrib == {"message": "2 wrong"}
    assert bad[0].text == "2 wrong\nthis & that"
    assert crashed[0].tag == "error"
    assert left_out[0].attrib == {"message": "not asked"}


def test_the_same_suites_are_the_same_bytes() -> None:
    suites = [Suite("s", (Case("a"), Case("b", failure="x")))]
    assert junit_xml(suites) == junit_xml(suites)


@given(st.text(), st.text())
def test_any_text_makes_valid_xml(name: str, failure: str) -> None:
    root = fromstring(junit_xml([Suite(name, (Case(name, name, failure=failure),))]).encode())
    allowed = [
        c for c in name if c in "\t\n\r" or 0x20 <= ord(c) <= 0xD7FF or 0xE000 <= ord(c) <= 0xFFFD or ord(c) > 0xFFFF
    ]
    assert root[0].attrib["name"] == "".join(allowed)


@pytest.mark.parametrize("character", ["\x00", "\x1b", "\x0b", "\ufffe", "\ud800"])
def test_invalid_characters_are_removed(character: str) -> None:
    assert 'name="ab"' in junit_xml([Suite(f"a{character}b", ())])


def test_writes_a_file(tmp_path: Path) -> None:
    write_junit(tmp_path / "junit.xml", [Suite("ö", ())])
    assert parse(tmp_path / "junit.xml").getroot()[0].attrib["name"] == "ö"
