"""What every workflow and every action of the project keeps to."""

import re
import subprocess
from pathlib import Path

import pytest

from calibration.commands.init import DEFAULT_SUITE
from tests.repositories import needs_git

from .yaml_lines import ACTIONS, PROJECT, WORKFLOWS, entries

FILES = [*WORKFLOWS, *ACTIONS]


@pytest.fixture(params=FILES, ids=lambda path: str(path.relative_to(PROJECT)))
def file(request: pytest.FixtureRequest) -> Path:
    return Path(request.param)


def test_all_are_looked_at() -> None:
    assert {path.name for path in WORKFLOWS} >= {"pipeline.yml", "push.yml", "checks.yml", "release.yml"}
    assert len(ACTIONS) >= 8


def test_all_say_the_same_owner() -> None:
    """Of this repository on GitHub: `make owner` replaces it."""
    needs_git()
    places = ("--", ".github", "actions", "calibration", "docs", "examples", "README.md", "mkdocs.yml")
    ours = r"((?<=github\.com/)|(?<![\w./-]))[\w-]+/calibration-ci(?![\w-])|(?<=^\* @).*"  # not in a registry
    command = ["git", "grep", "-hoIP", ours, *places]
    said = set(subprocess.check_output(command, cwd=PROJECT, text=True).split())
    repository = DEFAULT_SUITE.partition("@")[0]
    assert said == {repository, repository.partition("/")[0]}


def test_no_script_holds_a_template_expression(file: Path) -> None:
    """What GitHub pastes into a script is code there; by variables it stays text."""
    runs = list(entries(file, "run"))
    assert runs or file.name == "push.yml"
    for line, text in runs:
        assert "${{" not in text, f"{file}:{line}"


def test_foreign_actions_are_pinned_by_hash_and_say_their_version(file: Path) -> None:
    lines = file.read_text().splitlines()
    for line, used in entries(file, "uses"):
        if not used.startswith("./"):
            assert re.fullmatch(r"[\w.-]+/[\w./-]+@[0-9a-f]{40}", used), f"{file}:{line}"
            assert re.search(r" # v\d+\.\d+\.\d+$", lines[line - 1]), f"{file}:{line}"


def test_every_python_is_isolated(file: Path) -> None:
    """A yaml.py in the user's workspace, or a PYTHONPATH, is no part of ours."""
    for line, text in entries(file, "run"):
        for call in re.findall(r"(?<![\w./-])python[\d.]*\b(?!-)(.*)", text):
            assert call.startswith(" -I "), f"{file}:{line}: python{call}"


def test_the_way_into_every_action_is_isolated() -> None:
    script = (PROJECT / "actions" / "bootstrap.sh").read_text()
    assert re.findall(r'"\$python" (\S+)', script) == ["-I", "-I"]


def test_every_script_says_its_shell_where_others_run_it(file: Path) -> None:
    """A composite action must, and the reusable workflow may meet a container, where the default is sh."""
    if file in ACTIONS or file.name == "pipeline.yml":
        shells = [text for _, text in entries(file, "shell")]
        assert shells == ["bash"] * len(list(entries(file, "run")))
