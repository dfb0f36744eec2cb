"""Accepted findings, and limits of their number."""

from datetime import date
from pathlib import Path

import pytest

from calibration.addons.analysis.results import CodeFinding, Suppressed
from calibration.addons.analysis.settings import Suppression, parse_limits, read_suppressions, sift
from calibration.base import InputError

TODAY = date(2030, 1, 31)
FINDING = CodeFinding("scripts/run.py", 3, "ruff/S603", "security", "warning", "subprocess")
OTHER = CodeFinding("a.cpp", 1, "cppcheck/nullPointer", "error-prone", "error", "null")


def test_what_is_covered_is_taken_out_with_its_reason() -> None:
    suppression = Suppression("ruff/*", "constants", "scripts/*")
    found = sift([FINDING, OTHER], [suppression], TODAY)
    assert found.kept == (OTHER,)
    assert found.suppressed == (Suppressed(FINDING, "constants"),)
    assert not found.remarks


def test_the_last_day_counts_and_the_next_does_not() -> None:
    assert not sift([FINDING], [Suppression("ruff/S603", "r", until=TODAY)], TODAY).kept
    ended = sift([FINDING], [Suppression("ruff/S603", "r", until=date(2030, 1, 30))], TODAY)
    assert ended.kept == (FINDING,)
    assert ended.remarks == ("the suppression of ruff/S603 in * ended on 2030-01-30",)


def test_a_suppression_that_matches_nothing_is_reported() -> None:
    assert sift([OTHER], [Suppression("ruff/S1", "r")], TODAY).remarks == (
        "the suppression of ruff/S1 in * covers nothing",
    )


def test_a_file_is_read_with_dates_as_yaml_has_them(tmp_path: Path) -> None:
    path = tmp_path / "s.yml"
    path.write_text(
        "suppressions:\n- {rule: ruff/S603, reason: constants, until: 2030-01-31}\n"
        "- {rule: a, reason: b, until: '2030-02-01'}\n"
    )
    assert [each.until for each in read_suppressions(path)] == [TODAY, date(2030, 2, 1)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- {rule: ruff/S603}", "reason"),
        ("- {rule: ruff/S603, reason: ''}", "reason"),
        ("- {rule: a, reason: b, until: soon}", "until: found 'soon', expected a date such as"),
        ("- {rule: a, reason: b, until: '2030-02-31'}", "until"),
        ("- {rule: a, reason: b, pth: c}", "path"),
        ("  a: 3", "suppressions"),
    ],
)
def test_what_is_wrong_in_the_file_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "s.yml"
    path.write_text(f"suppressions:\n{text}\n")
    with pytest.raises(InputError, match=said) as error:
        read_suppressions(path)
    assert str(path) in str(error.value)


def test_limits_count_severities_categories_and_all() -> None:
    found = [
        limit.check([FINDING, OTHER], "new") for limit in parse_limits(["error=1", "security=0", "all=1"], "max-new")
    ]
    assert [check.passed for check in found] == [True, False, False]
    assert str(found[1]) == "new findings (security): found 1, expected at most 0"


@pytest.mark.parametrize("text", ["error", "error=-1", "errors=1", "error=1.5", "=1"])
def test_what_is_no_limit_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="max-new: "):
        parse_limits([text], "max-new")
