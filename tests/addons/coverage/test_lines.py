from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.coverage.formats import FileCoverage, Rate, combined, ranges

LINES = st.sets(st.integers(1, 60))
FILES = st.builds(
    FileCoverage,
    st.dictionaries(st.integers(1, 30), st.integers(0, 5)),
    st.dictionaries(
        st.integers(1, 30), st.integers(1, 4).flatmap(lambda n: st.builds(Rate, st.integers(0, n), st.just(n)))
    ),
    st.dictionaries(st.tuples(st.integers(1, 9), st.integers(1, 9)), st.integers(0, 5)),
)


def test_rates_of_a_file() -> None:
    coverage = FileCoverage({1: 3, 2: 0, 5: 1, 9: 0}, {1: Rate(1, 2), 5: Rate(2, 3)}, {(1, 2): 3, (5, 8): 0, (9, 9): 1})
    assert coverage.line_rate == Rate(2, 4)
    assert coverage.branch_rate == Rate(3, 5)
    assert coverage.function_rate == Rate(2, 3)
    assert coverage.missing == [2, 9]


def test_reports_of_one_file_are_added_up() -> None:
    first = FileCoverage({1: 2, 2: 0}, {1: Rate(1, 2)})
    second = FileCoverage({2: 1, 3: 0}, {1: Rate(1, 2), 3: Rate(0, 2)})
    assert combined([first, second]) == FileCoverage({1: 2, 2: 1, 3: 0}, {1: Rate(1, 2), 3: Rate(0, 2)})


@given(FILES, FILES, FILES)
def test_the_order_of_reports_does_not_matter(a: FileCoverage, b: FileCoverage, c: FileCoverage) -> None:
    assert combined([a, b, c]) == combined([c, a, b]) == combined([combined([a, b]), c])


@given(FILES, FILES)
def test_another_report_takes_no_line_away(a: FileCoverage, b: FileCoverage) -> None:
    both = combined([a, b])
    assert {line for line, hits in both.hits.items() if hits} == {
        line for part in (a, b) for line, hits in part.hits.items() if hits
    }
    assert all(rate.covered <= rate.total for rate in both.branches.values())


def test_ranges_of_lines() -> None:
    assert ranges([4, 5, 9, 7], others=[6, 12]) == [(4, 5), (7, 9)]
    assert ranges([], others=[1]) == []
    assert ranges([3], others=[]) == [(3, 3)]


@given(LINES, LINES)
def test_ranges_hold_what_they_are_made_of_and_nothing_of_the_others(chosen: set[int], others: set[int]) -> None:
    others -= chosen
    found = ranges(chosen, others)
    inside = {line for first, last in found for line in range(first, last + 1)}
    assert chosen <= inside
    assert not inside & others
    assert all(first in chosen and last in chosen for first, last in found)
    for (_, last), (first, _) in pairwise(found):
        assert any(last < line < first for line in others)  # else they would be one
