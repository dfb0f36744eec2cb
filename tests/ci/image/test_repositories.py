from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.ci.image.repositories import Repository, read_repositories


def read(tmp_path: Path, text: str) -> tuple[Repository, ...]:
    file = tmp_path / "a.repos"
    file.write_text(text)
    return read_repositories(file)


def test_repos(tmp_path: Path) -> None:
    text = f"""
repositories:
  core/atom: {{type: git, url: 'https://github.com/lardemua/atom.git', version: {"a" * 40}}}
  other: {{type: git, url: 'git@github.com:team/other.git', version: noetic-devel}}
  third: {{type: git, url: 'ssh://git@host:2222/x.git'}}
"""
    first, second, third = read(tmp_path, text)
    assert first == Repository("core/atom", "https://github.com/lardemua/atom.git", "a" * 40)
    assert (first.by_ssh, second.by_ssh, third.by_ssh) == (False, True, True)
    assert (first.pinned, second.pinned, third.pinned) == (True, False, False)
    assert third.version is None


def test_rosinstall(tmp_path: Path) -> None:
    text = "- git: {local-name: a, uri: 'https://h/a.git', version: 12}\n- git: {local-name: b, uri: 'http://h/b'}"
    assert read(tmp_path, text) == (Repository("a", "https://h/a.git", "12"), Repository("b", "http://h/b"))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("{type: hg, url: 'https://h/a'}", "found the type 'hg', only git"),
        ("{type: git, url: 'file:///etc'}", "found the address 'file:///etc'"),
        ("{type: git, url: 'ext::sh -c evil'}", "found the address"),
        ("{type: git, url: '--upload-pack=evil'}", "found the address"),
        ("{type: git, url: 'https://[bad'}", "found the address"),
        ("{type: git, url: 'https://h:99999/x'}", "found the address"),
        ("{type: git}", "found the address 'None'"),
        ("{type: git, url: 'https://bot:hunter2@h/a'}", "has a password in it"),
        ("{type: git, url: 'https://h/a', version: --evil}", "found the version '--evil'"),
        ("{type: git, url: 'https://h/a', version: 1.10}", "found the version 1.1,"),
        ('{type: git, url: "https://h/a\\nb"}', "more than one line"),
        ("text", "expected type, url and version"),
    ],
)
def test_refused_repositories(tmp_path: Path, entry: str, message: str) -> None:
    with pytest.raises(InputError, match=f"a.repos: a: .*{message}|a.repos: .*{message}") as error:
        read(tmp_path, f"repositories: {{a: {entry}}}")
    assert "hunter2" not in str(error.value)


@pytest.mark.parametrize("name", ["../a", "/a", "a/../../b", "."])
def test_no_repository_outside_the_workspace(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="a path inside the workspace was expected"):
        read(tmp_path, yaml.safe_dump({"repositories": {name: {"type": "git", "url": "https://h/a"}}}))


@pytest.mark.parametrize("text", ["a: 1", "repositories: []", "1", "- 1", "- {git: 1}", "- {git: {}, hg: {}}"])
def test_other_files(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"a\.repos: "):
        read(tmp_path, text)


def test_two_in_one_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two repositories are cloned to a"):
        read(tmp_path, "- git: {local-name: a, uri: 'https://h/1'}\n- git: {local-name: a/, uri: 'https://h/2'}")


def test_a_password_is_in_no_message(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        read(tmp_path, "- git: {local-name: a, uri: 'ftp://bot:hunter2@h/a'}")
    assert "hunter2" not in str(error.value)


@given(
    st.recursive(
        st.none() | st.text(max_size=9) | st.integers(),
        lambda x: (
            st.lists(x)
            | st.dictionaries(
                st.sampled_from(["repositories", "git", "type", "url", "uri", "version", "local-name"]), x
            )
        ),
        max_leaves=9,
    )
)
def test_whatever_it_holds_there_is_no_traceback(tmp_path_factory: pytest.TempPathFactory, document: object) -> None:
    file = tmp_path_factory.mktemp("repos") / "a.repos"
    file.write_text(yaml.safe_dump(document))
    try:
        read_repositories(file)
    except InputError as error:
        assert str(error).isprintable()  # noqa: PT017
