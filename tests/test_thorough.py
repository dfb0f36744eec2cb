"""Which cases of a test are thorough."""

import pytest

from tests.thorough import thorough


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("case", [thorough("marked itself"), "first", "second", "third"])
def test_but_the_first_and_those_marked_themselves(request: pytest.FixtureRequest, case: str) -> None:
    is_thorough = any(mark.name == "thorough" for mark in request.node.iter_markers())
    assert is_thorough == (case not in ("first", "second"))
