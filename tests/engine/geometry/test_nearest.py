"""Nearest neighbours against all distances, and another library's tree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from calibration.engine.geometry import nearest as module
from calibration.engine.geometry.nearest import nearest


@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(1, 40), st.integers(1, 3))
def test_no_other_point_lies_nearer(seed, count, among, dimensions):
    rng = np.random.default_rng(seed)
    points, others = rng.normal(size=(count, dimensions)), rng.normal(size=(among, dimensions)) + 100
    found = np.linalg.norm(points - others[nearest(points, others)], axis=-1)
    least = np.linalg.norm(points[:, None] - others, axis=-1).min(-1)
    np.testing.assert_allclose(found, least, rtol=1e-12)


@pytest.mark.parametrize("chunk", [1, 7000, 1 << 20])
def test_a_tree_finds_the_same_whatever_the_chunk(monkeypatch, chunk):
    monkeypatch.setattr(module, "_CHUNK", chunk)
    rng = np.random.default_rng(1)
    points, others = rng.normal(size=(300, 3)), rng.normal(size=(500, 3))
    np.testing.assert_array_equal(nearest(points, others), cKDTree(others).query(points)[1])
