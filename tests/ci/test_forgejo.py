"""Forgejo and Gitea Actions, by recorded variables of their runners and a stand-in of their API."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from calibration.__main__ import main
from calibration.ci.forgejo import FORGEJO
from calibration.ci.github.service import GITHUB
from calibration.ci.services import event_of, service_of
from tests.ci.github.stand_in import FORBIDDEN, TOKEN, GitHub, stand_in


class ForgejoApi(GitHub):
    """An API whose list of comments has one page, and whose job tokens write as forgejo-actions."""

    def answer(self, method: str, path: str, body: Any, token: str | None) -> tuple[int, object, dict[str, str]]:
        if path == "/user":
            return FORBIDDEN
        if method == "GET":
            assert "per_page" not in path
            return 200, list(self.comments), {}
        answer = super().answer(method, path, body, token)
        if method == "POST":
            self.comments[-1]["user"] = {"login": "forgejo-actions"}
        return answer


@pytest.fixture(params=["FORGEJO_ACTIONS", "GITEA_ACTIONS"])
def api(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ForgejoApi]:
    """Run in a step of a pull request."""
    body = {
        "pull_request": {
            "number": 7,
            "head": {"sha": "a" * 40, "repo": {"full_name": "me/robot"}},
            "base": {"sha": "b" * 40, "repo": {"full_name": "me/robot"}},
        },
        "repository": {"full_name": "me/robot", "fork": False, "default_branch": "main"},
    }
    (tmp_path / "event.json").write_text(json.dumps(body))
    monkeypatch.chdir(tmp_path)
    with stand_in(ForgejoApi) as found:
        for name, value in {
            request.param: "true",
            "GITHUB_ACTIONS": "true",
            "GITHUB_API_URL": found.url,
            "GITHUB_SERVER_URL": "https://forge.example",
            "GITHUB_REPOSITORY": "me/robot",
            "GITHUB_EVENT_NAME": "pull_request",
            "GITHUB_EVENT_PATH": str(tmp_path / "event.json"),
            "GITHUB_RUN_ID": "41",
            "GITHUB_RUN_ATTEMPT": "",
            "GITHUB_WORKFLOW": "calibration.yml",
            "GITHUB_OUTPUT": str(tmp_path / "outputs"),
            "GITHUB_TOKEN": TOKEN,
        }.items():
            monkeypatch.setenv(name, value)
        yield found


def test_it_is_told_from_github() -> None:
    assert service_of({"GITHUB_ACTIONS": "true", "GITEA_ACTIONS": "true"}) is FORGEJO
    assert service_of({"GITHUB_ACTIONS": "true", "FORGEJO_ACTIONS": "true"}) is FORGEJO
    assert service_of({"GITHUB_ACTIONS": "true", "FORGEJO_ACTIONS": ""}) is GITHUB


def test_a_step_has_outputs_and_lines(api: ForgejoApi, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{name},5\n" for name in "abcdefghijkl")
    Path("t.csv").write_text(f"k,v\n{rows}")
    assert main(["introspect-csv", "--file", "t.csv", "--column", "v", "--max", "3"]) == 1
    assert "verdict=fail\n" in (tmp_path / "outputs").read_text()
    out, err = capsys.readouterr()
    assert err.count("error: t.csv:") == 12  # where GitHub has nine
    assert "::error" not in out


def test_one_comment_is_kept_by_a_token_of_a_job(api: ForgejoApi, capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(120):  # more than a page
        api.add("words", "somebody", "User")
    assert main(["comment"]) == 0
    assert main(["comment"]) == 0
    assert len(api.comments) == 121
    assert "comment updated" in capsys.readouterr().out
    assert "https://forge.example/me/robot/actions/runs/41" in api.bodies()[-1]
    assert main(["comment", "--mode", "delete"]) == 0
    assert len(api.comments) == 120


def test_never_asks_github(api: ForgejoApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GITHUB_API_URL")
    assert main(["comment"]) == 2


def test_the_event_has_githubs_form(api: ForgejoApi, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    environment = {
        "FORGEJO_ACTIONS": "true",
        "GITHUB_EVENT_NAME": "pull_request",
        "GITHUB_EVENT_PATH": str(tmp_path / "event.json"),
        "GITHUB_REPOSITORY": "me/robot",
    }
    event = event_of(environment)
    assert (event.pull_request_commit, event.by_stranger) == ("a" * 40, None)
    assert event.bases == ("b" * 40, "refs/remotes/origin/main")
