"""The same work for many items, on all cores."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def on_all_cores(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """The results in the order of the items; ``work`` is a function of a module."""
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(work, items, chunksize=5))
