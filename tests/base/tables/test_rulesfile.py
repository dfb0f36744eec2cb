from pathlib import Path

import pytest

from calibration.base import InputError
from calibration.base.tables.rules import LimitRule, Limits, RuleSet, TextRule
from calibration.base.tables.table import EveryRow, IndexedRow, LabelledRow
from calibration.ci.introspection import read_rules

COLUMNS = """
introspection_target_columns:
  - "RMS (pix)":
      validation_min: 0
      validation_max: 2.0
      acceptable_min: 0
      acceptable_max: 3.0
      value_row: Averages
  - "Trans (mm)":
      acceptable_max: 5.0
      use_latest_row: true
  - Status:
      contains_str: ok
      does_not_contain_str: error
      value_row: "000"
"""
RULES = (
    LimitRule("RMS (pix)", LabelledRow("Averages"), Limits(0, 3)),
    LimitRule("RMS (pix)", EveryRow(), Limits(0, 2)),
    LimitRule("Trans (mm)", IndexedRow(-1), Limits(None, 5)),
    TextRule("Status", LabelledRow("000"), "ok", "error"),
)


def indented(text: str, by: int) -> str:
    return "".join(" " * by + line for line in text.splitlines(keepends=True))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rules.yml"


def test_rules_in_our_form(path: Path) -> None:
    path.write_text("rules:\n  - {column: RMS (pix), row: Averages, min: 0, max: 1e1}\nmin-rows: 20\n")
    assert read_rules(path) == RuleSet((LimitRule("RMS (pix)", LabelledRow("Averages"), Limits(0, 10)),), min_rows=20)


def test_a_list_of_rules(path: Path) -> None:
    path.write_text("- {column: x, max: 3}\n")
    assert read_rules(path).rules == (LimitRule("x", EveryRow(), Limits(None, 3)),)


@pytest.mark.parametrize(
    "document",
    [
        COLUMNS,
        "with:\n" + indented(COLUMNS, 2),
        "plugin: file_introspection.plugin.FileIntrospection\nwith:\n" + indented(COLUMNS, 2),
        "application: {distro: noetic}\njobs:\n  compose: {plugin: a, with: {timeout: 300.0}}\n  introspection:\n"
        "    plugin: b\n    with:\n" + indented(COLUMNS, 6),
        "applications:\n  robot:\n    distro: noetic\n    jobs:\n      check:\n        with:\n" + indented(COLUMNS, 10),
        COLUMNS.replace("introspection_target_columns:", "introspection_target_columns: !!python/tuple"),
    ],
)
def test_rules_in_a_rigelfile(path: Path, document: str) -> None:
    path.write_text(document)
    assert read_rules(path) == RuleSet(RULES)


def test_the_file_of_a_rigelfile(path: Path) -> None:
    path.write_text("file: /archives/latest/results.csv\n" + COLUMNS)
    assert read_rules(path).file == "/archives/latest/results.csv"


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ("acceptable_max: 3", "choose it with value_row or use_latest_row"),
        ("acceptable_max: 3, use_latest_row: false", "choose it with value_row or use_latest_row"),
        ("acceptable_max: 3, use_latest_row: true, value_row: a", "both choose a row"),
        ("acceptable_max: 3, use_latest_row: 1", "use_latest_row: true or false was expected, found 1"),
        ("acceptable_max: 3, contains_str: a, value_row: a", "max is for numbers and contains for text"),
        ("validation_max: 3, contains_str: a, value_row: a", "every-max is for numbers and contains for text"),
        ("use_latest_row: true", "the rule has no limit"),
        ("value_row: a, acceptable_max: null", "the rule has no limit"),
        ("acceptable_min: 3, acceptable_max: 2, value_row: a", "no number can be as asked"),
        ("acceptable_maximum: 3", "there is no key 'acceptable_maximum': did you mean 'acceptable_max'?"),
        ("acceptable_max: '{{ vars.max }}', value_row: a", "only Rigel fills in '{{ vars.max }}'"),
        ("acceptable_max: .nan, value_row: a", "found nan, expected a finite number"),
    ],
)
def test_wrong_rules_in_a_rigelfile(path: Path, limits: str, message: str) -> None:
    path.write_text(f"introspection_target_columns: [RMS: {{{limits}}}]\n")
    with pytest.raises(InputError) as caught:
        read_rules(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("introspection_target_columns: {a: 1}", "a list of columns was expected"),
        ("introspection_target_columns: [a]", "entry 1: one column and its limits were expected"),
        ("introspection_target_columns: [{a: {}, b: {}}]", "entry 1: one column and its limits were expected"),
        ("introspection_target_columns: [{a: 3}]", "entry 1: one column and its limits were expected"),
        ("introspection_target_columns: []", "there is no rule"),
        ("files: x\n" + COLUMNS, "there is no key 'files': did you mean 'file'?"),
        (
            "jobs:\n  a: {with: {introspection_target_columns: []}}\n  b: {with: {introspection_target_columns: []}}\n",
            "jobs.a.with, jobs.b.with all have introspection_target_columns",
        ),
        ("jobs: {a: {plugin: x}}", "unknown key 'jobs'"),
        ("", "found null, expected keys: rules, key-column"),
        ("rules: [", "this is not valid YAML"),
        ("a: 1\nb: 2\na: 3\n", "the key 'a' occurs twice"),
        ("a: &x [*x]", "its aliases expand to more than"),
        ("rules: !!python/object/apply:os.system [echo]", "this is not valid YAML: could not determine a constructor"),
        ("rules: !!python/tuple 3", "this is not valid YAML"),
        ("? {a: b}\n: 1\n", "this is not valid YAML"),
        ("- 1\n---\n- 2\n", "this is not valid YAML"),
        ("a: 2020-13-45\n", "this is not valid YAML"),
        ("a: \x07\n", "this is not valid YAML"),
        ("[" * 5000, "nested too deeply"),
    ],
)
def test_files_that_hold_no_rules(path: Path, document: str, message: str) -> None:
    path.write_text(document)
    with pytest.raises(InputError) as caught:
        read_rules(path)
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)


def test_a_repeated_key_is_named_with_its_line(path: Path) -> None:
    path.write_text("rules:\n  - column: x\n    max: 1\n    max: 2\n")
    with pytest.raises(InputError, match=r"rules\.yml:4: this is not valid YAML: the key 'max' occurs twice"):
        read_rules(path)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a file of rules was expected, but it cannot be read: No such file"):
        read_rules(tmp_path / "none.yml")
    with pytest.raises(InputError, match="no regular file"):
        read_rules(tmp_path)
    (tmp_path / "large.yml").write_bytes(b"#" * (1024 * 1024 + 1))
    with pytest.raises(InputError, match="found 1048577 bytes"):
        read_rules(tmp_path / "large.yml")
    (tmp_path / "binary.yml").write_bytes(b"\xff\xfe\x00\xd8")
    with pytest.raises(InputError, match="not valid YAML"):
        read_rules(tmp_path / "binary.yml")
