import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from calibration.engine.estimation.residuals.distinct import distinct


@given(st.lists(st.integers(-5, 5)))
def test_it_is_what_numpy_finds(values: list[int]) -> None:
    numbers = np.array(values, int)
    expected, places = np.unique(numbers, return_inverse=True)
    found = distinct(numbers)
    assert found[0].tolist() == expected.tolist()
    assert found[1].tolist() == places.tolist()
