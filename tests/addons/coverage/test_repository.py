import os
from pathlib import Path

import pytest

import calibration.ci.git
from calibration.addons.coverage.sources import Sources, find_sources, language_of
from calibration.base import InfrastructureError, InputError
from calibration.ci.git import Repository, is_commit
from tests.conftest import NEEDS_ROOT
from tests.repositories import commit, git

from .projects import robot


def sources(root: Path, *named: str, exclude: tuple[str, ...] | None = None, directory: Path | None = None) -> Sources:
    return find_sources(Repository.around(root), directory or root, map(Path, named), exclude)


def test_a_folder_outside_of_any_repository(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"a folder in a git repository was expected \(check it out before\): no folder"
    ):
        Repository.around(tmp_path)
    with pytest.raises(InputError, match="none: there is no such folder"):
        Repository.around(tmp_path / "none")


def test_no_git(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    git(tmp_path, "init", "-q")
    monkeypatch.setenv("PATH", str(tmp_path / "none"))
    with pytest.raises(InfrastructureError, match="git cannot be started: No such file"):
        Repository.around(tmp_path)


def test_git_that_takes_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    git(tmp_path, "init", "-q")
    (tmp_path / "git").write_text("#!/bin/sh\nexec sleep 30\n")
    (tmp_path / "git").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(calibration.ci.git, "COMMAND_SECONDS", 0.3)
    with pytest.raises(InfrastructureError, match=r"git rev-parse took longer than 0.3 s"):
        Repository.around(tmp_path)


def test_the_root_is_found_from_below_and_through_links(tmp_path: Path) -> None:
    root = robot(tmp_path / "a project")
    (tmp_path / "link").symlink_to(root / "robot")
    assert Repository.around(tmp_path / "link").root == root


def test_a_checkout_of_another_user(tmp_path: Path) -> None:
    root = robot(tmp_path / "theirs")
    if os.getuid() != 0:
        pytest.skip(f"{NEEDS_ROOT}, who can give files away")
    for path in [root, *root.rglob("*")]:
        os.chown(path, 12345, 12345, follow_symlinks=False)
    assert Repository.around(root).tracked() == [
        ".gitignore",
        "robot/__init__.py",
        "robot/naming.py",
        "tests/test_naming.py",
    ]


def test_only_regular_files_that_are_there_are_tracked_files(tmp_path: Path) -> None:
    root = robot(tmp_path / "p")
    (root / "passwords.py").symlink_to("/etc/passwd")
    commit(root, {"gone.py": "1\n", 'we"ird ü\n.py': "1\n"})
    (root / "gone.py").unlink()
    (root / "untracked.py").write_text("1\n")
    names = Repository.around(root).tracked(exclude=["tests", ".gitignore"])
    assert names == ["robot/__init__.py", "robot/naming.py", 'we"ird ü\n.py']


def test_a_configuration_cannot_start_programs(tmp_path: Path) -> None:
    root = robot(tmp_path / "p")
    trap = tmp_path / "trap"
    trap.write_text(f"#!/bin/sh\ntouch {tmp_path}/sprung\ncat\n")
    trap.chmod(0o755)
    git(root, "config", "core.fsmonitor", str(trap))
    git(root, "config", "diff.external", str(trap))
    git(root, "config", "diff.evil.textconv", str(trap))
    (root / ".gitattributes").write_text("*.py diff=evil\n")
    (root / "robot/naming.py").write_text("changed = 1\n")
    checkout = Repository.around(root)
    assert checkout.tracked()
    assert b"+changed = 1" in checkout.difference("HEAD")
    assert not (tmp_path / "sprung").exists()


def test_commits(tmp_path: Path) -> None:
    root = robot(tmp_path / "p")
    checkout = Repository.around(root)
    first = checkout.head()
    assert first is not None
    assert is_commit(first)
    git(root, "checkout", "-q", "-b", "topic")
    topic = commit(root, {"a.py": "1\n"})
    git(root, "checkout", "-q", "main")
    main = commit(root, {"b.py": "1\n"})
    git(root, "merge", "-q", "--no-edit", "topic")
    merge = checkout.head() or ""
    assert checkout.parents(merge) == [main, topic]
    assert checkout.merge_base("topic", main) == first
    assert checkout.commit("no-such") is None
    assert checkout.commit("--all") is None
    assert checkout.parents("0" * 40) == []
    assert checkout.merge_base("0" * 40, "HEAD") is None
    with pytest.raises(InfrastructureError, match=r"git diff: .*000"):
        checkout.difference("0" * 40)
    shallow = tmp_path / "shallow"
    git(tmp_path, "clone", "-q", "--depth", "1", f"file://{root}", str(shallow))
    checkout = Repository.around(shallow)
    assert checkout.parents(merge) == [main, topic]  # though they are not there
    assert checkout.commit(main) is None


def test_a_broken_checkout(tmp_path: Path) -> None:
    root = robot(tmp_path / "p")
    (root / ".git/index").write_bytes(b"x" * 100)
    with pytest.raises(InfrastructureError, match=r"git ls-files: .*index"):
        Repository.around(root).tracked()


def test_no_commit_yet(tmp_path: Path) -> None:
    git(tmp_path, "init", "-q")
    assert Repository.around(tmp_path).head() is None


def test_tests_and_what_builds_do_not_count(tmp_path: Path) -> None:
    root = robot(tmp_path / "p")
    others = ("setup.py", "docs/conf.py", "src/test/a.py", "src/arm_test.cpp", "src/test_arm.cpp", "conftest.py")
    ours = ("src/arm.cpp", "src/protests.py", "README.md", "src/latest.py")
    commit(root, dict.fromkeys((*others, *ours), "1\n"))
    counted = ["robot/__init__.py", "robot/naming.py", "src/arm.cpp", "src/latest.py", "src/protests.py"]
    assert sources(root).counted == counted
    assert sources(root, exclude=("robot/*",)).counted[:2] == ["conftest.py", "docs/conf.py"]


def test_sources_that_are_named(tmp_path: Path) -> None:
    root = robot(tmp_path / "p")
    commit(
        root,
        {
            "src/arm/move.py": "1\n",
            "src/arm/__init__.py": "",
            "src/hand.py": "1\n",
            "[x]/a.py": "1\n",
            "src2/a.py": "1\n",
        },
    )
    assert sources(root, "src").counted == ["src/arm/__init__.py", "src/arm/move.py", "src/hand.py"]
    assert sources(root, "src/hand.py", "[x]").counted == ["[x]/a.py", "src/hand.py"]
    assert sources(root, "arm", directory=root / "src").counted == ["src/arm/__init__.py", "src/arm/move.py"]
    assert sources(root, "..", directory=root / "src").folders == (".",)
    assert sources(root).measured() == [str(root), "arm", "robot"]
    assert sources(root, "src").measured() == [str(root / "src"), "arm"]
    # Of a file, its folder: coverage.py would take it for the name of a package.
    assert sources(root, "src/hand.py", "[x]").measured() == [str(root / "src"), str(root / "[x]")]


@pytest.mark.parametrize(
    ("named", "exclude", "message"),
    [
        ("../other", None, "source: ../other: found a path outside of the repository"),
        ("none", None, "source: none: no source file was found there"),
        ("tests", None, "source: tests: no source file was found there that git tracks and exclude leaves in"),
        (".", ("**",), "source: .: no source file was found"),
    ],
)
def test_sources_that_are_none(tmp_path: Path, named: str, exclude: tuple[str, ...] | None, message: str) -> None:
    with pytest.raises(InputError) as refused:
        sources(robot(tmp_path / "p"), named, exclude=exclude)
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("path", "language"),
    [("a/b.py", "python"), ("x.HPP", "cpp"), ("a.tsx", "typescript"), ("README", None), ("py", None)],
)
def test_languages(path: str, language: str | None) -> None:
    assert language_of(path) == language
