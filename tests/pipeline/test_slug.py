import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.pipeline.workflow_plan import MAX_SLUG_LENGTH, slugs


@given(st.lists(st.text()), st.lists(st.sampled_from(["taken", "unnamed", "a"])))
def test_slugs_are_safe_and_no_two_are_alike(names: list[str], taken: list[str]) -> None:
    found = slugs(names, taken)
    assert len(found) == len(names)
    assert len({slug.lower() for slug in [*found, *taken]}) == len(found) + len({slug.lower() for slug in taken})
    for slug in found:
        assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", slug)
        assert len(slug) <= MAX_SLUG_LENGTH + 6


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["t2rgb_0m_0.5rad"], ["t2rgb_0m_0.5rad"]),
        (["../../etc", "...", "a b/c"], ["etc", "unnamed", "a_b_c"]),
        (["a", "A", "a"], ["a", "A_2", "a_3"]),
        (["a", "a_2", "a"], ["a", "a_2", "a_3"]),
        ([':"<>|*?\r\n\\/'], ["unnamed"]),
    ],
)
def test_slugs(names: list[str], expected: list[str]) -> None:
    assert slugs(names) == expected
