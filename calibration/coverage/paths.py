"""Names in reports to files of the repository. What fits no file, or several, is said and not guessed."""

import os
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from calibration.coverage.lines import FileCoverage, combined
from calibration.coverage.reports.report import Report
from calibration.coverage.repository import Repository

MAX_COPY = 8 * 1024 * 1024
"""Bytes of a file that is looked at to see whether it is a copy of a tracked one."""


@dataclass(frozen=True)
class Mapped:
    """Reports, held against the repository."""

    files: Mapping[str, FileCoverage]
    """By path in the repository."""
    unmatched: tuple[str, ...] = ()
    """Names that are no file of the repository."""
    ambiguous: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Names that may be several files, with these."""
    ill_fitting: Mapping[str, int] = field(default_factory=dict)
    """Files that have fewer lines than a report says, with the highest line: the report is of another version."""


@dataclass(frozen=True)
class PathMap:
    """Finds the tracked file that a name in a report means."""

    repository: Repository
    directory: Path
    """Where the tests ran."""
    tracked: Sequence[str]
    """Every tracked file."""

    def find(self, name: str, folders: Iterable[str] = ()) -> tuple[str, ...]:
        """The files that a name may mean: one when it is clear.

        The first of these ways that finds any decides: the path below one of the report's own folders, or where
        the tests ran, or the root; where there is such a file that is not tracked, the one that it is a copy of
        (installed before it was tested); the end of a tracked file's path; a tracked file's path at the end of the
        name (the tests ran in another checkout).
        """
        name = os.path.normpath(name.replace("\\", "/")) if name.strip() else ""
        if not name or "\0" in name:
            return ()
        places = [self.directory / folder / name for folder in folders] or [self.directory / name]
        for group in (places, [self.directory / name], [self.repository.root / name]):
            if found := self._exact(group):
                return found
        existing = [place for place in places if _is_file(place)]
        return self._copies(existing) if existing else self._by_end(name)

    @cached_property
    def _known(self) -> frozenset[str]:
        return frozenset(self.tracked)

    @cached_property
    def _by_name(self) -> Mapping[str, list[str]]:
        """Tracked files by their last part."""
        found: dict[str, list[str]] = defaultdict(list)
        for path in self.tracked:
            found[path.rpartition("/")[2]].append(path)
        return found

    def _exact(self, places: Iterable[Path]) -> tuple[str, ...]:
        paths = {self.repository.path(place) for place in places}
        return tuple(sorted(path for path in paths if path is not None and path in self._known))

    def _by_end(self, name: str) -> tuple[str, ...]:
        same_name = self._by_name.get(name.rpartition("/")[2], [])
        if longer := tuple(path for path in same_name if path.endswith("/" + name)):
            return longer
        # of a file in the root the name alone is its path, which a file of any other program may have too
        inside = [path for path in same_name if "/" in path and name.endswith("/" + path)]
        return tuple(sorted(inside, key=len)[-1:])

    def _copies(self, places: Iterable[Path]) -> tuple[str, ...]:
        for place in places:
            if content := _content(place):
                same_name = self._by_name.get(place.name, [])
                if found := tuple(path for path in same_name if _content(self.repository.root / path) == content):
                    return found
        return ()


def mapped(reports: Iterable[Report], paths: PathMap, counted: Iterable[str]) -> Mapped:
    """Combine reports to what is covered of the repository's files.

    Args:
        reports: whatever was read.
        paths: how their names are understood.
        counted: the files that count; of others nothing is kept, and nothing is said.
    """
    wanted = set(counted)
    parts: dict[str, list[FileCoverage]] = defaultdict(list)
    unmatched: dict[str, None] = {}
    ambiguous: dict[str, tuple[str, ...]] = {}
    for report in reports:
        for name, coverage in report.files.items():
            found = paths.find(name, report.folders)
            if not found:
                unmatched[name] = None
            elif len(found) > 1:
                ambiguous[name] = found
            elif found[0] in wanted:
                parts[found[0]].append(coverage)
    files, ill_fitting = {}, {}
    for path in sorted(parts):
        coverage = combined(parts[path])
        highest = max([*coverage.hits, *coverage.branches], default=0)
        if highest > _line_count(paths.repository.root / path):
            ill_fitting[path] = highest
        else:
            files[path] = coverage
    return Mapped(files, tuple(unmatched), ambiguous, ill_fitting)


def _line_count(path: Path) -> int:
    content = path.read_bytes()
    # a tool may count a line after the last line end, and other characters that end a line
    return max(content.count(b"\n"), len(content.decode("utf-8", "replace").splitlines()), content.count(b"\r")) + 1


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long, or that no file can have
        return False


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes() if path.stat().st_size <= MAX_COPY else b""
    except OSError:
        return b""
