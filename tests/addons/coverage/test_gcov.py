"""JSON of gcov: known counts, and hostile documents."""

import json
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.coverage.formats import Rate, parse_gcov
from calibration.base import InputError


def line(number: int, count: int, *branches: int, thrown: int = 0) -> dict[str, Any]:
    listed = [{"count": each, "throw": False} for each in branches] + [{"count": 0, "throw": True}] * thrown
    return {"line_number": number, "count": count, "branches": listed}


def document(*lines: dict[str, Any], functions: tuple[dict[str, int], ...] = (), name: str = "src/a.cpp") -> bytes:
    files = [{"file": name, "lines": lines, "functions": functions}]
    return json.dumps({"files": files, "current_working_directory": "/ws/build"}).encode()


def test_counts_of_object_files_and_template_instances_add_up() -> None:
    function = {"start_line": 3, "end_line": 5, "execution_count": 2}
    first = document(line(3, 1), line(4, 0, 0, 3, thrown=2), line(3, 1), functions=(function,))
    report = parse_gcov(first + b"\n\n" + document(line(4, 2)), "gcov.json")
    found = report.files["src/a.cpp"]
    assert dict(found.hits) == {3: 2, 4: 2}
    assert dict(found.branches) == {4: Rate(1, 2)}
    assert dict(found.functions) == {(3, 5): 2}
    assert report.folders == ("/ws/build",)


BAD = [
    b"{}",
    b"[1]",
    b'{"files": 3, "current_working_directory": ""}',
    document(line(0, 1)),
    document(line(1, -1)),
    document({"line_number": 1, "count": 1}),
    document(line(1, 1)).replace(b": 1,", b": 1.5,", 1),
]


@pytest.mark.parametrize("data", BAD)
def test_what_is_no_gcov_is_refused_at_its_line(data: bytes) -> None:
    with pytest.raises(InputError, match=r"^g\.json:2: "):
        parse_gcov(document(line(1, 1)) + b"\n" + data, "g.json")


@given(st.binary(max_size=100))
def test_bytes_of_any_kind_are_read_or_refused(data: bytes) -> None:
    with suppress(InputError):
        parse_gcov(data, "x")
