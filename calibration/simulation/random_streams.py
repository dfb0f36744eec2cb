"""Random numbers that depend on what they are for, not on what was drawn before."""

from zlib import crc32

import numpy as np


def stream(seed: int, *purpose: str | int) -> np.random.Generator:
    """A generator for one purpose, such as (collection, sensor); the same in any process and order."""
    key = [p if isinstance(p, int) else crc32(p.encode()) for p in purpose]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))
