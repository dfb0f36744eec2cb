"""Functions that tests run and do not test, found in projects whose tests are really run."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks.pseudo_tested import PlantedProject
from benchmarks.pseudo_tested import projects as planted_projects
from calibration.__main__ import main
from calibration.addons.coverage.workers import run_on
from tests.addons.coverage.projects import robot
from tests.processes import runs
from tests.repositories import commit, git
from tests.thorough import thorough

PYTEST = "pytest -q -p no:cacheprovider"
ARM = """import functools, subprocess, sys, time

LOG = []


def walked(a):
    return [a * 2.0]


def tested(a):
    return a * 2.0


def logged(a):
    LOG.append(a)


def walked_log(a):
    LOG.append(a + 1)


def numbers(n):
    for i in range(n):
        yield i


def walked_numbers(n):
    for i in range(n):
        yield i


async def awaited(a):
    return a + 1


@functools.lru_cache
def cached(a):
    return a + 5


def at_import(k):
    return k + 1


K = at_import(3)


def set_up():
    LOG.append("set")
    return 5


def remaining(n):
    return n - 1


def steps(n):
    total = 0
    while n > 0:
        n, total = remaining(n), total + 1
    return total


def by_process(x):
    return x * 2


def walked_by_process(x):
    return x * 2


def zero(x):
    return x - x


class Arm:
    def __init__(self, x):
        self.x = x + 1
        self.y = 2

    @property
    def reach(self):
        return self.x + 1

    @property
    def walked_reach(self):
        return self.x + 2

    @classmethod
    def made(cls, x):
        return cls(x + 1)

    def chained(self):
        self.y += 1
        return self

    def parked(self):
        self.at = self.x + 1
        self.still = True

    def stopped(self):
        self.speed, self.brake = 0, True


if __name__ == "__main__":
    print(by_process(4))
    walked_by_process(3)
"""
TESTS = """import asyncio, subprocess, sys, unittest
from robot import arm


class ArmTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.value = arm.set_up()

    def test_a_walk(self):
        arm.walked(2)
        arm.walked_log(1)
        list(arm.walked_numbers(3))
        arm.cached(1)
        arm.Arm(1).walked_reach
        arm.Arm(1).chained().chained()
        its = arm.Arm(1)
        its.parked()
        self.assertEqual((its.at, its.still), (its.at, its.still))
        its.stopped()
        self.assertTrue(its.brake)
        self.assertFalse(its.speed)
        self.assertEqual(arm.zero(3), 0)

    def test_set_up(self):
        self.assertEqual(self.value, 5)

    def test_values(self):
        self.assertEqual(arm.tested(2), 4.0)
        self.assertEqual(list(arm.numbers(3)), [0, 1, 2])
        self.assertEqual(asyncio.run(arm.awaited(1)), 2)
        self.assertEqual(arm.cached(1), 6)
        self.assertEqual(arm.steps(4), 4)
        self.assertEqual(arm.Arm.made(1).x, 3)

    def test_log(self):
        arm.logged(7)
        self.assertEqual(arm.LOG[-1], 7)

    def test_each(self):
        for number in (1, 2):
            with self.subTest(number):
                self.assertEqual(arm.Arm(number).reach, number + 2)

    def test_import(self):
        arm.at_import(1)
        self.assertEqual(arm.K, 4)

    def test_process(self):
        done = subprocess.run([sys.executable, "-m", "robot.arm"], stdout=subprocess.PIPE)
        self.assertEqual(done.stdout, b"8\\n")
"""
WALKED = {"walked", "walked_log", "walked_numbers", "walked_by_process"}
WALKED |= {"Arm.walked_reach", "Arm.chained", "Arm.parked"}

Judge = Callable[..., tuple[int, dict[str, Any]]]


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project, in which the tests are run outside of GitHub."""
    for name in [name for name in os.environ if name.startswith(("GITHUB_", "INPUT_", "CODACY_", "COVERAGE_"))]:
        monkeypatch.delenv(name)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    root = robot(tmp_path / "p")
    monkeypatch.chdir(root)
    monkeypatch.setattr("calibration.addons.coverage.pseudo_tested.MAX_WORKERS", 1)  # the machine is shared
    return root


@pytest.fixture
def judge(root: Path) -> Judge:
    def judged(run: str, *arguments: str) -> tuple[int, dict[str, Any]]:
        given = ["coverage-upload", "--run", run, "--interpreter", sys.executable, "--output", "out", *arguments]
        code = main(given)
        results = Path("out/results.json")
        return code, json.loads(results.read_text())["pseudo_tested"] if results.exists() else {}

    return judged


def names(found: dict[str, Any]) -> set[str]:
    functions = found["functions"]
    assert isinstance(functions, list)
    return {each["name"] for each in functions}


@pytest.mark.parametrize("run", [thorough(f"{PYTEST} -n 2"), "python3 -m unittest tests.test_arm"])
def test_functions_that_tests_only_walk_through(
    root: Path, judge: Judge, run: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calibration.addons.coverage.pseudo_tested.MAX_WORKERS", 2)
    commit(root, {"robot/arm.py": ARM, "tests/__init__.py": "", "tests/test_arm.py": TESTS})
    code, found = judge(run, "--pseudo-tested", "all", "--source", "robot/arm.py")
    assert code == 0
    assert names(found) == WALKED
    assert found["judged"] == 22
    assert found["unjudged"] == found["failing"] == []
    assert found["functions"][0] == {
        "path": "robot/arm.py",
        "line": 6,
        "name": "walked",
        "changed": False,
        "replacements": ["returns []", "returns [0.0]"],
        "tests": [
            "tests/test_arm.py::ArmTest::test_a_walk" if "pytest" in run else "tests.test_arm.ArmTest.test_a_walk"
        ],
    }
    assert (
        "warning: robot/arm.py:6: no test fails when walked returns [] or returns [0.0] instead"
        in capsys.readouterr().err
    )
    assert git(root, "status", "--porcelain") == ""


@pytest.mark.parametrize(
    "project",
    [each for each in planted_projects(3, 3) if each.style == "fixtures"],
    ids=lambda p: p.style,
)
def test_a_share_of_the_benchmark(root: Path, judge: Judge, project: PlantedProject) -> None:
    commit(root, project.files)
    code, found = judge(project.command, "--pseudo-tested", "all", "--source", "robot/parts.py")
    assert code == 0
    assert {name.rpartition(".")[2] for name in names(found)} == project.planted


@pytest.mark.thorough
def test_limits_are_of_the_change_or_of_all(root: Path, judge: Judge) -> None:
    base = "def old(a):\n    return a + 1\n"
    test = "from robot import arm\n\n\ndef test_arm():\n    arm.old(1)\n"
    commit(root, {"robot/arm.py": base, "tests/test_arm.py": test})
    commit(
        root, {"robot/arm.py": f"{base}\n\ndef new(a):\n    return a\n", "tests/test_arm.py": f"{test}    arm.new(1)\n"}
    )
    code, found = judge(PYTEST, "--max-pseudo-tested-change", "0", "--base", "HEAD~1")
    assert (code, names(found), found["judged"]) == (1, {"new"}, 1)  # the other is not even tried
    code, found = judge(PYTEST, "--max-pseudo-tested-change", "1", "--max-pseudo-tested", "1", "--base", "HEAD~1")
    assert (code, names(found)) == (1, {"new", "old"})
    assert [each["changed"] for each in found["functions"]] == [True, False]


@pytest.mark.thorough
def test_fixtures_of_several_tests_belong_to_all_of_them(root: Path, judge: Judge) -> None:
    test = """import pytest
from robot.naming import joined, split
@pytest.fixture(scope="module")
def name(): return joined("a", "b")
@pytest.fixture(scope="session")
def parts(): return split("a_b")
def test_first(name, parts): pass
def test_second(name): assert name == "a_b"
"""
    commit(root, {"tests/test_naming.py": test})
    code, found = judge(PYTEST, "--pseudo-tested", "all")
    assert (code, names(found)) == (0, {"split"})


@pytest.mark.thorough
def test_tests_that_need_others_or_that_fail_in_the_copy_judge_nothing(root: Path, judge: Judge) -> None:
    test = f"""import os
from robot.naming import joined, split
SEEN = []
def test_first(): SEEN.append(split("a_b"))
def test_needs_the_first(): assert SEEN and joined("a") == "a"
def test_needs_its_place(): assert os.getcwd() == {str(root)!r} and split("a_b") == ["a", "b"]
"""
    commit(root, {"tests/test_naming.py": test})
    code, found = judge(PYTEST, "--pseudo-tested", "all")
    assert (code, names(found)) == (0, {"split"})
    assert found["failing"] == ["tests/test_naming.py::test_needs_its_place"]
    assert [each["reason"] for each in found["unjudged"]] == ["its tests fail when they are run alone"]


@pytest.mark.thorough
def test_a_function_without_which_tests_never_end_is_tested(
    root: Path, judge: Judge, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """What its tests start in sessions of their own ends with them."""
    test = f"""import os, subprocess
from robot.arm import drive
def test_drive():
    if os.getcwd() != {str(root)!r}:
        with open({str(tmp_path / "pids")!r}, "a") as file:
            print(subprocess.Popen(["sleep", "60"], start_new_session=True).pid, file=file)
    drive(3)
"""
    monkeypatch.setattr("calibration.addons.coverage.pseudo_tested.SECONDS_OF_JOB", 0.5)
    commit(
        root,
        {
            "robot/arm.py": "def left(n):\n return n - 1\n\n\ndef drive(n):\n while n > 0:\n  n = left(n)\n",
            "tests/test_naming.py": test,
        },
    )
    code, found = judge(PYTEST, "--pseudo-tested", "all", "--source", "robot/arm.py")
    assert (code, names(found), found["judged"]) == (0, {"drive"}, 2)
    started = [int(pid) for pid in (tmp_path / "pids").read_text().split()]
    assert len(started) >= 3
    assert [pid for pid in started if runs(pid)] == []


@pytest.mark.thorough
def test_the_budget(
    root: Path, judge: Judge, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def impatient(workers: Any, tasks: Any, deadline: float, selector: Any) -> bool:
        waiting = list(tasks)
        return run_on(workers, waiting, deadline if len(waiting) == 1 else 0.0, selector)

    monkeypatch.setattr("calibration.addons.coverage.pseudo_tested.run_on", impatient)
    test = "from robot.naming import joined, split\ndef test(): joined('a'); split('a')\n"
    commit(root, {"tests/test_naming.py": test})
    code, found = judge(PYTEST, "--max-pseudo-tested", "1")
    assert (code, found["judged"], len(found["unjudged"])) == (3, 0, 2)
    assert "max-pseudo-tested is undecided: 2 functions are not judged" in capsys.readouterr().err
    code, _ = judge(PYTEST, "--max-pseudo-tested", "2")  # kept in any case
    assert code == 0
    monkeypatch.setattr("calibration.addons.coverage.pseudo_tested.run_on", lambda *_: False)
    code, _ = judge(PYTEST, "--pseudo-tested", "all")
    assert code == 3
    assert "one run of the tests took longer than 600 s (pseudo-tested-budget)" in capsys.readouterr().err


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("{python} -c 'import robot.naming'", "run starts no pytest and no unittest"),
        ("{pytest}\n{pytest}", "run starts pytest or unittest more than once"),
        *(
            thorough(f"[ -z $PYTEST_PLUGINS ] || {in_the_copy}{{pytest}}", message)
            for in_the_copy, message in (
                ("exit 3\n", "cannot be run in a copy of the checkout: exit code 3"),
                ("touch tests/test_x.py; ", None),
                ("echo + > tests/test_x.py; ", "in a copy of the checkout: exit code 2"),
                ("echo 'def test(): 1 / 0' > tests/test_naming.py; ", "no test passes in a copy"),
                (
                    "printf 'import os\ndef test(): os._exit(0)\n' > tests/test_a.py; ",
                    "do not come to their end in a copy of the checkout: not tests/test_a.py::test",
                ),
            )
        ),
    ],
)
def test_commands_that_cannot_be_judged(
    root: Path, judge: Judge, script: str, message: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest_command = f"{sys.executable} -m {PYTEST}"
    text = f"#!/bin/sh\n{script.replace('{python}', sys.executable).replace('{pytest}', pytest_command)}\n"
    commit(root, {"check.sh": text})
    (root / "check.sh").chmod(0o755)
    code = main(["coverage-upload", "--run", "./check.sh", "--pseudo-tested", "all", "--output", "out"])
    err = capsys.readouterr().err
    assert (code == 0) is (message is None)
    if message is not None:
        assert code == 2
        assert message in err
        assert len(err.splitlines()) == 1


@pytest.mark.thorough
@pytest.mark.parametrize("number", [thorough(signal.SIGINT), signal.SIGTERM])
def test_a_signal_leaves_nothing_behind(root: Path, tmp_path: Path, number: signal.Signals) -> None:
    test = f"""import os, subprocess, time
from robot.naming import joined
def test():
    if joined("a") != "a":
        nap = subprocess.Popen(["sleep", "60"], start_new_session=True)
        line = f"{{os.getpid()}} {{nap.pid}} {{os.getcwd()}}\\n"
        with open({str(tmp_path / "pids")!r}, "a") as file: file.write(line)
        time.sleep(60)
"""
    commit(root, {"tests/test_naming.py": test})
    arguments = ["coverage-upload", "--run", PYTEST, "--interpreter", sys.executable, "--pseudo-tested", "all"]
    with subprocess.Popen(
        [sys.executable, "-m", "calibration", *arguments],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[4])},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        pids = tmp_path / "pids"
        while process.poll() is None and not (pids.exists() and pids.read_text().endswith("\n")):
            time.sleep(0.02)
        process.send_signal(number)
        assert process.stderr is not None
        assert f"error: stopped by {number.name}" in process.stderr.read()
    job, nap, copy = pids.read_text().split()
    assert not runs(int(job))
    assert not runs(int(nap))
    assert not Path(copy).exists()
