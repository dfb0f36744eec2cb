"""Tables that software left, against the one that follows from its dataset."""

import numpy as np
import pytest

from calibration.base.tables.table import parse_table
from calibration.engine.diagnosis.table_follows import not_evaluated, table_follows
from calibration.engine.evaluation.table import Table

VALUES = np.array([[0.31, 1.2], [5.2, 2.4], [0.04, 3.6]])
MADE = Table("Collection #", ("RMS (pix)", "Trans (mm)"), ("000", "004", "007"), VALUES)


def said(text: str) -> list[tuple[str, str]]:
    return [(found.severity, found.text) for found in table_follows(parse_table(text, "t.csv"), MADE)]


def test_its_own_table_follows() -> None:
    assert said(MADE.to_csv()) == []


@pytest.mark.parametrize(
    "text",
    [
        "Collection #;Trans (mm);Colour;RMS (pix)\n0;1.2;red;0.3\n4;2.4;red;5.2\n7;3.6;red;0.0\n",  # few digits
        "Collection #,RMS (pix)\n004,5.21\n000,0.3094\nAverages,1.85\n",  # another order, one left out, a percent off
        "Collection,RMS (pix)\nAverages,1.85e0\n",
        "Collection,RMS (pix)\nAverages,18.5e-1\nMedian,0.31\n",
    ],
)
def test_digits_order_and_method_may_differ(text: str) -> None:
    assert said(text) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Collection #,RMS (pix)\n004,0.31\n", "the table says RMS (pix) 0.31 for 004, its dataset gives 5.2"),
        ("Collection #,RMS (pix)\nAverages,0.31\n", "the table says RMS (pix) 0.31 on average, its dataset gives 1.85"),
        ("Collection #,Trans (mm)\n000,0\n004,0\nAverages,0\n", "the table says Trans (mm) 0 for 000"),
        ("Collection #,RMS (pix)\n000,---\n", "the table says RMS (pix) --- for 000, its dataset gives 0.31"),
        ("Collection #,RMS (pix)\n000,nan\n", "the table says RMS (pix) nan for 000"),
        ("Collection #,RMS (pix)\n000,0\n004,0\n", "the table says RMS (pix) 0 for 000, its dataset gives 0.31"),
        ("Collection #,RMS (pix)\nAverages,2.1\n", "RMS (pix) 2.1 on average"),
        ("Collection #,RMS (pix)\n000,-0.31\n", "the table says RMS (pix) -0.31 for 000"),
        ("Collection #,RMS (pix)\n000,\n", "the table says RMS (pix) nothing for 000"),
        ("Collection #,RMS (pix)\n100,0.31\n", "the table has no row of the collections of its dataset (000, 004, 007"),
    ],
)
def test_what_does_not_follow_is_red(text: str, message: str) -> None:
    [(severity, found)] = said(text)
    assert severity == "red"
    assert message in found


def test_only_the_first_difference_is_reported() -> None:
    [(_, text)] = said("Collection #,RMS (pix),Trans (mm)\n000,0,0\n004,0,0\n007,0,0\nAverages,0,0\n")
    assert "RMS (pix) 0 for 000" in text
    assert "and 6 more values differ" in text


def test_other_columns_are_not_verified() -> None:
    [(severity, text)] = said("Name,Error\na,1\n")
    assert severity == "note"
    assert "not verified" in text


def test_what_the_sensor_did_not_see_has_no_value() -> None:
    missing = np.array([[True, False], [False, False], [False, False]])
    made = Table(MADE.key, MADE.columns, MADE.labels, VALUES, missing=missing)
    assert table_follows(parse_table(made.to_csv(), "t.csv"), made) == ()


def test_without_an_evaluation_the_rms_is_compared_with_the_noise() -> None:
    assert [found.severity for found in not_evaluated(0.0, 0.15)] == ["red"]
    for rms, noise in ((0.1, 0.15), (None, 0.15), (0.0, float("nan"))):
        assert [found.severity for found in not_evaluated(rms, noise)] == ["note"]
