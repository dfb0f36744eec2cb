"""The suite on a machine that has none of the tools that tests use: no engine, no browser, no registry, no git."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
SHARE = "test_hostile_repositories or test_interruption or test_build_and_registry or test_labels"


@pytest.mark.thorough
def test_what_needs_a_missing_tool_is_skipped_and_named(tmp_path: Path) -> None:
    """All tests are collected, and a share of them is run."""
    (tmp_path / "python").symlink_to(sys.executable)
    bare = {"PATH": str(tmp_path), "HOME": str(tmp_path), "DOCKER_HOST": "unix:///nowhere/docker.sock"}
    options = ("-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--hypothesis-profile", "few", "-k", SHARE)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "tests"],
        cwd=PROJECT,
        env=bare | {"TMPDIR": os.environ.get("TMPDIR", "/tmp")},  # noqa: S108
        capture_output=True,
        text=True,
        check=False,
    )
    said = done.stdout
    assert done.returncode == 0, said[-3000:]
    tools = set(re.findall(r"^\d+ skipped: needs (.+)$", "\n".join(said.splitlines()[-10:]), re.MULTILINE))
    assert {"Docker Engine (apt-get install docker.io, and start dockerd)", "git (apt-get install git)"} <= tools
