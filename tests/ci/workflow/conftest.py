"""A runner that writes into files and streams of the test."""

import io
from pathlib import Path

import pytest

from calibration.ci.github.service import GITHUB
from calibration.ci.workflow import Runner


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    folder = tmp_path / "work space"
    folder.mkdir()
    return folder


@pytest.fixture
def github(tmp_path: Path, workspace: Path) -> Runner:
    """Return a step's runner as GitHub makes it."""
    return Runner(
        GITHUB,
        workspace=workspace,
        output_file=tmp_path / "output",
        summary_file=tmp_path / "summary",
        stdout=io.StringIO(),
        stderr=io.StringIO(),
    )


@pytest.fixture
def laptop() -> Runner:
    return Runner(stdout=io.StringIO(), stderr=io.StringIO())


def printed(runner: Runner) -> str:
    """Return what went to stdout."""
    assert isinstance(runner.stdout, io.StringIO)
    return runner.stdout.getvalue()


def complained(runner: Runner) -> str:
    """Return what went to stderr."""
    assert isinstance(runner.stderr, io.StringIO)
    return runner.stderr.getvalue()
