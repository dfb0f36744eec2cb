"""Tests in real containers, of a command without a test tool; `benchmarks/image_tests.py` runs those of examples/."""

import re
from pathlib import Path

import pytest

from calibration.addons.image_tests.settings import ImageTests
from calibration.addons.image_tests.test_image import run_image_tests
from calibration.base import ExitCode
from calibration.base.records import read
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.report import Report
from calibration.ci.workflow import Runner
from tests.conftest import PROJECT

PROGRAM = """
import os, sys, time
open(sys.argv[1] + "/a.xml", "w").write('<testsuite><testcase name="one"/></testsuite>')
print("about to", sys.argv[2], flush=True)
if sys.argv[2] == "crash": os.kill(os.getpid(), 11)
if sys.argv[2] == "hang": time.sleep(600)
if sys.argv[2] == "reach": __import__("socket").create_connection(("192.0.2.1", 80), 1)
"""


def run_of(image: str, output: Path, how: str) -> Report:
    entry = {"image": image, "command": ["python3", "-c", PROGRAM, "{output}", how], "timeout": "5s"}
    tests = read(ImageTests, entry, "tests.a", name="a")
    found, _ = run_image_tests([tests], output, PROJECT, ExecutionTarget(), Runner())
    return found


@pytest.mark.parametrize(
    ("how", "reason"), [("crash", "SIGSEGV"), ("hang", "longer than its 5 s"), ("reach", "timed out|unreachable")]
)
def test_tests_that_crash_hang_or_need_the_network_are_red(
    python_image: str, tmp_path: Path, how: str, reason: str
) -> None:
    found = run_of(python_image, tmp_path, how)
    assert found.exit_code == ExitCode.FAIL
    [line] = found.reasons
    assert re.search(reason, line)
    assert f"about to {how}" in found.log()


def test_a_command_that_passes_is_green_and_leaves_its_report(python_image: str, tmp_path: Path) -> None:
    found = run_of(python_image, tmp_path, "pass")
    assert (found.exit_code, found.outputs["passed"]) == (ExitCode.PASS, 1)
    assert (tmp_path / "a" / "artifacts" / "a.xml").exists()
