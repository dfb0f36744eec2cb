"""The reusable workflow as another repository calls it, under act; artifacts go by stand-ins, the suite by git."""

import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from .conftest import PROJECT, Repository, Run, commit, tool

OUTPUTS = ("verdict", "success-rate", "billed-minutes", "cost")
"""Of the workflow; a job of the caller prints them."""
STAND_INS = Path(__file__).with_name("stand_ins")
WORKFLOW = PROJECT / ".github" / "workflows" / "pipeline.yml"
PINS = sorted(
    set(re.findall(r"uses: (actions/(?:cache|attest|(?:up|down)load-artifact)@[0-9a-f]{40})", WORKFLOW.read_text()))
)


@dataclass(frozen=True)
class Caller:
    """A user's repository that calls the workflow."""

    repository: Repository
    artifacts: Path
    """What the jobs uploaded, a folder each."""
    inputs: Mapping[str, object] = field(default_factory=dict)
    secrets: Mapping[str, str] = field(default_factory=dict)
    """What the workflow's secrets are in the caller's repository; a fork has none."""

    def write(self, inputs: Mapping[str, object], files: Mapping[str, str | Path], *, reference: str = "@v1") -> None:
        """Write the files and a workflow that calls pipeline.yml of the suite at a reference, and commit."""
        folder = self.repository.folder
        for name, content in files.items():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, Path):
                shutil.copytree(content, target, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.jpg", "*.png"))
            else:
                target.write_text(content)
        workflow = {
            "on": ["push", "pull_request"],
            "jobs": {
                "robot": {
                    "permissions": {"contents": "read"},
                    "uses": f"me/suite/.github/workflows/pipeline.yml{reference}",
                    "with": {**self.inputs, **inputs},
                    "secrets": {
                        name: f"${{{{ secrets.{name.upper().replace('-', '_')} }}}}"
                        for name in ("codacy-project-token", "registry-password", "signing-key")
                    },
                },
                "after": {
                    "needs": "robot",
                    "if": "always()",
                    "runs-on": "ubuntu-latest",
                    "steps": [
                        {
                            "run": 'echo "outputs: $OUTPUTS"',
                            "env": {
                                "OUTPUTS": " ".join(f"{name}=${{{{ needs.robot.outputs.{name} }}}}" for name in OUTPUTS)
                            },
                        }
                    ],
                },
            },
        }
        path = folder / ".github" / "workflows" / "push.yml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump(workflow, sort_keys=False))
        commit(folder)

    def run(self, *arguments: str, reference: str = "@v1") -> Run:
        """Run the workflow for an event, a push unless told."""
        shutil.rmtree(self.artifacts, ignore_errors=True)
        self.artifacts.mkdir()
        options = [f"--local-repository={pin}={STAND_INS / pin[8:].partition('@')[0]}" for pin in PINS]
        options += [f"--local-repository=me/suite{reference}={self.repository.suite}"]
        for name, value in self.secrets.items() if "pull_request" not in arguments else ():
            options += ["--secret", f"{name.upper().replace('-', '_')}={value}"]
        options += ["--env", f"ARTIFACTS={self.artifacts}", "--env", f"GIT_CONFIG_GLOBAL={self._git_configuration()}"]
        return self.repository.act(*(arguments or ("push",)), *options)

    def _git_configuration(self) -> Path:
        """Git's settings that turn GitHub's address of the suite into its folder here."""
        path = self.artifacts.with_name("gitconfig")
        settings = (f"url.{self.repository.suite}.insteadOf", "https://github.com/me/suite"), ("safe.directory", "*")
        for setting in settings:  # the first is what docs/under-act.md tells
            subprocess.run([tool("git"), "config", "--file", path, *setting], check=True)
        return path
