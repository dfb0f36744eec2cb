"""Packing of mounts as tar files."""

import io
import os
import socket
import tarfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.aws_batch.store import pack
from calibration.base import InfrastructureError, InputError
from tests.addons.aws_batch.client import unpacked


def packed(folder: Path) -> bytes:
    file = io.BytesIO()
    done = pack(folder, file)
    assert done.size == len(file.getvalue())
    return file.getvalue()


NAMES = st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), min_size=1, max_size=12).filter(
    lambda name: name not in (".", "..")
)


@given(st.dictionaries(NAMES, st.binary(max_size=2000), max_size=5))
def test_the_same_files_are_the_same_bytes_whenever_and_by_whom_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, files: dict[str, bytes]
) -> None:
    tars = []
    for turn in (0, 1):
        folder = tmp_path_factory.mktemp("in")
        for name, content in sorted(files.items(), reverse=bool(turn)):
            (folder / name).write_bytes(content)
            (folder / name).chmod(0o600 if turn else 0o664)
            os.utime(folder / name, (turn, turn))
        tars.append(packed(folder))
    assert tars[0] == tars[1]
    assert unpacked(tars[0]) == files


def test_folders_links_and_rights(tmp_path: Path) -> None:
    (tmp_path / "a" / "empty").mkdir(parents=True)
    (tmp_path / "a" / "run").write_text("x")
    (tmp_path / "a" / "run").chmod(0o700)
    (tmp_path / "latest").symlink_to("a/run")
    with tarfile.open(fileobj=io.BytesIO(packed(tmp_path))) as archive:
        members = {member.name: member for member in archive}
    assert list(members) == ["a", "a/empty", "a/run", "latest"]
    assert (members["a"].mode, members["a/run"].mode, members["latest"].linkname) == (0o755, 0o755, "a/run")
    assert {(m.uid, m.gid, m.uname, m.mtime) for m in members.values()} == {(0, 0, "", 0)}


@pytest.mark.parametrize("target", ["/etc/passwd", "../outside", "a/../../outside"])
def test_a_link_that_leads_out_is_refused(tmp_path: Path, target: str) -> None:
    (tmp_path / "in" / "a").mkdir(parents=True)
    (tmp_path / "outside").write_text("secret")
    (tmp_path / "in" / "link").symlink_to(target)
    with pytest.raises(
        InputError, match=r"link: is a link to '.*', which points out of the folder: replace it by a copy"
    ):
        packed(tmp_path / "in")


def test_special_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: is no file or folder"):
        packed(tmp_path)
    (tmp_path / "pipe").unlink()
    monkeypatch.chdir(tmp_path)  # paths of sockets must be short
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind("sock")
        with pytest.raises(InputError, match="sock: is no file or folder"):
            packed(tmp_path)


def test_unreadable_and_unwritable_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="nosuch: cannot be read: No such file"):
        packed(tmp_path / "nosuch")
    (tmp_path / "a").write_text("x")

    class Full(io.BytesIO):
        def write(self, data: object) -> int:
            raise OSError(28, "No space left on device")

    with pytest.raises(InfrastructureError, match="cannot be packed: No space left on device"):
        pack(tmp_path, Full())

    def refuse(self: Path, mode: str) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(InputError, match="a: cannot be read: Permission denied"):
        packed(tmp_path)
