import math
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.base.tables import Table
from calibration.base.tables.table import (
    Aggregate,
    IndexedRow,
    KeyedTable,
    LabelledRow,
    parse_aggregate,
    parse_row,
    parse_table,
)


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("Averages", LabelledRow("Averages")),
        ("000", LabelledRow("000")),
        ("first", IndexedRow(0)),
        ("last", IndexedRow(-1)),
        ("index:3", IndexedRow(3)),
        ("index:-2", IndexedRow(-2)),
        ("label:first", LabelledRow("first")),
        ("label:index:3", LabelledRow("index:3")),
        ("a:b", LabelledRow("a:b")),
    ],
)
def test_rows(text: str, target: LabelledRow | IndexedRow) -> None:
    assert parse_row(text) == target


@pytest.mark.parametrize("text", ["index:", "index:x", "index:1.5", "index:99999999999", "label:", "label: ", ""])
def test_what_names_no_row(text: str) -> None:
    with pytest.raises(InputError):
        parse_row(text)


@pytest.mark.parametrize("text", ["max", "min", "mean", "median", "p0", "p95", "p99.9", "p100"])
def test_aggregates(text: str) -> None:
    assert parse_aggregate(text) == Aggregate(text)


@pytest.mark.parametrize("text", ["", "avg", "p", "p101", "p-1", "p95%", "P95", "p1e1", "pnan"])
def test_what_is_no_aggregate(text: str) -> None:
    with pytest.raises(InputError, match="max, min, mean, median or a percentile such as p95"):
        parse_aggregate(text)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1), st.integers(0, 1000))
def test_aggregates_are_numpys(values: list[float], permille: int) -> None:
    decimals = [Decimal(repr(value)) for value in values]
    expected = {
        "max": np.max(values),
        "min": np.min(values),
        "mean": np.mean(values),
        "median": np.median(values),
        f"p{permille / 10}": np.percentile(values, permille / 10),
    }
    for name, value in expected.items():
        assert math.isclose(float(Aggregate(name)(decimals)), value, rel_tol=1e-9, abs_tol=1e-6)


def test_aggregates_are_as_exact_as_the_decimals() -> None:
    assert Aggregate("mean")([Decimal("0.1"), Decimal("0.2")]) == Decimal("0.15")
    assert Aggregate("median")([Decimal("0.2"), Decimal("0.1")]) == Decimal("0.15")
    assert Aggregate("p25")([Decimal("0.1"), Decimal("0.3")]) == Decimal("0.15")
    assert Aggregate("p95")([Decimal("0.3")] * 7) == Decimal("0.3")
    assert Aggregate("mean")([Decimal("1e308")] * 9) == Decimal("1e308")


def test_key_column_is_given_or_found(atom: Table) -> None:
    assert KeyedTable.of(atom, None, ()).key_column == "Collection #"
    assert KeyedTable.of(atom, "Rot (deg)", ()).key_column == "Rot (deg)"
    assert KeyedTable.of(parse_table("x,Collection\n1,2\n", "t"), None, ()).key_column == "Collection"
    assert KeyedTable.of(parse_table("Transform,Description\na,b\n", "t"), None, ()).key_column == "Transform"
    with pytest.raises(InputError, match="there is no column 'Collection'"):
        KeyedTable.of(atom, "Collection", ())


def test_rows_of_a_table(atom: Table) -> None:
    keyed = KeyedTable.of(atom, None, ("Averages",))
    assert [keyed.label(row) for row in keyed.every_row] == ["000", "001", "002"]
    assert keyed.row(LabelledRow("001")) == atom.rows[1]
    assert keyed.row(LabelledRow("Averages")) == atom.rows[3]
    assert keyed.row(IndexedRow(-1)) == atom.rows[3]
    assert keyed.row(IndexedRow(-4)) == atom.rows[0]
    assert keyed.row(IndexedRow(4)) is None
    assert keyed.row(IndexedRow(-5)) is None


def test_labels_must_be_there_once(atom: Table) -> None:
    with pytest.raises(
        InputError, match=r"results\.csv: .*'Collection #' has no row 'Average': did you mean 'Averages'"
    ):
        KeyedTable.of(atom, None, ()).row(LabelledRow("Average"))
    with pytest.raises(InputError, match=r"no row '7'.*by its place a row is index:7"):
        KeyedTable.of(atom, None, ()).row(LabelledRow("7"))
    with pytest.raises(InputError, match="more than one row is labelled 'x': lines 2 and 4"):
        KeyedTable.of(parse_table("k,v\nx,1\ny,2\nx,3\n", "t"), None, ()).row(LabelledRow("x"))
