from pathlib import Path

import pytest

from calibration.addons.coverage.formats import CoverageReport, FileCoverage
from calibration.addons.coverage.reading import MAX_COPY, PathMap, mapped
from calibration.ci.git import Repository
from tests.repositories import commit, write

FILES = {
    "setup.py": "1\n",
    "src/robot/naming.py": "a\nb\nc\n",
    "src/robot/__init__.py": "",
    "src/robot/arm/__init__.py": "",
    "lib/robot/naming.py": "other\n",
    "src/only.cpp": "1\n2\n",
    "deep/src/only.cpp": "1\n",
    "tools/script.py": "x\n",
}


@pytest.fixture
def paths(tmp_path: Path) -> PathMap:
    commit(tmp_path / "p", FILES)
    repository = Repository.around(tmp_path / "p")
    return PathMap(repository, repository.root / "src", repository.tracked())


@pytest.mark.parametrize(
    ("name", "folders", "found"),
    [
        ("{root}/src/robot/naming.py", [], ["src/robot/naming.py"]),
        ("{root}/src/../lib/./robot/naming.py", [], ["lib/robot/naming.py"]),
        ("robot/naming.py", [], ["src/robot/naming.py"]),  # relative to where the tests ran
        ("lib/robot/naming.py", [], ["lib/robot/naming.py"]),  # relative to the root
        ("naming.py", ["{root}/lib/robot"], ["lib/robot/naming.py"]),  # the report's own folder first
        ("robot/naming.py", ["{root}/lib", "{root}/src"], ["lib/robot/naming.py", "src/robot/naming.py"]),
        ("robot/naming.py", ["/other/src"], ["src/robot/naming.py"]),
        ("robot\\arm\\__init__.py", [], ["src/robot/arm/__init__.py"]),
        ("arm/__init__.py", [], ["src/robot/arm/__init__.py"]),  # the end of one path
        ("__init__.py", [], ["src/robot/__init__.py", "src/robot/arm/__init__.py"]),
        ("naming.py", [], ["lib/robot/naming.py", "src/robot/naming.py"]),
        ("/app/src/robot/naming.py", [], ["src/robot/naming.py"]),  # another checkout
        ("/app/deep/src/only.cpp", [], ["deep/src/only.cpp"]),  # the longer path
        ("/ws/src/arm/__init__.py", [], ["src/robot/arm/__init__.py"]),  # a package in the workspace of an image
        ("/usr/src/naming.py", [], []),
        ("/usr/lib/python3/setup.py", [], []),  # not the one in the root
        ("../../../../../etc/passwd", [], []),
        ("../setup.py", [], ["setup.py"]),
        ("/src/robot/other.py", [], []),
        ("", [], []),
        (" ", [], []),
        ("a\0b", [], []),
        ("x" * 5000, [], []),
    ],
)
def test_which_file_is_meant(paths: PathMap, name: str, folders: list[str], found: list[str]) -> None:
    root = str(paths.repository.root)
    there = [folder.replace("{root}", root) for folder in folders]
    assert paths.find(name.replace("{root}", root), there) == tuple(found)


def test_a_file_that_exists_elsewhere_is_meant_only_if_it_is_a_copy(paths: PathMap, tmp_path: Path) -> None:
    installed = tmp_path / "site-packages"
    write(
        installed,
        {
            "robot/naming.py": FILES["src/robot/naming.py"],
            "robot/__init__.py": "",
            "src/robot/naming.py": "another program's\n",
            "script.py": "x" * (MAX_COPY + 1),
        },
    )
    assert paths.find(f"{installed}/robot/naming.py") == ("src/robot/naming.py",)
    assert paths.find(f"{installed}/src/robot/naming.py") == ()
    assert paths.find(f"{installed}/robot/__init__.py") == ()  # all empty files are alike
    assert paths.find(f"{installed}/script.py") == ()


def test_a_file_that_may_not_be_read(paths: PathMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, {"elsewhere/script.py": "x\n"})

    def refuse(_: Path) -> bytes:
        raise PermissionError

    assert paths.find(str(tmp_path / "elsewhere/script.py")) == ("tools/script.py",)
    monkeypatch.setattr(Path, "read_bytes", refuse)
    assert paths.find(str(tmp_path / "elsewhere/script.py")) == ()


def test_a_link_to_a_tracked_file(paths: PathMap, tmp_path: Path) -> None:
    (tmp_path / "linked.py").symlink_to(paths.repository.root / "tools/script.py")
    assert paths.find(str(tmp_path / "linked.py")) == ("tools/script.py",)


def test_reports_are_held_against_the_repository(paths: PathMap) -> None:
    one = CoverageReport("1", {"robot/naming.py": FileCoverage({1: 1, 2: 0}), "__init__.py": FileCoverage({1: 1})})
    two = CoverageReport(
        "2",
        {
            "/app/src/robot/naming.py": FileCoverage({2: 4, 3: 0}),
            "/usr/include/vector": FileCoverage({1: 1}),
            "src/only.cpp": FileCoverage({3: 1}),  # it has two lines, and perhaps one begun
            "deep/src/only.cpp": FileCoverage({9: 1}),
            "setup.py": FileCoverage({1: 1}),
        },
        ("/nowhere",),
    )
    counted = [path for path in paths.tracked if path != "setup.py"]
    found = mapped([one, two], paths, counted)
    assert found.files == {
        "src/robot/naming.py": FileCoverage({1: 1, 2: 4, 3: 0}),
        "src/only.cpp": FileCoverage({3: 1}),
    }
    assert found.left_out.unmatched == ("/usr/include/vector",)
    assert found.left_out.ambiguous == {"__init__.py": ("src/robot/__init__.py", "src/robot/arm/__init__.py")}
    assert found.left_out.ill_fitting == {"deep/src/only.cpp": 9}
