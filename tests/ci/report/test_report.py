import io
import json
import math
from pathlib import Path

import pytest

from calibration.base import ExitCode, InfrastructureError
from calibration.base.records import document_of
from calibration.ci.github.service import GITHUB
from calibration.ci.report import (
    Code,
    Lines,
    Outcome,
    Report,
    Table,
    Text,
    at_least,
    at_most,
    outcome_of_check,
    publish,
    remove_results,
)
from calibration.ci.workflow import Annotation, Runner

TABLE = Table(("Start", "a", "b|c", "d"), (("0 m", "1", "<2>", "-"), ("1 m", "-", "-", "3")))


def make(**changes: object) -> Report:
    fields = {
        "title": "check",
        "verdict": "fail",
        "sentence": "1 of 2 failed",
        "results": {"found": 2},
        "suites": {},
        "outputs": {"worst": 3.5, "best": None},
    }
    return Report(**(fields | changes))


@pytest.mark.parametrize(
    ("check", "passed", "text"),
    [
        (at_most("RMS", 0.9, 0.8, "px"), False, "RMS: found 0.9 px, expected at most 0.8 px"),
        (at_most("RMS", 0.8, 0.8, "px"), True, "RMS: found 0.8 px, expected at most 0.8 px"),
        (at_least("rate", 0.5, 0.75), False, "rate: found 0.5, expected at least 0.75"),
        (at_least("rate", None, 0.75), False, "rate: found no value, expected at least 0.75"),
        (at_most("RMS", 3.000004, 3), False, "RMS: found 3.000004, expected at most 3"),
        (at_least("RMS", 2.999996, 3), False, "RMS: found 2.999996, expected at least 3"),
        (at_most("RMS", math.nan, 3), False, "RMS: found nan, expected at most 3"),
        (at_most("RMS", -math.inf, 3), False, "RMS: found -inf, expected at most 3"),
        (at_least("RMS", math.inf, 3), False, "RMS: found inf, expected at least 3"),
    ],
)
def test_a_check_of_a_number(check: object, passed: bool, text: str) -> None:
    assert (check.passed, str(check)) == (passed, text)


def test_a_check_as_an_entry_of_the_results() -> None:
    entry = {"name": "rate", "value": 0.5, "limit": 0.75, "at_least": True, "unit": "", "passed": False}
    assert document_of(at_least("rate", 0.5, 0.75)) == entry


def test_the_verdict_of_an_outcome() -> None:
    assert Outcome(name="a").verdict == "pass"
    assert Outcome(name="a", reasons=("too far",)).verdict == "fail"
    assert Outcome(name="a", error=ExitCode.INFRASTRUCTURE).verdict == "fail"
    assert Outcome(name="a", skipped="not asked").verdict == "pass"


def test_a_check_as_an_outcome() -> None:
    assert outcome_of_check(at_most("RMS", 1, 2), "g") == Outcome(name="RMS", group="g")
    assert outcome_of_check(at_most("RMS", 2, 1), "g").verdict == "fail"


def test_a_table_in_every_form() -> None:
    assert TABLE.plain().splitlines() == ["Start  a  b|c  d", "0 m    1  <2>  -", "1 m    -  -    3"]
    assert TABLE.markdown().splitlines()[2] == "| 0 m | 1 | &lt;2&gt; | - |"
    assert TABLE.csv() == "Start,a,b|c,d\n0 m,1,<2>,-\n1 m,-,-,3\n"


def test_a_wide_table_is_split_in_the_log_only() -> None:
    table = Table(TABLE.columns, TABLE.rows, most_columns=2)
    assert table.plain().split("\n\n") == ["Start  a  b|c\n0 m    1  <2>", "Start  d\n1 m    3"]
    assert table.markdown() == TABLE.markdown()


def test_rows_and_lines_that_are_not_shown_are_counted() -> None:
    table = Table(("a", "b"), tuple((str(n), "x") for n in range(5)), most_rows=2, rest="all.csv")
    for text in (table.plain(), table.markdown()):
        assert "and 3 more, see all.csv" in text
        assert text.count("x") == 2
    assert table.csv().count("x") == 5
    assert Lines(("a", "b", "c"), most=1).plain() == "a\nand 2 more, see results.json"


def test_everything_that_people_read_is_bounded(tmp_path: Path) -> None:
    lines, err = tuple(f"line {number} of many" for number in range(5000)), io.StringIO()
    blocks = (Table(("a",), tuple((line,) for line in lines)), Lines(lines))
    report = make(
        reasons=lines, blocks=blocks, suites={"s": [Outcome(name="a", reasons=lines)]}, results={"all": lines}
    )
    publish(report, Runner(stderr=err, stdout=io.StringIO()), tmp_path)
    assert (tmp_path / "summary.md").read_text().count("of many") == 3 * 1000
    assert (tmp_path / "junit.xml").read_text().count("of many") == 1000 + 1  # the first is also the message
    assert (tmp_path / "junit.xml").read_text().count("and 4000 more, see results.json") == 1
    assert err.getvalue().splitlines()[-1] == "and 4000 more"
    assert (tmp_path / "results.json").read_text().count("of many") == 2 * 5000


def test_the_summary_has_the_verdict_then_reasons_then_blocks() -> None:
    hidden, folded = Text("only here", only="log"), Code("x `y`\n", title="How", folded=True)
    text = make(reasons=("a < b", "c"), blocks=(TABLE, hidden, folded, Lines((), title="Nothing"))).markdown()
    assert text.startswith("## check: fail: 1 of 2 failed\n\n- a &lt; b\n- c\n\n| Start |")
    assert text.endswith("<details><summary>How</summary>\n\n```\nx `y`\n```\n\n</details>\n")
    assert "only here" not in text
    assert "Nothing" not in text


def test_published(tmp_path: Path) -> None:
    out, err = io.StringIO(), io.StringIO()
    runner = Runner(
        GITHUB, output_file=tmp_path / "o", summary_file=tmp_path / "s", stdout=out, stderr=err, workspace=tmp_path
    )
    report = make(
        reasons=("::error::x",),
        warnings=("look",),
        notes=("no figure",),
        annotations=(Annotation("bad cell", file=tmp_path / "t.csv", line=3),),
        blocks=(Lines(("::add-mask::a",), title="Found"), Text("folded", only="summary")),
        suites={"s": [Outcome(name="a", reasons=("why",))]},
        files={"t.csv": "a\n", "f.png": b"\x00"},
    )
    publish(report, runner, tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("results.json", "summary.md", "junit.xml", "t.csv", "f.png")
    }
    assert json.loads((tmp_path / "out" / "results.json").read_text()) == {
        "schema": 1,
        "verdict": "fail",
        "reasons": ["::error::x"],
        "found": 2,
    }
    assert 'failures="1"' in (tmp_path / "out" / "junit.xml").read_text()
    lines = out.getvalue().splitlines()
    token = lines[0].removeprefix("::stop-commands::")
    shown = lines[1 : lines.index(f"::{token}::")]
    assert shown[:2] == ["Found", "::add-mask::a"]
    assert lines[-1] == f"fail: 1 of 2 failed ({tmp_path / 'out' / 'results.json'})"
    assert [line.partition(" ")[0] for line in lines if line.startswith(("::error", "::warning", "::notice"))] == [
        *("::error", "::error", "::warning", "::notice")
    ]
    assert (tmp_path / "s").read_text() == (tmp_path / "out" / "summary.md").read_text()
    outputs = dict(line.split("=", 1) for line in (tmp_path / "o").read_text().splitlines())
    assert outputs == {
        "verdict": "fail",
        "results": str(tmp_path / "out" / "results.json"),
        "summary": str(tmp_path / "out" / "summary.md"),
        "worst": "3.5",
        "best": "",
    }


def test_an_output_has_no_more_entries_than_a_later_step_can_take(tmp_path: Path) -> None:
    out = io.StringIO()
    entries = [{"file": f"{number}.csv"} for number in range(20_000)]
    outputs = {"values": entries, "rates": {str(number): 1.0 for number in range(20_000)}, "few": [1, 2]}
    publish(make(outputs=outputs), Runner(GITHUB, output_file=tmp_path / "o", stdout=out))
    found = dict(line.split("=", 1) for line in (tmp_path / "o").read_text().splitlines())
    assert all(len(value) <= 100_000 for value in found.values())
    values, rates = json.loads(found["values"]), json.loads(found["rates"])
    assert values == entries[: len(values)]
    assert min(len(values), len(rates)) > 1000
    assert found["few"] == "[1, 2]"
    notices = [line for line in out.getvalue().splitlines() if line.startswith("::notice")]
    assert f"values: has the first {len(values)} of 20000 entries; all are in results.json" in notices[0]
    assert len(notices) == 2


def test_without_a_folder_nothing_is_written(tmp_path: Path) -> None:
    out = io.StringIO()
    publish(make(), Runner(output_file=tmp_path / "o", stdout=out))
    assert out.getvalue() == "fail: 1 of 2 failed\n"
    assert "results=\n" in (tmp_path / "o").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["o"]


def test_the_verdicts_line_commands_nothing() -> None:
    out = io.StringIO()
    publish(make(sentence="a\n::add-mask::b ##[add-mask]c"), Runner(GITHUB, stdout=out))
    assert out.getvalue() == "fail: a ::add-mask::b ## [add-mask]c\n"


def test_no_number_that_is_not_finite_reaches_the_results() -> None:
    assert json.loads(str(make(results={"x": math.nan}).written()["results.json"]))["x"] is None


def test_results_of_an_earlier_run_are_removed(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("x")
    (tmp_path / "mine").write_text("x")
    remove_results(tmp_path, ("a", "b"))
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    with pytest.raises(
        InfrastructureError, match="mine: the results cannot be written: it, or a folder above it, is a file"
    ):
        remove_results(tmp_path / "mine", ("a",))
