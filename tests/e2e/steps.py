"""Many steps in one run of act: each uses an action of the suite, and what came of each is read from the log."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from .conftest import Run


@dataclass(frozen=True)
class Step:
    """A step that uses an action; the job goes on whatever comes of it."""

    id: str
    action: str
    """``introspect-csv``; empty for the root action."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    variables: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        """The step as YAML, of which JSON is a part."""
        path = f"me/suite/actions/{self.action}@v1" if self.action else "me/suite@v1"
        given = {"name": f"step {self.id}", "id": self.id, "uses": path, "continue-on-error": True}
        return f"- {json.dumps(given | {'with': self.inputs, 'env': self.variables})}\n"


@dataclass(frozen=True)
class Outcome:
    """What came of a step."""

    log: str

    @property
    def code(self) -> int:
        """The exit code."""
        [failed] = set(re.findall(r"(?:exit status |exitcode ')(\d+)", self.log)) or {
            "0"
        }  # on the machine, in an image
        return int(failed)

    @property
    def annotations(self) -> list[str]:
        """What it said as errors."""
        return Run(self.code, self.log).annotations

    @property
    def outputs(self) -> dict[str, str]:
        """Its outputs."""
        return dict(re.findall(r"::set-output:: ([\w-]+)=(.*)", self.log))


def outcome(run: Run, step: Step) -> Outcome:
    """What came of a step in a run."""
    found = re.search(rf"Run Main step {step.id}\n(.*?)(?:Success|Failure) - Main step {step.id} ", run.log, re.DOTALL)
    assert found, f"{step.id} has not run:\n{run.log}"
    return Outcome(found[1])


def workflow(steps: Sequence[Step], last: str = "") -> str:
    """The steps, and one that runs some lines of bash and says which steps have succeeded."""
    outcomes = " ".join(f"{step.id}=${{{{ steps.{step.id}.outcome }}}}" for step in steps)
    script = {"shell": "bash", "env": {"OUTCOMES": outcomes}, "run": f'echo "outcomes: $OUTCOMES"\n{last}'}
    return "".join(map(str, steps)) + f"- {json.dumps(script)}\n"


def outcomes(run: Run) -> dict[str, str]:
    """What the runner itself says of every step: success or failure."""
    [line] = [line for line in run.printed if line.startswith("outcomes: ")]
    return dict(pair.split("=") for pair in line.removeprefix("outcomes: ").split())
