"""Coverage of a repository from reports of every kind, with real data files of coverage.py."""

import shutil
import sqlite3
import sys
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from coverage import CoverageData

from calibration.addons.coverage import coverage_py
from calibration.addons.coverage.formats import MAX_BYTES, FileCoverage, Rate
from calibration.addons.coverage.reading import Found, read_reports
from calibration.addons.coverage.sources import find_sources
from calibration.base import InfrastructureError, InputError
from calibration.ci.git import Repository
from tests.repositories import commit, write

from .projects import NAMING, robot

JUMPS = [(-1, 1), (1, 7), (7, -1), (-1, 2), (2, 4), (4, -1)]
"""Lines of naming.py that the project's test runs: 1, 2, 4 and 7."""
NAMING_COVERAGE = FileCoverage({1: 1, 2: 1, 3: 0, 4: 1, 7: 1, 8: 0}, {2: Rate(1, 2)}, {(1, 4): 1, (7, 8): 0})
NOT_RUN = FileCoverage({1: 0, 2: 0, 3: 0, 4: 0, 7: 0, 8: 0}, {2: Rate(0, 2)}, {(1, 4): 0, (7, 8): 0})


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return robot(tmp_path / "project")


def write_data(path: Path, jumps: Mapping[str, Any] | None = None, lines: Mapping[str, Any] | None = None) -> Path:
    with closing(CoverageData(basename=str(path))) as data:
        if jumps is not None:
            data.add_arcs(jumps)
            data.touch_files(list(jumps))
        if lines is not None:
            data.add_lines(lines)
    return path


def read(root: Path, *files: Path, settings: Mapping[str, Any] | None = None, source: str = ".") -> Found:
    folder = root.parent / "meanwhile"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    sources = find_sources(Repository.around(root), root, [Path(source)], None)
    return read_reports(files, sources, settings or {}, folder)


def test_a_data_file_with_jumps(root: Path, tmp_path: Path) -> None:
    file = write_data(tmp_path / ".coverage", {str(root / "robot/naming.py"): JUMPS, "/usr/lib/other.py": [(1, 2)]})
    before = file.read_bytes()
    found = read(root, file)
    assert found.files == {"robot/__init__.py": FileCoverage(), "robot/naming.py": NAMING_COVERAGE}
    assert found.left_out.unmatched == ("/usr/lib/other.py",)
    assert file.read_bytes() == before


def test_a_data_file_with_lines_of_another_checkout(root: Path, tmp_path: Path) -> None:
    file = write_data(tmp_path / ".coverage", lines={"/app/robot/naming.py": [1, 2, 4, 7]})
    assert read(root, file).files["robot/naming.py"] == FileCoverage(
        NAMING_COVERAGE.hits, functions=NAMING_COVERAGE.functions
    )


def test_data_files_of_both_kinds_and_other_reports_together(root: Path, tmp_path: Path) -> None:
    name = str(root / "robot/naming.py")
    files = [
        write_data(tmp_path / ".coverage.1", {name: JUMPS[:3]}),
        write_data(tmp_path / ".coverage.2", {name: JUMPS[3:]}),
        write_data(tmp_path / ".coverage.3", lines={name: [8]}),
    ]
    (tmp_path / "l.info").write_text("SF:robot/naming.py\nDA:3,5\nDA:8,1\nend_of_record\n")
    (tmp_path / "c.xml").write_bytes(
        b'\xef\xbb\xbf<coverage line-rate="1">'
        b'<class filename="naming.py"><line number="3" hits="1"/></class></coverage>'
    )
    coverage = read(root, *files, tmp_path / "l.info", tmp_path / "c.xml").files["robot/naming.py"]
    assert coverage.hits == {1: 1, 2: 1, 3: 6, 4: 1, 7: 1, 8: 2}
    assert coverage.branches == {2: Rate(1, 2)}


def test_files_of_plugins_and_files_that_were_only_looked_at_are_kept(tmp_path: Path) -> None:
    """A template, measured by a plugin of coverage.py; and a module of which no line was run."""
    with closing(CoverageData(basename=str(tmp_path / ".coverage"))) as data:
        data.add_arcs({"/app/page.html": [(1, 2)]})
        data.add_file_tracers({"/app/page.html": "templates"})
        data.touch_files(["/app/idle.py"])
    names = {"/app/page.html": "/here/page.html", "/app/idle.py": "/here/idle.py"}
    [merged] = coverage_py.merge([tmp_path / ".coverage"], names, [], tmp_path)
    with closing(CoverageData(basename=str(merged))) as data:
        data.read()
        assert data.measured_files() == {"/here/page.html", "/here/idle.py"}
        assert data.file_tracer("/here/page.html") == "templates"
        assert data.arcs("/here/page.html") == [(1, 2)]


def test_files_that_no_test_loads_count_with_all_their_lines(root: Path, tmp_path: Path) -> None:
    commit(root, {"robot/arm.py": NAMING, "robot/broken.py": "def f(:\n", "robot/old.py": "print 'x'\n"})
    file = write_data(tmp_path / ".coverage", {str(root / "robot/naming.py"): JUMPS})
    found = read(root, file)
    assert found.files["robot/arm.py"] == NOT_RUN
    assert found.left_out.unreadable == ("robot/broken.py", "robot/old.py")


def test_with_a_report_of_another_tool_too(root: Path, tmp_path: Path) -> None:
    commit(root, {"robot/arm.py": NAMING})
    (tmp_path / "c.xml").write_text(
        '<coverage line-rate="1"><class filename="robot/naming.py"><line number="1" hits="1"/></class></coverage>'
    )
    found = read(root, tmp_path / "c.xml")
    assert found.files["robot/naming.py"] == FileCoverage({1: 1})
    assert found.files["robot/arm.py"] == NOT_RUN


def test_a_language_that_no_report_speaks_of_counts_for_nothing(root: Path, tmp_path: Path) -> None:
    commit(root, {"src/arm.cpp": "1\n2\n", "src/hand.cpp": "1\n", "x.sh": "1\n"})
    (tmp_path / "l.info").write_text("SF:src/arm.cpp\nDA:1,1\nend_of_record\n")
    found = read(root, tmp_path / "l.info")
    assert found.files == {"src/arm.cpp": FileCoverage({1: 1})}
    assert found.left_out.without_report == {"python": 2, "shell": 1}


def test_what_the_team_excludes_is_excluded(root: Path, tmp_path: Path) -> None:
    file = write_data(tmp_path / ".coverage", {str(root / "robot/naming.py"): JUMPS})
    found = read(root, file, settings={"report:exclude_lines": ["def split"], "run:omit": ["*"]})
    assert found.files["robot/naming.py"].hits == {1: 1, 2: 1, 3: 0, 4: 1}


def test_a_link_is_not_followed_out_of_the_repository(root: Path, tmp_path: Path) -> None:
    (tmp_path / "secret.py").write_text("password = 1\n")
    (root / "robot/link.py").symlink_to(tmp_path / "secret.py")
    commit(root, {})
    names = ["robot/link.py", str(tmp_path / "secret.py"), "../secret.py", str(root / "../secret.py")]
    found = read(root, write_data(tmp_path / ".coverage", {name: [(-1, 1), (1, -1)] for name in names}))
    assert set(found.files) == {"robot/__init__.py", "robot/naming.py"}
    assert set(names) <= set(found.left_out.unmatched)


def test_names_that_may_be_several_files(root: Path, tmp_path: Path) -> None:
    commit(root, {"a/x.py": "1\n", "b/x.py": "2\n"})
    found = read(root, write_data(tmp_path / ".coverage", {"x.py": [(1, 2)]}))
    assert found.left_out.ambiguous == {"x.py": ("a/x.py", "b/x.py")}
    assert found.files["a/x.py"] == found.files["b/x.py"] == FileCoverage({1: 0})


def test_data_of_another_version_of_the_file(root: Path, tmp_path: Path) -> None:
    """coverage.py itself leaves out what is not in the file."""
    file = write_data(tmp_path / ".coverage", {str(root / "robot/naming.py"): [(-1, 1), (1, 99), (99, -1)]})
    found = read(root, file)
    assert set(found.files["robot/naming.py"].hits) == set(NOT_RUN.hits)


def corrupted(path: Path) -> None:
    write_data(path, {"a.py": JUMPS})
    content = bytearray(path.read_bytes())
    content[100:] = b"\xff" * (len(content) - 100)
    path.write_bytes(content)


def of_another_schema(path: Path) -> None:
    write_data(path, {"a.py": JUMPS})
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE coverage_schema SET version = 99")


def with_lines_without_end(path: Path) -> None:
    write_data(path, lines={"a.py": [1]})
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE line_bits SET numbits = zeroblob(2000000)")


def of_another_program(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE line_bits (numbits)")


def too_large(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (corrupted, "a data file of coverage.py was expected, and this one cannot be read"),
        (of_another_schema, "this one cannot be read: "),
        (of_another_program, "this one cannot be read"),
        (with_lines_without_end, "it contains line numbers above 10000000"),
        (
            too_large,
            "found 104857601 bytes, a data file of coverage.py, Cobertura XML, LCOV or JSON of gcov",
        ),
        (Path.mkdir, "this is no regular file"),
        (Path.touch, "it is empty, a data file of coverage.py, Cobertura XML, LCOV or JSON of gcov was expected"),
        (lambda path: path.write_text("hello"), "found none of the known forms, a data file of coverage.py, Cob"),
        (lambda path: path.write_text("<html/>"), "found XML with the root <html>"),
        (lambda path: None, "cannot be read: No such file"),
    ],
)
def test_what_is_no_report(root: Path, tmp_path: Path, make: Any, message: str) -> None:
    file = tmp_path / "report"
    make(file)
    with pytest.raises(InputError) as refused:
        read(root, file)
    assert "report" in str(refused.value)
    assert message in str(refused.value)


def test_a_python_that_cannot_report(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_data(tmp_path / "data", {str(root / "robot/naming.py"): JUMPS})
    with pytest.raises(InfrastructureError, match=r"x: /no/python cannot write a report of it: .*No such file"):
        coverage_py.report_of(file, "x", {}, root, "/no/python")
    with pytest.raises(InfrastructureError, match=r"x: coverage.py cannot report on it: .*no_such_plugin"):
        coverage_py.report_of(file, "x", {"run:plugins": ["no_such_plugin"]}, root, sys.executable)
    monkeypatch.setattr(coverage_py, "XML_TIMEOUT", 0.01)
    with pytest.raises(InfrastructureError, match=r"cannot write a report of it: .*timed out"):
        coverage_py.report_of(file, "x", {}, root, sys.executable)


def test_data_of_which_nothing_can_be_reported(root: Path, tmp_path: Path) -> None:
    write(root, {"robot/naming.py": "def (:\n"})
    file = write_data(tmp_path / ".coverage", {str(root / "robot/naming.py"): JUMPS})
    found = read(root, file, source="robot/naming.py")
    assert found.files == {}
    assert found.left_out.unreadable == ("robot/naming.py",)
