"""Planted functions that tests only walk through, in five small projects with different styles of tests."""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT

PLANTED, TESTED = 12, 24
"""Functions of a project that its tests only walk through, and that they test."""
TESTS_OF_LARGE = 500
CHANGED_OF_LARGE = 10


@dataclass(frozen=True)
class FunctionKind:
    """Source of a function, a call of it, and what the call gives; {n} is its number and {k} a constant of its own."""

    source: str
    call: str
    expected: str

    def filled(self, number: int) -> "FunctionKind":
        """Return the function with its number."""
        marks = {"{n}": str(number), "{k}": str(number + 3)}

        def fill(text: str) -> str:
            for mark, value in marks.items():
                text = text.replace(mark, value)
            return text

        return FunctionKind(fill(self.source), fill(self.call), fill(self.expected))

    @property
    def name(self) -> str:
        """Name of the function that is judged: the last that the source defines."""
        return self.source.rpartition("def ")[2].partition("(")[0]


KINDS = (
    FunctionKind("def scale_{n}(x):\n    return x * {k} + 1\n", "scale_{n}(3)", "3 * {k} + 1"),
    FunctionKind(
        "def wrap_{n}(angle: float) -> float:\n    while angle > {k}:\n        angle -= 2 * {k}\n    return angle\n",
        "wrap_{n}({k} + 2.5)",
        "2.5 - {k}",
    ),
    FunctionKind('def frame_{n}(name: str) -> str:\n    return f"{name}_{k}"\n', "frame_{n}('arm')", "'arm_{k}'"),
    FunctionKind(
        "def grid_{n}(count):\n    return [i * {k} for i in range(count)]\n", "grid_{n}(3)", "[0, {k}, 2 * {k}]"
    ),
    FunctionKind("def limits_{n}(low):\n    return {'low': low - {k}}\n", "limits_{n}(1)", "{'low': 1 - {k}}"),
    FunctionKind("def parts_{n}(x):\n    return x // 7, x % 7\n", "parts_{n}(33)", "(4, 5)"),
    FunctionKind("def inside_{n}(x):\n    return -{k} < x < {k}\n", "inside_{n}(1), inside_{n}({k})", "(True, False)"),
    FunctionKind("def record_{n}(log, x):\n    log.append(x + {k})\n", "logged(record_{n}, 4)", "[4 + {k}]"),
    FunctionKind(
        "def check_{n}(x):\n    if x > {k}:\n        raise ValueError(x)\n", "refused(check_{n}, {k} + 1)", "True"
    ),
    FunctionKind(
        "def steps_{n}(n):\n    for i in range(n):\n        yield i + {k}\n", "list(steps_{n}(2))", "[{k}, {k} + 1]"
    ),
    FunctionKind("async def fetch_{n}(x):\n    return x + {k}\n", "asyncio.run(fetch_{n}(1))", "1 + {k}"),
    FunctionKind(
        "def find_{n}(names):\n    return next((n for n in names if len(n) > 2), None)\n",
        "find_{n}(['a', 'arm']), find_{n}([])",
        "('arm', None)",
    ),
    FunctionKind(
        "@functools.lru_cache(maxsize=None)\ndef cached_{n}(x):\n    return x - {k}\n", "cached_{n}(9)", "9 - {k}"
    ),
    FunctionKind(
        "@contextlib.contextmanager\ndef held_{n}(log):\n    log.append({k})\n    yield len(log)\n",
        "entered(held_{n}, [])",
        "[{k}]",
    ),
    FunctionKind(
        "class Arm{n}:\n    def __init__(self):\n        self.x = 1\n        self.y = 2\n\n"
        "    def moved_{n}(self):\n        self.x += {k}\n        return self\n",
        "Arm{n}().moved_{n}().x",
        "1 + {k}",
    ),
    FunctionKind(
        "class Rig{n}:\n    x = {k}\n\n    @property\n    def reach_{n}(self):\n        return self.x * 2\n",
        "Rig{n}().reach_{n}",
        "2 * {k}",
    ),
    FunctionKind(
        "class Joint{n}:\n    @classmethod\n    def named_{n}(cls, name):\n        return cls.__name__ + name\n",
        "Joint{n}.named_{n}('a')",
        "'Joint{n}a'",
    ),
    FunctionKind(
        "def shifted_{n}(points):\n    return np.asarray(points) + {k}\n",
        "shifted_{n}([1.0, 2.0]).tolist()",
        "[1.0 + {k}, 2.0 + {k}]",
    ),
)
IMPORTS = "import asyncio\nimport contextlib\nimport functools\nimport numpy as np\n"
HELPERS = """

def logged(function, x):
    log = []
    function(log, x)
    return log


def refused(function, x):
    try:
        function(x)
    except ValueError:
        return True
    return False


def entered(manager, log):
    with manager(log):
        return log
"""


@dataclass(frozen=True)
class PlantedProject:
    """A project whose functions are tested, or only run, as it is known."""

    style: str
    command: str
    files: dict[str, str]
    planted: frozenset[str]
    tested: frozenset[str]


def projects(planted: int = PLANTED, tested: int = TESTED) -> list[PlantedProject]:
    """Generate the projects, one of each style of tests."""
    return [_project(style, number * (planted + tested), planted, tested) for number, style in enumerate(STYLES)]


def _project(style: str, begin: int, planted: int, tested: int) -> PlantedProject:
    numbers = range(begin, begin + planted + tested)
    kinds = [KINDS[(number * 5 + begin) % len(KINDS)].filled(number) for number in numbers]
    walked = [index % 3 == 0 and index < 3 * planted for index in range(len(kinds))]
    source = IMPORTS + "".join(f"\n\n{kind.source}" for kind in kinds)
    command, test, tool = STYLES[style]
    texts = [test(kind, only_run) for kind, only_run in zip(kinds, walked, strict=True)]
    if tool:
        source += HELPERS + "\n\nif __name__ == '__main__':\n    import sys\n    print(eval(sys.argv[1]))\n"
    head = "import asyncio\nimport subprocess\nimport sys\nimport unittest\nfrom robot.parts import *\n" + HELPERS
    if "pytest" in command:
        head = f"import pytest\n{head}"
    if style == "unittest":
        texts = ["\n\nclass PartsTest(unittest.TestCase):\n", *texts]
    return PlantedProject(
        style,
        command,
        {
            "robot/__init__.py": "",
            "robot/parts.py": source,
            "tests/__init__.py": "",
            "tests/test_parts.py": head + "".join(texts),
        },
        frozenset(kind.name for kind, only_run in zip(kinds, walked, strict=True) if only_run),
        frozenset(kind.name for kind, only_run in zip(kinds, walked, strict=True) if not only_run),
    )


def _function(kind: FunctionKind, only_run: bool) -> str:
    body = (
        f"    result = {kind.call}\n    assert result is not None\n"
        if only_run
        else f"    assert ({kind.call}) == {kind.expected}\n"
    )
    return f"\n\ndef test_{kind.name}():\n{body}"


def _method(kind: FunctionKind, only_run: bool) -> str:
    body = kind.call if only_run else f"self.assertEqual(({kind.call}), {kind.expected})"
    return f"    def test_{kind.name}(self):\n        {body}\n\n"


def _parameters(kind: FunctionKind, only_run: bool) -> str:
    judged = "eval(call)" if only_run else "assert eval(call) == expected"
    cases = f"[({kind.call!r}, {kind.expected}), ({kind.call!r}, {kind.expected})]"
    head = f'@pytest.mark.parametrize(("call", "expected"), {cases})'
    return f"\n\n{head}\ndef test_{kind.name}(call, expected):\n    {judged}\n"


def _fixture(kind: FunctionKind, only_run: bool) -> str:
    judged = "pass" if only_run else f"assert {kind.name}_value == {kind.expected}"
    return (
        f'\n\n@pytest.fixture(scope="module")\ndef {kind.name}_value():\n    return {kind.call}\n'
        f"\n\ndef test_first_{kind.name}({kind.name}_value):\n    pass\n"
        f"\n\ndef test_second_{kind.name}({kind.name}_value):\n    {judged}\n"
    )


def _program(kind: FunctionKind, only_run: bool) -> str:
    judged = "done.returncode == 0" if only_run else f"done.stdout.decode().strip() == str({kind.expected})"
    run = f'subprocess.run([sys.executable, "-m", "robot.parts", {kind.call!r}], stdout=subprocess.PIPE)'
    return f"\n\ndef test_{kind.name}():\n    done = {run}\n    assert {judged}\n"


STYLES = {
    "functions": ("pytest -q -p no:cacheprovider", _function, False),
    "unittest": ("python -m unittest tests.test_parts", _method, False),
    "parameters": ("pytest -q -p no:cacheprovider", _parameters, False),
    "fixtures": ("pytest -q -p no:cacheprovider", _fixture, False),
    "programs": ("pytest -q -p no:cacheprovider", _program, True),
}
"""Styles of tests: the command, how a function is tested or only run, whether as a program."""


def measure(quick: bool) -> Iterator[Row]:
    """Planted functions that are found, tested ones that are called pseudo-tested, and the time of a large project."""
    found = planted = called = tested = 0
    seconds = 0.0
    missed: list[str] = []
    for project in projects(*((4, 8) if quick else (PLANTED, TESTED))):
        with tempfile.TemporaryDirectory() as folder:
            commit(Path(folder), project.files)
            results, taken = judged(Path(folder), project.command, "--pseudo-tested", "all")
        names = names_of(results)
        found, planted = found + len(names & project.planted), planted + len(project.planted)
        called, tested = called + len(names & project.tested), tested + len(project.tested)
        missed += [f"{project.style}: {name}" for name in sorted((project.planted - names) | (project.tested & names))]
        seconds += taken
    note = f"of {planted} in five projects, {seconds:.0f} s{'; wrong: ' + ', '.join(missed) if missed else ''}"
    yield Row("pseudo_tested/planted found", 100 * found / planted, "%", Bar(low=95), note)
    yield Row("pseudo_tested/tested ones called so", 100 * called / tested, "%", Bar(high=1), f"of {tested}")
    yield _large()


def _large() -> Row:
    """Time of a change of ten functions in a project of 500 tests."""
    kinds = [KINDS[number % len(KINDS)].filled(number) for number in range(TESTS_OF_LARGE)]
    head = "import asyncio\nfrom robot.parts import *\n" + HELPERS
    files = {
        "robot/__init__.py": "",
        "robot/parts.py": IMPORTS + "".join(f"\n\n{kind.source}" for kind in kinds),
        "tests/__init__.py": "",
        "tests/test_parts.py": head + "".join(_function(kind, only_run=False) for kind in kinds),
    }
    changed = files["robot/parts.py"]
    for kind in kinds[:: TESTS_OF_LARGE // CHANGED_OF_LARGE]:
        changed = changed.replace(kind.source, kind.source.rstrip() + "  # changed\n")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        commit(Path(folder), files)
        commit(Path(folder), {"robot/parts.py": changed})
        command = "pytest -q -p no:cacheprovider"
        results, seconds = judged(Path(folder), command, "--max-pseudo-tested-change", "0", "--base", "HEAD~1")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    counts = f"{results['judged']} functions of {len(kinds)}, {TESTS_OF_LARGE} tests"
    note = f"{counts}, with their run and coverage; {busy:.1f} s of processors"
    return Row("pseudo_tested/change of ten", seconds, "s", Bar(high=60), note)


def names_of(results: dict[str, object]) -> set[str]:
    """Return the names of the pseudo-tested functions, without those of their classes."""
    functions = results["functions"]
    return {str(each["name"]).rpartition(".")[2] for each in functions} if isinstance(functions, list) else set()


def commit(root: Path, files: dict[str, str]) -> None:
    """Write files and commit them."""
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    identity = ["-c", "user.name=x", "-c", "user.email=x@example.org", "-c", "commit.gpgsign=false"]
    for step in (["init", "-q"], ["add", "-A"], ["commit", "-q", "-m", "x"]):
        subprocess.run(["git", *identity, *step], cwd=root, check=True, capture_output=True)


def judged(root: Path, run: str, *arguments: str) -> tuple[dict[str, object], float]:
    """Return the pseudo-tested functions of a project, and the seconds of the whole command."""
    with tempfile.TemporaryDirectory() as output:
        command: Sequence[str] = (
            *(sys.executable, "-m", "calibration", "coverage-upload", "--run", run, "--interpreter", sys.executable),
            *("--output", output, *arguments),
        )
        start = time.monotonic()
        done = subprocess.run(
            command, cwd=root, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False
        )
        seconds = time.monotonic() - start
        if done.returncode > 1:
            raise RuntimeError(done.stderr.strip()[-300:])
        results: dict[str, object] = json.loads(Path(output, "results.json").read_text())["pseudo_tested"]
        return results, seconds
