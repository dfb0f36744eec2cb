"""The table and its CSV text."""

import csv
import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.evaluation.table import Table


def test_csv_has_atoms_form():
    table = Table("Collection #", ("RMS (pix)", "X err (pix)"), ("000", "003"), np.array([[0.5, 1], [1.25, 2.00004]]))
    assert table.to_csv() == (
        "Collection #,RMS (pix),X err (pix)\n"
        "000,0.5000,1.0000\n"
        "003,1.2500,2.0000\n"
        "Averages,0.8750,1.5000\n"
    )  # fmt: skip


def test_averages_are_those_of_the_printed_values():
    values = np.array([[0.00014], [0.00014], [0.00014], [0.00006]])
    table = Table("k", ("a",), ("0", "1", "2", "3"), values)
    assert table.average("a") == pytest.approx(0.0001, abs=1e-12)
    assert values.mean() == pytest.approx(0.00012)


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=20))
def test_what_is_written_reads_back(numbers):
    table = Table("k", ("a",), tuple(f"{i:03d}" for i in range(len(numbers))), np.array(numbers)[:, None])
    rows = list(csv.reader(io.StringIO(table.to_csv())))
    assert [row[0] for row in rows] == ["k", *table.labels, "Averages"]
    np.testing.assert_allclose([float(row[1]) for row in rows[1:-1]], numbers, atol=5.1e-5)
    assert float(rows[-1][1]) == pytest.approx(np.mean([float(row[1]) for row in rows[1:-1]]), abs=5.1e-5)


def test_a_number_that_is_none_stays_one():
    table = Table("k", ("a", "b"), ("000",), np.array([[np.nan, np.inf]]))
    assert table.to_csv().splitlines()[1:] == ["000,nan,inf", "Averages,nan,inf"]


def test_zero_has_no_sign():
    assert "-" not in Table("k", ("a",), ("000",), np.array([[-1e-9]])).to_csv()


def test_labels_are_quoted_where_csv_needs_it():
    assert Table("k", ("a",), ('x,"y"',), np.ones((1, 1))).to_csv().splitlines()[1] == '"x,""y""",1.0000'


def test_a_table_without_rows_is_none():
    with pytest.raises(ValueError, match="0 rows"):
        Table("k", ("a",), (), np.empty((0, 1)))


def test_sizes_must_fit():
    with pytest.raises(ValueError, match="2 rows, 1 columns"):
        Table("k", ("a",), ("0", "1"), np.ones((1, 1)))


def test_it_is_written_with_unix_line_ends(tmp_path):
    table = Table("k", ("a",), ("000",), np.ones((1, 1)))
    table.write(tmp_path / "results" / "table.csv")
    assert (tmp_path / "results" / "table.csv").read_bytes() == b"k,a\n000,1.0000\nAverages,1.0000\n"


def test_what_is_missing_is_told_from_what_is_no_number():
    values = np.array([[1.0, np.nan, np.nan], [3.0, 4.0, np.nan]])
    table = Table("k", ("a", "b", "c"), ("0", "1"), values, missing=np.array([[0, 1, 1], [0, 0, 1]], bool))
    assert table.to_csv().splitlines()[1:] == ["0,1.0000,---,---", "1,3.0000,4.0000,---", "Averages,2.0000,4.0000,---"]
    assert table.average("b") == 4
    assert np.isnan(table.average("c"))
    wrong = Table("k", ("a", "b", "c"), ("0", "1"), values, missing=np.array([[0, 1, 0], [0, 0, 1]], bool))
    assert wrong.to_csv().splitlines()[-1] == "Averages,2.0000,4.0000,nan"
