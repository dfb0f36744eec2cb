import json
from pathlib import Path

import jsonschema
import pytest
from defusedxml.ElementTree import fromstring

from calibration.base import tables as introspection
from calibration.base.tables import Table, TableResult, judge, parse_rules
from calibration.base.tables.table import parse_table
from calibration.base.tables.table_verdict import MOST_LISTED
from calibration.ci.introspection import introspection_report

SCHEMA = json.loads((Path(introspection.__file__).parent / "results.schema.json").read_text())
RULES = parse_rules(
    {
        "rules": [
            {"column": "RMS (pix)", "row": "Averages", "max": 3, "every-max": 0.8},
            {"column": "Rot (deg)", "aggregate": "p95", "max": 0.01},
            {"column": "Trans (mm)", "contains": "."},
        ],
        "required-rows": ["000"],
    },
    "rules",
)


@pytest.fixture
def red(atom: Table) -> TableResult:
    return judge(atom, RULES)


@pytest.fixture
def green(atom: Table) -> TableResult:
    return judge(atom, parse_rules([{"column": "RMS (pix)", "max": 3}], "rules"))


@pytest.fixture
def hostile() -> TableResult:
    """Return a verdict on cells that would break out of every format."""
    cell = "|`</td>\x85 ]]>&amp; ::error::x ##[add-mask]y\u202e"
    table = parse_table(f'k|,"v\n::x"\n{cell},{cell}\n', "a|b<c>.csv")
    return judge(table, parse_rules([{"column": "v\n::x", "max": 1}, {"column": "k|", "matches": "x"}], "rules"))


def test_sentence(red: TableResult, green: TableResult) -> None:
    assert introspection_report([green]).line == "pass: 2 checks of 1 table"
    assert introspection_report([green, red]).line == "fail: 2 violations in 8 checks of 2 tables"


def test_violations_beyond_what_can_be_read_are_counted() -> None:
    lines = "".join(f"r{i},5\n" for i in range(MOST_LISTED + 7))
    many = judge(parse_table(f"k,v\n{lines}", "many.csv"), parse_rules([{"column": "v", "max": 3}], "rules"))
    assert len(many.violations) == MOST_LISTED
    found = introspection_report([many])
    assert found.line == f"fail: {MOST_LISTED + 7} violations in 2 checks of 1 table"
    assert found.outputs["violations"] == MOST_LISTED + 7
    assert "many.csv: v, every row: 7 more violations not listed" in found.log()
    assert f"{MOST_LISTED + 7} violations" in found.suites["many.csv"][1].reasons[0]
    assert [check["violations"] for check in found.document["tables"][0]["checks"]] == [0, MOST_LISTED + 7]


def test_log_lists_every_check_and_violation(red: TableResult, green: TableResult) -> None:
    violations, checks = introspection_report([red]).log().split("\n\n")
    assert len(checks.splitlines()) == 2 + len(red.checks)
    assert violations.splitlines() == [
        "file         line  column     row               found   expected",
        "results.csv  3     RMS (pix)  001               0.9     at most 0.8",
        "results.csv        Rot (deg)  p95 of every row  0.0385  at most 0.01",
    ]
    assert "found" not in introspection_report([green]).log()


def test_log_lines_cannot_be_broken(hostile: TableResult) -> None:
    log = introspection_report([hostile]).log()
    assert len(log.split("\n")) == 1 + 2 + 1 + 2 + 3
    assert "##[" not in log
    assert "\u202e" not in log


def test_markdown(red: TableResult, hostile: TableResult) -> None:
    text = introspection_report([red]).markdown()
    assert text.startswith("## Tables: fail: 2 violations in 6 checks of 1 table\n")
    assert "| results.csv | 3 | RMS (pix) | 001 | 0.9 | at most 0.8 |\n" in text
    for line in introspection_report([hostile]).markdown().split("\n"):
        if line.startswith("|"):
            assert line.count("|") == 7
            assert "<" not in line.replace("<br>", "")


def test_results_are_as_the_schema_says(red: TableResult, green: TableResult, hostile: TableResult) -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    empty = judge(parse_table("k,v\n", "t"), parse_rules([{"column": "v", "max": 1}], "rules"))
    for verdicts in ([red], [green], [hostile], [red, green], [empty]):
        jsonschema.validate(json.loads(introspection_report(verdicts).written()["results.json"]), SCHEMA)


def test_results(red: TableResult, green: TableResult) -> None:
    results = json.loads(introspection_report([green, red]).written()["results.json"])
    assert (results["schema"], results["verdict"], results["violations"]) == (1, "fail", 2)
    first, second = results["tables"]
    assert (first["file"], first["rows"], first["key_column"], first["verdict"]) == (
        "results.csv",
        4,
        "Collection #",
        "pass",
    )
    assert second["violations"] == [
        {"line": 3, "column": "RMS (pix)", "row": "001", "found": "0.9", "expected": "at most 0.8"},
        {"line": None, "column": "Rot (deg)", "row": "p95 of every row", "found": "0.0385", "expected": "at most 0.01"},
    ]
    assert second["checks"][2] == {
        "column": "RMS (pix)",
        "rows": "row Averages",
        "expected": "at most 3",
        "judged": 1,
        "value": 0.7,
        "smallest": 0.7,
        "largest": 0.7,
        "violations": 0,
        "verdict": "pass",
    }
    assert introspection_report([green, red]).written() == introspection_report([green, red]).written()


def test_values(red: TableResult) -> None:
    values = introspection_report([red]).outputs["values"]
    assert [value["value"] for value in values] == [4, None, 0.7, None, 0.0385, None]
    assert {value["file"] for value in values} == {"results.csv"}


def test_junit(red: TableResult, hostile: TableResult) -> None:
    root = fromstring(introspection_report([red]).written()["junit.xml"])
    assert root.attrib["tests"] == "6"
    assert root.attrib["failures"] == "2"
    failures = root.findall(".//failure")
    assert failures[0].text == "1 violation\nresults.csv:3: RMS (pix), 001: found 0.9, expected at most 0.8"
    assert failures[1].text.endswith("results.csv: Rot (deg), p95 of every row: found 0.0385, expected at most 0.01")
    assert root.find(".//testcase[failure]").attrib["line"] == "3"
    fromstring(introspection_report([hostile]).written()["junit.xml"])


def test_annotations(red: TableResult) -> None:
    first, second = introspection_report([red]).all_annotations()
    assert (first.file, first.line, first.message) == (
        "results.csv",
        3,
        "RMS (pix), 001: found 0.9, expected at most 0.8",
    )
    assert second.line is None
