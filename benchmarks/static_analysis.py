"""Static analysis of 100 000 lines, of a change of ten files, and of code that is only moved or reformatted."""

import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT

PYTHON_FILES, CPP_FILES = 800, 100
FUNCTIONS = 16
"""Per Python file, of six lines each; C++ files have twice as many."""
REFACTORINGS = 200


def measure(quick: bool) -> Iterator[Row]:
    """Times of a large repository, and new findings in refactored ones."""
    with tempfile.TemporaryDirectory() as folder:
        yield from _large(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        yield _refactored(Path(folder), 10 if quick else REFACTORINGS)


def _large(root: Path) -> Iterator[Row]:
    files = {f"python/module_{n}.py": _python(n) for n in range(PYTHON_FILES)}
    files |= {f"cpp/part_{n}.cpp": _cpp(n) for n in range(CPP_FILES)}
    _commit(root, files)
    lines = sum(text.count("\n") for text in files.values())
    seconds, results = _analysed(root)
    count = len(results["unchanged"])
    yield Row(
        "static_analysis/whole", seconds, "s", Bar(high=60), f"{lines} lines in {len(files)} files, {count} findings"
    )
    changed = {name: f"{files[name]}\n\ndef more(text):\n    return eval(text)\n" for name in list(files)[:10]}
    _commit(root, changed)
    seconds, results = _analysed(root, "--base", "HEAD~1")
    note = f"a change of {len(changed)} of them, {len(results['new'])} new findings"
    yield Row("static_analysis/change", seconds, "s", Bar(high=10), note)


def _refactored(root: Path, count: int) -> Row:
    """New findings of changes that move, reformat or rename files, each from the state before it."""
    draw = random.Random(1)
    files = {f"module_{n}.py": _python(n) for n in range(6)}
    _commit(root, files)
    new = known = 0
    for _ in range(count):
        files = draw.choice((_moved, _reformatted, _renamed, _with_lines))(files, draw)
        for path in root.glob("*.py"):
            path.unlink()
        _commit(root, files)
        _, results = _analysed(root, "--tools", "ruff", "--base", "HEAD~1")
        new, known = new + len(results["new"]), known + len(results["unchanged"])
    note = f"{count} refactorings, {known} findings that are not new"
    return Row("static_analysis/new in refactorings", float(new), "findings", Bar(high=0), note)


def _moved(files: dict[str, str], draw: random.Random) -> dict[str, str]:
    """Move the last function of a file to the end of another."""
    source, target = draw.sample(sorted(files), 2)
    head, mark, last = files[source].rpartition("\n\n\ndef ")
    return {
        **files,
        source: f"{head}\n" if mark else files[source],
        target: f"{files[target]}\n\ndef {last}" if mark else files[target],
    }


def _reformatted(files: dict[str, str], draw: random.Random) -> dict[str, str]:
    """Format a file for another length of line."""
    name = draw.choice(sorted(files))
    command = [
        sys.executable,
        "-m",
        "ruff",
        "format",
        "--isolated",
        "--line-length",
        str(draw.choice((40, 60, 120))),
        "-",
    ]
    done = subprocess.run(command, input=files[name], capture_output=True, text=True, check=True)
    return {**files, name: done.stdout}


def _renamed(files: dict[str, str], draw: random.Random) -> dict[str, str]:
    name = draw.choice(sorted(files))
    return {each if each != name else f"renamed_{draw.randrange(10**6)}.py": text for each, text in files.items()}


def _with_lines(files: dict[str, str], draw: random.Random) -> dict[str, str]:
    """Put a comment at the top of a file."""
    name = draw.choice(sorted(files))
    return {**files, name: f"# {draw.random()}\n{files[name]}"}


def _python(seed: int) -> str:
    draw = random.Random(seed)
    functions = []
    for n in range(FUNCTIONS):
        a, b = draw.randrange(100), draw.randrange(2, 9)
        flaw = draw.choice(
            ("", "", "", "    unused = values\n", f"    print(eval('{a}'))\n", f"    print(missing_{a})\n")
        )
        functions.append(
            f"def function_{seed}_{n}(values, factor={b}):\n    total = {a}\n    for value in values:\n"
            f"        total += value * factor\n{flaw}    return total\n"
        )
    return '"""Generated."""\n\n\n' + "\n\n".join(functions)


def _cpp(seed: int) -> str:
    draw = random.Random(seed)
    functions = [
        f"int function_{seed}_{n}(const std::vector<int> & values)\n{{\n  int total = {draw.randrange(100)};\n"
        f"  for (int value : values) {{\n    total += value * {draw.randrange(2, 9)};\n  }}\n  return total;\n}}\n"
        for n in range(2 * FUNCTIONS)
    ]
    return "#include <vector>\n\n" + "\n".join(functions)


def _commit(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    identity = ["-c", "user.name=x", "-c", "user.email=x@example.org", "-c", "commit.gpgsign=false"]
    steps = [["add", "-A"], ["commit", "-q", "--allow-empty", "-m", "x"]]
    for step in steps if (root / ".git").exists() else [["init", "-q"], *steps]:
        subprocess.run(["git", *identity, *step], cwd=root, check=True, capture_output=True)


def _analysed(root: Path, *arguments: str) -> tuple[float, dict[str, list[object]]]:
    """Return the seconds of the command, and its results."""
    with tempfile.TemporaryDirectory() as output:
        command = [sys.executable, "-m", "calibration", "static-analysis", "--output", output, *arguments]
        start = time.monotonic()
        done = subprocess.run(
            command, cwd=root, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True
        )
        seconds = time.monotonic() - start
        if done.returncode > 1:
            raise RuntimeError(done.stderr.strip()[-300:])
        return seconds, json.loads(Path(output, "results.json").read_text())
