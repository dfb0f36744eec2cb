"""Rows on a verdict without any limits set: of the first recording of a robot, and of later ones.

Each module of this folder has a function ``rows(quick)`` that yields its rows; a new module needs no other line.
"""

import importlib
import pkgutil
from collections.abc import Iterator

from benchmarks.rows import Row


def measure(quick: bool) -> Iterator[Row]:
    """Yield the rows of every module of this folder."""
    for module in pkgutil.iter_modules(__path__):
        yield from importlib.import_module(f"{__name__}.{module.name}").rows(quick)
