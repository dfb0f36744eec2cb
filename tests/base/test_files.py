import os
import shutil
import signal
import tempfile
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from calibration.base import (
    InfrastructureError,
    InputError,
    follow_no_links,
    link_or_copy,
    temporary_folder,
    write_atomically,
)
from calibration.base.process import Terminated, terminate_cleanly


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_writes_into_folders_that_it_makes(tmp_path: Path) -> None:
    write_atomically(tmp_path / "a" / "b" / "c.txt", "line\r\nö\n")
    assert (tmp_path / "a" / "b" / "c.txt").read_bytes() == "line\r\nö\n".encode()
    assert names(tmp_path / "a" / "b") == ["c.txt"]


def test_replaces_the_old_content(tmp_path: Path) -> None:
    path = tmp_path / "c"
    path.write_text("a longer text that was there")
    write_atomically(path, b"\x00new")
    assert path.read_bytes() == b"\x00new"
    assert names(tmp_path) == ["c"]


def test_others_may_read_it_as_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("x")
    write_atomically(tmp_path / "atomic", "x")
    assert (tmp_path / "atomic").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_link_is_replaced_and_its_target_left_alone(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_text("old")
    link.symlink_to(target)
    write_atomically(link, "new")
    assert target.read_text() == "old"
    assert link.read_text() == "new"


def test_lone_surrogates_are_escaped(tmp_path: Path) -> None:
    write_atomically(tmp_path / "x", "half \udcff")
    assert (tmp_path / "x").read_text() == "half \\udcff"


def test_a_failure_is_an_infrastructure_error_with_file_and_reason(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(InfrastructureError, match=r"file/out\.json: cannot be written: File exists"):
        write_atomically(tmp_path / "file" / "out.json", "x")
    (tmp_path / "folder" / "inner").mkdir(parents=True)
    with pytest.raises(InfrastructureError, match="folder: cannot be written: Is a directory"):
        write_atomically(tmp_path / "folder", "x")
    assert names(tmp_path) == ["file", "folder"]


def test_a_long_name_is_no_problem_of_the_temporary_file(tmp_path: Path) -> None:
    write_atomically(tmp_path / ("ö" * 125), "x")
    with pytest.raises(InfrastructureError, match="File name too long"):
        write_atomically(tmp_path / ("ö" * 150), "x")


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_the_old_file_survives_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    path = tmp_path / "results.json"
    path.write_text("old")

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(os, "rename", fail)
    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises((InfrastructureError, KeyboardInterrupt)) as caught:
        write_atomically(path, "new")
    if isinstance(error, OSError):
        assert str(caught.value) == f"{path}: cannot be written: No space left on device"
    assert path.read_text() == "old"
    assert names(tmp_path) == ["results.json"]


@pytest.mark.parametrize("linked", [True, False])
def test_a_file_is_linked_or_where_that_is_impossible_copied(
    linked: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, target = tmp_path / "source", tmp_path / "folder" / "target"
    source.write_bytes(bytes(range(256)) * 10_000)  # several parts

    def refused(*_: object) -> None:
        raise OSError("no links")

    if not linked:
        monkeypatch.setattr(Path, "hardlink_to", refused)
    link_or_copy(source, target)
    assert target.read_bytes() == source.read_bytes()
    assert target.samefile(source) == linked
    assert names(target.parent) == ["target"]


@pytest.mark.parametrize(("module", "function"), [(tempfile, "mkdtemp"), (shutil, "rmtree")])
def test_a_temporary_folder_is_removed_whenever_a_signal_arrives(
    module: ModuleType, function: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = getattr(module, function)

    def interrupted(*arguments: Any, **named: Any) -> object:
        done = real(*arguments, **named) if function == "mkdtemp" else None
        signal.raise_signal(signal.SIGTERM)
        return done or real(*arguments, **named)

    monkeypatch.setattr(module, function, interrupted)
    with pytest.raises(Terminated), terminate_cleanly(), temporary_folder(parent=tmp_path) as folder:
        (folder / "file").touch()
    assert list(tmp_path.iterdir()) == []


def test_a_temporary_folder_is_new_where_it_was_asked_for(tmp_path: Path) -> None:
    with temporary_folder("some-", tmp_path) as folder, temporary_folder("some-", tmp_path) as other:
        assert folder != other
        assert {each.parent for each in (folder, other)} == {tmp_path}
        assert folder.name.startswith("some-")
        assert folder.stat().st_mode & 0o777 == 0o700
    assert names(tmp_path) == []


def test_what_cannot_be_removed_is_an_error_or_stays(tmp_path: Path) -> None:
    for ignore in (False, True):
        with (
            nullcontext() if ignore else pytest.raises(NotADirectoryError),
            temporary_folder(parent=tmp_path, ignore_cleanup_errors=ignore) as folder,
        ):
            folder.rmdir()
            folder.touch()
        folder.unlink()


@pytest.mark.parametrize("relative", [True, False])
def test_nothing_is_written_through_a_link_in_the_output(
    relative: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    elsewhere, output = tmp_path / "elsewhere", Path("out") if relative else tmp_path / "out"
    elsewhere.mkdir()
    (tmp_path / "output").mkdir()
    (tmp_path / "out").symlink_to("output")  # the output itself may be a link: the caller named it
    (output / "robot").symlink_to(elsewhere)
    write_atomically(output / "robot" / "before", "x")
    follow_no_links(output)
    for name in ("robot/a", "robot/deep/a", "b/../robot/a"):
        with pytest.raises(InputError, match="out/robot: found a link, expected a folder"):
            write_atomically(output / name, "x")
    assert names(elsewhere) == ["before"]
    write_atomically(output / "other" / "a", "x")
    (output / "results.json").symlink_to(elsewhere / "before")
    write_atomically(output / "results.json", "new")
    assert (elsewhere / "before").read_text() == "x"
    assert (output / "other" / "a").read_text() == "x"
