"""What a step is told about the machine that runs it."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self, TextIO


@dataclass(frozen=True)
class Runner:
    """The runner as one step sees it: where it runs, and where its output goes."""

    github: bool = False
    """Whether a GitHub runner (or act) reads the log, so that workflow commands mean something."""
    workspace: Path | None = None
    """The checkout; annotations name files relative to it."""
    output_file: Path | None = None
    """The file that takes the step's outputs; none when there is no runner."""
    summary_file: Path | None = None
    """The file that takes the step's Markdown summary; none when there is no runner."""
    debug: bool = False
    """Whether the user asked the runner for debug logging."""
    pull_request: bool = False
    """Whether it runs for a pull request, of which nothing is merged yet."""
    stdout: TextIO = field(default_factory=lambda: sys.stdout, repr=False, compare=False)
    """The log, and the workflow commands."""
    stderr: TextIO = field(default_factory=lambda: sys.stderr, repr=False, compare=False)
    """Errors, one line each."""

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """Read the runner's own variables; an empty variable counts as none."""

        def path(name: str) -> Path | None:
            return Path(environment[name]) if environment.get(name) else None

        return cls(
            github=environment.get("GITHUB_ACTIONS") == "true",
            workspace=path("GITHUB_WORKSPACE"),
            output_file=path("GITHUB_OUTPUT"),
            summary_file=path("GITHUB_STEP_SUMMARY"),
            debug=environment.get("RUNNER_DEBUG") == "1",
            pull_request=environment.get("GITHUB_EVENT_NAME", "").startswith("pull_request"),
        )

    def log(self, text: str = "") -> None:
        """Print a line to the log at once.

        Text that others wrote may hold workflow commands: print it inside
        :func:`calibration.workflow.stop_commands`.
        """
        print(text, file=self.stdout, flush=True)

    def relative(self, path: str | Path) -> str:
        """Name a file as an annotation must: relative to the workspace where it lies in it, with ``/``."""
        if self.workspace is not None:
            resolved = Path(os.path.realpath(path))
            workspace = Path(os.path.realpath(self.workspace))
            if resolved.is_relative_to(workspace):
                return resolved.relative_to(workspace).as_posix()
        return str(path)
