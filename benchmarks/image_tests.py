"""Tests in the image: the workspaces of examples/ in a real engine, green, and with a planted failure of each kind."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.rows import Bar, Row
from calibration.addons.image_tests.results import TestsOfEntry
from calibration.addons.image_tests.settings import ImageTests
from calibration.addons.image_tests.test_image import run_image_tests
from calibration.base.records import read
from calibration.ci.execution.backends import ExecutionTarget
from calibration.ci.image.building import build_image
from calibration.ci.image.specification import read_image_specification
from calibration.ci.workflow import Runner

PROJECT = Path(__file__).resolve().parents[1]
UNDERLAY: dict[str, Any] = {"workspace": "/underlay"}
PLANTED: dict[str, tuple[dict[str, Any], str]] = {
    "catkin, gtest fails": ({"environment": {"FAILS": 1}}, "Boards.OneForTwoCameras failed"),
    "colcon, gtest and pytest fail": ({**UNDERLAY, "environment": {"FAILS": 1}}, "test_half_the_way failed"),
    "colcon, gtest crashes": ({**UNDERLAY, "environment": {"CRASHES": 1}}, "SEGFAULT"),
    "colcon, pytest hangs": ({**UNDERLAY, "environment": {"HANGS": 1}, "timeout": "30s"}, "longer than its 30 s"),
    "colcon, no package": ({**UNDERLAY, "arguments": ["--packages-select", "none"]}, "no test ran"),
}
"""Settings of tests that must be red, and a part of one of their reasons."""
FLAKY_RUNS = 20


def measure(quick: bool) -> Iterator[Row]:
    """Yield the number of green and red entries that are judged as they should be."""
    with TemporaryDirectory() as folder:
        specification = read_image_specification(PROJECT / "examples" / "workspaces" / "calibration.yml")
        image = build_image(specification, Runner()).reference
        output = Path(folder)
        green = [_tested(image, output / name, entry) for name, entry in (("catkin", {}), ("colcon", UNDERLAY))]
        yield Row("image_tests/workspaces are green", sum(not each.reasons for each in green), "of 2", Bar(low=2))
        red = [
            any(reason in line for line in _tested(image, output / "red" / str(number), entry).reasons)
            for number, (entry, reason) in enumerate(PLANTED.values())
        ]
        yield Row("image_tests/planted failures are red", sum(red), f"of {len(red)}", Bar(low=len(red)))
        if not quick:
            planner = {"workspace": "/underlay/src/colcon/route_planner", "tool": "pytest", "environment": {"RARE": 1}}
            flaky = _tested(image, output / "flaky", {**planner, "repeat": FLAKY_RUNS}).failures
            yield Row(f"image_tests/flaky after {FLAKY_RUNS} runs", len(flaky), "of 1", Bar(low=1))


def _tested(image: str, output: Path, entry: dict[str, Any]) -> TestsOfEntry:
    tests = read(ImageTests, {"image": image, **entry}, "tests", name="tests")
    _, found = run_image_tests([tests], output, PROJECT, ExecutionTarget(), Runner())
    return found.tests[0]
