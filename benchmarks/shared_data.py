"""The datasets that lie beside the project, in ``../shared/data``; not part of it."""

from functools import cache
from pathlib import Path

from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset

ROOT = Path(__file__).parents[1]
FOLDER = ROOT.parent / "shared" / "data"
NOISE_PAIRS = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5))
"""Starting noise of the matrix: m, rad."""


def missing(name: str) -> str:
    """Reason why a dataset cannot be used; empty if it can."""
    found = (FOLDER / name / "dataset.json").is_file()
    return "" if found else f"no ../shared/data/{name}: it is not part of the project"


@cache
def load(name: str) -> Dataset:
    """The dataset of a folder, read once in each process."""
    return read_dataset(FOLDER / name)
