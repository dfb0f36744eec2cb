"""What a mount holds, as a tar: the same bytes for the same files, whoever owns them and whenever they were written."""

import hashlib
import os
import stat
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, cast

from calibration.errors import InputError, WorldError


@dataclass(frozen=True)
class Packed:
    """A tar that was written."""

    sha256: str
    size: int
    """Bytes."""


class _Hashing:
    """A file that is written, and its digest."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.digest = hashlib.sha256()
        self.size = 0

    def write(self, data: bytes) -> int:
        self.digest.update(data)
        self.size += len(data)
        return self._file.write(data)


def pack(folder: Path, file: IO[bytes]) -> Packed:
    """Write a folder's content as a tar.

    Everybody may read what is in it. Links inside stay links.

    Raises:
        InputError: something cannot be read, is no file or folder, or a link that leads out.
        WorldError: the tar cannot be written.
    """
    root = folder.resolve()
    hashing = _Hashing(file)
    try:
        with tarfile.open(fileobj=cast("IO[bytes]", hashing), mode="w|", format=tarfile.PAX_FORMAT) as archive:
            for path in _all_in(root):
                _add(archive, root, path)
    except OSError as error:
        raise WorldError(f"{folder}: cannot be packed: {error.strerror or error}") from error
    return Packed(hashing.digest.hexdigest(), hashing.size)


def _all_in(folder: Path) -> Iterator[Path]:
    """Everything below a folder, in an order that is always the same."""
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from None
    for path in entries:
        yield path
        if path.is_dir() and not path.is_symlink():
            yield from _all_in(path)


def _add(archive: tarfile.TarFile, root: Path, path: Path) -> None:
    status = path.lstat()
    entry = tarfile.TarInfo(path.relative_to(root).as_posix())
    executable = status.st_mode & 0o100
    entry.mode = 0o755 if executable or stat.S_ISDIR(status.st_mode) else 0o644
    if stat.S_ISLNK(status.st_mode):
        entry.type, entry.linkname = tarfile.SYMTYPE, _link_inside(root, path)
        archive.addfile(entry)
    elif stat.S_ISDIR(status.st_mode):
        entry.type = tarfile.DIRTYPE
        archive.addfile(entry)
    elif stat.S_ISREG(status.st_mode):
        entry.size = status.st_size
        try:
            content = path.open("rb")
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        with content:
            archive.addfile(entry, content)  # an OSError where it became shorter
    else:
        raise InputError(f"{path}: is no file or folder, but a device, a pipe or a socket: AWS Batch cannot have it")


def _link_inside(root: Path, path: Path) -> str:
    """What a link names, which is in the folder.

    Raises:
        InputError: it is not.
    """
    name = os.fspath(path.readlink())
    to = os.path.normpath(path.parent / name)
    if PurePosixPath(name).is_absolute() or not Path(to).is_relative_to(root):
        raise InputError(f"{path}: is a link to '{name}', which leads out of the folder: put a copy in its place")
    return name
