"""Environment that the runner provides to a step."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self, TextIO


@dataclass(frozen=True)
class Runner:
    """Runner of a step: its environment variables, and its output streams."""

    github: bool = False
    """Whether a GitHub runner (or act) reads the log, so that workflow commands have an effect."""
    workspace: Path | None = None
    """The checkout; annotations name files relative to it."""
    output_file: Path | None = None
    """File for the step's outputs; None without a runner."""
    summary_file: Path | None = None
    """File for the step's Markdown summary; None without a runner."""
    debug: bool = False
    """Whether debug logging is enabled on the runner."""
    pull_request: bool = False
    """Whether the run is for an unmerged pull request."""
    stdout: TextIO = field(default_factory=lambda: sys.stdout, repr=False, compare=False)
    """Stream of the log and the workflow commands."""
    stderr: TextIO = field(default_factory=lambda: sys.stderr, repr=False, compare=False)
    """Stream of errors, one line each."""

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """Read the runner's environment variables; an empty variable counts as unset."""

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
        """Print a line to the log immediately.

        Untrusted text may contain workflow commands: print it inside
        :func:`calibration.ci.workflow.stop_commands`.
        """
        print(text, file=self.stdout, flush=True)

    def relative(self, path: str | Path) -> str:
        """Return the path of a file for an annotation: relative to the workspace if it is inside, with ``/``."""
        if self.workspace is not None:
            resolved = Path(os.path.realpath(path))
            workspace = Path(os.path.realpath(self.workspace))
            if resolved.is_relative_to(workspace):
                return resolved.relative_to(workspace).as_posix()
        return str(path)
