"""Content of files in commits, commits that changed a file, and commits missing in a shallow checkout."""

from pathlib import Path
from typing import Any

import pytest

from calibration.base import InputError
from calibration.ci.git import Repository
from tests.repositories import git

FILE = "calibration-baseline.json"


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Return a repository with three commits, two of which change the file."""
    root = tmp_path / "origin"
    root.mkdir()
    git(root, "init", "--quiet", "--initial-branch=main")
    for number, (name, text) in enumerate([(FILE, "one"), ("other", "text"), (FILE, "two")]):
        (root / name).write_text(text)
        git(root, "add", ".")
        git(root, "commit", "--quiet", "-m", f"change {number}: tab\tand more")
    return root


def test_content_of_a_file_in_a_commit(checkout: Path) -> None:
    repository = Repository.around(checkout)
    head = repository.head()
    assert head is not None
    [first] = repository.parents(repository.parents(head)[0])
    assert repository.content(head, FILE, 100) == b"two"
    assert repository.content(first, FILE, 100) == b"one"
    assert repository.content(first, "other", 100) is None
    assert repository.content("f" * 40, FILE, 100) is None
    with pytest.raises(InputError, match="found 3 bytes, expected at most 2"):
        repository.content(head, FILE, 2)


def test_a_link_in_a_commit_is_refused(checkout: Path) -> None:
    (checkout / FILE).unlink()
    (checkout / FILE).symlink_to("/etc/passwd")
    git(checkout, "add", ".")
    git(checkout, "commit", "--quiet", "-m", "link")
    with pytest.raises(InputError, match="expected a regular file, found a link"):
        Repository.around(checkout).content("HEAD", FILE, 100)


def test_which_commits_changed_a_file(checkout: Path) -> None:
    repository = Repository.around(checkout)
    found = repository.changes_of(FILE)
    assert [each.subject for each in found] == ["change 2: tab\tand more", "change 0: tab\tand more"]
    assert found[0].hash == repository.head()
    assert str(found[0]) == f"{found[0].date} ({found[0].hash[:7]})"
    assert repository.changes_of(FILE, newest=1) == found[:1]
    assert repository.changes_of(FILE, since=found[1].hash) == found[:1]
    assert repository.changes_of(FILE, since="2001-01-01") == found
    assert repository.changes_of("none") == []


def test_a_repository_without_commits(tmp_path: Path) -> None:
    git(tmp_path, "init", "--quiet")
    assert Repository.around(tmp_path).changes_of(FILE) == []


def test_a_shallow_checkout_fetches_the_one_commit(checkout: Path, tmp_path: Path) -> None:
    git(tmp_path, "clone", "--quiet", "--depth=1", f"file://{checkout}", "shallow")
    git(checkout, "config", "uploadpack.allowAnySHA1InWant", "true")
    repository = Repository.around(tmp_path / "shallow")
    first = Repository.around(checkout).changes_of(FILE)[1].hash
    assert repository.commit(first) is None
    assert repository.content(repository.fetched(first), FILE, 100) == b"one"


def test_a_failed_fetch_is_reported(checkout: Path, tmp_path: Path) -> None:
    git(tmp_path, "clone", "--quiet", "--depth=1", f"file://{checkout}", "shallow")
    (tmp_path / "origin").rename(tmp_path / "gone")
    with pytest.raises(
        InputError, match=r"is not in this checkout \(fetch-depth: 2, GIT_DEPTH: 2 on GitLab\), and cannot"
    ) as error:
        Repository.around(tmp_path / "shallow").fetched("a" * 40)
    assert "\n" not in str(error.value)


def test_contents_are_read_within_a_limit(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of gigabytes takes kilobytes in a repository: its size is asked for before it is read."""
    for text in ("", "a\nb\n", "x" * 8, "y" * 5, "z" * 1_000_000):
        (checkout / FILE).write_text(text)
        git(checkout, "commit", "--quiet", "-am", "more")
    repository = Repository.around(checkout)
    hashes = git(checkout, "rev-list", "HEAD").split()
    read: list[int] = []
    ask = Repository._run_git

    def asking(self: Repository, *arguments: str, **given: Any) -> tuple[int, bytes, bytes]:
        answer = ask(self, *arguments, **given)
        read.append(len(answer[1]))
        return answer

    monkeypatch.setattr(Repository, "_run_git", asking)
    found = dict(repository.contents([*hashes, "f" * 40], FILE, 10))
    expected = [None, b"y" * 5, b"x" * 8, b"a\nb\n", b"", b"two", b"one", b"one"]
    assert list(found.items()) == [*zip(hashes, expected, strict=True), ("f" * 40, None)]
    assert max(read) < 1000
    assert dict(repository.contents(hashes[:2], "a b", 10)) == dict.fromkeys(hashes[:2])
    with pytest.raises(InputError, match="a path without line breaks was expected"):
        list(repository.contents(hashes, f"{FILE}\nHEAD:other", 10))
