"""The comment of the root action and of the action `comment`, under act, with a stand-in of GitHub's API."""

import json
import re
import sys
from pathlib import Path

from tests.ci.github.stand_in import TOKEN, github

from .conftest import FORK, PROJECT, Repository
from .steps import Step, outcome, outcomes, workflow

REPORT = "https://robot.example/report"
PIPELINE = {"systems": {"robot": {"dataset": "my robot"}}, "noise": {"translation": [0]}}


def test_steps_of_a_job_keep_one_comment_and_the_verdict_is_the_calibrations(
    repository: Repository, tmp_path: Path
) -> None:
    with github() as api:
        more = {"python": sys.executable, "token": TOKEN}
        root = {"config": "pipeline.yml", "comment": "keep", "output": "found", **more}
        own = {"results": "found", "api-url": api.url, **more}
        steps = [
            Step("root", "", root, {"HTTPS_PROXY": "http://127.0.0.1:9"}),  # act lets no step say where the API is
            Step("first", "comment", own),
            Step("again", "comment", own),
            Step("other", "comment", {**own, "name": "other", "report-url": REPORT}),
            Step("refused", "comment", {**own, "token": "none"}),
        ]
        api.repository = "me/my-robot"
        files = {"pipeline.yml": json.dumps(PIPELINE), "my robot": PROJECT / "datasets" / "t2rgb"}
        repository.write(workflow(steps), files)
        event = json.loads(json.dumps(FORK))
        event["pull_request"]["head"]["repo"] = {"full_name": "me/robot"}
        (tmp_path / "event.json").write_text(json.dumps(event))
        run = repository.act("pull_request", "-e", str(tmp_path / "event.json"))
        assert run.code == 0, run.log
        assert outcomes(run) == {step.id: "success" for step in steps[:-1]} | {"refused": "failure"}
        [unreachable] = outcome(run, steps[0]).annotations
        assert "api.github.com: no answer" in unreachable
        [refused] = outcome(run, steps[-1]).annotations
        assert "the token is wrong or has expired" in refused
        assert "pull request 7: comment created" in run.log
        assert "pull request 7: comment updated" in run.log
        first, other = api.bodies()
        assert "✅ Calibration: pass" in first
        assert re.search(r"\| pass \|.* px \|", first)
        assert "✅ Calibration (other): pass" in other
        assert f"[report]({REPORT})" in other
