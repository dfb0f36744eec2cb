"""Workspaces: results are kept, only for the same inputs, and for one process at a time."""

import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from pathlib import Path

import pytest

from calibration.base import InfrastructureError, InputError
from calibration.ci.execution.tasks import UNFINISHED_FOLDER, Task, Workspace, identity, run_tasks, workspace


def opened(output: Path, identity: str) -> AbstractContextManager[Workspace[int]]:
    return workspace(output, identity, json.dumps, json.loads)


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def interrupted(output: Path, identity: str, work_on: Callable[[Workspace[int]], object] = lambda _: None) -> None:
    with suppress(KeyboardInterrupt), opened(output, identity) as work:
        work_on(work)
        raise KeyboardInterrupt


def test_finished_tasks_are_found(tmp_path: Path) -> None:
    interrupted(tmp_path, "a", lambda work: work.keep("b/c, d", 2, {"x.pcd": b"points"}))
    seen: list[object] = []
    interrupted(tmp_path, "a", lambda work: seen.append((work.find("b/c, d"), (work.folder / "x.pcd").read_bytes())))
    assert seen == [(2, b"points")]
    with opened(tmp_path, "a") as work:
        assert (work.find("b/c, d"), work.find("b")) == (2, None)
    assert names(tmp_path) == set()


def test_other_work_begins_anew(tmp_path: Path) -> None:
    interrupted(tmp_path, "a", lambda work: work.keep("0", 1, {"x.pcd": b""}))
    (tmp_path / UNFINISHED_FOLDER / "sub").mkdir()
    with opened(tmp_path, "b") as work:
        assert work.find("0") is None
        assert names(work.folder) == {"identity.txt"}


def test_a_result_that_is_broken_is_not_done(tmp_path: Path) -> None:
    with opened(tmp_path, "a") as work:
        for name in ("0", "1"):
            work.keep(name, 1234)
        next(work.folder.glob("1.*")).write_text("12{")
        assert (work.find("0"), work.find("1")) == (1234, None)


def test_an_interruption_before_anything_is_done_leaves_nothing(tmp_path: Path) -> None:
    interrupted(tmp_path / "a" / "b", "a")
    assert list(tmp_path.iterdir()) == []


def test_two_at_a_time(tmp_path: Path) -> None:
    code = (
        "import sys, json; from pathlib import Path; from calibration.ci.execution.tasks import workspace\n"
        "with workspace(Path(sys.argv[1]), 'a', json.dumps, json.loads): pass"
    )
    with opened(tmp_path, "a"):
        other = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=False)
        with pytest.raises(InputError, match="another run uses this folder"), opened(tmp_path, "a"):
            pass
    assert "another run uses this folder; wait for it, or stop it" in other.stderr
    with opened(tmp_path, "a"):
        pass


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(InfrastructureError, match=r"file/inside: cannot be written: .*is a file"),
        opened(tmp_path / "file" / "inside", "a"),
    ):
        pass
    assert UNFINISHED_FOLDER not in names(tmp_path)


def test_identities_differ_in_every_part() -> None:
    assert identity(b"ab", b"c") != identity(b"a", b"bc")
    assert identity(b"a") == identity(b"a")


@pytest.mark.parametrize("workers", [1, 2])
def test_tasks_that_are_done_are_not_run_again(workers: int, tmp_path: Path) -> None:
    (tmp_path / "ran").mkdir()

    def work(number: int) -> int:
        (tmp_path / "ran" / str(number)).touch()
        return 10 * number

    def run(done: Callable[[int, int, int], None]) -> dict[str, int]:
        with opened(tmp_path, "a") as kept:
            tasks = [kept.keeping(Task.call(str(n), lambda n=n: work(n))) for n in range(9)]  # type: ignore[misc]
            return run_tasks(tasks, workers=workers, find=kept.find, done=done)

    def interrupt(count: int, _total: int, _result: int) -> None:
        if count == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(interrupt)
    before = {path.name for path in (tmp_path / "ran").iterdir()}
    assert 4 <= len(before) <= 9
    for name in before:
        (tmp_path / "ran" / name).unlink()
    counts: list[int] = []
    found = run(lambda count, total, _: counts.append(count + 100 * total))
    assert found == {str(n): 10 * n for n in range(9)}
    assert counts == [900 + n for n in range(1, 10)]
    assert {path.name for path in (tmp_path / "ran").iterdir()} == {str(n) for n in range(9)} - before
