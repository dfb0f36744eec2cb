"""Parser of gcov's JSON (GCC 9 and newer): one document for each object file, a line each."""

import io
from collections.abc import Iterator
from typing import Any

from calibration.addons.coverage.formats import MAX_HITS, MAX_LINE, CoverageReport
from calibration.addons.coverage.lines import FileCoverage, Rate, combined
from calibration.base.documents import parse_json
from calibration.base.errors import InputError

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
