"""An unfinished collection: what is done stays, of the same collection only, and for one process at a time."""

import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from calibration.errors import InputError, WorldError
from calibration.simulation.collection.record import Record
from calibration.simulation.collection.workspace import FOLDER, Workspace, identity, workspace


def names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def interrupted(output: Path, identity: str, work_on: Callable[[Workspace], object] = lambda _: None) -> None:
    with suppress(KeyboardInterrupt), workspace(output, identity) as work:
        work_on(work)
        raise KeyboardInterrupt


def test_what_is_done_is_found_again(rlbot_records: list[Record], tmp_path: Path) -> None:
    interrupted(tmp_path, "a", lambda work: work.add(rlbot_records[2], {"x.pcd": b"points"}))
    seen: list[object] = []
    interrupted(tmp_path, "a", lambda work: seen.append((work.records(), (work.folder / "x.pcd").read_bytes())))
    assert seen == [({2: rlbot_records[2]}, b"points")]
    with workspace(tmp_path, "a") as work:
        assert work.records() == {2: rlbot_records[2]}
    assert names(tmp_path) == set()


def test_another_collection_begins_anew(rlbot_records: list[Record], tmp_path: Path) -> None:
    interrupted(tmp_path, "a", lambda work: work.add(rlbot_records[0], {"x.pcd": b""}))
    (tmp_path / FOLDER / "sub").mkdir()
    with workspace(tmp_path, "b") as work:
        assert work.records() == {}
        assert names(work.folder) == {"lock", "identity.txt"}


def test_a_record_that_is_broken_is_not_done(rlbot_records: list[Record], tmp_path: Path) -> None:
    with workspace(tmp_path, "a") as work:
        work.add(rlbot_records[0], {})
        work.add(rlbot_records[1], {})
        path = next(work.folder.glob("*1.record.json"))
        path.write_text(path.read_text()[:-20])
        (work.folder / "x.record.json").write_text("[]")
        assert work.records() == {0: rlbot_records[0]}


def test_an_interruption_before_anything_is_done_leaves_nothing(tmp_path: Path) -> None:
    interrupted(tmp_path / "a" / "b", "a")
    assert list(tmp_path.iterdir()) == []


def test_two_at_a_time(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from calibration.simulation.collection.workspace import workspace\n"
        "with workspace(Path(sys.argv[1]), 'a'): pass"
    )
    with workspace(tmp_path, "a"):
        other = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=False)
        with (
            pytest.raises(InputError, match="another collection into this folder is running"),
            workspace(tmp_path, "a"),
        ):
            pass
    assert "another collection into this folder is running; wait or stop it" in other.stderr
    with workspace(tmp_path, "a"):
        pass


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(WorldError, match="file/inside: cannot be written: Not a directory"),
        workspace(tmp_path / "file" / "inside", "a"),
    ):
        pass
    assert FOLDER not in names(tmp_path)


def test_identities_differ_in_every_part() -> None:
    assert identity(b"ab", b"c") != identity(b"a", b"bc")
    assert identity(b"a") == identity(b"a")
