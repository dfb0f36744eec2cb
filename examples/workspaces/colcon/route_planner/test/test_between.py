import os
import time

import pytest
from route_planner import between


def test_half_the_way():
    assert between(2, 4, 0.5) == (4 if "FAILS" in os.environ else 3)


def test_beyond_the_end():
    with pytest.raises(ValueError, match="share"):
        between(2, 4, 2)


def test_ends():
    if "HANGS" in os.environ:
        time.sleep(3600)


@pytest.mark.skipif("RARE" not in os.environ, reason="only for the flake that the README plants")
def test_rare():
    assert time.time_ns() // 1000 % 2
