"""Hypothesis strategies for batches of rotations, poses and points."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calibration.base.arrays import Array
from calibration.engine.geometry import rotations, transforms

shapes = st.sampled_from([(), (1,), (3,), (2, 3)])
"""Batch shapes; the last axes are added."""


def vectors(size: int, bound: float, shape: st.SearchStrategy[tuple[int, ...]] = shapes) -> st.SearchStrategy[Array]:
    numbers = st.floats(-bound, bound, allow_subnormal=False)
    return shape.flatmap(lambda batch: arrays.arrays(np.float64, (*batch, size), elements=numbers))


rotation_vectors = vectors(3, 3.0)


def poses(shape: st.SearchStrategy[tuple[int, ...]] = shapes) -> st.SearchStrategy[Array]:
    return vectors(6, 3.0, shape).map(lambda v: transforms.transform(rotations.exp(v[..., 3:]), v[..., :3]))


def random_rotations(count: int, seed: int = 0) -> Array:
    """Uniform on SO(3)."""
    q = np.random.default_rng(seed).normal(size=(count, 4))
    return rotations.from_quaternion(q)
