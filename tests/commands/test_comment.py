"""``comment``: the right pull request for each event; forks, pushes and local runs without a comment."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from calibration.__main__ import main, run_action
from calibration.ci.report.report import BRIEF_FILE, Brief
from tests.ci.github.stand_in import FORBIDDEN, REPOSITORY, TOKEN, GitHub, github

HEAD = "a" * 40
FOUND = Brief(verdict="pass", sentence="4 cells calibrated")
OURS = {"full_name": REPOSITORY, "owner": {"login": "me"}}
FORK = {"full_name": "stranger/robot", "owner": {"login": "stranger"}}


@pytest.fixture
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[GitHub]:
    """Start the stand-in of GitHub's API, with results of a run in the working directory."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "output").mkdir()
    (tmp_path / "output" / BRIEF_FILE).write_text(FOUND.text)
    with github() as found:
        variables = {
            "GITHUB_ACTIONS": "true",
            "GITHUB_API_URL": found.url,
            "GITHUB_SERVER_URL": "https://github.com",
            "GITHUB_REPOSITORY": REPOSITORY,
            "GITHUB_WORKFLOW": "robot",
            "GITHUB_RUN_ID": "41",
            "GITHUB_RUN_ATTEMPT": "2",
            "GITHUB_OUTPUT": str(tmp_path / "outputs"),
            "INPUT_TOKEN": TOKEN,
        }
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr("calibration.base.http.FIRST_PAUSE", 0.0)
        yield found


@pytest.fixture
def event(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Set the event that started the workflow."""

    def of(name: str, body: dict[str, Any]) -> None:
        path = tmp_path / "event.json"
        path.write_text(json.dumps(body))
        monkeypatch.setenv("GITHUB_EVENT_NAME", name)
        monkeypatch.setenv("GITHUB_EVENT_PATH", str(path))

    return of


def pull_request(repository: dict[str, Any]) -> dict[str, Any]:
    head = {"sha": HEAD, "repo": repository}
    return {"pull_request": {"number": 7, "head": head, "base": {"repo": OURS}}, "repository": OURS}


def after_run(**more: Any) -> dict[str, Any]:
    run = {
        "id": 40,
        "run_attempt": 1,
        "name": "robot",
        "html_url": "https://github.com/me/robot/actions/runs/40",
        "head_sha": HEAD,
        "head_branch": "better",
        "head_repository": FORK,
    }
    return {"workflow_run": run | more, "repository": OURS}


def test_a_pull_request_gets_one_comment(service: GitHub, event: Any, tmp_path: Path) -> None:
    event("pull_request", pull_request(OURS))
    assert run_action("comment") == 0
    [body] = service.bodies()
    assert body.startswith("<!-- calibration-ci robot/ run 41.2 -->\n### ✅ Calibration: pass\n\n4 cells calibrated\n")
    assert body.endswith("[run](https://github.com/me/robot/actions/runs/41) · aaaaaaa\n")
    assert (tmp_path / "outputs").read_text() == "number=7\n"
    assert run_action("comment") == 0
    assert len(service.comments) == 1


def test_a_run_without_results_takes_the_pass_of_an_earlier_one_back(service: GitHub, event: Any) -> None:
    event("pull_request", pull_request(OURS))
    assert run_action("comment") == 0
    Path("output", BRIEF_FILE).unlink()
    assert run_action("comment") == 0
    [body] = service.bodies()
    assert "❌ Calibration: fail\n\nThe run ended without results" in body


def test_it_is_deleted_on_request(
    service: GitHub, event: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    event("pull_request", pull_request(OURS))
    assert run_action("comment") == 0
    monkeypatch.setenv("INPUT_MODE", "delete")
    assert run_action("comment") == 0
    assert service.comments == []
    assert "pull request 7: 1 comment deleted" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "body", "expected"),
    [
        ("pull_request", pull_request(FORK), "no comment: it is a pull request from a fork"),
        ("push", {"repository": OURS}, "no comment: the event push is about no open pull request"),
    ],
)
def test_without_a_pull_request_of_the_team_there_is_a_notice(
    service: GitHub,
    event: Any,
    capsys: pytest.CaptureFixture[str],
    name: str,
    body: dict[str, Any],
    expected: str,
) -> None:
    event(name, body)
    assert run_action("comment") == 0
    assert f"::notice title=Comment::{expected}" in capsys.readouterr().out
    assert service.comments == []


def test_after_a_strangers_run_the_pull_request_is_found_by_its_branch_and_commit(service: GitHub, event: Any) -> None:
    def head(sha: str) -> dict[str, Any]:
        return {"label": "stranger:better", "sha": sha, "repo": FORK}

    service.pulls = [{"number": 3, "head": head("b" * 40)}, {"number": 7, "head": head(HEAD)}]
    event("workflow_run", after_run())
    assert run_action("comment") == 0
    [body] = service.bodies()
    assert body.startswith("<!-- calibration-ci robot/ run 40.1 -->\n")
    assert body.endswith("[run](https://github.com/me/robot/actions/runs/40) · aaaaaaa\n")


@pytest.mark.parametrize("more", [{"head_sha": "c" * 40}, {"head_branch": None}, {"head_repository": None}])
def test_a_branch_that_has_gone_on_gets_no_comment_of_an_old_run(
    service: GitHub, event: Any, more: dict[str, Any]
) -> None:
    service.pulls = [{"number": 7, "head": {"label": "stranger:better", "sha": HEAD}}]
    event("workflow_run", after_run(**more))
    assert run_action("comment") == 0
    assert service.comments == []


def test_untrusted_results_are_validated(service: GitHub, event: Any, capsys: pytest.CaptureFixture[str]) -> None:
    service.pulls = [{"number": 7, "head": {"label": "stranger:better", "sha": HEAD}}]
    event("workflow_run", after_run())
    path = Path("output", BRIEF_FILE)
    path.unlink()
    path.symlink_to("/etc/passwd")
    assert run_action("comment") == 2
    assert "root:" not in capsys.readouterr().out
    path.unlink()
    path.write_text('{"verdict": "pass", "sentence": "::error::x", "number": 9}')
    assert run_action("comment") in (0, 2)
    assert all("number" not in body for body in service.bodies())


def test_a_missing_permission_is_bad_input(service: GitHub, event: Any, capsys: pytest.CaptureFixture[str]) -> None:
    event("pull_request", pull_request(OURS))
    service.answers = [FORBIDDEN]
    assert run_action("comment") == 2
    assert "pull-requests: write" in capsys.readouterr().out


def test_a_missing_token_is_named(
    service: GitHub, event: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    event("pull_request", pull_request(OURS))
    monkeypatch.delenv("INPUT_TOKEN")
    monkeypatch.delenv("GITHUB_TOKEN", raising=False)
    assert run_action("comment") == 2
    assert "token: found none, expected ${{ github.token }}" in capsys.readouterr().out


def test_a_local_run_prints_the_comment(
    service: GitHub, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("GITHUB_ACTIONS", "INPUT_TOKEN"):
        monkeypatch.delenv(name)
    assert main(["comment"]) == 0
    assert capsys.readouterr().out.startswith("### ✅ Calibration: pass\n\n4 cells calibrated\n")
    assert main(["comment", "--token", "secret"]) == 2
    assert main(["comment", "--results", "nowhere"]) == 2
    assert "nowhere/comment.json" in capsys.readouterr().err
    assert service.asked == []
