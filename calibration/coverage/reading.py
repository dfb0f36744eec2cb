"""Reports and measurements to what is covered of the repository, with the files that no test has loaded."""

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from calibration.coverage.lines import FileCoverage
from calibration.coverage.paths import Mapped, PathMap, mapped
from calibration.coverage.reports.cobertura import parse_cobertura
from calibration.coverage.reports.data_file import MAGIC, copied, measured_names, merge, report_of
from calibration.coverage.reports.lcov import parse_lcov
from calibration.coverage.reports.report import MAX_BYTES, Report
from calibration.coverage.sources import Sources, language_of
from calibration.errors import InputError
from calibration.files import read_bytes

KINDS = "a data file of coverage.py, Cobertura XML or LCOV"
_PYTHON = "python"


@dataclass(frozen=True)
class Found:
    """What reports say of the repository."""

    mapped: Mapped
    unreadable: tuple[str, ...] = ()
    """Python files that have no lines in the end: they cannot be parsed."""
    without_report: Mapping[str, int] = field(default_factory=dict)
    """How many source files there are of each language that no report speaks of; they count for nothing."""

    @classmethod
    def nothing(cls) -> Self:
        """Where there is no report."""
        return cls(Mapped({}))

    @property
    def files(self) -> Mapping[str, FileCoverage]:
        """What is covered, by path."""
        return self.mapped.files


def read_reports(
    files: Sequence[Path],
    sources: Sources,
    settings: Mapping[str, Any],
    folder: Path,
    executable: str | None = None,
) -> Found:
    """Read reports of any kind, combine them and hold them against the repository.

    Args:
        files: the reports.
        sources: the files that count.
        settings: the team's own, of coverage.py.
        folder: an empty one, for what is needed meanwhile.
        executable: the Python that measured; None for ours.

    Raises:
        InputError: a file is no report, or is broken or too large; names it.
        WorldError: coverage.py cannot report on its data.
    """
    paths = PathMap(sources.repository, sources.directory, sources.tracked)
    reports, data_files = _parsed(files)
    spoken_of = _Names(paths)
    for name in measured_names(data := copied(data_files, folder)):
        spoken_of.add(name)
    others = mapped(reports, paths, sources.counted)
    known = {*others.files, *others.ill_fitting, *spoken_of.found.values()}
    languages = {language_of(path) for path in known} | ({_PYTHON} if data else set())
    python = [path for path in sources.counted if language_of(path) == _PYTHON and _PYTHON in languages]
    root = sources.repository.root
    wanted = {name: str(root / path) for name, path in spoken_of.found.items() if path in set(python)}
    untouched = [str(root / path) for path in python if path not in known]
    merged = merge(data, wanted, untouched, folder)
    label = ", ".join(map(str, data_files)) or "the files without a report"
    own = [report_of(file, label, settings, root, executable or sys.executable) for file in merged]
    found = mapped([*reports, *own], paths, sources.counted)
    return Found(
        replace(
            found,
            unmatched=tuple(dict.fromkeys([*found.unmatched, *spoken_of.unmatched])),
            ambiguous={**found.ambiguous, **spoken_of.ambiguous},
        ),
        tuple(path for path in python if path not in found.files and path not in found.ill_fitting),
        Counter(language for path in sources.counted if (language := language_of(path)) and language not in languages),
    )


class _Names:
    """The names in data files of coverage.py, which are to be understood before its report is written."""

    def __init__(self, paths: PathMap) -> None:
        self.found: dict[str, str] = {}
        """The tracked file of each name."""
        self.unmatched: list[str] = []
        self.ambiguous: dict[str, tuple[str, ...]] = {}
        self._paths = paths

    def add(self, name: str) -> None:
        found = self._paths.find(name)
        if len(found) == 1:
            self.found[name] = found[0]
        elif found:
            self.ambiguous[name] = found
        else:
            self.unmatched.append(name)


def _parsed(files: Sequence[Path]) -> tuple[list[Report], list[Path]]:
    """Reports, and files that are data of coverage.py.

    Raises:
        InputError: a file is neither.
    """
    reports, data_files = [], []
    for file in files:
        content = read_bytes(file, MAX_BYTES, KINDS)
        begin = content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
        if content.startswith(MAGIC):
            data_files.append(file)
        elif not begin:
            raise InputError(f"{file}: it is empty, {KINDS} was expected")
        elif begin.startswith((b"<", b"\xff\xfe", b"\xfe\xff")):  # the latter: XML in UTF-16
            reports.append(parse_cobertura(content, str(file)))
        elif b"SF:" in content:
            reports.append(parse_lcov(content, str(file)))
        else:
            raise InputError(f"{file}: found none of the known forms, {KINDS} was expected")
    return reports, data_files
