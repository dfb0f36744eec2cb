"""The workflow's step that fetches the suite, as GitHub runs it, from a repository on this machine."""

import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from .conftest import commit, git
from .pipeline import WORKFLOW

STEP: dict[str, Any] = next(
    step
    for step in yaml.safe_load(WORKFLOW.read_text())["jobs"]["plan"]["steps"]
    if step.get("name") == "Fetch Calibration CI"
)
PLANTED = "ghs_planted"
CALL = "jobs:\n  robot:\n    uses: {}/.github/workflows/pipeline.yml{}\n"


class Machine:
    """A runner's workspace and temporary folder, and a suite of two commits on what stands for GitHub."""

    def __init__(self, folder: Path) -> None:
        self.suite = folder / "github" / "suite"
        self.workspace = folder / "my robot"
        self.temporary = folder / "temp"
        for path in (self.suite / "actions", self.suite / "datasets", self.workspace, self.temporary):
            path.mkdir(parents=True)
        (self.suite / "datasets" / "large").write_text("-")
        (self.suite / "actions" / "code").write_text("first")
        commit(self.suite)
        self.first = subprocess.check_output(["git", "rev-parse", "HEAD"], cwd=self.suite, text=True).strip()
        (self.suite / "actions" / "code").write_text("second")
        commit(self.suite)
        git(self.suite, "tag", "v1")
        git(self.suite, "config", "uploadpack.allowAnySHA1InWant", "true")
        self.configuration = folder / "gitconfig"
        self.configuration.write_text(f'[url "file://{self.suite}"]\n\tinsteadOf = https://github.com/me/suite\n')

    def call(self, text: str, name: str = "push.yml") -> None:
        path = self.workspace / ".github" / "workflows" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def fetch(
        self, repository: str = "", commit: str = "", suite: str = "", token: str = "", *, act: bool = False
    ) -> tuple[int, str]:
        """Run the step and return its exit code and log."""
        variables = {
            "PATH": os.environ["PATH"],
            "HOME": str(self.temporary),
            "RUNNER_TEMP": str(self.temporary),
            "GITHUB_WORKSPACE": str(self.workspace),
            "GITHUB_SERVER_URL": "https://github.com",
            "GIT_CONFIG_GLOBAL": str(self.configuration),
            "GIT_ALLOW_PROTOCOL": "file",  # nothing leaves this machine
        }
        script = STEP["run"].replace("for pause in 2 5 0", "for pause in 0 0 0")
        done = subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", script],
            cwd=self.workspace,
            env=variables
            | {"REPOSITORY": repository, "COMMIT": commit, "SUITE": suite, "TOKEN": token}
            | ({"ACT": "true"} if act else {}),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=60,
            check=False,
        )
        return done.returncode, done.stdout

    @property
    def code(self) -> str:
        return (self.temporary / "calibration-ci-suite" / "actions" / "code").read_text()


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_github_tells_the_commit_and_that_one_is_fetched(machine: Machine) -> None:
    """Not the tag that has moved on, and not what the workspace says: a fork may have written that."""
    machine.call(CALL.format("evil/suite", "@v1"))
    code, log = machine.fetch("me/suite", machine.first, suite="evil/suite@v1", token=PLANTED)
    assert code == 0, log
    assert machine.code == "first"
    assert not (machine.temporary / "calibration-ci-suite" / "datasets").exists()
    assert PLANTED not in log
    kept = (machine.temporary / "calibration-ci-suite" / ".git" / "config").read_text()
    assert "AUTHORIZATION" not in kept.upper()
    assert list(machine.workspace.iterdir()) == [machine.workspace / ".github"]  # it stays the user's


def test_a_second_time_on_the_same_machine(machine: Machine) -> None:
    assert machine.fetch("me/suite", machine.first)[0] == 0
    assert machine.fetch("me/suite", "v1")[0] == 0
    assert machine.code == "second"


@pytest.mark.parametrize("line", [CALL, CALL.replace("uses: {}", "uses: '{}").replace("{}\n", "{}' # main\n")])
def test_under_act_which_does_not_tell_the_callers_own_line_does(line: str, machine: Machine) -> None:
    machine.call(line.format("me/suite", "@v1"))
    machine.call(line.format("me/suite", "@v1"), "nightly.yml")
    code, log = machine.fetch(act=True)
    assert code == 0, log
    assert machine.code == "second"


def test_a_runner_that_does_not_tell_the_commit_is_refused(machine: Machine) -> None:
    """The caller's line may name a tag that has moved, and in a fork another repository."""
    machine.call(CALL.format("me/suite", "@v1"))
    code, log = machine.fetch()
    assert code == 2
    assert "2.334.0" in log
    assert not (machine.temporary / "calibration-ci-suite").exists()


def test_the_input_comes_before_the_callers_line(machine: Machine) -> None:
    machine.call(CALL.format("evil/suite", "@v1"))
    assert machine.fetch(suite=f"me/suite@{machine.first}")[0] == 0
    assert machine.code == "first"


def test_this_repositorys_own_pipeline_is_not_fetched(machine: Machine) -> None:
    machine.call(CALL.format(".", ""))
    (machine.workspace / "actions").mkdir()
    (machine.workspace / "actions" / "code").write_text("mine")
    assert machine.fetch(act=True)[0] == 0
    assert machine.code == "mine"


@pytest.mark.parametrize(
    "suite",
    [
        "me/suite",
        "suite@v1",
        "me/suite@",
        "me/suite@-x",
        "me/suite@v1 --upload-pack=x",
        "a/b/c@v1",
        "$(touch pwned)/x@v1",
    ],
)
def test_what_is_no_reference_is_refused(suite: str, machine: Machine) -> None:
    code, log = machine.fetch(suite=suite)
    assert code == 2
    [line] = log.splitlines()
    assert line.startswith("::error::this runner does not tell where the workflow comes from: add to its inputs suite:")
    assert not list(machine.workspace.rglob("pwned"))


@pytest.mark.parametrize("lines", [[], [CALL.format("me/suite", "@v1"), CALL.format("me/suite", "@v2")]])
def test_a_caller_that_does_not_say_or_says_two_things_is_asked(lines: list[str], machine: Machine) -> None:
    for i, line in enumerate(lines):
        machine.call(line, f"{i}.yml")
    code, log = machine.fetch(act=True)
    assert code == 2
    assert "add to its inputs suite: OWNER/REPOSITORY@REF" in log


def test_a_reference_that_cannot_be_fetched_is_said(machine: Machine) -> None:
    code, log = machine.fetch("me/suite", "v9")
    assert code == 3
    last = log.splitlines()[-1]
    assert last.startswith("::error::Calibration CI could not be fetched from https://github.com: me/suite@v9: ")
    assert "secret suite-token" in last
