"""Quantiles of the norm of Gaussian errors, against draws."""

import numpy as np
import pytest

from calibration.engine.statistics import probability_beyond, quantile_of_norm, size_without_error


@pytest.mark.parametrize(
    "sigmas", [(1, 0, 0), (1, 1, 0), (1, 1, 1), (3, 1, 0.1), (1, 0.5, 0.5), (2e-6, 1e-6, 0), (5, 4)]
)
def test_quantiles_are_those_of_draws(sigmas: tuple[float, ...]) -> None:
    """Of any shape, and in any frame."""
    rng = np.random.default_rng(1)
    Q, _ = np.linalg.qr(rng.normal(size=(len(sigmas), len(sigmas))))
    S = (Q @ np.diag(np.square(sigmas)) @ Q.T)[None]
    sizes = np.linalg.norm(rng.normal(size=(100_000, len(sigmas))) * sigmas, axis=1)
    for probability in (0.5, 0.95):
        expected = float(np.quantile(sizes, probability))
        assert quantile_of_norm(S, probability)[0] == pytest.approx(expected, rel=0.008)
        assert probability_beyond(S, expected)[0] == pytest.approx(1 - probability, abs=0.004)


def test_nothing_that_errs_is_exact() -> None:
    """Zero, no NaN."""
    assert quantile_of_norm(np.zeros((2, 3, 3)), 0.95).tolist() == [0, 0]
    assert probability_beyond(np.zeros((1, 3, 3)), 1.0)[0] == pytest.approx(0, abs=1e-9)


def test_an_estimate_is_shorter_without_its_error_along_each_axis() -> None:
    """A size in a direction that is known stays, that in one that is not is none."""
    errors = np.diag([0.1, 10.0, 0.0])
    assert size_without_error(np.array([3.0, 6.0, 4.0]), errors) == pytest.approx(np.sqrt(25 - 0.01))
    assert size_without_error(np.array([0.05, 6.0, 0.0]), errors) == 0
