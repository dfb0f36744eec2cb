"""Random generators by purpose, independent of the order of use."""

from zlib import crc32

import numpy as np


def stream(seed: int, *purpose: str | int) -> np.random.Generator:
    """Return the generator for a purpose, such as (collection, sensor); equal in any process and order."""
    key = [p if isinstance(p, int) else crc32(p.encode()) for p in purpose]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
