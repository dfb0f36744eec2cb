"""A target of the fuzzer."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
DATASETS = PROJECT / "datasets"


@dataclass(frozen=True)
class Target:
    """A reader, and files that it can read."""

    name: str
    """The name of the file that it is given."""
    originals: Callable[[], list[bytes]]
    read: Callable[[Path], object]
    """Raises `CalibrationError` for what it refuses; anything else is a bug."""
    share: int = 10
    """Of so many cases of all targets together, by weight: what takes long has few."""


def files_of(*patterns: str) -> Callable[[], list[bytes]]:
    """Return a function that reads the files of patterns in the project."""
    return lambda: [path.read_bytes() for pattern in patterns for path in sorted(PROJECT.glob(pattern))]
