"""Pythons of a team: one with pytest and coverage.py, and one with nothing at all."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from calibration.addons.coverage.coverage_py import plain, team_settings
from calibration.addons.coverage.reading import Found, read_reports
from calibration.addons.coverage.sources import find_sources
from calibration.addons.coverage.tests import (
    Measurement,
    Tests,
    measured_environment,
    measurement,
    parse_command,
    run_tests,
)
from calibration.ci.git import Repository
from calibration.ci.workflow import Runner
from tests.addons.coverage.projects import TOKEN, robot

Run = Callable[..., tuple[Tests, Measurement, Found]]


@pytest.fixture(scope="session")
def bare_python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A Python without a single package."""
    folder = tmp_path_factory.mktemp("bare")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True, timeout=60)
    python = str(folder / "bin/python3")
    found = subprocess.run([python, "-c", "import coverage"], capture_output=True, check=False)
    assert b"ModuleNotFoundError" in found.stderr
    return python


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A project with a module and a test of it."""
    return robot(tmp_path / "a project")


@pytest.fixture
def run(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs a command in the project as the action does, and reads what was measured."""
    monkeypatch.setenv("CODACY_PROJECT_TOKEN", TOKEN)
    monkeypatch.delenv("COVERAGE_RCFILE", raising=False)
    monkeypatch.delenv("PYTHONPATH", raising=False)  # it may lead to our own tests, in the place of the project's

    def run_it(text: str, interpreter: str | None = None, seconds: float = 60) -> tuple[Tests, Measurement, Found]:
        folder = tmp_path / "measuring"
        for name in ("measuring", "reading"):
            (tmp_path / name).mkdir()
        settings = team_settings(root)
        sources = find_sources(Repository.around(root), root, (), None)
        command = parse_command(text, root, interpreter, plain(os.environ), tmp_path / "out/tests.xml")
        environment = measured_environment(os.environ, settings, sources.measured(), folder)
        runner = Runner.from_environment({})
        tests = run_tests(command, root, environment, seconds, runner, tmp_path / "out/tests.log", [TOKEN])
        measured = measurement(folder)
        return (
            tests,
            measured,
            read_reports(measured.files, sources, settings, tmp_path / "reading", measured.executable),
        )

    return run_it
