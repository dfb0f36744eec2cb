"""Quantiles of the norm of Gaussian errors, against draws."""

import numpy as np
import pytest

from calibration.engine.tasks.gaussian_norm import probability_beyond, quantile_of_norm


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
