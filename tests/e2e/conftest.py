"""A user's repository and real GitHub Actions, run on this machine by act, without a network between them.

act runs the jobs on the host (`-P ubuntu-latest=-self-hosted`), takes the suite from a local checkout in place of
GitHub, and answers `actions/checkout` with a copy of the user's repository.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path

import pytest

from calibration.__main__ import main

PROJECT = Path(__file__).resolve().parents[2]
TIMEOUT = 270
"""Seconds for one run of act, on a slow machine with much else to do."""
LARGE = shutil.ignore_patterns("__pycache__", "*.jpg", "*.png")
"""What is left out of copies: act copies a repository, and the suite for every step that uses an action, twice."""
BASH = """#!/bin/bash
/bin/bash "$@"
code=$?
((code == 0)) || sleep 0.2
exit "$code"
"""
"""act does not wait for the last output of a step that fails: bash, which ends a little after that output."""
FORK = {
    "pull_request": {
        "number": 7,
        "head": {"ref": "better", "sha": "0" * 40, "repo": {"fork": True, "full_name": "stranger/robot"}},
        "base": {"ref": "main", "repo": {"full_name": "me/robot"}},
    },
    "repository": {"full_name": "me/robot", "default_branch": "main"},
}
"""The event of a stranger's pull request."""


@dataclass(frozen=True)
class Run:
    """What act answered."""

    code: int
    log: str

    @property
    def annotations(self) -> list[str]:
        """The workflow commands that the runner obeyed as errors, from `::error` on.

        Act marks as unknown what has no title, and a second `::` in its text; GitHub knows it.
        """
        return re.findall(r"[❗❓] +(::error.*)", self.log)

    @property
    def installations(self) -> list[str]:
        """The names of the locks that were installed."""
        return re.findall(r"::group::Python environment: installing (\w+)", self.log)

    @property
    def tables(self) -> dict[str, list[list[str]]]:
        """Cells of the tables in the last summary of calibrations, row by row, by the header's first word."""
        summary = self.log[self.log.rindex("Summary - ## Calibration") :]
        text = re.findall(r"(?:^\|.*\n)+", summary, re.MULTILINE)
        tables = [[line.strip("| ").split(" | ") for line in table.splitlines()] for table in text]
        return {table[0][0]: [table[0], *table[2:]] for table in reversed(tables)}

    @property
    def outputs(self) -> set[str]:
        """The names of the outputs that were set, inside actions too."""
        return set(re.findall(r"::set-output:: ([\w-]+)=", self.log))

    @property
    def printed(self) -> list[str]:
        """The lines that steps printed."""
        return re.findall(r"^\[[^\]]*\] +\| (.*)$", self.log, re.MULTILINE)


@dataclass(frozen=True)
class Repository:
    """A git repository whose workflows act can run."""

    folder: Path
    suite: Path
    cache: Path

    def push(self, steps: str, files: Mapping[str, str | Path] | None = None, *arguments: str) -> Run:
        """Commit files and a workflow of one job with these steps, and run it."""
        self.write(steps, files or {})
        return self.act("push", *arguments)

    def write(self, steps: str, files: Mapping[str, str | Path]) -> None:
        """Commit files and a workflow of one job with these steps."""
        for name, content in files.items():
            target = self.folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, Path):
                shutil.copytree(content, target, ignore=LARGE)
            else:
                target.write_text(content)
        body = "".join(f"      {line}\n" for line in steps.strip("\n").splitlines())
        workflow = self.folder / ".github" / "workflows" / "push.yml"
        workflow.parent.mkdir(parents=True, exist_ok=True)
        workflow.write_text(
            "on: [push, pull_request]\n"
            "jobs:\n  robot:\n    runs-on: ubuntu-latest\n    steps:\n      - uses: actions/checkout@v7\n" + body
        )
        commit(self.folder)

    def pull_request_from_a_fork(self) -> Run:
        """Run what was written as GitHub does for a stranger's change: with an event that says so, and no secrets."""
        event = self.cache / "event.json"
        event.parent.mkdir(parents=True, exist_ok=True)
        event.write_text(json.dumps(FORK))
        return self.act("pull_request", "--eventpath", str(event))

    def act(self, *arguments: str) -> Run:
        """Run act here; whatever it has started ends with it."""
        command = [tool("act"), "-P", "ubuntu-latest=-self-hosted", *arguments]
        command += ["--local-repository", f"me/suite@v1={self.suite}"]
        with subprocess.Popen(
            command,
            cwd=self.folder,
            env=self._variables(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as process:
            try:
                log, _ = process.communicate(timeout=TIMEOUT)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGINT)  # which makes it remove its containers
                log, _ = process.communicate(timeout=60)
                pytest.fail(f"act was stopped after {TIMEOUT} s:\n{log}")
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
        return Run(process.returncode, log)

    def act_in(self, image: str, *arguments: str) -> Run:
        """Run a push with its job in a container of an image, beside this machine's engine; uv is brought along."""
        return self.act("push", *self.in_image("ubuntu-latest", image), *arguments)

    def in_image(self, label: str, image: str, *mounts: str) -> list[str]:
        """Return the arguments for jobs of a runner's label in containers of an image, with uv and its cache."""
        certificates = os.environ.get("SSL_CERT_FILE", "/etc/ssl/certs/ca-certificates.crt")
        shared = [f"{tool('uv')}:/usr/local/bin/uv:ro", f"{certificates}:{certificates}:ro", *mounts]
        environment = ["--env", f"SSL_CERT_FILE={certificates}"]
        if os.geteuid() == 0:  # the jobs are root, whose files have no place in the cache of another
            cache = self._variables()["UV_CACHE_DIR"]
            Path(cache).mkdir(parents=True, exist_ok=True)
            shared.append(f"{cache}:{cache}")
            environment += ["--env", f"UV_CACHE_DIR={cache}"]
        options = " ".join(f'-v "{mount}"' for mount in shared)
        return ["-P", f"{label}={image}", "--pull=false", "--container-options", options, *environment]

    def _variables(self) -> dict[str, str]:
        """Return this process's environment without what only tests set; act's own files go to a folder of ours."""
        mine = re.compile("GITHUB_|RUNNER_|INPUT_|COVERAGE_|PYTEST_|PYTHON|VIRTUAL_ENV|CALIBRATION_")
        variables = {name: value for name, value in os.environ.items() if not mine.match(name)}
        cache = Path(variables.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        variables.setdefault("UV_CACHE_DIR", str(cache / "uv"))
        variables.setdefault("PIP_CACHE_DIR", str(cache / "pip"))
        # uv, and nothing else of the development environment: pip, the other way, takes several times as long.
        programs = self.cache / "bin"
        programs.mkdir(parents=True, exist_ok=True)
        if not (programs / "uv").exists():
            (programs / "uv").symlink_to(tool("uv"))
            (programs / "bash").write_text(BASH)
            (programs / "bash").chmod(0o755)
        variables["PATH"] = f"{programs}{os.pathsep}{variables['PATH']}"
        return variables | {"XDG_CACHE_HOME": str(self.cache), "XDG_CONFIG_HOME": str(self.cache)}


def calibration(folder: Path, *arguments: str, codes: tuple[int, ...] = (0,)) -> None:
    """Run a command as a developer does on a laptop, in a folder; one of these exit codes is expected."""
    with chdir(folder), pytest.MonkeyPatch.context() as patch:
        for name in [name for name in os.environ if name.startswith("GITHUB_")]:
            patch.delenv(name)
        assert main(arguments) in codes


def tool(name: str) -> str:
    """Return the path of a program of the development environment; skip without it."""
    found = shutil.which(name, path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if found is None:
        pytest.skip(f"needs {name}")
    return found


def git(folder: Path, *arguments: str) -> None:
    identity = ["-c", "user.name=test", "-c", "user.email=test@example.org", "-c", "commit.gpgsign=false"]
    subprocess.run([tool("git"), *identity, *arguments], cwd=folder, check=True, capture_output=True, timeout=60)


def commit(folder: Path) -> None:
    if not (folder / ".git").exists():
        git(folder, "init", "--initial-branch=main")
        git(folder, "remote", "add", "origin", f"https://github.com/me/{folder.name.replace(' ', '-')}.git")
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--allow-empty", "--message=push")


@pytest.fixture(scope="session")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a checkout of this repository as it is now, tagged v1, without what no action reads."""
    return checkout(tmp_path_factory.mktemp("github") / "suite", (".github", "actions", "calibration", "requirements"))


@pytest.fixture
def suite_with_robots(tmp_path: Path) -> Path:
    """Return the same with the systems that ship, and the calibration.yml that names them."""
    folder = checkout(tmp_path / "suite", (".github", "actions", "calibration", "datasets", "requirements"))
    shutil.copy(PROJECT / "calibration.yml", folder)
    commit(folder)
    return folder


def checkout(folder: Path, names: Sequence[str]) -> Path:
    """Make a repository with folders of this one."""
    for name in names:
        shutil.copytree(PROJECT / name, folder / name, ignore=LARGE)
    shutil.copy(PROJECT / "action.yml", folder)
    commit(folder)
    git(folder, "tag", "v1")
    git(folder, "gc", "--quiet")  # one file in the place of several hundred to copy
    return folder


@pytest.fixture
def cache(tmp_path: Path) -> Iterator[Path]:
    """Return a folder for act's files; removed at once, because the environments in it are large."""
    folder = tmp_path / "cache"
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def repository(suite: Path, cache: Path, tmp_path: Path) -> Repository:
    """Return a user's repository, with nothing in it yet."""
    folder = tmp_path / "my robot"
    folder.mkdir()
    return Repository(folder, suite, cache)
