"""``static-analysis`` in a pull request: what the change brings in is red at its line, what the base has is not."""

import json
import subprocess

from .conftest import Repository, tool
from .steps import Step, outcome, workflow

KNOWN = "def known():\n    return missing_before\n"
PLANTED = "\n\ndef planted():\n    return missing_now\n"


def test_only_what_a_pull_request_brings_in_is_red(repository: Repository) -> None:
    step = Step("analysis", "static-analysis", {"tools": "ruff", "output": "the analysis"})
    steps = workflow([step])
    repository.write(steps, {"my package/naming.py": KNOWN})
    head = [tool("git"), "rev-parse", "HEAD"]
    base = subprocess.run(head, cwd=repository.folder, check=True, capture_output=True, text=True).stdout.strip()
    repository.write(steps, {"my package/naming.py": f"# a line more\n{KNOWN}{PLANTED}"})
    event = repository.cache / "event.json"
    event.parent.mkdir(parents=True, exist_ok=True)
    event.write_text(json.dumps({"pull_request": {"number": 1, "base": {"sha": base}, "head": {}}}))
    run = repository.act("pull_request", "--eventpath", str(event))
    came = outcome(run, step)
    assert came.code == 1, came.log
    assert (came.outputs["verdict"], came.outputs["new"], came.outputs["findings"]) == ("fail", "1", "2")
    [finding] = [each for each in came.annotations if "naming.py" in each]
    assert finding.startswith("::error file=my package/naming.py,line=7,title=ruff/F821::"), finding
    assert "missing_now" in finding
    assert came.outputs["sarif"] == "the analysis/findings.sarif"
