"""Shellcheck over every shell file of the project, and over the shell in workflows and actions."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from .yaml_lines import ACTIONS, PROJECT, WORKFLOWS, entries

_BESIDE_PYTHON = Path(sys.executable).with_name("shellcheck")
SHELLCHECK = _BESIDE_PYTHON if _BESIDE_PYTHON.exists() else Path("shellcheck")  # of apt, on arm64


def findings() -> Iterator[str]:
    """What is wrong in the whole project, a line each: file:line: what."""
    for path in shell_files():
        yield from check(path.read_text(), path)
    for path in [*WORKFLOWS, *ACTIONS]:
        for line, text in entries(path, "run"):
            # Without a first line that names a shell, what GitHub takes.
            yield from check(text, path, line, ("--shell", "bash"))


def shell_files() -> list[Path]:
    """Every file in git that is shell by its name or its first line."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=PROJECT,
        check=True,
        capture_output=True,
        text=True,
    )
    return [path for name in listed.stdout.split("\0") if name and is_shell(path := PROJECT / name)]


def is_shell(path: Path) -> bool:
    """Whether a file is a shell's."""
    if not path.is_file():
        return False
    if path.suffix in (".sh", ".bash"):
        return True
    with path.open("rb") as file:
        first = file.readline(100)
    return bool(re.match(rb"#!.*\b(ba|da)?sh\b", first))


def check(text: str, path: Path, line: int = 1, arguments: tuple[str, ...] = ()) -> Iterator[str]:
    """What shellcheck says of a text that begins on a line of a file."""
    done = subprocess.run(
        [str(SHELLCHECK), "--format", "json1", *arguments, "-"], input=text, capture_output=True, text=True
    )
    if done.returncode not in (0, 1):
        raise RuntimeError(f"shellcheck: {done.stderr.strip()}")
    for found in json.loads(done.stdout)["comments"]:
        at = line + found["line"] - 1
        yield f"{path.relative_to(PROJECT)}:{at}: SC{found['code']} {found['level']}: {found['message']}"


if __name__ == "__main__":
    found = list(findings())
    print(*found, sep="\n", end="\n" if found else "")
    sys.exit(bool(found))
