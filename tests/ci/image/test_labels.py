from pathlib import Path

import pytest

from calibration.ci.image.context import build_labels
from tests.repositories import git

OURS = {"ci.calibration.key": "k", "ci.calibration.specification": "s"}


def test_on_github(tmp_path: Path) -> None:
    variables = {"GITHUB_ACTIONS": "true", "GITHUB_SERVER_URL": "https://github.com", "GITHUB_REPOSITORY": "team/robot"}
    variables["GITHUB_SHA"] = "a" * 40
    assert build_labels("k", "s", {"team": "x"}, tmp_path, variables) == OURS | {
        "org.opencontainers.image.source": "https://github.com/team/robot",
        "org.opencontainers.image.revision": "a" * 40,
        "team": "x",
    }


@pytest.mark.parametrize(
    ("origin", "source"),
    [
        ("https://bot:hunter2@github.com/team/robot.git", "https://github.com/team/robot.git"),
        ("https://[bad", None),
        ("git@github.com:team/robot.git", "git@github.com:team/robot.git"),
    ],
)
def test_in_a_checkout(tmp_path: Path, origin: str, source: str | None) -> None:
    for command in (
        ["init", "--quiet"],
        ["remote", "add", "origin", origin],
        ["commit", "--quiet", "--allow-empty", "-m", "x"],
    ):
        git(tmp_path, *command)
    found = build_labels("k", "s", {}, tmp_path, {})
    assert found.get("org.opencontainers.image.source") == source
    assert len(found["org.opencontainers.image.revision"]) == 40


def test_where_there_is_no_git(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert build_labels("k", "s", {}, tmp_path, {}) == OURS
    monkeypatch.setenv("PATH", "/nowhere")
    assert build_labels("k", "s", {}, tmp_path, {}) == OURS


def test_the_users_labels_win_but_not_over_the_key(tmp_path: Path) -> None:
    user = {"org.opencontainers.image.revision": "mine", "ci.calibration.key": "forged"}
    assert build_labels("k", "s", user, tmp_path, {}) == OURS | {"org.opencontainers.image.revision": "mine"}
