"""The reusable workflow, called by another repository."""

import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from tests.thorough import thorough

from .conftest import FORK, PROJECT, Repository, commit
from .pipeline import Caller

projects = pytest.importorskip("tests.addons.coverage.projects")
TOKEN, codacy = projects.TOKEN, projects.codacy

DATASETS = PROJECT / "datasets"
DATA = {f"data of robots/{name}": DATASETS / name for name in ("t2rgb", "riwbot")}
TWO_BY_TWO = """
noise: {translation: [0, 0.5], rotation: [0.3]}
systems:
  two-cameras: {dataset: data of robots/t2rgb, evaluate: "rgb-to-rgb:right_camera:left_camera", limits: {rms-px: 1}}
  arm: {dataset: data of robots/riwbot}
"""
EVERYTHING_FAILS = """
systems:
  beyond-limit: {dataset: data of robots/riwbot, limits: {rms-px: 0.001}}
  not-there: {dataset: nowhere}
  lost: {dataset: data of robots/riwbot}
  later: {dataset: "simulation:fresh"}
simulation:
  fresh: {system: small, motion: generate:4, limits: {translation-mm: 0.000001}}
"""
NOTHING_LEFT = ("not-there", "lost", "later")
COLLECTED = """
systems:
  fresh: {dataset: "simulation:fresh", evaluate: "rgb-to-rgb:right_camera:left_camera"}
simulation:
  fresh: {system: small, motion: generate:4, limits: {translation-mm: 5}}
"""


@pytest.fixture
def caller(repository: Repository, tmp_path: Path) -> Caller:
    return Caller(repository, tmp_path / "artifacts", {"python": sys.executable})


def test_a_matrix_of_jobs_ends_in_one_table(caller: Caller) -> None:
    caller.write({"minute-rate": "0.006", "noise-inside-cells": False}, {**DATA, "calibration.yml": TWO_BY_TWO})
    run = caller.run()
    assert run.code == 0, run.log
    assert run.annotations == []
    table = run.tables["Start"]
    assert [row[0] for row in table] == ["Start", "0 m, 0.3 rad", "0.5 m, 0.3 rad"]
    assert table[0][1:] == ["two-cameras", "arm"]
    assert all("px" in cell and "FAIL" not in cell for row in table[1:] for cell in row[1:])
    results = json.loads((caller.artifacts / "calibration" / "results.json").read_text())
    assert len(results["cells"]) == 4
    for cell in results["cells"]:  # a path begins with the slug of the job, whose artifact has the rest
        assert (caller.artifacts / f"calibration~{cell['table']}").is_file()
    cost = results["cost"]
    assert cost["complete"]
    assert [job["job"] for job in cost["jobs"]] == ["plan", *["calibrate"] * 4, "verdict"]
    minutes = sum(max(1, math.ceil(job["seconds"] / 60)) for job in cost["jobs"])
    assert f"| all |  | 6 | {sum(job['seconds'] for job in cost['jobs'])} | {minutes} | {cost['cost']} |" in run.log
    price = f"{minutes * 0.006:.3f}".rstrip("0")
    assert f"outputs: verdict=pass success-rate=1.0 billed-minutes={minutes} cost={price}" in run.printed


def test_everything_that_goes_wrong_is_red_and_says_why(caller: Caller, small: Path, tmp_path: Path) -> None:
    """A broken limit, a dataset that is not there, a lost result, a collection and its system, the tests, no baseline.

    All that in a pull request from a fork, which has no secrets; that a push is red too, other tests see.
    """
    fork = tmp_path / "event.json"
    fork.write_text(json.dumps(FORK))
    inputs = {"tests": "python3 -m unittest -q", "coverage-minimum": "90", "check-recording": "tonight.mcap"}
    robot = {"robot.py": "def still():\n    if False:\n        pass\n    return True\n", "test_robot.py": UNCOVERED}
    caller.write(inputs, {**DATA, **robot, "small": small, "calibration.yml": EVERYTHING_FAILS})
    run = caller.run("pull_request", "-e", str(fork), "--env", "LOSE=calibration~lost_0m_0rad")
    assert run.code == 1
    title = "::error title=Calibration::"
    *_, gathered = [n for n, line in enumerate(run.annotations) if line.startswith(title)]
    gathered -= 6  # the last job says all seven in one go
    said = [line.removeprefix(title) for line in run.annotations[gathered:]]
    uncovered = "lines that are run: found 0.0 % (0 of 3), expected at least 90 % (minimum)"
    assert said[0].replace("%25", "%") == f"unit-tests: {uncovered}"
    assert said[1].startswith("check: calibration-baseline.json: found no such file")
    limit = "RMS: found 0.0542 px, expected at most 0.001 px"
    assert said[2] == f"beyond-limit: {limit}"
    lost = [f"{name}: its job left no result: see the job's log" for name in NOTHING_LEFT]
    assert said[3:6] == lost
    far = r"translation error against the truth: found [0-9.e-]+ mm, expected at most 1e-06"
    assert re.match(f"collected fresh: {far}", said[6])
    assert len(said) == 7
    others = run.annotations[:gathered]  # each job itself says why
    assert sorted(line.partition("::")[2] for line in others) == [
        "error file=calibration.yml,line=3,title=Calibration::" + limit,
        "error title=Calibration::" + said[6],
        f"error title=Coverage of the tests::{uncovered.replace('%', '%25')}",
        "error::" + said[1].removeprefix("check: "),
        "error::nowhere: a dataset was expected, but it cannot be read: No such file or directory",
    ]
    robots, collected = run.tables["Robot"], run.tables["Collected"]
    assert [row[1] for row in robots[1:]] == ["FAIL"] * 4
    assert {"0.0542 px", "0.00227 mm, 0.00026 deg"} <= set(robots[1])
    assert collected[1][-1].endswith("FAIL")
    assert "Traceback" not in run.log
    assert "| calibrate | failure | 3 |" in run.log
    assert "::set-output:: verdict=fail\n" in run.log
    assert re.search(r"::set-output:: billed-minutes=[0-9]+\n", run.log)
    results = json.loads((caller.artifacts / "calibration" / "results.json").read_text())
    assert results["verdict"] == "fail"
    unknown = [job["name"] for job in results["cost"]["jobs"] if job["seconds"] is None]
    assert unknown == ["lost, 0 m, 0 rad"]  # what is lost costs too, nobody knows how much


def test_what_cannot_be_planned_is_red(caller: Caller) -> None:
    """Each mistake has its own message, which tests of plan-matrix hold; here what the jobs make of one."""
    hostile = "$(touch pwned)`touch pwned`\n::error::x"
    caller.write({"systems": hostile, "python": ""}, {"calibration.yml": TWO_BY_TWO})
    run = caller.run()
    assert run.code == 1
    [wrong, gathered] = run.annotations
    assert wrong.startswith("::error::systems: there is no '$(touch pwned)`touch")
    assert "Calibration::plan: systems: there is no '$(touch pwned)`touch" in gathered  # the error of the job itself
    assert re.search(r"/plan *\] exit status 2\n", run.log)
    assert "| all |  | 2 |" in run.log  # plan and verdict are billed
    assert run.installations == ["engine"]  # where no interpreter is named, once for both jobs
    assert "/calibrate" not in run.log  # no cell has begun
    assert not list(caller.repository.folder.parent.rglob("pwned*"))


UNUSED = "::warning::a token of Codacy is given, and the coverage goes nowhere: add coverage-service: codacy"


@pytest.mark.thorough
def test_names_are_no_code_and_a_token_that_nobody_uses_is_warned_of(caller: Caller) -> None:
    caller = replace(caller, secrets={"codacy-project-token": TOKEN})
    name = "ri$(touch pwned)`touch pwned`;touch pwned #'wbot"
    caller.write({"datasets": f"my data/{name}", "minute-rate": "0"}, {f"my data/{name}": DATASETS / "riwbot"})
    run = caller.run()
    assert run.code == 0, run.log
    assert {"0.0542 px", "0.00227 mm, 0.00026 deg"} <= set(run.tables["Robot"][1])
    assert {path.name for path in caller.artifacts.iterdir()} == {
        "calibration",
        "calibration~plan",
        "calibration~ri_touchpwned_touchpwned_touchpwned_wbot_0m_0rad",
    }
    assert not list(caller.repository.folder.parent.rglob("pwned"))
    assert UNUSED in run.log


@pytest.mark.thorough
def test_two_calls_keep_apart_what_their_jobs_leave(caller: Caller) -> None:
    """The name of one begins with that of the other, which gathers after it: a result that it lost is not replaced."""
    inputs = {"translation-noise": "0", "datasets": "data of robots/riwbot"}
    caller.write(inputs, {"data of robots/riwbot": DATASETS / "riwbot"})
    path = caller.repository.folder / ".github" / "workflows" / "push.yml"
    workflow = yaml.safe_load(path.read_text())
    first = workflow["jobs"]["robot"]
    workflow["jobs"]["arm"] = {**first, "with": {**first["with"], "artifact-name": "calibration-arm"}}
    first["needs"] = "arm"
    path.write_text(yaml.safe_dump(workflow, sort_keys=False))
    commit(caller.repository.folder)
    lost = "riwbot_0m_0rad"
    run = caller.run("push", "--env", f"LOSE=calibration~{lost}")
    assert run.code == 1, run.log
    verdicts = {
        name: json.loads((caller.artifacts / name / "results.json").read_text())["verdict"]
        for name in ("calibration", "calibration-arm")
    }
    assert verdicts == {"calibration": "fail", "calibration-arm": "pass"}
    assert (caller.artifacts / f"calibration-arm~{lost}").is_dir()


def test_a_pull_request_from_a_fork_by_commit_without_secrets(caller: Caller, small: Path, tmp_path: Path) -> None:
    """The cells wait for the dataset that is collected; no token is given, which is no reason for a warning."""
    caller = replace(caller, secrets={"codacy-project-token": TOKEN})  # which a fork does not get
    event = tmp_path / "event.json"
    event.write_text(json.dumps(FORK))
    reference = (
        "@"
        + subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=caller.repository.suite, check=True, capture_output=True, text=True
        ).stdout.strip()
    )
    inputs = {"translation-noise": "0, 0.1", "noise-inside-cells": True, "job-name-prefix": "robot: "}
    caller.write(inputs, {**DATA, "small": small, "calibration.yml": COLLECTED}, reference=reference)
    run = caller.run("pull_request", "-e", str(event), reference=reference)
    assert run.code == 0, run.log
    assert "robot: verdict" in run.log
    cells, collected = run.tables["Start"], run.tables["Collected"]
    assert [row[0] for row in cells] == ["Start", "0 m, 0 rad", "0.1 m, 0 rad"]
    assert collected[1][:2] == ["fresh", "4 of 4 poses"]
    assert run.annotations == []
    assert UNUSED not in run.log
    kept = {path.name for path in caller.artifacts.iterdir()}
    assert kept == {"calibration", "calibration~plan", "calibration~collected-data", "calibration~fresh"}
    assert not (caller.artifacts / "calibration~fresh" / "collected").exists()  # it is in the other artifact


@pytest.mark.thorough
def test_this_repositorys_own_pipeline_runs_what_is_checked_out(
    suite_with_robots: Path, cache: Path, tmp_path: Path
) -> None:
    """Under act it is not fetched: a pull request tests its own code."""
    folder = suite_with_robots
    module = folder / "calibration" / "commands" / "plan_matrix.py"
    module.write_text(f"{module.read_text()}\nprint('the code of this checkout')\n")
    workflow = yaml.safe_load((folder / ".github/workflows/push.yml").read_text())
    [called] = [job for job in workflow["jobs"].values() if "uses" in job]
    assert called["uses"] == "./.github/workflows/pipeline.yml"
    called["with"] = {"systems": "riwbot", "jobs": "calibrate", "python": sys.executable}
    (folder / ".github/workflows/push.yml").write_text(
        yaml.safe_dump({"on": "push", "permissions": {}, "jobs": {"robots": called}})
    )
    commit(folder)
    own = Caller(Repository(folder, folder, cache), tmp_path / "own-artifacts")
    run = own.run("push", "--job", "robots")
    assert run.code == 0, run.log
    assert "the code of this checkout" in run.printed
    table = run.tables["Start"]
    assert len(table) == 5 + 7  # all noises, and the seven methods to compare with


ROBOT = {"robot.py": "def still():\n    return True\n", "calibrated.txt": "yes\n"}
UNCOVERED = """
import unittest


class Robot(unittest.TestCase):
    def test_nothing(self):
        pass
"""
UNIT_TEST = """
import unittest

import robot


class Robot(unittest.TestCase):
    def test_still(self):
        with open("calibrated.txt") as file:
            self.assertEqual(file.read(), "set up\\n")
        self.assertIs(robot.still(), {})
"""


@pytest.mark.thorough
@pytest.mark.parametrize("good", [thorough(True), False])
def test_unit_tests_and_static_analysis_without_a_calibration(good: bool, caller: Caller, tmp_path: Path) -> None:
    """A job each; a fork has no token for the coverage, which is no reason to be red: nor is its upload, skipped."""
    event = tmp_path / "event.json"
    [shown] = re.findall(r'`(\{"pull_request": .*?\}\})`', (PROJECT / "docs/under-act.md").read_text(), re.DOTALL)
    event.write_text(shown)  # as docs/under-act.md has it
    inputs = {
        "tests": "python3 -m unittest -q",
        "tests-setup": 'echo "set up" >calibrated.txt',
        "coverage-service": "codacy",
        "coverage-source": "robot.py",
        "coverage-minimum": "50",
        "analyse": True,
        "analysis-max-total": "error=5" if good else "error=0",
    }
    files = {"naming.py": "import os\n\n\ndef f():\n    return missing\n"}
    caller.write(inputs, {**ROBOT, **files, "test_robot.py": UNIT_TEST.format(good)})
    run = caller.run("pull_request", "-e", str(event))
    assert run.code == (0 if good else 1), run.log
    for job in ("unit-tests", "static-analysis"):
        assert f"| {job} | {'success' if good else 'failure'} |" in run.log
    said = [line for line in run.annotations if "title=Calibration::" in line]
    assert len(said) == (0 if good else 2)
    if not good:
        assert "unit-tests: the tests failed: exit code 1" in said[0]
        assert "Calibration::static-analysis: " in said[1]
    assert list(caller.artifacts.glob("calibration~unit-tests/results.json"))
    assert list(caller.artifacts.glob("calibration~static-analysis/findings.sarif"))


@pytest.mark.thorough
def test_the_coverage_is_uploaded_by_a_job_in_which_no_test_runs(repository: Repository, tmp_path: Path) -> None:
    caller = Caller(repository, tmp_path / "artifacts", {"python": sys.executable}, {"codacy-project-token": TOKEN})
    inputs = {
        "tests": "python3 -m unittest -q",
        "tests-setup": 'echo "set up" >calibrated.txt',
        "coverage-service": "codacy",
    }
    with codacy() as server:
        caller.write(
            inputs, {**ROBOT, "test_robot.py": UNIT_TEST.format("'PROJECT_TOKEN' not in str(__import__('os').environ)")}
        )
        run = caller.run("push", "--env", f"CODACY_API_BASE_URL={server.url}")
        assert run.code == 0, run.log
        [asked] = server.asked
    assert asked.headers["project-token"] == TOKEN
    assert b'"robot.py"' in asked.body
    assert "| coverage | success |" in run.log
    assert TOKEN not in run.log
