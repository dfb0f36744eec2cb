"""The commit that a report names."""

import json
import re
from pathlib import Path

from calibration.pipeline.baselines import commit_of_run
from tests.repositories import git


def test_the_checkout_s_commit_or_the_branch_s_of_a_pull_request(tmp_path: Path) -> None:
    assert commit_of_run(tmp_path, {}) is None
    git(tmp_path, "init", "--quiet")
    assert commit_of_run(tmp_path, {}) is None  # none yet
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "file").touch()
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "-m", "tab\tand more")
    found = commit_of_run(tmp_path / "robot", {})
    assert found is not None
    assert found.hash == git(tmp_path, "rev-parse", "HEAD").strip()
    assert re.fullmatch(r"[0-9a-f]{7} of \d{4}-\d\d-\d\d", str(found))
    head = "0123456789" * 4
    event = tmp_path / "event.json"
    event.write_text(json.dumps({"pull_request": {"head": {"sha": head}}}))
    merge = commit_of_run(tmp_path, {"GITHUB_ACTIONS": "true", "GITHUB_EVENT_PATH": str(event)})
    assert merge is not None
    assert (merge.hash, merge.date) == (head, found.date)
    event.write_text("no JSON")
    assert commit_of_run(tmp_path, {"GITHUB_ACTIONS": "true", "GITHUB_EVENT_PATH": str(event)}) is None
