import json
from pathlib import Path
from typing import Any

import pytest

from calibration.addons.coverage.sources import find_commit
from calibration.base import InputError
from calibration.ci.git import Repository
from calibration.ci.github.service import GitHubEvent
from calibration.ci.services import event_of
from calibration.ci.workflow.runner import Event
from tests.repositories import commit, git

A, B, C = "a" * 40, "b" * 40, "c" * 40
MAIN = {"default_branch": "main"}


def pull_request(head: str | None = "team/robot", base: str = "team/robot", sha: str = A) -> dict[str, Any]:
    repo = None if head is None else {"full_name": head}
    return {"pull_request": {"head": {"sha": sha, "repo": repo}, "base": {"sha": B, "repo": {"full_name": base}}}}


@pytest.fixture
def repository(tmp_path: Path) -> Repository:
    commit(tmp_path, {"a.py": "1\n"})
    return Repository.around(tmp_path)


@pytest.mark.parametrize(
    ("name", "body", "expected"),
    [
        ("push", {"before": B}, C),
        ("pull_request", pull_request(), A),  # not the merge that GITHUB_SHA is
        ("pull_request", {}, C),
        ("pull_request", {"pull_request": {"head": {"sha": "--evil"}}}, C),
        ("workflow_run", {"workflow_run": {"head_sha": A}}, A),
        ("merge_group", {"merge_group": {"head_sha": C, "base_sha": B}}, C),
        ("schedule", {}, C),
    ],
)
def test_the_commit_of_an_event(repository: Repository, name: str, body: dict[str, Any], expected: str) -> None:
    assert find_commit(None, GitHubEvent(name, C, body=body).facts, repository)[0] == expected
    assert find_commit("D" * 40, GitHubEvent(name, C, body=body).facts, repository) == ("d" * 40, "as given")


def test_a_pull_request_target_is_about_what_is_checked_out(repository: Repository) -> None:
    base = repository.head()
    event = GitHubEvent("pull_request_target", C, body=pull_request()).facts
    assert find_commit(None, event, repository)[0] == base
    git(repository.root, "checkout", "-q", "-b", "theirs")
    theirs = commit(repository.root, {"b.py": "1\n"})
    event = GitHubEvent("pull_request_target", C, body=pull_request(sha=theirs)).facts
    assert find_commit(None, event, repository)[0] == theirs
    git(repository.root, "checkout", "-q", "main")
    git(repository.root, "merge", "-q", "--no-ff", "--no-edit", "theirs")  # refs/pull/1/merge
    assert find_commit(None, event, repository)[0] == theirs


def test_off_github_it_is_what_is_checked_out(repository: Repository, tmp_path: Path) -> None:
    assert find_commit(None, Event(), repository)[0] == repository.head()
    empty = tmp_path / "empty"
    empty.mkdir()
    git(empty, "init", "-q")
    with pytest.raises(InputError, match="commit is not given, and there is no checkout"):
        find_commit(None, Event(), Repository.around(empty))


@pytest.mark.parametrize("text", ["main", "abc123", "a" * 41, "../" * 20, "g" * 40])
def test_a_commit_that_is_none(repository: Repository, text: str) -> None:
    with pytest.raises(InputError, match=r"commit: found .*, expected a hash of 40 hexadecimal digits"):
        find_commit(text, Event(), repository)


ACT = {"pull_request": {"head": {"ref": "better", "repo": {"full_name": "stranger/robot"}}}}
"""Documentation in the README for users of act."""


def test_a_teams_own_repository_may_be_a_fork() -> None:
    """GitHub says so of every pull request's head, whose branch may still be the team's."""
    body = pull_request()
    body["pull_request"]["head"]["repo"]["fork"] = True
    event = GitHubEvent("pull_request", body=body | {"repository": {"fork": True}}).facts
    assert event.by_stranger is None
    assert event.without_secrets == "it runs in a fork, which has no secrets of the original"


def test_the_event_is_read_only_on_github(tmp_path: Path) -> None:
    file = tmp_path / "event.json"
    file.write_text(json.dumps(pull_request()))
    variables = {
        "GITHUB_EVENT_PATH": str(file),
        "GITHUB_EVENT_NAME": "pull_request",
        "GITHUB_SHA": C,
        "GITHUB_ACTOR": "someone",
    }
    assert event_of(variables) == Event()
    event = GitHubEvent.from_environment(variables | {"GITHUB_ACTIONS": "true"})
    assert (event.name, event.sha, event.actor) == ("pull_request", C, "someone")
    assert event.at("pull_request", "head", "sha") == A
    file.write_text("[1]")
    assert GitHubEvent.from_environment(variables | {"GITHUB_ACTIONS": "true"}).body == {}
    file.write_text("{")
    with pytest.raises(InputError, match=r"\(GITHUB_EVENT_PATH\): this is no JSON"):
        GitHubEvent.from_environment(variables | {"GITHUB_ACTIONS": "true"})
    file.unlink()
    with pytest.raises(InputError, match="the event of GitHub was expected, but it cannot be read"):
        GitHubEvent.from_environment(variables | {"GITHUB_ACTIONS": "true"})
    assert GitHubEvent.from_environment({"GITHUB_ACTIONS": "true"}).body == {}


@pytest.mark.parametrize(
    ("event", "reason"),
    [
        (GitHubEvent("pull_request", body=pull_request()), None),
        (GitHubEvent("push", actor="someone", body={"repository": {"fork": False}}), None),
        (GitHubEvent("pull_request", body=pull_request(head="fork/robot")), "a pull request from a fork"),
        (GitHubEvent("pull_request", body=pull_request(head=None)), "a pull request from a fork"),
        (GitHubEvent("pull_request_review", body=pull_request(head="fork/robot")), "a pull request from a fork"),
        (GitHubEvent("pull_request_target", body=pull_request(head="fork/robot")), None),  # is given secrets
        (GitHubEvent("push", actor="dependabot[bot]"), "Dependabot"),
        (GitHubEvent("pull_request", body={"pull_request": {"user": {"login": "dependabot[bot]"}}}), "Dependabot"),
        (GitHubEvent("push", body={"repository": {"fork": True}}), "in a fork"),
        (GitHubEvent("pull_request", body=ACT, repository="me/robot"), "a pull request from a fork"),
    ],
)
def test_who_is_given_no_secrets(event: GitHubEvent, reason: str | None) -> None:
    assert (event.facts.without_secrets is None) if reason is None else (reason in (event.facts.without_secrets or ""))


@pytest.mark.parametrize(
    ("event", "bases"),
    [
        (GitHubEvent("pull_request", body=pull_request()), [B]),
        (
            GitHubEvent("push", body={"before": A, "repository": {"default_branch": "main"}}),
            [A, "refs/remotes/origin/main"],
        ),
        (GitHubEvent("push", body={"before": "0" * 40}), []),  # a new branch
        (GitHubEvent("merge_group", body={"merge_group": {"base_sha": A}}), [A]),
        (GitHubEvent("schedule", body={"before": A}), []),
        (GitHubEvent("push", body={"before": "--evil", "repository": {"default_branch": 3}}), []),
        (GitHubEvent(), []),
    ],
)
def test_what_a_change_is_compared_with(event: GitHubEvent, bases: list[str]) -> None:
    assert event.facts.bases == tuple(bases)
