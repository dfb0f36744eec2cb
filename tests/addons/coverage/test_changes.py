import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.coverage.formats import FileCoverage, Rate
from calibration.addons.coverage.results import CoverageOfChange, Span, coverage_of_change
from calibration.base import InfrastructureError, InputError
from calibration.ci.git import Repository, changed_lines, files_without_lines, find_base
from tests.repositories import commit, git

LINE = st.sampled_from(
    ["x = 1", "++ b/other.py", "+++ b/other.py", "--- a/x", "@@ -1,9 +1,9 @@", "-", "+", "", "\\ no", "y = 2", "ü"]
)


def changes(root: Path, base: str) -> dict[str, set[int]]:
    return changed_lines(Repository.around(root).difference(base))


def test_files_of_which_git_tells_no_lines(tmp_path: Path) -> None:
    names = ["a.py", "é b.py", "and b/x.py"]
    base = commit(tmp_path, {**dict.fromkeys((*names, "large.txt"), "1\n"), ".gitattributes": "*.py -diff\n"})
    commit(tmp_path, {**dict.fromkeys((*names, "new.py"), "2\n"), "large.txt": "\n" * 11_000_000})
    difference = Repository.around(tmp_path).difference(base)
    assert files_without_lines(difference) == {*names, "new.py", "large.txt"}
    assert changed_lines(difference) == {}
    assert len(difference) < 2000


@pytest.mark.skipif(sys.platform != "linux", reason="needs prlimit")
def test_the_memory_of_git_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The attribute ``diff`` makes text of a file of any size: 60 MB of line breaks took 2.4 GB."""
    monkeypatch.setattr("calibration.ci.git.MAX_MEMORY_BYTES", 200 * 1024**2)
    base = commit(tmp_path, {"large.txt": "1\n", ".gitattributes": "* diff\n"})
    commit(tmp_path, {"large.txt": "\n" * 11_000_000})
    with pytest.raises(InfrastructureError, match=r"git diff: .*Out of memory"):
        Repository.around(tmp_path).difference(base)


def test_lines_that_are_new(tmp_path: Path) -> None:
    base = commit(
        tmp_path, {"a.py": "1\n2\n3\n4\n", "gone.py": "bye\n", "old.py": "a\nb\nc\nd\ne\nf\n", "same.py": "1\n"}
    )
    (tmp_path / "gone.py").unlink()
    (tmp_path / "old.py").unlink()
    commit(
        tmp_path,
        {
            "a.py": "1\nzwei\n3\n4\n5\n",
            "new name.py": "a\nb\nc\nd\ne\nF\n",
            'q"\t\\ü.py': "1\n2",
            "empty.py": "",
            "image.bin": b"\0\1",
        },
    )
    (tmp_path / "same.py").write_text("1\nnot committed yet\n")
    assert changes(tmp_path, base) == {
        "a.py": {2, 5},
        "new name.py": {6},
        'q"\t\\ü.py': {1, 2},
        "same.py": {2},
    }


@pytest.fixture(scope="module")
def repository(tmp_path_factory: pytest.TempPathFactory) -> Repository:
    root = tmp_path_factory.mktemp("changes")
    commit(root, {"start": ""})
    return Repository.around(root)


@given(st.lists(LINE, max_size=8), st.lists(LINE, max_size=8), st.booleans())
def test_it_is_what_the_new_text_has_more(
    repository: Repository, before: list[str], after: list[str], ends: bool
) -> None:
    """File content is not interpreted, even if it looks like a difference."""
    (repository.root / "a.py").write_text("".join(f"{line}\n" for line in before))
    (repository.root / "z.py").write_text("1\n")
    git(repository.root, "add", "-A")
    git(repository.root, "commit", "-q", "--allow-empty", "-m", "before")
    text = "\n".join(after) + ("\n" if ends and after else "")
    (repository.root / "a.py").write_text(text)
    (repository.root / "z.py").write_text("1\n2\n")
    found = changed_lines(repository.difference("HEAD"))
    lines = text.split("\n")[: None if text and not text.endswith("\n") else -1]
    new = found.get("a.py", set())
    assert found.keys() <= {"a.py", "z.py"}
    assert found["z.py"] == {2}  # the file after it is still found
    assert new <= set(range(1, len(lines) + 1))
    kept = [line for number, line in enumerate(lines, 1) if number not in new]
    rest = iter(before)
    assert all(any(line == other for other in rest) for line in kept)  # what is not new was there, in this order


def test_what_is_covered_of_a_change() -> None:
    functions = {(1, 2): 0, (4, 5): 1, (6, 8): 1}
    files = {
        "a.py": FileCoverage({1: 1, 2: 0, 4: 0, 9: 3}, {}, functions),
        "b.py": FileCoverage({1: 1}),
        "c.py": FileCoverage({1: 0}),
    }
    changed = {"a.py": {2, 3, 4, 9}, "b.py": {1}, "README.md": {1}}
    of_change = CoverageOfChange("base", Rate(2, 4), (Span("a.py", 2, 4),), Rate(1, 2))
    assert coverage_of_change("base", changed, files) == of_change
    assert coverage_of_change("base", {}, files) == CoverageOfChange("base", Rate(), ())


def test_the_base_is_where_a_branch_left(tmp_path: Path) -> None:
    left = commit(tmp_path, {"a.py": "1\n"})
    git(tmp_path, "checkout", "-q", "-b", "topic")
    commit(tmp_path, {"b.py": "1\n"})
    git(tmp_path, "checkout", "-q", "main")
    commit(tmp_path, {"c.py": "1\n"})
    git(tmp_path, "checkout", "-q", "topic")
    repository = Repository.around(tmp_path)
    assert find_base(repository, "main", []) == left
    assert find_base(repository, None, ["0" * 40, "main"]) == left  # the first that is there
    with pytest.raises(InputError, match=r"base origin/main: no such commit is in this checkout: .*fetch-depth: 0"):
        find_base(repository, "origin/main", ["main"])
    with pytest.raises(InputError, match="there is no base to compare with"):
        find_base(repository, None, [])
    git(tmp_path, "checkout", "-q", "--orphan", "alone")
    commit(tmp_path, {"d.py": "1\n"})
    with pytest.raises(InputError, match="base main: no common ancestor with HEAD is in this checkout"):
        find_base(repository, "main", [])


@pytest.mark.parametrize("count", ["9" * 9, "9" * 5001])
def test_a_hunk_that_claims_more_lines_than_it_has_takes_no_memory(count: str) -> None:
    difference = f"+++ b/a.py\n@@ -0,0 +7,{count} @@\n+x\n+y\n"
    assert changed_lines(difference.encode()) in ({"a.py": {7, 8}}, {})
