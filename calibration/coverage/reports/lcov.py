"""LCOV's tracefiles (``lcov.info``), which compilers' tools and JavaScript's write."""

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from calibration.coverage.lines import FileCoverage
from calibration.coverage.rate import Rate
from calibration.coverage.reports.report import MAX_HITS, MAX_LINE, Report
from calibration.errors import InputError
from calibration.workflow.text import one_line, shorten

_LINE = re.compile(r"([0-9]{1,8}),([0-9]{1,19})(?:,[^,]*)?")
_BRANCH = re.compile(r"([0-9]{1,8}),([^,]+),([^,]+),(-|[0-9]{1,19})")


@dataclass
class _Record:
    hits: dict[int, int] = field(default_factory=dict)
    branches: dict[int, dict[tuple[str, str], bool]] = field(default_factory=dict)
    """Whether each branch of a line was taken."""

    def coverage(self) -> FileCoverage:
        rates = {line: Rate(sum(taken.values()), len(taken)) for line, taken in self.branches.items()}
        return FileCoverage(self.hits, rates)


def parse_lcov(data: bytes, name: str) -> Report:
    """Read a tracefile; several records of one file (one for each test) are added up.

    Raises:
        InputError: it is no tracefile, it ends in the middle of a record, or a number in it is none; names the line.
    """
    records: dict[str, _Record] = {}
    record: _Record | None = None
    for number, line in enumerate(io.BytesIO(data), 1):
        kind, _, value = line.decode("utf-8", "surrogateescape").strip().partition(":")
        if kind == "SF":
            if record is not None:
                raise InputError(f"{name}:{number}: a record begins before the last one ended (end_of_record)")
            if not value.strip():
                raise InputError(f"{name}:{number}: SF names no file")
            record = records.setdefault(value.strip(), _Record())
        elif kind == "end_of_record":
            record = None
        elif kind in ("DA", "BRDA"):
            if record is None:
                raise InputError(f"{name}:{number}: {kind} stands before the file that it is of (SF)")
            _add(record, kind, value.strip(), f"{name}:{number}")
    if record is not None:
        raise InputError(f"{name}: it ends in the middle of a record: end_of_record was expected")
    if not records:
        raise InputError(f"{name}: no file is named in it (SF:...), a tracefile of LCOV was expected")
    return Report(name, {file: record.coverage() for file, record in records.items()})


def tracefile(files: Mapping[str, FileCoverage]) -> str:
    """A tracefile of files, by their paths; :func:`parse_lcov` reads the same from it."""
    lines: list[str] = []
    for path, coverage in files.items():
        if len(path.splitlines()) != 1 or path != path.strip():
            continue  # the format has no name for such a file
        lines += ["TN:", f"SF:{path}"]
        lines += [f"DA:{line},{hits}" for line, hits in coverage.hits.items()]
        for line, rate in coverage.branches.items():
            lines += [f"BRDA:{line},0,{branch},{int(branch < rate.covered)}" for branch in range(rate.total)]
        lines.append("end_of_record")
    return "".join(f"{line}\n" for line in lines)


def _add(record: _Record, kind: str, value: str, where: str) -> None:
    found = (_LINE if kind == "DA" else _BRANCH).fullmatch(value)
    if found is None or not 1 <= int(found[1]) <= MAX_LINE:
        expected = "line,hits" if kind == "DA" else "line,block,branch,taken"
        raise InputError(f"{where}: found {kind}:{shorten(one_line(value))}, expected {kind}:{expected}")
    line = int(found[1])
    if kind == "DA":
        record.hits[line] = record.hits.get(line, 0) + min(int(found[2]), MAX_HITS)
        return
    taken = record.branches.setdefault(line, {})
    branch = (found[2], found[3])
    taken[branch] = taken.get(branch, False) or found[4].strip("-0") != ""
