"""Files that are broken or made to do harm: read to their end, and nothing is run."""

import time
from pathlib import Path

import pytest

from benchmarks.ros_defects import found_in
from benchmarks.ros_defects.workspace import Workspace, write
from calibration.addons.analysis.analysers import ANALYSERS
from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.ros.__main__ import check
from calibration.addons.analysis.ros.cmake import parse, read_cmake
from calibration.addons.analysis.ros.tree import MAX_ELEMENT_DEPTH, Tree, join, parse_xml, without_comments

LOOPS = "".join(f"foreach(x{depth} {'1 ' * 400})\n" for depth in range(10)) + "endforeach()\n" * 10


def commands(folder: Path, text: str) -> list[tuple[str, ...]]:
    write(folder, {"CMakeLists.txt": text})
    return [(each.name, *each.texts) for each in read_cmake(Tree(folder, ["CMakeLists.txt"]), "")]


def test_cmake_is_read_with_its_variables_and_loops(tmp_path: Path) -> None:
    text = """project(p) # (comment
#[[ a(
]] set(NODES one;two) LIST(APPEND NODES "three four")
foreach(node IN LISTS NODES)
  add_executable(${node} src/${node}.cpp [[raw ${x}]])
endforeach()
function(f) hidden(x) endfunction()
install(TARGETS ${UNKNOWN} "${NODES}" DESTINATION lib/${PROJECT_NAME})
"""
    found = commands(tmp_path, text)
    assert [each for each in found if each[0] == "add_executable"] == [
        ("add_executable", "one", "src/one.cpp", "raw ${x}"),
        ("add_executable", "two", "src/two.cpp", "raw ${x}"),
        ("add_executable", "three four", "src/three four.cpp", "raw ${x}"),
    ]
    assert found[-1] == ("install", "TARGETS", "${UNKNOWN}", "one;two;three four", "DESTINATION", "lib/p")
    assert "hidden" not in [each[0] for each in found]


def test_lines_of_cmake_are_those_of_the_file() -> None:
    [(_, arguments, line)] = parse('\nx(a\n  "b\nc"\n  d)')
    assert (line, [each.line for each in arguments]) == (2, [2, 3, 5])


@pytest.mark.thorough(but_first=3)
@pytest.mark.parametrize(
    "text",
    [
        LOOPS,
        "set(A x)\n" + "set(A ${A} ${A})\n" * 5_000,
        "set(A xx)\n" + 'set(A "${A}${A}${A}")\n' * 5_000,
        "[[" * 50_000,
        '"' * 50_001,
        "a(" * 50_000,
        "set(A " + "b " * 4_000 + ")\n" + "a(${A})\n" * 10_000,
        "foreach(a 1)\n" * 20_000,
        "add_subdirectory(.)\nadd_subdirectory(..)\n",
        "set(A ${B})\nset(B ${A})\na(${A})\n",
    ],
)
def test_hostile_cmake_ends(tmp_path: Path, text: str) -> None:
    start = time.monotonic()
    commands(tmp_path, text)
    assert time.monotonic() - start < 60


def test_a_path_does_not_lead_out_of_the_repository() -> None:
    assert join("a/b", "../c") == "a/c"
    assert join("a", "../../etc/passwd") is None


def test_lines_stay_where_comments_are_taken_out() -> None:
    assert without_comments("a<!-- b\nc -->d\n<!-- e\n") == "a\nd\n\n"


@pytest.mark.thorough(but_first=4)
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("harm", [b"\xff\xfe\x00(", b"<" * 50_000, b"(" * 50_000, b"", b"[" * 50_000, b"${" * 50_000])
def test_broken_files_are_findings_or_nothing(tmp_path: Path, version: int, harm: bytes) -> None:
    files = Workspace(version, 0).files
    write(tmp_path, files)
    for path in files:
        if not path.endswith("package.xml"):
            (tmp_path / path).write_bytes(harm)
    assert all(each.path in files and each.line >= 1 for each in check(Tree(tmp_path, files)))


def test_nothing_is_run(tmp_path: Path) -> None:
    harm = "import pathlib\npathlib.Path(__file__).with_name('harmed').touch()\n"
    files = Workspace(2, 0).files
    files |= {path: harm + text for path, text in files.items() if path.endswith(".py")}
    files |= {"json.py": harm, "calibration/__init__.py": harm, "runpy.py": harm}
    write(tmp_path, files)
    analyser = ANALYSERS["ros"]
    copy = Copy(tmp_path, tuple(files), present=tuple(files))
    analyser.findings(copy, [path for path in files if analyser.wants(path, copy)], 60)
    assert not list(tmp_path.rglob("harmed"))


def test_a_package_below_a_package_and_an_ignored_one_are_none() -> None:
    files = Workspace(1, 0).files
    package = next(path for path in files if path.endswith("_driver/package.xml"))
    text = files[package].replace("<version>1.2.0</version>", "")
    folder = package.rpartition("/")[0]
    assert found_in({**files, f"{folder}/test/package.xml": text}) == []
    assert found_in({**files, "old/package.xml": text, "old/CATKIN_IGNORE": ""}) == []
    assert [each.rule for each in found_in({**files, "old/package.xml": text.replace("driver", "old")})] != []


@pytest.mark.parametrize("path", ["otter_bringup/launch/sensors.launch.xml", "otter_description/urdf/robot.urdf"])
def test_elements_thousands_deep_are_not_read(path: str) -> None:
    files = Workspace(2, 0).files
    tag, inside = ("robot", "link") if path.endswith("urdf") else ("launch", "group")
    found_in({**files, path: f"<{tag}>{f'<{inside}>' * 3000}{f'</{inside}>' * 3000}</{tag}>"})
    assert parse_xml(b"<a>" * MAX_ELEMENT_DEPTH + b"</a>" * MAX_ELEMENT_DEPTH) is not None
    assert parse_xml(b"<a>" * (MAX_ELEMENT_DEPTH + 1) + b"</a>" * (MAX_ELEMENT_DEPTH + 1)) is None
