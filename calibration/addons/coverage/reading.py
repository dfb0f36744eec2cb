"""Coverage of the repository's files from reports and measurements; an ambiguous file name is reported, not guessed."""

import os
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from calibration.addons.coverage import formats
from calibration.addons.coverage.coverage_py import SQLITE_MAGIC, copied, measured_names, merge, report_of
from calibration.addons.coverage.sources import PYTHON_LANGUAGE, Sources, functions_of, language_of
from calibration.base import InputError, read_bytes
from calibration.base.records import field, result
from calibration.ci.git import Repository

MAX_COPY = 8 * 1024 * 1024
"""Largest file that is compared with tracked files to find its original, in bytes."""


@result
class UncountedFile:
    """Content of reports that is not counted, and languages without a report."""

    unmatched: tuple[str, ...] = field("Names that are no tracked file.")
    ambiguous: Mapping[str, tuple[str, ...]] = field("Names that may be several files, with these.")
    ill_fitting: Mapping[str, int] = field("Files with fewer lines than a report claims, with its highest line number.")
    unreadable: tuple[str, ...] = field("Python files that cannot be parsed.")
    without_report: Mapping[str, int] = field(
        "Number of source files by language, for languages that no report contains."
    )


NOTHING_LEFT_OUT = UncountedFile((), {}, {}, (), {})


@dataclass(frozen=True)
class Found:
    """Coverage of the repository, with what could not be used."""

    files: Mapping[str, formats.FileCoverage]
    """Coverage of each file, by path in the repository."""
    left_out: UncountedFile = NOTHING_LEFT_OUT


@dataclass(frozen=True)
class PathMap:
    """Mapping of names in reports to tracked files."""

    repository: Repository
    directory: Path
    """Working directory of the tests."""
    tracked: Sequence[str]
    """Every tracked file."""

    def find(self, name: str, folders: Iterable[str] = ()) -> tuple[str, ...]:
        """Return the files that a name may refer to: exactly one if it is unambiguous.

        The first successful rule decides: the path below one of the report's own folders, the working directory
        of the tests, or the root; if such a file exists but is not tracked, the tracked file that it is a copy of
        (installed before it was tested); the end of a tracked file's path; a tracked file's path at the end of the
        name (the tests ran in another checkout); the end of a tracked file's path below ``src`` of a workspace.
        """
        name = os.path.normpath(name.replace("\\", "/")) if name.strip() else ""
        if not name or "\0" in name:
            return ()
        places = [self.directory / folder / name for folder in folders] or [self.directory / name]
        for group in (places, [self.directory / name], [self.repository.root / name]):
            if found := self._exact_paths(group):
                return found
        existing = [place for place in places if _is_file(place)]
        return self._paths_of_copies(existing) if existing else self._by_end(name)

    @cached_property
    def _known_paths(self) -> frozenset[str]:
        return frozenset(self.tracked)

    @cached_property
    def _by_name(self) -> Mapping[str, list[str]]:
        """Tracked files by their file name."""
        found: dict[str, list[str]] = defaultdict(list)
        for path in self.tracked:
            found[path.rpartition("/")[2]].append(path)
        return found

    def _exact_paths(self, places: Iterable[Path]) -> tuple[str, ...]:
        paths = {self.repository.path(place) for place in places}
        return tuple(sorted(path for path in paths if path is not None and path in self._known_paths))

    def _by_end(self, name: str) -> tuple[str, ...]:
        same_name = self._by_name.get(name.rpartition("/")[2], [])
        if longer := tuple(path for path in same_name if path.endswith("/" + name)):
            return longer
        # the path of a file in the root is its name alone, which may occur in any other program too
        if inside := [path for path in same_name if "/" in path and name.endswith("/" + path)]:
            return (max(inside, key=len),)
        package = name.partition("/src/")[2]  # in the workspace of an image, to which a folder was copied
        return tuple(path for path in same_name if "/" in package and path.endswith("/" + package))

    def _paths_of_copies(self, places: Iterable[Path]) -> tuple[str, ...]:
        for place in places:
            if content := _read_content(place):
                same_name = self._by_name.get(place.name, [])
                if found := tuple(path for path in same_name if _read_content(self.repository.root / path) == content):
                    return found
        return ()


def mapped(reports: Iterable[formats.CoverageReport], paths: PathMap, counted: Iterable[str]) -> Found:
    """Combine reports to the coverage of the repository's files.

    Args:
        reports: the parsed reports.
        paths: mapping of their file names.
        counted: the files that count; others are ignored.
    """
    wanted = set(counted)
    parts: dict[str, list[formats.FileCoverage]] = defaultdict(list)
    names = _Names(paths)
    for report in reports:
        for name, coverage in report.files.items():
            if (file := names.file(name, report.folders)) in wanted:
                parts[file].append(coverage)
    files, ill_fitting = {}, {}
    for path in sorted(parts):
        coverage = formats.combined(parts[path])
        highest = max([*coverage.hits, *coverage.branches], default=0)
        if highest > _line_count(paths.repository.root / path):
            ill_fitting[path] = highest
        elif language_of(path) == PYTHON_LANGUAGE:
            source = (paths.repository.root / path).read_bytes()
            files[path] = replace(coverage, functions=_python_functions(path, source, coverage.hits))
        else:
            files[path] = coverage
    return Found(files, UncountedFile(tuple(names.unmatched), names.ambiguous, ill_fitting, (), {}))


def _python_functions(path: str, source: bytes, hits: Mapping[int, int]) -> dict[tuple[int, int], int]:
    """Return the hits of the functions of a Python file; reports of coverage.py, of Cobertura's form, tell none."""
    found = {}
    for function in functions_of(path, source):
        if own := function.own_lines & hits.keys():
            found[function.first, function.last] = max(hits[line] for line in own)
    return found


class _Names:
    """Return the file of each name in the reports; unmatched and ambiguous names are kept for the report."""

    def __init__(self, paths: PathMap) -> None:
        self.unmatched: dict[str, None] = {}
        self.ambiguous: dict[str, tuple[str, ...]] = {}
        self._paths = paths

    def file(self, name: str, folders: Iterable[str] = ()) -> str:
        """Return the file, or an empty string if the name is unmatched or ambiguous."""
        found = self._paths.find(name, folders)
        if len(found) == 1:
            return found[0]
        if found:
            self.ambiguous[name] = found
        else:
            self.unmatched[name] = None
        return ""


def _line_count(path: Path) -> int:
    content = path.read_bytes()
    # a tool may count a line after the last line end, and other characters that end a line
    return max(content.count(b"\n"), len(content.decode("utf-8", "replace").splitlines()), content.count(b"\r")) + 1


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long for a path, or with characters that a path cannot have
        return False


def _read_content(path: Path) -> bytes:
    try:
        return path.read_bytes() if path.stat().st_size <= MAX_COPY else b""
    except OSError:
        return b""


KINDS_OF_REPORTS = "a data file of coverage.py, Cobertura XML, LCOV or JSON of gcov"


def read_reports(
    files: Sequence[Path],
    sources: Sources,
    settings: Mapping[str, Any],
    folder: Path,
    executable: str | None = None,
) -> Found:
    """Read reports of any format, combine them and map them to the repository.

    Args:
        files: the reports.
        sources: the files that count.
        settings: the team's settings of coverage.py.
        folder: created, for temporary files.
        executable: the Python that measured; None for this one.

    Raises:
        InputError: a file is not a report, is malformed, or is too large; names it.
        InfrastructureError: coverage.py cannot report on its data.
    """
    paths = PathMap(sources.repository, sources.directory, sources.tracked)
    folder.mkdir(exist_ok=True)
    reports, data_files = _separate_reports(files)
    names, data = _Names(paths), copied(data_files, folder)
    measured = {name: file for name in measured_names(data) if (file := names.file(name))}
    others = mapped(reports, paths, sources.counted)
    known = {*others.files, *others.left_out.ill_fitting, *measured.values()}
    languages = {language_of(path) for path in known} | ({PYTHON_LANGUAGE} if data else set())
    python = [path for path in sources.counted if language_of(path) == PYTHON_LANGUAGE and PYTHON_LANGUAGE in languages]
    root = sources.repository.root
    wanted = {name: str(root / path) for name, path in measured.items() if path in set(python)}
    untouched = [str(root / path) for path in python if path not in known]
    merged = merge(data, wanted, untouched, folder)
    label = ", ".join(map(str, data_files)) or "the files without a report"
    own = [report_of(file, label, settings, root, executable or sys.executable) for file in merged]
    found = mapped([*reports, *own], paths, sources.counted)
    left_out = UncountedFile(
        tuple(dict.fromkeys([*found.left_out.unmatched, *names.unmatched])),
        {**found.left_out.ambiguous, **names.ambiguous},
        found.left_out.ill_fitting,
        tuple(path for path in python if path not in found.files and path not in found.left_out.ill_fitting),
        Counter(language for path in sources.counted if (language := language_of(path)) and language not in languages),
    )
    return replace(found, left_out=left_out)


def _separate_reports(files: Sequence[Path]) -> tuple[list[formats.CoverageReport], list[Path]]:
    """Separate reports from data files of coverage.py.

    Raises:
        InputError: a file is neither.
    """
    reports, data_files = [], []
    for file in files:
        content = read_bytes(file, formats.MAX_BYTES, KINDS_OF_REPORTS)
        begin = content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
        if content.startswith(SQLITE_MAGIC):
            data_files.append(file)
        elif not begin:
            raise InputError(f"{file}: it is empty, {KINDS_OF_REPORTS} was expected")
        elif begin.startswith((b"<", b"\xff\xfe", b"\xfe\xff")):  # the latter: XML in UTF-16
            reports.append(formats.parse_cobertura(content, str(file)))
        elif begin.startswith(formats.GCOV_START):
            reports.append(formats.parse_gcov(content, str(file)))
        elif b"SF:" in content:
            reports.append(formats.parse_lcov(content, str(file)))
        else:
            raise InputError(f"{file}: found none of the known forms, {KINDS_OF_REPORTS} was expected")
    return reports, data_files
