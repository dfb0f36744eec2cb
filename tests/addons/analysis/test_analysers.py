"""Every analyser on a planted defect, and on files that are made to break it."""

import sys
from pathlib import Path

import pytest

from calibration.addons.analysis.analysers import ANALYSERS
from calibration.addons.analysis.analysers.analyser import module, run_program
from calibration.addons.analysis.copies import Copy, may_be_analysed
from calibration.addons.analysis.results import CodeFinding
from calibration.base import InfrastructureError
from tests.repositories import write

WORKFLOW = """on: pull_request_target
jobs:
  a:
    runs-on: ubuntu-latest
    steps:
      - run: echo ${{ github.event.pull_request.title }}
"""
COMPLEX = "def f(x):\n" + "".join(f"    if x == {n}:\n        return {n}\n" for n in range(20))


def look(folder: Path, name: str, files: dict[str, str | bytes], seconds: float = 60) -> list[CodeFinding]:
    """Findings of an analyser in those of the files that it selects."""
    write(folder, files)
    copy = Copy(folder, tuple(files), present=tuple(files))
    wanted = [path for path in files if ANALYSERS[name].wants(path, copy)]
    return ANALYSERS[name].findings(copy, wanted, seconds) if wanted else []


@pytest.mark.parametrize(
    ("name", "path", "text", "line", "rule", "kind"),
    [
        ("ruff", "-a b.py", "import subprocess\n\n\ndef f(x):\n    return eval(x)\n", 5, "S307", "security"),
        ("ruff", "a.py", "import os\n", 1, "F401", "unused code"),
        ("ruff", "a.py", "print(nothing)\n", 1, "F821", "error-prone"),
        ("ruff", "scripts/a", "#!/usr/bin/env python3\nprint(nothing)\n", 2, "F821", "error-prone"),
        ("ruff", "a.py", "def f(:\n", 1, "invalid-syntax", "error-prone"),
        ("cppcheck", "a.cpp", "int main() {\n  int *p = 0;\n  return *p;\n}\n", 3, "nullPointer", "error-prone"),
        ("shellcheck", "a.sh", "#!/bin/sh\ncd $1\n", 2, "SC2164", "error-prone"),
        ("shellcheck", "run", "#!/bin/bash\nunused=1\n", 2, "SC2034", "unused code"),
        ("yamllint", "a.yml", "a: 1\nb: 2\na: 3\n", 3, "key-duplicates", "error-prone"),
        ("yamllint", "a.yaml", "a: [1\n", 2, "syntax", "error-prone"),
        ("zizmor", ".github/workflows/a.yml", WORKFLOW, 1, "dangerous-triggers", "security"),
        ("zizmor", ".github/workflows/a.yml", WORKFLOW, 6, "template-injection", "security"),
        ("lizard", "a.py", COMPLEX, 1, "complexity", "complexity"),
        ("xml", "a.launch", "<launch>\n<node>\n</launch>\n", 3, "syntax", "error-prone"),
        ("xml", "a.urdf", '<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', 1, "entities", "security"),
        ("xml", "package.xml", '<?xml version="1.0" encoding="klingon"?><a/>', 1, "syntax", "error-prone"),
    ],
)
def test_a_planted_defect_is_found_at_its_line(
    tmp_path: Path, name: str, path: str, text: str, line: int, rule: str, kind: str
) -> None:
    found = look(tmp_path, name, {path: text})
    assert (path, line, f"{name}/{rule}", kind) in [(each.path, each.line, each.rule, each.category) for each in found]


@pytest.mark.parametrize(
    ("name", "path", "text"),
    [
        ("ruff", "a.py", '"""What it is."""\n\nimport os\n\nprint(os.name)\n'),
        ("cppcheck", "a.cpp", "int main() { return 0; }\n"),
        ("shellcheck", "a.sh", '#!/bin/sh\ncd "$1" || exit 1\n'),
        ("yamllint", "a.yml", "a: 1\nb: [1, 2]\n"),
        ("lizard", "a.py", "def f(x):\n    return x\n"),
        ("xml", "a.launch", "<launch/>\n"),
    ],
)
def test_what_is_right_is_not_found(tmp_path: Path, name: str, path: str, text: str) -> None:
    assert look(tmp_path, name, {path: text}) == []


def test_the_teams_settings_are_respected(tmp_path: Path) -> None:
    text = "import os\nprint(nothing)\n"
    found = look(tmp_path, "ruff", {"a.py": text, "ruff.toml": 'lint.select = ["F401"]\n'})
    assert [each.rule for each in found] == ["ruff/F401"]
    assert look(tmp_path / "y", "yamllint", {"a.yml": "a: 1\na: 2\n", ".yamllint": "rules: {}\n"}) == []


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("ruff", {"a.py": "x = 1\n", "ruff.toml": "lint.select = [\n"}),
        ("ruff", {"a.py": "x = 1\n", "ruff.toml": 'lint.select = ["NONE999"]\n'}),
        ("yamllint", {"a.yml": "a: 1\n", ".yamllint": "rules: {nothing: enable}\n"}),
        ("zizmor", {".github/workflows/a.yml": WORKFLOW, "zizmor.yml": "rules: 3\n"}),
    ],
)
def test_broken_settings_are_one_line(tmp_path: Path, name: str, files: dict[str, str | bytes]) -> None:
    with pytest.raises(InfrastructureError, match=rf"{name} failed with exit code \d+: \S") as error:
        look(tmp_path, name, files)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "path", "content"),
    [
        ("ruff", "a.py", b"x = '\xff\xfe'\n"),
        ("ruff", "a.py", ("(" * 5000).encode()),
        ("cppcheck", "a.cpp", b'#include "a.cpp"\nint f() {\n'),
        ("cppcheck", "a.cpp", ("{" * 5000).encode()),
        ("shellcheck", "a.sh", b"if [ \xff\n"),
        ("yamllint", "a.yml", b"a: \xff\n"),
        ("yamllint", "a.yml", b"a: &a [*a, *a]\nb: *a\n"),
        ("yamllint", "a.yml", b"[" * 500),
        ("zizmor", ".github/workflows/a.yml", b"a: [\n"),
        ("zizmor", ".github/workflows/a.yml", b""),
        ("lizard", "a.py", ("(" * 5000).encode()),
        ("xml", "a.urdf", b"<a>" * 100_000),
        ("xml", "a.urdf", b""),
    ],
)
def test_files_that_do_not_parse_are_findings_or_nothing(tmp_path: Path, name: str, path: str, content: bytes) -> None:
    assert all(each.path == path and each.line >= 1 for each in look(tmp_path, name, {path: content}))


def test_a_package_of_the_repository_does_not_take_an_analysers_place(tmp_path: Path) -> None:
    harm = "import pathlib\npathlib.Path(__file__).with_name('harmed').touch()\n"
    write(
        tmp_path,
        {"yamllint.py": harm, "yaml.py": harm, "lizard.py": harm, "ruff/__main__.py": harm, "ruff/__init__.py": harm},
    )
    for name in ("ruff", "lizard", "yamllint"):
        look(tmp_path, name, {"a.yml": "a: 1\n", "a.py": "import os\n"})
    assert not list(tmp_path.rglob("harmed"))


def test_a_program_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    with pytest.raises(InfrastructureError, match=r"sleeper took longer than 0\.2 s"):
        run_program("sleeper", ["sleep", "60"], tmp_path, 0.2, (0,))


def test_a_program_that_fails_is_no_program_without_findings(tmp_path: Path) -> None:
    with pytest.raises(InfrastructureError, match=r"failed with exit code 1: .*No module named nothing"):
        run_program("nothing", module("nothing"), tmp_path, 60, (0,))
    with pytest.raises(InfrastructureError, match="cannot be started"):
        run_program("nothing", ["./nothing"], tmp_path, 60, (0,))


def test_programs_see_no_variables_of_the_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INPUT_TOKEN", "secret")
    monkeypatch.setenv("GITHUB_TOKEN", "secret")
    assert "secret" not in run_program("env", ["env"], tmp_path, 60, (0,)).output


def test_the_files_that_count_are_those_of_the_analysers(tmp_path: Path) -> None:
    kinds = "action bash c cc cpp cxx h hh hpp hxx launch msg py pyi sdf sh srdf srv test urdf xacro xml yaml yml"
    others = "cfg cmake csv dat gv html ini ipynb json log md rst svg toml txt world zzz"
    names = ["a", "CMakeLists.txt", "dataset.json", "setup.cfg"]
    names += [f"a.{suffix}" for suffix in f"{kinds} {others}".split()]
    write(tmp_path, dict.fromkeys(names, "#!/bin/sh\n"))
    copy = Copy(tmp_path, tuple(names), present=("package.xml", *names))
    wanted = {name for name in names if any(each.wants(name, copy) for each in ANALYSERS.values())}
    assert {name for name in names if may_be_analysed(name)} == wanted


def test_the_memory_of_a_program_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.addons.analysis.analysers.analyser.MAX_MEMORY", 100 << 20)
    code = "import time; time.sleep(0.5); print(len(bytearray(%d << 20)))"
    assert run_program("x", [sys.executable, "-c", code % 10], tmp_path, 30, (0,)).output == "10485760\n"
    with pytest.raises(InfrastructureError, match=r"x failed with exit code 1: .*MemoryError"):
        run_program("x", [sys.executable, "-c", code % 1000], tmp_path, 30, (0,))


SOURCED = "#!/bin/sh\n# shellcheck source=/dev/zero\n. ./x\n"


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("ruff", {"a.py": "x = 1\n", "ruff.toml": 'extend = "/dev/zero"\n'}),
        ("shellcheck", {"a.sh": SOURCED, ".shellcheckrc": "external-sources=true\n"}),
    ],
)
def test_a_file_without_end_takes_no_more_memory_than_a_program_may_have(
    name: str, files: dict[str, str | bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calibration.addons.analysis.analysers.analyser.MAX_MEMORY", 300 << 20)
    with pytest.raises(InfrastructureError, match=f"{name} failed with exit code"):
        look(tmp_path, name, files)


RUFF_ERROR = """ruff failed
  Cause: Failed to parse /elsewhere
  Cause: TOML parse error at line 1, column 16
  |
1 | root:x:0:secret
  |                ^
key with no value, expected `=`
"""


def test_an_error_quotes_no_line_of_a_file_elsewhere(tmp_path: Path) -> None:
    """As `extend = "/elsewhere"` in ruff.toml makes ruff do."""
    program = [sys.executable, "-c", f"import sys; sys.exit({RUFF_ERROR!r})"]
    with pytest.raises(InfrastructureError, match=r"parse /elsewhere Cause: TOML parse error at line 1, column 16$"):
        run_program("ruff", program, tmp_path, 60, (0,))
    (tmp_path / "x").write_text("root:x:0:secret\n")
    with pytest.raises(InfrastructureError, match="ruff failed with exit code 2") as error:
        look(tmp_path, "ruff", {"a.py": "x = 1\n", "ruff.toml": f'extend = "{tmp_path}/x"\n'})
    assert "secret" not in str(error.value)
