"""Products in pieces: those of the whole, whatever the size of a piece."""

import numpy as np
import pytest

from calibration.engine.estimation.residuals import one_thread
from calibration.engine.estimation.residuals.one_thread import product, sum_of_products


@pytest.mark.parametrize("most", [1, 40, 1 << 18])
@pytest.mark.parametrize("rows", [0, 1, 37])
def test_products_in_pieces_are_those_of_the_whole(monkeypatch, most, rows):
    monkeypatch.setattr(one_thread, "MAX_MULTIPLICATIONS", most)
    rng = np.random.default_rng([most, rows])  # others than those before, which may still lie in the memory
    A, B, small = rng.normal(size=(rows, 4)), rng.normal(size=(rows, 3)), rng.normal(size=(4, 3))
    np.testing.assert_allclose(product(A, small), A @ small, atol=1e-14)
    np.testing.assert_allclose(sum_of_products(A, B), A.T @ B, atol=1e-13)
    np.testing.assert_array_equal(sum_of_products(A[:, :0], B), np.zeros((0, 3)))
