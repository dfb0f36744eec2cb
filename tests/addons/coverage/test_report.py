import io
import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest
from defusedxml.ElementTree import fromstring

from calibration.addons import coverage
from calibration.addons.coverage.formats import FileCoverage, Rate
from calibration.addons.coverage.pseudo_tested import (
    OVER_BUDGET,
    PseudoTestedFunction,
    PseudoTestedResults,
    UnjudgedFunction,
)
from calibration.addons.coverage.reading import Found, UncountedFile
from calibration.addons.coverage.report import badge, remarks, report
from calibration.addons.coverage.results import (
    CoverageLimit,
    CoverageOfChange,
    CoverageResults,
    PseudoTestedLimit,
    Span,
    Uploaded,
)
from calibration.addons.coverage.tests import Tests
from calibration.base import ExitCode
from calibration.ci.github.service import GITHUB
from calibration.ci.report.junit import CaseOutcome, Tally, junit_xml
from calibration.ci.workflow import Runner, annotate
from calibration.ci.workflow.runner import Level

SCHEMA = json.loads(Path(coverage.__file__ or "").with_name("results.schema.json").read_text())
FILES = {
    "robot/arm.py": FileCoverage({1: 1, 2: 0, 3: 0, 5: 0, 9: 1}, {2: Rate(0, 2)}, {(1, 5): 0, (8, 9): 1}),
    "robot/naming.py": FileCoverage({1: 1, 2: 1, 3: 1, 4: 1, 5: 0}, functions={(1, 5): 1}),
    "robot/__init__.py": FileCoverage(),
    "a|b\n::error::.py": FileCoverage({1: 0}),
}
LEFT_OUT = UncountedFile(
    tuple(f"/usr/include/{i}" for i in range(25)),
    {"x.py": ("a/x.py", "b/x.py")},
    {"robot/new.py": 99},
    ("robot/broken.py",),
    {"cpp": 3, "shell": 1},
)
FAILURES = (
    CaseOutcome("tests.test_a.test_x", "assert 1 == 2", "tests/test_a.py", 7),
    CaseOutcome("tests.test_b", "boom"),
)
PSEUDO_TESTED = PseudoTestedResults(
    judged=4,
    judged_of_change=0,
    functions=(
        PseudoTestedFunction(
            "robot/arm.py", 8, "Arm.move", False, ("returns 0", "returns 1"), tuple(f"test_{n}" for n in range(5))
        ),
    ),
    unjudged=(UnjudgedFunction("robot/arm.py", 1, "reach", True, OVER_BUDGET),),
    failing=("test_x",),
    seconds=12.3,
)
FULL = CoverageResults(
    Found(FILES, LEFT_OUT),
    60.0,
    "a" * 40,
    Tests("pytest -q", 1, 1.5, Tally(3, 2, 1, FAILURES)),
    CoverageOfChange("b" * 40, Rate(1, 4), (Span("robot/arm.py", 2, 5),), Rate(1, 2)),
    "",
    (CoverageLimit("minimum", 80, Rate(6, 11)), CoverageLimit("minimum-change", 20, Rate(1, 4), of_change=True)),
    PSEUDO_TESTED,
    pseudo_tested_limits=(
        PseudoTestedLimit("max-pseudo-tested-change", 0, 0, 1),
        PseudoTestedLimit("max-pseudo-tested", 1, 1, 0),
    ),
    upload=Uploaded("codacy", "failed", "codacy: answered 503"),
)
EMPTY = CoverageResults(Found({}), 60.0, "a" * 40)
GOOD = CoverageResults(Found({"a.py": FileCoverage({1: 1})}), 60.0, "a" * 40, upload=Uploaded("codacy", "uploaded"))


def test_the_sentence() -> None:
    assert report(GOOD).line == "pass: 100.0 % (1 of 1) of the lines are run; uploaded to codacy"
    assert report(FULL).line == (
        "fail: the tests failed: exit code 1, 2 of 5 failed; "
        "lines that are run: found 54.5 % (6 of 11), expected at least 80 % (minimum); the upload failed"
    )
    skipped = replace(GOOD, upload=Uploaded("codacy", "skipped", "a fork"))
    assert report(skipped).line.endswith("; not uploaded (a fork)")
    assert report(replace(GOOD, upload=Uploaded("codacy", "dry-run"))).line.endswith("; nothing was sent (dry-run)")
    assert report(replace(GOOD, upload=Uploaded())).line.endswith("of the lines are run")


@pytest.mark.parametrize(
    ("results", "code"),
    [
        (GOOD, ExitCode.PASS),
        (FULL, ExitCode.FAIL),  # the verdict goes before the upload
        (replace(GOOD, upload=Uploaded("codacy", "failed")), ExitCode.INFRASTRUCTURE),
        (replace(GOOD, tests=Tests("x", 0, 1.0, Tally())), ExitCode.FAIL),
        (replace(GOOD, limits=(CoverageLimit("minimum", 100, Rate(1, 1)),)), ExitCode.PASS),
        (replace(GOOD, limits=(CoverageLimit("minimum", 0, Rate()),)), ExitCode.FAIL),  # nothing is no pass
        (replace(GOOD, limits=(CoverageLimit("minimum-functions", 60, Rate(1, 2), "functions"),)), ExitCode.FAIL),
        (replace(GOOD, pseudo_tested_limits=(PseudoTestedLimit("max-pseudo-tested", 1, 2, 0),)), ExitCode.FAIL),
        (replace(GOOD, pseudo_tested_limits=(PseudoTestedLimit("max-pseudo-tested", 2, 2, 0),)), ExitCode.PASS),
        # three that are not judged may break the limit, or not
        (replace(GOOD, pseudo_tested_limits=(PseudoTestedLimit("x", 2, 0, 3),)), ExitCode.INFRASTRUCTURE),
        (replace(GOOD, pseudo_tested_limits=(PseudoTestedLimit("x", 3, 0, 3),)), ExitCode.PASS),
        (replace(GOOD, limits=(CoverageLimit("minimum-change", 100, Rate(), of_change=True),)), ExitCode.PASS),
        (replace(GOOD, limits=(CoverageLimit("minimum-change", 50, Rate(1, 3), of_change=True),)), ExitCode.FAIL),
    ],
)
def test_the_exit_code(results: CoverageResults, code: ExitCode) -> None:
    found = report(results)
    assert found.exit_code == code
    assert found.verdict == ("fail" if code is ExitCode.FAIL else "pass")


def test_files_below_the_goal() -> None:
    assert FULL.below_goal == ["a|b\n::error::.py", "robot/arm.py"]  # the worst first; an empty file has no goal
    assert replace(FULL, goal=40.0).below_goal == ["a|b\n::error::.py"]
    assert FULL.lines == Rate(6, 11)
    assert FULL.branches == Rate(0, 2)


def test_the_log() -> None:
    table, said, pseudo_tested = report(FULL).log().split("\n\n", 2)
    lines = table.splitlines()
    assert [line.split() for line in lines[:3]] == [
        ["file", "lines", "branches", "functions", "goal", "not", "run"],
        [
            *[
                "total",
                "54.5",
                "%",
                "(6",
                "of",
                "11)",
                "0.0",
                "%",
                "(0",
                "of",
                "2)",
                "66.6",
                "%",
                "(2",
                "of",
                "3)",
                "2",
                "below",
                "60",
                "%",
            ]
        ],
        ["a|b", "::error::.py", "0.0", "%", "(0", "of", "1)", "-", "-", "below", "1"],
    ]
    assert "robot/arm.py" in lines[4]
    assert lines[4].split()[-2:] == ["below", "2-5"]
    assert said.splitlines() == [
        "change since bbbbbbbbbbbb: 25.0 % (1 of 4) of its lines are run",
        "1 of 4 functions that tests run are not tested (12 s)",
        "these tests do not pass in a copy of the checkout, and judge nothing: test_x",
        f"1 functions that tests run are not judged: {OVER_BUDGET}",
        "in reports, but no file that git tracks: " + ", ".join(f"/usr/include/{i}" for i in range(20)) + " and 5 more",
        "left out, because it may be several files: x.py (a/x.py, b/x.py)",
        "left out, because a report contains line 99, which the file lacks: robot/new.py",
        "left out, because coverage.py cannot read or parse them: robot/broken.py",
        "3 cpp files not counted: no report contains any",
        "1 shell file not counted: no report contains any",
    ]
    assert pseudo_tested.splitlines()[-1].split("  ") == [
        "Arm.move",
        "robot/arm.py:8",
        "returns 0 or returns 1",
        "test_0, test_1, test_2 and 2 more",
    ]


def test_a_long_table_is_cut_in_the_log() -> None:
    many = Found({f"{i:04}.py": FileCoverage({1: 1}) for i in range(300)})
    text = report(replace(GOOD, found=many, no_change="no base")).log()
    assert "and 101 more, see results.json" in text
    assert text.endswith("\n\nno coverage of the change: no base")


def test_tests_that_run_nothing_are_suspicious() -> None:
    idle = replace(GOOD, found=Found({"a.py": FileCoverage({1: 0})}), tests=Tests("make", 0, 1.0), upload=Uploaded())
    assert remarks(idle) == [
        "not a line is run: tests that measure themselves (pytest-cov) name their report (reports)"
    ]
    assert remarks(replace(idle, tests=None)) == []


def test_the_summary() -> None:
    text = report(FULL).markdown()
    assert text.startswith("## Coverage of the tests: fail: the tests failed: exit code 1")
    assert "| tests | 3 passed | 5 run, 1 skipped |\n" in text
    assert "| lines of the change | 25.0 % | 1 of 4 |\n" in text
    assert "| functions of the change | 50.0 % | 1 of 2 |\n" in text
    assert "### 1 functions that tests run and do not test\n" in text
    assert "### 2 of 4 files are below the goal of 60 %\n" in text
    assert "| a&#124;b<br>::error::.py | 0.0 % (0 of 1) |" in text
    assert "<details><summary>All 4 files</summary>" in text
    assert "below the goal" not in report(GOOD).markdown()


def test_annotations() -> None:
    found = report(FULL, Path("sub")).all_annotations()
    assert [(a.level, a.file, a.line, a.message) for a in found] == [
        (Level.ERROR, Path("sub/tests/test_a.py"), 7, "tests.test_a.test_x: assert 1 == 2"),
        (Level.ERROR, None, None, "tests.test_b: boom"),
        (Level.ERROR, None, None, "codacy: answered 503"),
        (Level.WARNING, "robot/arm.py", 2, "no test runs lines 2 to 5 of this change"),
        (
            Level.ERROR,
            None,
            None,
            f"max-pseudo-tested-change is undecided: 1 functions are not judged, as {OVER_BUDGET}",
        ),
        (
            Level.WARNING,
            "robot/arm.py",
            8,
            "no test fails when Arm.move returns 0 or returns 1 instead: test_0, test_1, test_2 and 2 more only run it",
        ),
        (Level.ERROR, None, None, "the tests failed: exit code 1, 2 of 5 failed"),
        (Level.ERROR, None, None, "lines that are run: found 54.5 % (6 of 11), expected at least 80 % (minimum)"),
    ]
    skipped = replace(
        GOOD,
        upload=Uploaded("codacy", "skipped", "a fork"),
        change=CoverageOfChange("b", Rate(), (Span("a.py", 1, 1),)),
    )
    assert [(a.level, a.message) for a in report(skipped).all_annotations()] == [
        (Level.NOTICE, "not uploaded: a fork"),
        (Level.WARNING, "no test runs line 1 of this change"),
    ]


def test_every_line_without_a_test_is_counted_on_github_and_ten_are_shown() -> None:
    lines = tuple(Span("a.py", line, line) for line in range(1, 400, 2))
    files = Found({"a.py": FileCoverage({line: line % 2 ^ 1 for line in range(1, 400)})})
    change = replace(GOOD, found=files, change=CoverageOfChange("b", Rate(0, 200), lines))
    log = io.StringIO()
    annotate(Runner(GITHUB, stdout=log), report(change).all_annotations())
    shown = log.getvalue().splitlines()
    assert len(shown) == 10
    assert shown[-1] == "::warning::and 191 more: see the log and the summary"
    assert len(report(change).document["change"]["missing"]) == 200


@pytest.mark.parametrize("results", [FULL, EMPTY, GOOD], ids=["full", "empty", "good"])
def test_results_are_as_their_schema_says(results: CoverageResults) -> None:
    document = report(results).document
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.validate(document, SCHEMA)
    assert set(document) == set(SCHEMA["properties"])


def test_the_numbers_of_the_results() -> None:
    document = report(FULL).document
    assert document["lines"] == {"covered": 6, "total": 11, "percent": 54.54}
    assert document["tests"]["failed"] == 2
    assert document["change"]["missing"] == [{"path": "robot/arm.py", "first": 2, "last": 5}]
    assert [file["lines"]["percent"] for file in document["files"]] == [0.0, None, 40.0, 80.0]
    assert document["functions"] == {"covered": 2, "total": 3, "percent": 66.66}
    assert document["pseudo_tested"]["functions"][0]["tests"] == [f"test_{n}" for n in range(5)]
    assert document["upload"] == {"service": "codacy", "state": "failed", "reason": "codacy: answered 503"}


def test_outputs() -> None:
    assert report(FULL, badge=Path("b.svg")).outputs == {
        "line-rate": 54.54,
        "branch-rate": 0.0,
        "function-rate": 66.66,
        "change-rate": 25.0,
        "change-function-rate": 50.0,
        "pseudo-tested": 1,
        "pseudo-tested-change": 0,
        "files-below-goal": 2,
        "uploaded": "failed",
        "commit": "a" * 40,
        "badge": Path("b.svg"),
    }
    assert report(EMPTY).outputs["line-rate"] is report(EMPTY).outputs["change-rate"] is None


def test_junit() -> None:
    cases = {
        case.get("name"): [child.tag for child in case]
        for case in fromstring(junit_xml(report(FULL).suites)).iter("testcase")
    }
    assert cases == {
        "tests": ["failure"],
        "minimum 80 %": ["failure"],
        "minimum-change 20 %": [],
        "max-pseudo-tested-change 0": ["error"],
        "max-pseudo-tested 1": [],
        "upload to codacy": ["error"],
    }
    assert [case.get("name") for case in fromstring(junit_xml(report(EMPTY).suites)).iter("testcase")] == []


@pytest.mark.parametrize(
    ("rate", "text", "colour"),
    [
        (Rate(999, 1000), "99%", "#3a7d1e"),
        (Rate(60, 100), "60%", "#3a7d1e"),
        (Rate(45, 100), "45%", "#946200"),
        (Rate(44, 100), "44%", "#b3261e"),
        (Rate(), "unknown", "#6b6b6b"),
    ],
)
def test_the_badge(rate: Rate, text: str, colour: str) -> None:
    picture = badge(rate, 60)
    assert fromstring(picture).tag == "{http://www.w3.org/2000/svg}svg"
    assert f"coverage: {text}<" in picture
    assert colour in picture
    assert badge(rate, 60) == picture
    assert len(picture) < 1000
