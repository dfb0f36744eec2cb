"""Mark of the tests that are not run on every push: by `make test` and every night instead.

``@pytest.mark.thorough`` marks a test whose subject a cheaper one watches too, ``@pytest.mark.thorough(but_first=N)``
all cases of a test but its first N, and `thorough` a single case.
"""

from collections import Counter
from collections.abc import Iterable

import pytest
from _pytest.mark import ParameterSet


def thorough(*values: object) -> ParameterSet:
    """Return a parameter set that is one of many of its kind."""
    return pytest.param(*values, marks=pytest.mark.thorough)


def unmark_first_cases(items: Iterable[pytest.Item]) -> None:
    """Take the mark from the first N cases of each test that is marked with ``but_first=N``."""
    unmarked: Counter[str] = Counter()
    for item in items:
        marks = [mark for mark in item.own_markers if mark.name == "thorough"]
        test = item.nodeid.partition("[")[0]
        if len(marks) == 1 and unmarked[test] < marks[0].kwargs.get("but_first", 0):
            unmarked[test] += 1
            item.own_markers.remove(marks[0])
