"""A report as it was read: names are whatever the tool wrote that made it."""

from collections.abc import Mapping
from dataclasses import dataclass

from calibration.coverage.lines import FileCoverage

MAX_BYTES = 100 * 1024 * 1024
"""The largest report that is read."""
MAX_LINE = 10_000_000
"""The highest number of a line."""
MAX_HITS = 2**63 - 1


@dataclass(frozen=True)
class Report:
    """What one report says."""

    name: str
    """For messages: its path."""
    files: Mapping[str, FileCoverage]
    """By the name that the report gives each."""
    folders: tuple[str, ...] = ()
    """That the names are relative to, as the report says; absolute, or relative to where the tests ran."""
