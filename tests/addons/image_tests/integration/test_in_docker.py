"""Tests in real containers: of a command without a test tool, and of the workspaces in examples/."""

import json
import subprocess
from pathlib import Path

import pytest

from calibration.addons.image_tests.running import run_image_tests
from calibration.addons.image_tests.settings import ImageTests
from calibration.base.errors import ExitCode
from calibration.base.records import read
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.report import Report
from calibration.ci.workflow import Runner
from calibration.commands.run import command as run_command
from tests.conftest import PROJECT

PROGRAM = """
import os, sys, time
open(sys.argv[1] + "/a.xml", "w").write('<testsuite><testcase name="one"/></testsuite>')
print("about to", sys.argv[2], flush=True)
if sys.argv[2] == "crash": os.kill(os.getpid(), 11)
if sys.argv[2] == "hang": time.sleep(600)
if sys.argv[2] == "reach": __import__("socket").create_connection(("192.0.2.1", 80), 5)
"""


def tested(image: str, output: Path, how: str) -> Report:
    entry = {"image": image, "command": ["python3", "-c", PROGRAM, "{output}", how], "timeout": "5s"}
    tests = read(ImageTests, entry, "tests.a", name="a")
    found, _ = run_image_tests([tests], output, PROJECT, ExecutionTarget(), Runner())
    return found


@pytest.mark.parametrize(
    ("how", "reason"), [("crash", "SIGSEGV"), ("hang", "longer than its 5 s"), ("reach", "Network is unreachable")]
)
def test_tests_that_crash_hang_or_need_the_network_are_red(
    python_image: str, tmp_path: Path, how: str, reason: str
) -> None:
    found = tested(python_image, tmp_path, how)
    assert found.exit_code == ExitCode.FAIL
    [line] = found.reasons
    assert reason in line
    assert f"about to {how}" in found.log()


def test_a_command_that_passes_is_green_and_leaves_its_report(python_image: str, tmp_path: Path) -> None:
    found = tested(python_image, tmp_path, "pass")
    assert (found.exit_code, found.outputs["passed"]) == (ExitCode.PASS, 1)
    assert (tmp_path / "a" / "artifacts" / "a.xml").exists()


def test_the_workspaces_of_the_example_are_built_and_tested(base_image: str, tmp_path: Path) -> None:
    """Green, then with a planted failure of each kind: places are those in the checkout."""
    config = PROJECT / "examples" / "workspaces" / "calibration.yml"
    options = ["--config", str(config), "--output", str(tmp_path), "--only", "test"]
    assert run_command.main(options, standalone_mode=False) == ExitCode.PASS
    document = json.loads((tmp_path / "tests" / "results.json").read_text())
    catkin, colcon = document["tests"]
    assert [run["passed"] for run in catkin["runs"]] == [2]
    assert [run["passed"] for run in colcon["runs"]] == [7]
    assert [Path(path).name for path in colcon["coverage"]] == ["gcov.json"]
    image = colcon["image"]

    arguments = ["--image", image, "--workspace", "/underlay", "--output", str(tmp_path / "red")]
    red = read(ImageTests, {"image": image, "workspace": "/underlay", "environment": {"FAILS": 1}}, "t", name="t")
    found, results = run_image_tests([red], Path(arguments[-1]), PROJECT, ExecutionTarget(), Runner())
    assert found.exit_code == ExitCode.FAIL
    places = {failure.name: (failure.file, failure.line) for failure in results.tests[0].failures}
    assert places["Odometry.BackwardsIsNegative"] == (
        "examples/workspaces/colcon/wheel_odometry/test/test_odometry.cpp",
        12,
    )
    assert places["route_planner.test.test_between.test_half_the_way"] == (
        "examples/workspaces/colcon/route_planner/test/test_between.py",
        9,
    )
    subprocess.run(["docker", "image", "rm", "--force", image], check=True, capture_output=True)
