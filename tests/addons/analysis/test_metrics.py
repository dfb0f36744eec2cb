"""Metrics and the grade: worse for more findings, complexity and duplication."""

from pathlib import Path

import pytest

from calibration.addons.analysis.analysers.programs import CodeMetrics, grade_badge, grade_of, measure
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import CodeFinding
from tests.repositories import write

BODY = "".join(f"    total = total * {n} + table[{n}] - other[{n}]\n" for n in range(40))
FUNCTION = "def {name}(total, table, other):\n" + BODY + "    return total\n\n\n"
BRANCHES = (
    "def branches(x):\n" + "".join(f"    if x == {n}:\n        return {n}\n" for n in range(20)) + "    return x\n"
)


def measured(folder: Path, files: dict[str, str | bytes]) -> CodeMetrics:
    write(folder, files)
    return measure(Copy(folder, tuple(files)), list(files), 60)


def test_functions_complexity_and_duplication_are_counted(tmp_path: Path) -> None:
    whole = {"a.py": FUNCTION.format(name="one") + BRANCHES, "b.py": FUNCTION.format(name="two"), "readme.md": "# x\n"}
    found = measured(tmp_path / "whole", whole)
    assert (found.functions, found.complex_functions) == (3, 1)
    assert found.mean_complexity == pytest.approx((1 + 1 + 21) / 3, abs=0.1)
    assert found.duplicate_percent > 30
    alone = measured(tmp_path / "alone", {"a.py": FUNCTION.format(name="one")})
    assert (alone.complex_functions, alone.duplicate_percent) == (0, 0)
    assert measured(tmp_path / "none", {"readme.md": "# x\n"}) == CodeMetrics()


@pytest.mark.parametrize(
    ("weight", "complex_percent", "duplicate_percent", "grade"),
    [
        (0, 0, 0, "A"),
        (1, 10, 10, "A"),
        (1.01, 0, 0, "B"),
        (0, 10.1, 0, "B"),
        (0, 0, 10.1, "B"),
        (0, 100, 100, "C"),
        (10.5, 0, 0, "D"),
        (40.1, 0, 0, "F"),
        (1e9, 100, 100, "F"),
    ],
)
def test_grades(weight: float, complex_percent: float, duplicate_percent: float, grade: str) -> None:
    assert grade_of(weight, complex_percent, duplicate_percent) == grade
    assert f">{grade}</text>" in grade_badge(grade)


def test_an_error_weighs_more_than_a_warning_and_that_more_than_a_note() -> None:
    weights = [
        CodeMetrics().graded([CodeFinding("a.py", 1, "x/y", "style", severity, "")], 1000).weighted_findings
        for severity in ("error", "warning", "note")
    ]
    assert weights == [5.0, 1.0, 0.2]
    assert CodeMetrics().graded([], 0).grade == "A"
