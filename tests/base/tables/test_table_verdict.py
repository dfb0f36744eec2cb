from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.base.tables import RuleSet, Table, TableResult, Violation, judge, parse_rules
from calibration.base.tables.table import Row, parse_table

RMS = "RMS (pix)"


def verdict_on(table: Table, *rules: dict[str, Any], baseline: Table | None = None, **keys: Any) -> TableResult:
    document = {"rules": list(rules), **{key.replace("_", "-"): value for key, value in keys.items()}}
    return judge(table, parse_rules(document, "rules"), baseline)


def column(*cells: str) -> Table:
    """Return a table of a key column k and a column v."""
    return parse_table("k,v\n" + "".join(f'r{number},"{cell}"\n' for number, cell in enumerate(cells)), "t")


def test_the_papers_gate(atom: Table) -> None:
    rule = {"column": RMS, "row": "Averages", "min": 0, "max": 3, "every-min": 0, "every-max": 2}
    verdict = verdict_on(atom, rule)
    assert verdict.passed
    assert verdict.violations == ()
    assert [(check.rows, check.value, check.smallest, check.largest) for check in verdict.checks] == [
        ("number of rows", 4, 4, 4),
        ("row Averages", 0.7, 0.7, 0.7),
        ("every row", None, 0.5, 0.9),
    ]


def test_every_violation_is_listed(atom: Table) -> None:
    verdict = verdict_on(
        atom,
        {"column": RMS, "row": "Averages", "max": 0.6, "every-max": 0.5},
        {"column": "Rot (deg)", "aggregate": "max", "max": 0.03},
        required_rows=["000", "007"],
        min_rows=9,
    )
    assert not verdict.passed
    assert verdict.violations == (
        Violation("results.csv", None, None, "number of rows", "4", "at least 9"),
        Violation("results.csv", None, "Collection #", "007", "no such row", "a row with this label"),
        Violation("results.csv", 5, RMS, "Averages", "0.7", "at most 0.6"),
        Violation("results.csv", 3, RMS, "001", "0.9", "at most 0.5"),
        Violation("results.csv", 4, RMS, "002", "0.7", "at most 0.5"),
        Violation("results.csv", 5, RMS, "Averages", "0.7", "at most 0.5"),
        Violation("results.csv", None, "Rot (deg)", "max of every row", "0.04", "at most 0.03"),
    )
    assert verdict.violations[2].message == "RMS (pix), Averages: found 0.7, expected at most 0.6"
    assert [check.verdict for check in verdict.checks] == ["fail"] * 5


@pytest.mark.parametrize(
    ("rule", "passed"),
    [
        ({"row": "Averages", "max": 0.7}, True),
        ({"row": "Averages", "max": 0.7, "exclusive": True}, False),
        ({"row": "Averages", "min": 0.7}, True),
        ({"row": "Averages", "min": 0.7, "exclusive": True}, False),
        ({"row": "first", "max": 0.5}, True),
        ({"row": "first", "max": 0.4999}, False),
        ({"row": "last", "min": 0.7, "max": 0.7}, True),
        ({"row": "index:1", "min": 0.9}, True),
        ({"row": "index:-2", "min": 0.8}, False),
        ({"aggregate": "max", "max": 0.9}, True),
        ({"aggregate": "min", "min": 0.51}, False),
        ({"aggregate": "mean", "min": 0.7, "max": 0.7}, True),
        ({"aggregate": "median", "min": 0.7, "max": 0.7}, True),
        ({"aggregate": "p50", "min": 0.7, "max": 0.7}, True),
        ({"max": 0.9}, True),
        ({"max": 0.89}, False),
    ],
)
def test_rows_and_aggregates(atom: Table, rule: dict[str, Any], passed: bool) -> None:
    assert verdict_on(atom, {"column": RMS, **rule}).passed is passed


def test_summary_rows_are_part_of_every_row_unless_excluded() -> None:
    table = parse_table("Collection #,n\n000,1\n001,2\nAverages,1.5\nTotal,99\n", "t")
    rules = [{"column": "n", "max": 2}, {"column": "n", "aggregate": "mean", "max": 1.5}]
    assert not verdict_on(table, *rules).passed
    assert not verdict_on(table, *rules, exclude_summary_rows=True).passed
    assert not verdict_on(table, *rules, summary_rows=["Averages", "Total"]).passed
    excluded = {"exclude_summary_rows": True, "summary_rows": ["Averages", "Total"]}
    assert verdict_on(table, *rules, **excluded).passed
    assert not verdict_on(table, *rules, **excluded, min_rows=3).passed
    assert not verdict_on(table, {"column": "n", "row": "Total", "max": 2}, **excluded).passed
    assert not verdict_on(table, {"column": "n", "row": "last", "max": 2}, **excluded).passed


@pytest.mark.parametrize("cell", ["nan", "NaN", "inf", "-inf", "", "text", "1,5", "1e999", "0x1", "1 mm", "--", "None"])
@pytest.mark.parametrize("target", [{}, {"row": "r1"}, {"aggregate": "min"}, {"aggregate": "median"}])
def test_what_is_no_number_is_never_a_pass(cell: str, target: dict[str, str]) -> None:
    verdict = verdict_on(column("1", cell, "2"), {"column": "v", "min": -1e300, "max": 1e300, **target})
    (violation,) = verdict.violations
    assert (violation.line, violation.row) == (3, "r1")
    assert cell in violation.found
    assert violation.expected.startswith("a number at least")


def test_a_table_without_rows_is_never_a_pass() -> None:
    for rule in ({"max": 1}, {"aggregate": "max", "max": 1}, {"row": "last", "max": 1}, {"contains": "x"}):
        verdict = verdict_on(column(), {"column": "v", **rule})
        assert [violation.found for violation in verdict.violations] == ["0", "no row"]


def test_only_summary_rows_are_no_rows() -> None:
    table = parse_table("Collection #,n\nAverages,1.5\n", "t")
    assert verdict_on(table, {"column": "n", "max": 2}).passed
    assert not verdict_on(table, {"column": "n", "max": 2}, exclude_summary_rows=True).passed


def test_too_few_rows_for_an_index() -> None:
    (violation,) = verdict_on(column("1"), {"column": "v", "row": "index:5", "max": 1}).violations
    assert (violation.row, violation.found) == ("row index:5", "no row")


@pytest.mark.parametrize(
    ("rule", "passed"),
    [
        ({"contains": "ok"}, False),
        ({"row": "r0", "contains": "ok"}, True),
        ({"row": "r1", "does-not-contain": "error"}, False),
        ({"row": "r0", "does-not-contain": "error"}, True),
        ({"matches": ".*"}, True),
        ({"row": "r0", "matches": "ok"}, False),
        ({"row": "r0", "matches": "ok.*"}, True),
        ({"row": "r2", "matches": r"\d+"}, True),
        ({"row": "r2", "contains": "3"}, True),
    ],
)
def test_texts(rule: dict[str, Any], passed: bool) -> None:
    table = column("ok, all well", "an error", "13")
    assert verdict_on(table, {"column": "v", **rule}).passed is passed


def test_a_long_cell_is_not_held_against_a_regular_expression() -> None:
    (violation,) = verdict_on(column("a" * 1001), {"column": "v", "matches": "a*"}).violations
    assert violation.found == "a text of 1001 characters"
    assert verdict_on(column("a" * 1000), {"column": "v", "matches": "a*"}).passed
    assert verdict_on(column("a" * 1001), {"column": "v", "contains": "a"}).passed


def test_a_row_without_a_label_is_named_by_its_line() -> None:
    table = parse_table("k,v\n,5\n", "t")
    (violation,) = verdict_on(table, {"column": "v", "max": 1}).violations
    assert violation.row == "line 2"


def test_what_cannot_be_judged(atom: Table) -> None:
    for rules, message in [
        ([{"column": "RMS", "max": 3}], "there is no column 'RMS'"),
        ([{"column": RMS, "row": "Average", "max": 3}], "no row 'Average'"),
        ([{"column": RMS, "max-increase": "1%"}], "but there is no baseline"),
    ]:
        with pytest.raises(InputError, match=message):
            verdict_on(atom, *rules)
    with pytest.raises(InputError, match="there is no column 'Run'"):
        verdict_on(atom, {"column": RMS, "max": 3}, key_column="Run")
    with pytest.raises(InputError, match="there is no rule"):
        judge(atom, RuleSet())


def test_bad_input_wins_over_a_violation(atom: Table) -> None:
    with pytest.raises(InputError):
        verdict_on(atom, {"column": RMS, "max": 0}, {"column": "none", "max": 3})


BASELINE = column("0.5", "1.0", "2.0")


@pytest.mark.parametrize(
    ("cells", "rule", "rows"),
    [
        (["0.5", "1.0", "2.0"], {"max-increase": "0"}, []),
        (["0.55", "1.1", "2.2"], {"max-increase": "10%"}, []),
        (["0.56", "1.1", "2.3"], {"max-increase": "10%"}, ["r0", "r2"]),
        (["0.6", "1.1", "2.1"], {"max-increase": 0.1}, []),
        (["0.61", "1.1", "2.1"], {"max-increase": 0.1}, ["r0"]),
        (["0", "0", "0"], {"max-increase": "10%"}, []),
        (["0", "0.9", "2.0"], {"max-decrease": "10%"}, ["r0"]),
        (["9", "1.2", "1.7"], {"max-increase": "10%", "max-decrease": "10%"}, ["r0", "r1", "r2"]),
        (["9", "9", "2.1"], {"row": "last", "max-increase": 0.1}, []),
        (["9", "9", "2.2"], {"row": "r2", "max-increase": 0.1}, ["r2"]),
        (["0.5", "2.0", "1.0"], {"aggregate": "max", "max-increase": "0%"}, []),
        (["0.5", "2.1", "1.0"], {"aggregate": "max", "max-increase": "0%"}, ["max of every row"]),
        (["nan", "1.0", ""], {"max-increase": "10%"}, ["r0", "r2"]),
        (["nan", "1.0", "x"], {"aggregate": "max", "max-increase": "10%"}, ["r0", "r2"]),
        (["0.5", "1.0"], {"max-increase": "10%"}, ["r2"]),
        (["0.5", "1.0", "2.0", "0.1"], {"max-increase": "10%"}, ["r3"]),
    ],
)
def test_baseline(cells: list[str], rule: dict[str, Any], rows: list[str]) -> None:
    verdict = verdict_on(column(*cells), {"column": "v", **rule}, baseline=BASELINE)
    assert [violation.row for violation in verdict.violations] == rows


def test_rows_are_matched_by_label_in_any_order() -> None:
    table = parse_table("v,k\n2.0,r2\n0.5,r0\n1.0,r1\n", "t")
    assert verdict_on(table, {"column": "v", "max-increase": "0"}, baseline=BASELINE, key_column="k").passed


def test_a_violation_names_the_baseline() -> None:
    (violation,) = verdict_on(
        column("0.6", "1.0", "2.0"), {"column": "v", "max-increase": "10%", "max-decrease": "5%"}, baseline=BASELINE
    ).violations
    assert violation.expected == "at least 0.475 and at most 0.55 (baseline 0.5)"


@pytest.mark.parametrize(
    ("baseline", "rule", "message"),
    [
        (
            column("0.5", "nan", "1"),
            {"max-increase": "1%"},
            "t:3: v: the baseline has 'nan', which is no",
        ),
        (column("0.5", "x", "1"), {"aggregate": "max", "max-increase": "1%"}, "the baseline has 'x'"),
        (column(), {"max-increase": "1%"}, "the baseline has no row to compare with"),
        (column("1"), {"row": "r1", "max-increase": "1%"}, "no row 'r1'"),
        (parse_table("k,w\nr0,1\n", "t"), {"max-increase": "1%"}, "there is no column 'v'"),
        (parse_table("k,v\nr0,1\nr0,1\n", "t"), {"max-increase": "1%"}, "t:3: a second row is labelled 'r0'"),
    ],
)
def test_a_baseline_that_cannot_be_compared_with(baseline: Table, rule: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        verdict_on(column("0.5", "1", "1"), {"column": "v", **rule}, baseline=baseline)


def test_repeated_labels_cannot_be_matched() -> None:
    for text in ("k,v\nr0,1\nr0,1\n", "k,v\n,1\n,1\n"):
        with pytest.raises(InputError, match="rows cannot be matched with the baseline; is 'k' the key column"):
            verdict_on(parse_table(text, "t"), {"column": "v", "max-increase": "1%"}, baseline=BASELINE)


NUMBERS = st.floats(-100, 100, allow_subnormal=False)


@given(
    st.lists(NUMBERS, min_size=1, max_size=6),
    st.tuples(NUMBERS, NUMBERS).map(sorted),
    st.floats(0, 10),
    st.booleans(),
    st.sampled_from([{}, {"row": "first"}, {"aggregate": "mean"}, {"aggregate": "p90"}]),
)
def test_wider_limits_never_turn_a_pass_into_a_fail(
    values: list[float], limits: list[float], more: float, exclusive: bool, target: dict[str, str]
) -> None:
    low, high = limits
    if exclusive and low == high:
        return
    rule = {"column": "v", "exclusive": exclusive, **target}
    table = column(*map(repr, values))
    narrow = verdict_on(table, {**rule, "min": low, "max": high})
    wide = verdict_on(table, {**rule, "min": low - more, "max": high + more})
    assert wide.passed >= narrow.passed
    assert len(wide.violations) <= len(narrow.violations)


@given(st.lists(NUMBERS, min_size=1, max_size=6))
def test_a_table_never_differs_from_itself(values: list[float]) -> None:
    table = column(*map(repr, values))
    for target in ({}, {"row": "last"}, {"aggregate": "mean"}, {"aggregate": "p33.3"}):
        rule = {"column": "v", "max-increase": "0", "max-decrease": "0%", **target}
        assert verdict_on(table, rule, baseline=table).passed


@given(st.lists(st.text(max_size=5), max_size=4))
def test_any_cells_are_judged(cells: list[str]) -> None:
    table = Table("t", ("k", "v"), tuple(Row(line, ("", cell)) for line, cell in enumerate(cells, start=2)))
    verdict = verdict_on(table, {"column": "v", "min": 0}, {"column": "v", "aggregate": "mean", "max": 1})
    if verdict.passed:
        numbers = [float(cell) for cell in cells]
        assert min(numbers) >= 0
        assert sum(numbers) / len(numbers) <= 1
