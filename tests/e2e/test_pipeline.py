"""The reusable workflow, called by another repository."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from .conftest import PROJECT, Repository, commit
from .pipeline import Caller

DATASETS = PROJECT / "datasets"
DATA = {f"data of robots/{name}": DATASETS / name for name in ("t2rgb", "riwbot")}
TWO_BY_TWO = """
noise: {translation: [0, 0.5], rotation: [0.3]}
systems:
  two-cameras: {dataset: data of robots/t2rgb, evaluate: "rgb-to-rgb:right_camera:left_camera", limits: {rms-px: 1}}
  arm: {dataset: data of robots/riwbot}
"""
THREE_WAYS_TO_FAIL = """
systems:
  beyond-limit: {dataset: data of robots/riwbot, limits: {rms-px: 0.001}}
  not-there: {dataset: nowhere}
  lost: {dataset: data of robots/riwbot}
"""
COLLECTED = """
systems:
  fresh: {dataset: "simulation:fresh", evaluate: "rgb-to-rgb:right_camera:left_camera"}
simulation:
  fresh: {system: data of robots/t2rgb, motion: generate:4, limits: {translation-mm: 5}}
"""
FORK = {
    "pull_request": {
        "number": 7,
        "head": {"ref": "better", "sha": "0" * 40, "repo": {"fork": True, "full_name": "stranger/robot"}},
        "base": {"ref": "main", "repo": {"full_name": "me/robot"}},
    },
    "repository": {"full_name": "me/robot", "default_branch": "main"},
}


@pytest.fixture
def caller(repository: Repository, tmp_path: Path) -> Caller:
    return Caller(repository, tmp_path / "artifacts", {"python": sys.executable})


def test_a_matrix_of_jobs_ends_in_one_table(caller: Caller) -> None:
    caller.write({}, {**DATA, "calibration.yml": TWO_BY_TWO})
    run = caller.run()
    assert run.code == 0, run.log
    assert run.annotations == []
    assert "outputs: pass 1.0" in run.printed
    [table] = run.tables
    assert [row[0] for row in table] == ["Start", "0 m, 0.3 rad", "0.5 m, 0.3 rad"]
    assert table[0][1:] == ["two-cameras", "arm"]
    assert all("px" in cell and "FAIL" not in cell for row in table[1:] for cell in row[1:])
    results = json.loads((caller.artifacts / "calibration" / "results.json").read_text())
    assert len(results["cells"]) == 4
    for cell in results["cells"]:  # the paths are those in the folder that all artifacts make together
        assert list(caller.artifacts.glob(f"*/{cell['table']}")), cell["table"]


def test_everything_that_goes_wrong_in_a_cell_is_red(caller: Caller) -> None:
    caller.write({}, {**DATA, "calibration.yml": THREE_WAYS_TO_FAIL})
    run = caller.run("push", "--env", "LOSE=calibration-lost_0m_0rad")
    assert run.code == 1
    said = [line for line in run.annotations if "title=gather-results" in line]
    assert len(said) == 3
    assert "beyond-limit" in said[0]
    assert "RMS: found 0.0542 px, at most 0.001 px was expected" in said[0]
    assert "not-there, 0 m, 0 rad, seed 1: its job left no result" in said[1]
    assert "lost, 0 m, 0 rad, seed 1: its job left no result" in said[2]
    assert any("nowhere" in line for line in run.annotations)  # the job itself says why
    [table] = run.tables
    assert table[1][1:] == ["0.0542 px, 0.00227 mm, 0.00026 deg, FAIL", "FAIL", "FAIL"]
    assert "Traceback" not in run.log


def test_a_plan_that_fails_is_red(caller: Caller) -> None:
    caller.write({"python": ""}, {"calibration.yml": TWO_BY_TWO.replace("dataset", "datset", 1)})
    run = caller.run()
    assert run.code == 1
    [wrong, gathered] = run.annotations
    assert "unknown key 'datset': did you mean 'dataset'?" in wrong
    assert "the job plan failed" in gathered
    assert run.installations == ["calibrate", "calibrate"]  # where no interpreter is named
    assert "calibrate (" not in run.log  # no cell has begun


def test_a_pull_request_from_a_fork_by_commit_without_secrets(caller: Caller, tmp_path: Path) -> None:
    """The cells wait for the dataset that is collected; the tests run without a token for their coverage."""
    event = tmp_path / "event.json"
    event.write_text(json.dumps(FORK))
    reference = (
        "@"
        + subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=caller.repository.suite, check=True, capture_output=True, text=True
        ).stdout.strip()
    )
    inputs = {"translation-noise": "0, 0.1", "noise-inside-cells": True, "job-name-prefix": "robot: "}
    caller.write(inputs, {**DATA, "calibration.yml": COLLECTED}, reference=reference)
    run = caller.run("pull_request", "-e", str(event), reference=reference)
    assert run.code == 0, run.log
    assert "robot: calibrate (fresh)" in run.log
    cells, collected = run.tables
    assert [row[0] for row in cells] == ["Start", "0 m, 0 rad", "0.1 m, 0 rad"]
    assert collected[1][:2] == ["fresh", "4 of 4 poses"]
    assert run.annotations == []
    kept = {path.name for path in caller.artifacts.iterdir()}
    assert kept == {"calibration", "calibration-collected-data", "calibration-fresh"}
    assert not list((caller.artifacts / "calibration-fresh").glob("*/collected"))  # it is in the other artifact


def test_this_repositorys_own_pipeline_runs_what_is_checked_out(caller: Caller, tmp_path: Path) -> None:
    """Under act it is not fetched: a pull request tests its own code."""
    folder = tmp_path / "own"
    shutil.copytree(caller.repository.suite, folder)
    module = folder / "calibration" / "commands" / "plan_matrix.py"
    module.write_text(f"{module.read_text()}\nprint('the code of this checkout')\n")
    workflow = yaml.safe_load((folder / ".github/workflows/push.yml").read_text())
    [called] = [job for job in workflow["jobs"].values() if "uses" in job]
    assert called["uses"] == "./.github/workflows/pipeline.yml"
    called["with"] |= {"systems": "riwbot", "jobs": "calibrate", "python": sys.executable}
    (folder / ".github/workflows/push.yml").write_text(
        yaml.safe_dump({"on": "push", "permissions": {}, "jobs": {"robots": called}})
    )
    commit(folder)
    own = Caller(Repository(folder, folder, caller.repository.cache), tmp_path / "own-artifacts")
    run = own.run("push", "--job", "robots")
    assert run.code == 0, run.log
    assert "the code of this checkout" in run.printed
    [table] = run.tables
    assert len(table) == 5 + 2  # all noises, and the two methods to compare with


ROBOT = {"robot.py": "def still():\n    return True\n", "calibrated.txt": "yes\n"}
UNIT_TEST = """
import unittest

import robot


class Robot(unittest.TestCase):
    def test_still(self):
        with open("calibrated.txt") as file:
            self.assertEqual(file.read(), "set up\\n")
        self.assertIs(robot.still(), {})
"""


@pytest.mark.skipif(
    not (PROJECT / "actions" / "coverage-upload" / "action.yml").exists(), reason="needs the action coverage-upload"
)
@pytest.mark.parametrize("still", [True, False])
def test_unit_tests_alone(still: bool, caller: Caller, tmp_path: Path) -> None:
    """Their own job; a fork has no token for the coverage, which is no reason to be red."""
    event = tmp_path / "event.json"
    event.write_text(json.dumps(FORK))
    inputs = {
        "tests": "python3 -m unittest -q",
        "tests-setup": 'echo "set up" >calibrated.txt',
        "coverage-service": "codacy",
        "coverage-minimum": "50",
    }
    caller.write(inputs, {**ROBOT, "test_robot.py": UNIT_TEST.format(still)})
    run = caller.run("pull_request", "-e", str(event))
    assert run.code == (0 if still else 1), run.log
    assert any(f"unit-tests {'success' if still else 'failure'}" in line for line in run.printed)
    assert any("the job unit-tests failed" in line for line in run.annotations) is not still
    assert list(caller.artifacts.glob("calibration-unit-tests/unit-tests/results.json"))
