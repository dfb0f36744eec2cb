"""A single comment, in spite of re-runs, failures and concurrent runs."""

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from calibration.base import InfrastructureError, InputError
from calibration.ci.github.comments import MAX_COMMENT_CHARACTERS, Comments, Marker
from calibration.ci.github.service import GitHubApi

from .stand_in import FORBIDDEN, REPOSITORY, TOKEN, GitHub, github

KEY = "calibration (main) --> x/"


@pytest.fixture
def service() -> Iterator[GitHub]:
    with github() as found:
        yield found


def comments(service: GitHub, token: str = TOKEN) -> Comments:
    return Comments(GitHubApi.open(token, service.url, lambda _: None), REPOSITORY, 7)


def marker(run: int, attempt: int = 1, key: str = KEY) -> Marker:
    return Marker(key, (run, attempt))


def test_every_run_writes_the_same_comment(service: GitHub) -> None:
    service.add("A person says something.", "somebody", "User")
    assert comments(service).keep(marker(1), "first") == "created"
    assert comments(service).keep(marker(2), "second") == "updated"
    assert comments(service).keep(marker(2, 2), "again") == "updated"
    assert service.bodies() == ["A person says something.", marker(2, 2).text + "again"]
    assert comments(service).remove(KEY) == 1
    assert comments(service).remove(KEY) == 0
    assert service.bodies() == ["A person says something."]


def test_an_earlier_run_that_is_repeated_leaves_the_comment_of_a_later_one(service: GitHub) -> None:
    comments(service).keep(marker(2), "later")
    assert comments(service).keep(marker(1, 3), "earlier") == "left: a later run has written it"
    assert service.bodies() == [marker(2).text + "later"]


def test_two_workflows_have_a_comment_each(service: GitHub) -> None:
    comments(service).keep(marker(1), "one")
    comments(service).keep(marker(1, key="other"), "two")
    assert comments(service).remove("other") == 1
    assert service.bodies() == [marker(1).text + "one"]


def test_it_is_found_among_hundreds(service: GitHub) -> None:
    for index in range(250):
        service.add(f"comment {index}", "somebody", "User")
    comments(service).keep(marker(1), "one")
    assert comments(service).keep(marker(2), "two") == "updated"
    assert len(service.comments) == 251


@pytest.mark.parametrize("user", [None, "robot-account"])
def test_markers_of_other_users_are_ignored(service: GitHub, user: str | None) -> None:
    service.user = user
    service.add(marker(10**17).text + "mine now", "stranger", "User")
    assert comments(service).keep(marker(1), "ours") == "created"
    assert comments(service).keep(marker(2), "ours again") == "updated"
    assert service.bodies() == [marker(10**17).text + "mine now", marker(2).text + "ours again"]


@pytest.mark.parametrize("later_first", [False, True])
def test_of_two_runs_at_once_one_comment_stays_with_the_text_of_the_later(service: GitHub, later_first: bool) -> None:
    both_looked = threading.Barrier(2)
    looks = {"count": 0}

    def wait_for_the_other(method: str, path: str) -> None:
        with service.lock:
            looks["count"] += "/issues/7/comments?" in path
            first = "/issues/7/comments?" in path and looks["count"] <= 2
        if first:  # so that neither sees the other's comment
            both_looked.wait(timeout=60)

    service.before_answer = wait_for_the_other
    runs = [threading.Thread(target=comments(service).keep, args=(marker(run), f"run {run}")) for run in (1, 2)]
    for thread in reversed(runs) if later_first else runs:
        thread.start()
    for thread in runs:
        thread.join(timeout=60)
    assert service.bodies() == [marker(2).text + "run 2"]


def test_an_answer_that_is_lost_makes_no_second_comment(service: GitHub) -> None:
    def done_but_not_answered(method: str, path: str) -> None:
        if method == "POST":
            service.add(marker(1).text + "text")
            service.before_answer = None

    service.before_answer = done_but_not_answered
    service.answers = [(502, {"message": "Bad Gateway"}, {})]
    assert comments(service).keep(marker(1), "text") == "created"
    assert service.bodies() == [marker(1).text + "text"]


def test_a_comment_that_is_deleted_meanwhile_is_made_anew(service: GitHub) -> None:
    comments(service).keep(marker(1), "one")

    def delete(method: str, path: str) -> None:
        if method == "PATCH":
            service.comments.clear()

    service.before_answer = delete
    assert comments(service).keep(marker(2), "two") == "created"
    assert service.bodies() == [marker(2).text + "two"]


def test_a_text_is_truncated_to_the_limit_of_github(service: GitHub) -> None:
    comments(service).keep(marker(1), "x" * 10**6)
    assert [len(body) for body in service.bodies()] == [MAX_COMMENT_CHARACTERS]


@pytest.mark.parametrize(
    ("answers", "kind", "expected"),
    [
        ([FORBIDDEN], InputError, "the token lacks a permission: the job needs permissions: pull-requests: write"),
        (
            [(403, {"message": "API rate limit exceeded"}, {"X-RateLimit-Remaining": "0"})],
            InfrastructureError,
            "the rate limit of this token is exceeded",
        ),
        (
            [(403, {"message": "You have exceeded a secondary rate limit"}, {"Retry-After": "60"})],
            InfrastructureError,
            "the rate limit of this token is exceeded",
        ),
        ([(502, {"message": "Bad Gateway"}, {})] * 4, InfrastructureError, "answered 502 (Bad Gateway) (4 attempts)"),
        ([(404, {"message": "Not Found"}, {})], InputError, "the token has no access to this pull request"),
        ([(422, {"message": "Validation Failed"}, {})], InfrastructureError, "answered 422 (Validation Failed)"),
        ([(429, {}, {"Retry-After": "3600"})], InfrastructureError, "3600 s"),
    ],
)
def test_errors_of_github_are_one_line(
    service: GitHub, answers: list[Any], kind: type[Exception], expected: str
) -> None:
    service.answers = list(answers)
    with pytest.raises(kind) as error:
        comments(service).keep(marker(1), "text")
    assert expected in str(error.value)
    assert "\n" not in str(error.value)
    assert service.comments == []


def test_a_wrong_token_is_named_and_never_shown(service: GitHub) -> None:
    with pytest.raises(InputError) as error:
        comments(service, "wrong secret").keep(marker(1), "text")
    assert "the token is wrong or has expired" in str(error.value)
    assert "wrong secret" not in str(error.value)


def test_a_busy_server_is_asked_again(service: GitHub) -> None:
    service.answers = [(503, {}, {}), (429, {}, {"Retry-After": "1"})]
    assert comments(service).keep(marker(1), "text") == "created"
    assert len(service.comments) == 1


@pytest.mark.parametrize("url", ["http://api.example.org", "api.github.com", "ftp://127.0.0.1"])
def test_a_token_is_sent_only_over_tls(url: str) -> None:
    with pytest.raises(InputError, match="GITHUB_API_URL: found"):
        GitHubApi.open(TOKEN, url)
