"""What is made of a key is kept for the next ones that are the same."""

import pytest

from calibration.base.latest import Latest


def test_it_is_made_again_for_another_key_and_after_an_error() -> None:
    latest, made = Latest[str, int](lambda a, b: a.lower() == b.lower()), []

    def make() -> int:
        made.append(1)
        return len(made)

    def fail() -> int:
        raise ValueError("planted")

    with pytest.raises(ValueError, match="planted"):
        latest.of("a", fail)
    assert [latest.of(key, make) for key in "aAba"] == [1, 1, 2, 3]
