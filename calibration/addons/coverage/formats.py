"""Coverage of files: of lines, branches and functions, and the reports that state it.

Parsers of Cobertura XML, LCOV, and JSON of gcov 9 and newer give one structure; reports of the same files are combined.
"""

import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from itertools import pairwise
from typing import Any, NoReturn
from xml.etree.ElementTree import Element

from calibration.base import InputError, one_line, parse_json, shorten
from calibration.base.documents import xml_elements
from calibration.base.records import computed, field, result

MAX_BYTES = 100 * 1024 * 1024
"""Limit of the size of a report."""
MAX_LINE = 10_000_000
"""Limit of a line number."""
MAX_HITS = 2**63 - 1


@result
class Rate:
    """A ratio of counts: covered and total."""

    covered: int = field("Number of lines, branches or functions that tests run.", default=0)
    total: int = field("Number of executable lines, of branches or of functions.", default=0)

    def __add__(self, other: "Rate") -> "Rate":
        return Rate(self.covered + other.covered, self.total + other.total)

    @property
    @computed()
    def percent(self) -> float | None:
        """Percentage with two decimals, rounded down, so that only full coverage is 100; null if total is 0."""
        return None if self.total == 0 else self.covered * 10_000 // self.total / 100

    def reaches(self, minimum: float) -> bool:
        """Return whether the percentage is at least ``minimum``; always False if total is 0."""
        return self.total > 0 and self.covered * 100 >= minimum * self.total

    def __str__(self) -> str:
        if self.percent is None:
            return "-"
        return f"{math.floor(self.percent * 10) / 10:.1f} % ({self.covered} of {self.total})"


@dataclass(frozen=True)
class FileCoverage:
    """Line, branch and function coverage of a file."""

    hits: Mapping[int, int] = dataclass_field(default_factory=dict)
    """Hits of each executable line; the first line is 1."""
    branches: Mapping[int, Rate] = dataclass_field(default_factory=dict)
    """Branches taken, by the line that branches."""
    functions: Mapping[tuple[int, int], int] = dataclass_field(default_factory=dict)
    """Hits of each function, by its first and last line: those of the line of its that is run most."""

    @property
    def line_rate(self) -> Rate:
        """Rate of executable lines."""
        return Rate(sum(count > 0 for count in self.hits.values()), len(self.hits))

    @property
    def branch_rate(self) -> Rate:
        """Rate of all branches."""
        return sum(self.branches.values(), Rate())

    @property
    def function_rate(self) -> Rate:
        """Rate of functions of which a line was run."""
        return Rate(sum(count > 0 for count in self.functions.values()), len(self.functions))

    @property
    def missing(self) -> list[int]:
        """Lines that no test runs, in order."""
        return sorted(line for line, count in self.hits.items() if count == 0)

    def ranges(self, lines: Iterable[int]) -> list[tuple[int, int]]:
        """Join executable lines to ranges (first, last) without another executable line between."""
        return ranges(lines, self.hits.keys() - set(lines))


def combined(parts: Iterable[FileCoverage]) -> FileCoverage:
    """Combine the coverage of one file from several reports: the union of the lines, with the sum of their hits.

    A report gives the number of branches taken, not which ones, so the maximum over the reports is used.
    """
    hits: dict[int, int] = {}
    branches: dict[int, Rate] = {}
    functions: dict[tuple[int, int], int] = {}
    for part in parts:
        for line, count in part.hits.items():
            hits[line] = hits.get(line, 0) + count
        for line, rate in part.branches.items():
            known = branches.get(line, Rate())
            branches[line] = Rate(max(known.covered, rate.covered), max(known.total, rate.total))
        for span, count in part.functions.items():
            functions[span] = functions.get(span, 0) + count
    return FileCoverage(hits, branches, functions)


def ranges(lines: Iterable[int], others: Iterable[int]) -> list[tuple[int, int]]:
    """Join lines to ranges (first, last) that contain none of the ``others``.

    Lines in neither set (comments, empty lines) do not split a range.
    """
    chosen = set(lines)
    found: list[tuple[int, int]] = []
    joined = False
    for line in sorted(chosen.union(others)):
        if line not in chosen:
            joined = False
        elif joined:
            found[-1] = (found[-1][0], line)
        else:
            found.append((line, line))
            joined = True
    return found


@dataclass(frozen=True)
class CoverageReport:
    """Content of one coverage report."""

    name: str
    """Path of the report, for messages."""
    files: Mapping[str, FileCoverage]
    """Coverage by the file name in the report."""
    folders: tuple[str, ...] = ()
    """Folders that the names are relative to; absolute, or relative to the working directory of the tests."""


_WHOLE_NUMBER = re.compile(r"[0-9]{1,19}")
_BRANCH_COVERAGE = re.compile(r"\s*[0-9.]+\s*%\s*\(([0-9]{1,9})/([0-9]{1,9})\)\s*")


def parse_cobertura(data: bytes, name: str) -> CoverageReport:
    """Parse Cobertura XML; classes in one file, and entries of one line, are added up.

    Raises:
        InputError: it is not Cobertura XML, or a number is malformed; names the file and line concerned.
    """
    hits: dict[str, dict[int, int]] = {}
    branches: dict[str, dict[int, Rate]] = {}
    folders: list[str] = []
    file: str | None = None
    in_methods = 0
    functions: dict[str, dict[tuple[int, int], int]] = {}
    of_method: dict[int, int] = {}
    root: Element | None = None
    for event, element in xml_elements(data, name):
        tag = element.tag
        if root is None:
            root = element
            _check_root(element, name)
        elif tag == "class" and event == "start":
            file = element.get("filename")
            if not file:
                raise InputError(f"{name}: a class has no filename")
            hits.setdefault(file, {})
            branches.setdefault(file, {})
            functions.setdefault(file, {})
        elif tag == "methods":  # the class repeats their lines
            in_methods += 1 if event == "start" else -1
        elif tag == "line" and event == "end" and file is not None:
            where = f"{name}: {file}"
            _add_line(element, where, *((of_method, {}) if in_methods else (hits[file], branches[file])))
        elif tag == "method" and event == "end" and file is not None and of_method:
            span = (min(of_method), max(of_method))
            functions[file][span] = functions[file].get(span, 0) + max(of_method.values())
            of_method = {}
        elif tag == "source" and event == "end" and element.text and element.text.strip():
            folders.append(element.text.strip())
        if event == "end":
            element.clear()
    found = {file: FileCoverage(lines, branches[file], functions[file]) for file, lines in hits.items()}
    return CoverageReport(name, found, tuple(folders))


def _check_root(root: Element, name: str) -> None:
    if root.tag == "coverage" and "line-rate" in root.attrib:
        return
    tag = shorten(one_line(str(root.tag)))
    raise InputError(f"{name}: found XML with the root <{tag}>, expected Cobertura: <coverage line-rate=...>")


def _add_line(element: Element, where: str, hits: dict[int, int], branches: dict[int, Rate]) -> None:
    number = _whole_number(element.get("number"), where, "number", 1, MAX_LINE)
    count = _whole_number(element.get("hits"), f"{where}:{number}", "hits", 0, MAX_HITS)
    hits[number] = hits.get(number, 0) + count
    condition = element.get("condition-coverage")
    if element.get("branch", "").lower() == "true" and condition is not None:
        found = _BRANCH_COVERAGE.fullmatch(condition)
        if found is None or int(found[1]) > int(found[2]):
            _refuse_value(f"{where}:{number}", "condition-coverage", condition, "such as 50% (1/2)")
        known = branches.get(number, Rate())
        branches[number] = Rate(max(known.covered, int(found[1])), max(known.total, int(found[2])))


def _whole_number(text: str | None, where: str, key: str, least: int, most: int) -> int:
    if text is None or not _WHOLE_NUMBER.fullmatch(text) or not least <= int(text) <= most:
        _refuse_value(where, key, text, f"a whole number from {least} to {most}")
    return int(text)


def _refuse_value(where: str, key: str, found: str | None, expected: str) -> NoReturn:
    shown = "nothing" if found is None else repr(shorten(found))
    raise InputError(f"{shorten(one_line(where), 300)}: {key} is {shown}, {expected} was expected")


_LINE_VALUE = re.compile(r"([0-9]{1,8}),([0-9]{1,19})(?:,[^,]*)?")
_BRANCH_VALUE = re.compile(r"([0-9]{1,8}),([^,]+),([^,]+),(-|[0-9]{1,19})")
_FUNCTION_VALUE = re.compile(r"([0-9]{1,8}),(?:([0-9]{1,8}),)?(.+)")
"""First line, last line where the tool tells it, name."""
_FUNCTION_HITS = re.compile(r"([0-9]{1,19}),(.+)")


@dataclass
class _Record:
    hits: dict[int, int] = dataclass_field(default_factory=dict)
    branches: dict[int, dict[tuple[str, str], bool]] = dataclass_field(default_factory=dict)
    """Return which branches of a line were taken."""
    spans: dict[str, tuple[int, int | None]] = dataclass_field(default_factory=dict)
    """First and last line of each function, by its name."""
    calls: dict[str, int] = dataclass_field(default_factory=dict)

    def coverage(self) -> FileCoverage:
        rates = {line: Rate(sum(taken.values()), len(taken)) for line, taken in self.branches.items()}
        begins = sorted({first for first, _ in self.spans.values()})
        end = max([*self.hits, *begins[-1:]], default=0)
        next_begins = dict(pairwise([*begins, end + 1]))
        functions: dict[tuple[int, int], int] = {}
        for name, (first, last) in self.spans.items():
            span = (first, next_begins[first] - 1 if last is None else last)
            functions[span] = functions.get(span, 0) + self.calls.get(name, 0)  # instances of one template
        return FileCoverage(self.hits, rates, functions)


def parse_lcov(data: bytes, name: str) -> CoverageReport:
    """Parse a tracefile (LCOV); records of one file (one for each test) are added up.

    Raises:
        InputError: it is not a tracefile, is truncated, or a number is malformed; names the line.
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
                raise InputError(f"{name}:{number}: {kind} precedes the file that it belongs to (SF)")
            _add_to_record(record, kind, value.strip(), f"{name}:{number}")
        elif record is not None and kind == "FN" and (span := _FUNCTION_VALUE.fullmatch(value.strip())):
            record.spans[span[3]] = (int(span[1]), int(span[2]) if span[2] else None)
        elif record is not None and kind == "FNDA" and (calls := _FUNCTION_HITS.fullmatch(value.strip())):
            record.calls[calls[2]] = record.calls.get(calls[2], 0) + min(int(calls[1]), MAX_HITS)
    if record is not None:
        raise InputError(f"{name}: it ends in the middle of a record: end_of_record was expected")
    if not records:
        raise InputError(f"{name}: no file is named in it (SF:...), a tracefile of LCOV was expected")
    return CoverageReport(name, {file: record.coverage() for file, record in records.items()})


def tracefile(files: Mapping[str, FileCoverage]) -> str:
    """Return the coverage of files as an LCOV tracefile, the inverse of :func:`parse_lcov`."""
    lines: list[str] = []
    for path, coverage in files.items():
        if len(path.splitlines()) != 1 or path != path.strip():
            continue  # LCOV cannot represent a file name with a line break
        lines += ["TN:", f"SF:{path}"]
        for (first, last), hits in coverage.functions.items():
            name = f"lines {first} to {last}"
            lines += [f"FN:{first},{last},{name}", f"FNDA:{hits},{name}"]
        lines += [f"DA:{line},{hits}" for line, hits in coverage.hits.items()]
        for line, rate in coverage.branches.items():
            lines += [f"BRDA:{line},0,{branch},{int(branch < rate.covered)}" for branch in range(rate.total)]
        lines.append("end_of_record")
    return "".join(f"{line}\n" for line in lines)


def _add_to_record(record: _Record, kind: str, value: str, where: str) -> None:
    found = (_LINE_VALUE if kind == "DA" else _BRANCH_VALUE).fullmatch(value)
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


GCOV_START = b'{"'
"""Start of a document of gcov, whose keys are of any order."""


def parse_gcov(data: bytes, name: str) -> CoverageReport:
    """Parse documents of gcov; those of one source file, and instances of one template, are added up.

    Raises:
        InputError: a line is no document of gcov, or a number is out of range; names the line.
    """
    parts: dict[str, list[FileCoverage]] = {}
    folders: dict[str, None] = {}
    for number, line in enumerate(io.BytesIO(data), 1):
        if not line.strip():
            continue
        try:
            document = parse_json(line)
            folders[str(document["current_working_directory"])] = None
            for file in document["files"]:
                parts.setdefault(str(file["file"]), []).extend(_parts_of_file(file))
        except (ValueError, KeyError, TypeError, RecursionError):
            raise InputError(f"{name}:{number}: this is no JSON of gcov (--json-format)") from None
    return CoverageReport(name, {file: combined(found) for file, found in parts.items()}, tuple(folders))


def _parts_of_file(file: dict[str, Any]) -> Iterator[FileCoverage]:
    for line in file["lines"]:
        number = _within(line["line_number"], 1, MAX_LINE)
        # a branch to the handler of an exception is the compiler's, not the code's
        branches = [_within(branch["count"], 0, MAX_HITS) for branch in line["branches"] if not branch.get("throw")]
        rates = {number: Rate(sum(count > 0 for count in branches), len(branches))} if branches else {}
        yield FileCoverage({number: _within(line["count"], 0, MAX_HITS)}, rates)
    for function in file["functions"]:
        span = _within(function["start_line"], 1, MAX_LINE), _within(function["end_line"], 1, MAX_LINE)
        yield FileCoverage(functions={span: _within(function["execution_count"], 0, MAX_HITS)})


def _within(number: object, least: int, most: int) -> int:
    if type(number) is not int or not least <= number <= most:
        raise ValueError
    return number
