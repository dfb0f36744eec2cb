"""The script that runs in containers, run here on small workspaces with tools of ours on the PATH."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from calibration.addons.image_tests.settings import SCRIPT_FILE

JUNIT = "<testsuite><testcase name='a'/></testsuite>"
TOOL_OF_MARK = {
    ".catkin_tools/": "catkin",
    "devel/setup.bash": "catkin_make",
    ".catkin_workspace": "catkin_make",
    "install/setup.bash": "colcon",
    "build/CTestTestfile.cmake": "ctest",
    "test/": "python3",
}


def tool(folder: Path, name: str, body: str) -> None:
    path = folder / "bin" / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"#!/bin/bash\n{body}\n")
    path.chmod(0o755)


def run(folder: Path, *arguments: str, coverage: str = "none") -> tuple[int, str, list[str]]:
    """Return the exit code, the output, and the files that are left."""
    output = folder / "output"
    command = ["bash", str(SCRIPT_FILE), arguments[0], str(folder / "ws"), str(output), coverage, *arguments[1:]]
    path = f"{folder / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(command, env={"PATH": path}, capture_output=True, text=True, timeout=60)
    return (
        done.returncode,
        done.stdout + done.stderr,
        sorted(str(path.relative_to(output)) for path in output.rglob("*") if path.is_file()),
    )


@pytest.mark.parametrize(("mark", "name"), TOOL_OF_MARK.items())
def test_the_tool_is_found_by_the_workspace(tmp_path: Path, mark: str, name: str) -> None:
    place = tmp_path / "ws" / mark
    (place if mark.endswith("/") else place.parent).mkdir(parents=True)
    if not mark.endswith("/"):
        place.write_text("")
    for each in ("catkin", "catkin_make", "colcon", "ctest", "python3"):
        tool(tmp_path, each, f'echo "{each} $*"')
    code, text, _ = run(tmp_path, "auto", "-x")
    assert code == 0
    assert any(line.startswith(f"{name} ") and line.endswith(" -x") for line in text.splitlines())


def test_only_reports_of_this_run_are_collected(tmp_path: Path) -> None:
    build = tmp_path / "ws" / "build"
    build.mkdir(parents=True)
    (build / "old.xml").write_text(JUNIT)
    os.utime(build / "old.xml", (time.time() - 100,) * 2)
    tool(
        tmp_path,
        "colcon",
        f'echo "{JUNIT}" >build/new.xml; >build/empty.xml; echo "<package/>" >build/other.xml; exit 3',
    )
    code, _, files = run(tmp_path, "colcon")
    assert (code, files) == (3, ["reports/build/empty.xml", "reports/build/new.xml"])


def test_at_a_time_limit_what_is_there_is_left(tmp_path: Path) -> None:
    (tmp_path / "ws").mkdir()
    tool(tmp_path, "catkin_make", f'echo "{JUNIT}" >a.xml; touch started; exec sleep 60')
    command = ["bash", str(SCRIPT_FILE), "catkin_make", str(tmp_path / "ws"), str(tmp_path / "output"), "none"]
    process = subprocess.Popen(command, env={"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"})
    deadline = time.monotonic() + 30
    while not (tmp_path / "ws" / "started").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    process.terminate()
    assert process.wait(30) == 143
    assert (tmp_path / "output" / "reports" / "a.xml").exists()


def test_pytest_is_measured_and_leaves_its_report(tmp_path: Path) -> None:
    (tmp_path / "ws" / "tests").mkdir(parents=True)
    (tmp_path / "ws" / "tests" / "test_a.py").write_text("def test_a():\n    assert True\n")
    code, text, files = run(tmp_path, "auto", "-q", coverage="python")
    assert (code, files) == (0, ["coverage/python.info", "reports/pytest.xml"]), text


@pytest.mark.parametrize("name", ["nothing", "ctest"])
def test_a_workspace_without_tests_says_so(tmp_path: Path, name: str) -> None:
    (tmp_path / "ws").mkdir()
    code, text, _ = run(tmp_path, "auto" if name == "nothing" else name)
    assert code == 2
    assert str(tmp_path / "ws") in text


def test_a_missing_workspace_is_named(tmp_path: Path) -> None:
    code, text, _ = run(tmp_path, "auto")
    assert code == 2
    assert str(tmp_path / "ws") in text
