"""Tests of a team, really run and really measured, in Pythons that are not ours."""

import shutil
import sys
from pathlib import Path

import pytest

from calibration.addons.coverage.formats import FileCoverage, Rate
from calibration.base import InfrastructureError, InputError
from calibration.ci.report.junit import Tally
from tests.addons.coverage.projects import NAMING, TOKEN
from tests.repositories import commit, git, write

from .conftest import Run

NAMING_COVERAGE = FileCoverage({1: 1, 2: 1, 3: 0, 4: 1, 7: 1, 8: 0}, {2: Rate(1, 2)}, {(1, 4): 1, (7, 8): 0})
OURS = sys.executable
"""With pytest and coverage.py of its own."""


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    "text",
    [
        "python3 -m unittest tests.test_naming",
        "unittest tests",
        "tests",
        "python3 -W error -B -m unittest discover tests",
    ],
)
def test_a_python_without_coverage(run: Run, bare_python: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    tests, measured, found = run(text, bare_python)
    assert tests.problem is None
    assert tests.tally == Tally(1)
    assert measured.executable == bare_python
    assert found.files["robot/naming.py"] == NAMING_COVERAGE
    out = capsys.readouterr().out
    assert f"{text} | Ran 1 test in " in out


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("text", ["pytest -q -p no:cacheprovider", "tests"])
def test_pytest(run: Run, root: Path, text: str) -> None:
    tests, measured, found = run(text, OURS)
    assert tests.problem is None
    assert tests.tally == Tally(1)
    assert measured.executable == OURS
    assert found.files["robot/naming.py"] == NAMING_COVERAGE
    assert found.files["robot/__init__.py"] == FileCoverage()


def test_a_shell_script_that_starts_python_as_it_likes(run: Run, root: Path, bare_python: str) -> None:
    code = f'import sys; sys.path.insert(0, "{root}"); import robot.naming as n; n.split("a")'
    script = f"#!/bin/sh\ncd /\n'{bare_python}' -c '{code}'\n"
    write(root, {"check.sh": script})
    (root / "check.sh").chmod(0o755)
    tests, _, found = run("./check.sh")
    assert (tests.problem, tests.tally) == (None, None)
    assert found.files["robot/naming.py"].hits == {1: 1, 2: 0, 3: 0, 4: 0, 7: 1, 8: 1}


def test_a_program_that_does_not_heed_pythonpath(run: Run, root: Path) -> None:
    """It starts its measurement by coverage.py's own file of the kind .pth, where that is new enough."""
    code = f'import sys; sys.path.insert(0, "{root}"); import robot.naming as n; n.split("a")'
    _, _, found = run(f"{OURS} -I -c '{code}'")
    assert found.files["robot/naming.py"].hits == {1: 1, 2: 0, 3: 0, 4: 0, 7: 1, 8: 1}


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes_that_the_tests_start(run: Run, root: Path, bare_python: str, method: str) -> None:
    test = f"""import multiprocessing, subprocess, sys, threading, unittest
from robot.naming import joined, split
class Test(unittest.TestCase):
    def test_process(self):
        process = multiprocessing.get_context("{method}").Process(target=split, args=("a_b",))
        process.start()
        process.join()
        self.assertEqual(process.exitcode, 0)
    def test_program(self):
        subprocess.run([sys.executable, "-c", "import robot.naming as n; n.joined()"], check=True)
    def test_thread(self):
        thread = threading.Thread(target=joined, args=("a",))
        thread.start()
        thread.join()
"""
    commit(root, {"tests/test_naming.py": test})
    tests, _, found = run("python3 -m unittest tests.test_naming", bare_python)
    assert tests.tally == Tally(3)
    assert found.files["robot/naming.py"].missing == []
    assert found.files["robot/naming.py"].branch_rate == Rate(2, 2)


@pytest.mark.thorough
def test_several_workers_of_pytest(run: Run, root: Path) -> None:
    commit(root, {"tests/test_split.py": "from robot.naming import split\ndef test_split(): assert split('a_b')\n"})
    tests, _, found = run("pytest -q -n 2 -p no:cacheprovider", OURS)
    assert tests.tally == Tally(2)
    assert found.files["robot/naming.py"].missing == [3]


def test_failures_say_where(run: Run, root: Path) -> None:
    bad = "def test_bad():\n    assert 1 == 2, '::error::evil'\n\n\ndef test_worse():\n    open('/no/such/file')\n"
    commit(root, {"tests/test_bad.py": bad})
    tests, _, found = run("pytest -q -p no:cacheprovider", OURS)
    assert tests.exit_code == 1
    assert tests.problem == "the tests failed: exit code 1, 2 of 3 failed"
    assert tests.tally is not None
    assert [(f.name, f.file, f.line) for f in tests.tally.failures] == [
        ("tests.test_bad.test_bad", "tests/test_bad.py", 1),
        ("tests.test_bad.test_worse", "tests/test_bad.py", 5),
    ]
    assert found.files["robot/naming.py"] == NAMING_COVERAGE  # measured all the same


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    ("text", "interpreter"),
    [("pytest -q -p no:cacheprovider -k nothing", "ours"), ("unittest empty", "bare")],
)
def test_no_test_ran(run: Run, root: Path, bare_python: str, text: str, interpreter: str) -> None:
    (root / "empty").mkdir()
    tests, _, _ = run(text, OURS if interpreter == "ours" else bare_python)
    assert tests.problem == "no test ran"


@pytest.mark.thorough
def test_all_tests_were_skipped(run: Run, root: Path) -> None:
    commit(root, {"tests/test_naming.py": "import pytest\npytestmark = pytest.mark.skip\ndef test(): pass\n"})
    tests, _, _ = run("pytest -q -p no:cacheprovider", OURS)
    assert tests.exit_code == 0
    assert tests.problem == "no test ran (1 were skipped)"


def test_it_takes_too_long(run: Run, root: Path) -> None:
    commit(root, {"tests/test_naming.py": "import time\ndef test(): time.sleep(60)\n"})
    with pytest.raises(InfrastructureError, match="the tests took longer than 2 s"):
        run("pytest -q -p no:cacheprovider", OURS, 2)


def test_an_installed_copy_is_what_the_tests_run(run: Run, root: Path, bare_python: str, tmp_path: Path) -> None:
    """As after ``pip install .``: the sources in the repository are not the files that are run."""
    [packages] = Path(bare_python).parents[1].glob("lib/python3*/site-packages")
    commit(root, {"src/arm/__init__.py": "", "src/arm/move.py": NAMING, "robot/__init__.py": "x = 1\n"})
    shutil.copytree(root / "src/arm", packages / "arm")
    try:
        tests, _, found = run("python3 -I -c 'import arm'", bare_python)  # isolated: PYTHONPATH is not heeded
        assert (tests.exit_code, found.files) == (0, {})
        shutil.rmtree(tmp_path / "measuring")
        shutil.rmtree(tmp_path / "reading")
        _, _, found = run("python3 -c 'import arm.move; arm.move.split(\"\")'", bare_python)
    finally:
        shutil.rmtree(packages / "arm")
    assert found.files["src/arm/move.py"].hits == {1: 1, 2: 0, 3: 0, 4: 0, 7: 1, 8: 1}
    assert found.files["robot/__init__.py"].hits == {1: 0}


def test_the_tests_see_neither_token_nor_our_packages(run: Run, root: Path, bare_python: str, tmp_path: Path) -> None:
    test = """import os, sys, unittest
class Test(unittest.TestCase):
    def test(self):
        print(sorted(name for name in os.environ if "TOKEN" in name), "planted-" "t0ken/with+signs=")
        print([name for name in ("click", "numpy", "coverage.cmdline") if name in sys.modules])
        self.assertFalse([entry for entry in sys.path if "brought" in entry or "injected" in entry])
        print("::add-mask::x")
"""
    commit(root, {"tests/test_naming.py": test})
    tests, _, _ = run("unittest tests", bare_python)
    assert tests.problem is None
    log = (tmp_path / "out/tests.log").read_text()
    assert "[] ***\n[]\n" in log
    assert TOKEN not in log


def test_a_sitecustomize_of_the_team_still_runs(
    run: Run, root: Path, bare_python: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    commit(root, {"site/sitecustomize.py": "import os\nos.environ['TEAM'] = 'here'\n"})
    monkeypatch.setenv("PYTHONPATH", str(root / "site"))
    tests, measured, _ = run("python3 -c 'import os, robot.naming; print(os.environ[\"TEAM\"])'", bare_python)
    assert tests.exit_code == 0
    assert measured.files


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("text", ["import no_such_module\n", "raise RuntimeError('x')\n", "raise ImportError('x')\n"])
def test_a_sitecustomize_of_the_team_that_fails(
    run: Run, root: Path, bare_python: str, monkeypatch: pytest.MonkeyPatch, text: str, tmp_path: Path
) -> None:
    """Python says so and goes on, as it does without us."""
    commit(root, {"site/sitecustomize.py": text})
    monkeypatch.setenv("PYTHONPATH", str(root / "site"))
    tests, measured, _ = run("python3 -c 'import robot.naming'", bare_python)
    assert tests.exit_code == 0
    assert measured.files
    expected = text.split("'")[1] if "'" in text else "no_such_module"
    assert expected in (tmp_path / "out/tests.log").read_text()


def test_what_the_team_has_set_for_coverage(run: Run, root: Path, bare_python: str) -> None:
    config = "[tool.coverage.run]\nomit = ['robot/arm.py']\n[tool.coverage.report]\nexclude_also = ['def split']\n"
    commit(root, {"pyproject.toml": config, "robot/arm.py": "x = 1\n", "robot/naming.py": NAMING.replace("_", "-")})
    test = "import unittest\nimport robot.arm\nfrom robot.naming import joined\n"
    test += "class Test(unittest.TestCase):\n    def test(self): joined('a')\n"
    commit(root, {"tests/test_naming.py": test})
    _, _, found = run("unittest tests", bare_python)
    assert found.files["robot/naming.py"].hits == {1: 1, 2: 1, 3: 0, 4: 1}
    assert found.files["robot/arm.py"].missing == [1]


def test_a_coverage_that_does_not_suit_the_python(run: Run, bare_python: str, tmp_path: Path) -> None:
    """As for a Python that is too old for the coverage.py that is brought along: said, and the tests go on."""
    [packages] = Path(bare_python).parents[1].glob("lib/python3*/site-packages")
    (packages / "coverage.py").write_text("def f(:\n")
    try:
        tests, measured, found = run("unittest tests", bare_python)
    finally:
        (packages / "coverage.py").unlink()
    assert tests.problem is None
    assert (measured.files, found.files) == ((), {})
    [problem] = measured.problems
    assert problem.startswith(f"{bare_python} (3.")
    assert "cannot be measured, neither with a coverage.py of its own nor with ours: SyntaxError: " in problem


@pytest.mark.thorough
def test_results_of_an_earlier_run_are_not_taken_for_this_ones(run: Run, tmp_path: Path) -> None:
    write(tmp_path, {"out/tests.xml": '<testsuites><testsuite><testcase name="old"/></testsuite></testsuites>'})
    tests, _, _ = run("pytest --no-such-option", OURS)
    assert (tests.exit_code, tests.tally) == (4, None)


def test_results_that_are_none(run: Run, root: Path) -> None:
    write(root, {"run": "#!/bin/sh\necho '<html/>' > tests.xml\n"})
    (root / "run").chmod(0o755)
    with pytest.raises(InputError, match=r"tests.xml: found XML with the root <html>, expected JUnit"):
        run("./run run pytest --junitxml=tests.xml")


def test_a_crash(run: Run, root: Path) -> None:
    commit(root, {"tests/test_crash.py": "import os\ndef test_z(): os.abort()\n"})
    tests, _, _ = run("pytest -q -p no:cacheprovider -p no:faulthandler", OURS)
    assert tests.problem == "the tests were killed by SIGABRT"


def test_git_knows_nothing_new(run: Run, root: Path, bare_python: str) -> None:
    run("python3 -B -m unittest tests.test_naming", bare_python)
    assert git(root, "status", "--porcelain", "--ignored") == ""


def test_the_injected_programs_are_readable_for_old_pythons() -> None:
    import ast

    folder = Path(__file__).parents[4] / "calibration/addons/coverage/injected"
    for path in folder.glob("*.py"):
        ast.parse(path.read_text(), feature_version=(3, 4))
