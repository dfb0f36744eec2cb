from xml.etree.ElementTree import tostring

import pytest
from defusedxml.ElementTree import fromstring
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import ExitCode, visible
from calibration.ci.report import Outcome
from calibration.ci.report.junit import junit_xml


def test_suites_and_cases() -> None:
    xml = junit_xml(
        {
            "table.csv": [
                Outcome(name="good", group="g", seconds=1.25),
                Outcome(name="bad", group="g", reasons=("2 wrong", "this & that"), file="table.csv", line=3),
                Outcome(name="crashed", reasons=("engine",), error=ExitCode.INFRASTRUCTURE),
                Outcome(name="left out", skipped="not asked"),
            ],
            "empty": [],
        }
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
    assert (crashed[0].tag, crashed[0].text) == ("error", "engine")
    assert left_out[0].attrib == {"message": "not asked"}


def test_the_same_suites_are_the_same_bytes() -> None:
    suites = {"s": [Outcome(name="a"), Outcome(name="b", reasons=("x",))]}
    assert junit_xml(suites) == junit_xml(suites)


@given(st.text(), st.text())
def test_any_text_makes_valid_xml(name: str, failure: str) -> None:
    root = fromstring(junit_xml({name: [Outcome(name=name, group=name, reasons=(failure,))]}).encode())
    allowed = [
        c for c in name if c in "\t\n\r" or 0x20 <= ord(c) <= 0xD7FF or 0xE000 <= ord(c) <= 0xFFFD or ord(c) > 0xFFFF
    ]
    assert root[0].attrib["name"] == visible("".join(allowed))


@given(st.text(st.characters(exclude_characters="\r")), st.text(st.characters(exclude_characters="\r")))
def test_it_is_what_an_xml_library_writes(name: str, failure: str) -> None:
    xml = junit_xml({"empty": [], name: [Outcome(name=name, reasons=(failure,)), Outcome(name="good")]})
    assert f'<?xml version="1.0" encoding="utf-8"?>\n{tostring(fromstring(xml.encode()), encoding="unicode")}\n' == xml


@pytest.mark.parametrize("character", ["\x00", "\x1b", "\x0b", "\ufffe", "\ud800"])
def test_invalid_characters_are_removed(character: str) -> None:
    assert 'name="ab"' in junit_xml({f"a{character}b": []})


def test_an_error_without_a_reason_is_no_pass() -> None:
    assert fromstring(junit_xml({"s": [Outcome(name="a", error=ExitCode.INFRASTRUCTURE)]})).attrib["errors"] == "1"
