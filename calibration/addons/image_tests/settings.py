"""An entry of the section ``tests`` of calibration.yml: which tests run in the image, and how they are judged."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from calibration.base.records import ByName, Misfit, at_least, between, field, length, matching, record
from calibration.base.verdict import MAX_REPETITIONS
from calibration.ci.execution.job import NETWORK_HELP, OUTPUT, Artifact, Container, Job, Mount, Network, fill
from calibration.ci.execution.ros import ROS_HELP, Ros, with_ros

TestTool = Literal["auto", "colcon", "catkin", "catkin_make", "ctest", "pytest"]
SCRIPT_FILE = Path(__file__).with_name("run_tests.sh")
SCRIPT_PATH = "/calibration/run_tests.sh"
REPORTS_FOLDER, COVERAGE_FOLDER = "reports", "coverage"
"""Folders in the container's output, in which the script leaves what the tests wrote."""
CONTAINER_OF_TESTS = "tests"
MAX_RETRIES = 10
Pattern = Annotated[str, length(1)]


@record
class ImageTests:
    """Tests in a container of the image: those that a tool finds in a workspace, or a command of your own.

    In the command, {output} is a folder whose files are kept.
    """

    name: str = ""
    tool: TestTool = field(
        "Test tool of the workspace: colcon, catkin (catkin tools), catkin_make, ctest or pytest; auto finds it.",
        default="auto",
    )
    workspace: Annotated[str, matching("/.*", "an absolute path")] | None = field(
        "Folder of the workspace in the image (that of image.workspace, else the image's working directory).",
        default=None,
    )
    arguments: tuple[str, ...] = field("More arguments for the tool: [--packages-select, my_robot].", default=())
    reports: tuple[Pattern, ...] = field(
        "Files in the container with the results of your command, JUnit or CTest XML: /ws/build/**/*.xml ({output}/*).",
        default=(),
    )
    coverage: Literal["none", "python", "gcov"] = field(
        "Coverage that the tool leaves for coverage-upload: python (coverage.py in the image) or gcov (built with "
        "--coverage).",
        default="none",
    )
    coverage_files: tuple[Pattern, ...] = field(
        "Files in the container with the coverage that your command leaves: LCOV, Cobertura or JSON of gcov.",
        default=(),
    )
    allow_no_tests: bool = field("Whether it may be that no test runs.", default=False)
    repeat: Annotated[int, between(1, MAX_REPETITIONS)] = field(
        "Number of runs of these tests, side by side; tests that do not always pass are flaky.", default=1
    )
    retries: Annotated[int, between(0, MAX_RETRIES)] = field(
        "How often a run that fails is repeated; a test that passes then is flaky.", default=0
    )
    max_flake_rate: Annotated[float, between(0, 1)] | None = field(
        "Largest share of the runs in which a flaky test may fail (with repeat: none; with retries: any).",
        default=None,
    )
    parallel: Annotated[int, at_least(1)] | None = field(
        "Number of runs side by side (one for each core).", default=None
    )
    ros: Ros = field(ROS_HELP, default="none")
    network: Network = field(NETWORK_HELP, default="internal")
    container: Container = field(flat=True, default_factory=Container)

    def __post_init__(self) -> None:
        """Refuse keys of the presets beside a command, and those of a command beside a preset."""
        of_tool = {"arguments": self.arguments, "coverage": self.coverage != "none", "tool": self.tool != "auto"}
        of_command = {"reports": self.reports, "coverage-files": self.coverage_files}
        if self.container.command and (used := [key for key, value in of_tool.items() if value]):
            raise Misfit(f"{used[0]} is for a tool, and command is given: remove one of them")
        if not self.container.command and (used := [key for key, value in of_command.items() if value]):
            raise Misfit(f"{used[0]} is for a command of your own: the tool's own files are found")

    def with_defaults(self, image: str, workspace: str | None) -> "ImageTests":
        """Return the tests with this image and workspace, unless they name their own."""
        container = replace(self.container, image=self.container.image or image)
        return replace(self, container=container, workspace=self.workspace or workspace)

    def job(self, name: str) -> Job:
        """Return the job of one run.

        Raises:
            InputError: the command has an unknown placeholder, or a network that ROS cannot use.
        """
        where = f"tests.{self.name}"
        own, kept = self.container, Artifact(f"{OUTPUT}/*", required=False)
        if own.command:
            values = {"output": OUTPUT}
            command = fill(own.command, values, f"{where}.command")
            paths = fill((*self.reports, *self.coverage_files), values, f"{where}.reports")
            artifacts, mounts = tuple(Artifact(path, required=False) for path in paths) or (kept,), own.mounts
        else:
            workspace = self.workspace or "."
            command = ("bash", SCRIPT_PATH, self.tool, workspace, OUTPUT, self.coverage, *self.arguments)
            artifacts, mounts = (kept,), (*own.mounts, Mount(SCRIPT_FILE, SCRIPT_PATH))
        container = replace(
            own,
            name=CONTAINER_OF_TESTS,
            command=command,
            mounts=mounts,
            artifacts=tuple(dict.fromkeys((*own.artifacts, *artifacts))),
        )
        seconds = own.limits.seconds
        job = Job(name, (container,), self.network)
        return with_ros(job if seconds is None else replace(job, seconds=None), self.ros)


TESTS_BY_NAME = Annotated[
    tuple[ImageTests, ...],
    ByName(matching("[A-Za-z0-9][A-Za-z0-9_.-]{0,62}", "letters, digits and _ . -, at most 63 of them")),
]
"""The section ``tests``."""
