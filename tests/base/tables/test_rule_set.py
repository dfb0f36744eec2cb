import re
from typing import Any

import pytest

from calibration.base import InputError
from calibration.base.tables import parse_rules
from calibration.base.tables.rules import Allowance, ChangeRule, LimitRule, Limits, RuleSet, TextRule
from calibration.base.tables.table import Aggregate, EveryRow, IndexedRow, LabelledRow

RMS = "RMS (pix)"


def only(**rule: Any) -> Any:
    """Return the one rule that a mapping makes; its keys are given with _ for -."""
    (parsed,) = parse_rules([{key.replace("_", "-"): value for key, value in rule.items()}], "here").rules
    return parsed


@pytest.mark.parametrize(
    ("rule", "parsed"),
    [
        ({"max": 3}, LimitRule(RMS, EveryRow(), Limits(None, 3))),
        ({"every": True, "min": 0}, LimitRule(RMS, EveryRow(), Limits(0, None))),
        ({"every_min": 0, "every_max": 2}, LimitRule(RMS, EveryRow(), Limits(0, 2))),
        ({"row": "Averages", "min": 0, "max": 3}, LimitRule(RMS, LabelledRow("Averages"), Limits(0, 3))),
        ({"row": "last", "max": 3, "exclusive": True}, LimitRule(RMS, IndexedRow(-1), Limits(None, 3, True))),
        ({"aggregate": "p95", "max": "1e-3"}, LimitRule(RMS, Aggregate("p95"), Limits(None, 0.001))),
        ({"row": "Averages", "max_increase": "10%"}, ChangeRule(RMS, LabelledRow("Averages"), Allowance(10, True))),
        ({"max_decrease": 0.1}, ChangeRule(RMS, EveryRow(), None, Allowance(0.1, False))),
        ({"contains": "ok"}, TextRule(RMS, EveryRow(), contains="ok")),
        ({"row": "first", "does_not_contain": " x"}, TextRule(RMS, IndexedRow(0), does_not_contain=" x")),
        ({"matches": "a|b"}, TextRule(RMS, EveryRow(), matches=re.compile("a|b"))),
        ({"min": 3, "max": 3}, LimitRule(RMS, EveryRow(), Limits(3, 3))),
    ],
)
def test_rules(rule: dict[str, Any], parsed: object) -> None:
    assert only(column=RMS, **rule) == parsed


def test_one_mapping_can_judge_a_row_and_every_row() -> None:
    rule = {"column": RMS, "row": "Averages", "min": 0, "max": 3, "every-min": 0, "every-max": 2, "max-increase": "5%"}
    assert parse_rules({"rules": [rule]}, "here").rules == (
        LimitRule(RMS, LabelledRow("Averages"), Limits(0, 3)),
        LimitRule(RMS, EveryRow(), Limits(0, 2)),
        ChangeRule(RMS, LabelledRow("Averages"), Allowance(5, True)),
    )


def test_keys_of_the_table() -> None:
    document = {
        "rules": [],
        "key-column": "Run",
        "required-rows": ["000", "001"],
        "min-rows": 20,
        "summary-rows": ["Averages", "Mean"],
        "exclude-summary-rows": True,
        "file": "results/*.csv",
    }
    assert parse_rules(document, "here") == RuleSet(
        (), "Run", ("000", "001"), 20, ("Averages", "Mean"), True, "results/*.csv"
    )


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ({}, "the rule has no limit: give min, max"),
        ({"row": "Averages"}, "the rule has no limit"),
        ({"exclusive": True}, "the rule has no limit"),
        ({"row": "Averages", "every-max": 2}, "a row is chosen but has no limit"),
        ({"min": 3, "max": 2}, "no number can be as asked in 'RMS (pix)', every row: at least 3 and at most 2"),
        ({"min": 3, "max": 3, "exclusive": True}, "no number can be as asked"),
        ({"row": "x", "max": 1, "every-min": 2, "every-max": 1}, "no number can be as asked"),
        ({"contains": "an error", "does-not-contain": "error"}, "contains and does-not-contain contradict"),
        ({"max": 3, "contains": "x"}, "max is for numbers and contains for text: make two rules of it"),
        ({"every-max": 3, "matches": "x"}, "every-max is for numbers and matches for text"),
        ({"max-increase": "1%", "does-not-contain": "x"}, "max-increase is for numbers and does-not-contain for text"),
        ({"aggregate": "max", "contains": "x"}, "contains is for text, of which there is no max"),
        (
            {"row": "x", "aggregate": "max", "max": 1},
            "every, found row x and max of every row",
        ),
        ({"row": "x", "every": True, "max": 1}, "give one of row, aggregate, every"),
        ({"max": 1, "every-max": 1}, "are all for every row"),
        ({"contains": "x", "exclusive": True}, "exclusive is for min, max, every-min and every-max"),
        ({"maximum": 3}, "unknown key 'maximum'"),
        ({"every_max": 3}, "unknown key 'every_max': did you mean 'every-max'?"),
        ({3: 3}, "unknown key 3"),
        ({"max": None}, "max: found null, expected a finite number"),
        ({"max": True}, "max: found true, expected a finite number"),
        ({"max": "three"}, "max: found 'three', expected a finite number"),
        ({"max": float("nan")}, "max: found nan, expected a finite number"),
        ({"max": float("inf")}, "max: found inf, expected a finite number"),
        ({"max": 10**400}, "max: found 1000"),
        ({"max": [3]}, "max: found a list of 1, expected a finite number"),
        ({"row": 3, "max": 3}, "row: found 3, expected a text: put it in quotes"),
        ({"row": "", "max": 3}, "row: the text is empty"),
        ({"row": "index:x", "max": 3}, "row: 'index:x': a whole number was expected"),
        ({"aggregate": "avg", "max": 3}, "aggregate: 'avg' is no aggregate"),
        ({"exclusive": "yes", "max": 3}, "exclusive: found 'yes', expected true or false"),
        ({"contains": ""}, "contains: found '', expected a text that is not empty"),
        ({"matches": "("}, "matches: '(' is no regular expression: missing ), unterminated subpattern"),
        ({"matches": "a{99999999999}"}, "matches: 'a{99999999999}' is no regular expression: the repetition number"),
        ({"max-increase": "-1%"}, "max-increase: '-1%' is no allowance"),
        ({"max-increase": None}, "max-increase: found null, expected a text or a number"),
    ],
)
def test_wrong_rules(rule: dict[Any, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_rules({"rules": [{"column": "fine", "max": 1}, {"column": RMS, **rule}]}, "calibration.yml: rules")
    text = str(caught.value)
    assert text.startswith("calibration.yml: rules: ")
    assert "rules.1" in text or "no number" in text or "contradict" in text
    assert message in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (None, "here: found null, expected keys: rules, key-column"),
        ("rules", "here: found 'rules', expected keys: rules"),
        ([], "here: there is no rule, so nothing would be judged"),
        ({}, "here: there is no rule"),
        ({"rules": []}, "here: there is no rule"),
        ({"key-column": "x", "required-rows": []}, "here: there is no rule"),
        ({"rules": None}, "here: rules: found null, expected a list"),
        ({"rules": {"column": "x", "max": 1}}, "here: rules: found a mapping of 2 keys, expected a list"),
        (["x"], "here: rules.0: found 'x', expected keys: column, row"),
        ([{"max": 3}], "here: rules.0: missing key 'column'"),
        ([{"column": " ", "max": 3}], "here: rules.0.column: the text is empty"),
        ([{"column": 3, "max": 3}], "here: rules.0.column: found 3, expected a text"),
        ({"rule": []}, "here: unknown key 'rule': did you mean 'rules'?"),
        ({"min-rows": 0}, "here: min-rows: found 0, expected a whole number of at least 1"),
        ({"min-rows": True}, "here: min-rows: found "),
        ({"min-rows": 1.5}, "here: min-rows: found "),
        ({"required-rows": "000"}, "here: required-rows: found '000', expected a list"),
        ({"required-rows": [0]}, "here: required-rows.0: found 0, expected a text: put it in quotes"),
        ({"exclude-summary-rows": 1}, "here: exclude-summary-rows: found 1, expected true or false"),
        (
            [{"column": RMS, "row": "a", "max": 1}, {"column": RMS, "row": "a", "min": 2}],
            "here: no number can be as asked in 'RMS (pix)', row a: at most 1, but at least 2",
        ),
    ],
)
def test_wrong_sets_of_rules(document: object, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_rules(document, "here")
    assert str(caught.value).startswith(message)


def test_rules_for_different_rows_do_not_contradict() -> None:
    parse_rules([{"column": RMS, "row": "a", "max": 1}, {"column": RMS, "row": "b", "min": 2}], "here")
    parse_rules([{"column": RMS, "max": 1}, {"column": "X", "min": 2}], "here")
