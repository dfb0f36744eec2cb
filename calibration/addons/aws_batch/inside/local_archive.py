"""The job's volume as tar streams, read without following links, because its content is untrusted."""

import os
import posixpath
import stat
import tarfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from calibration.base import InfrastructureError, one_line, shorten
from calibration.ci.execution.extraction import RefusedError
from calibration.ci.execution.job import OUTPUT
from calibration.ci.execution.outcome import Archive, NothingThereError, Opener

_CHUNK_BYTES = 1024**2
_BLOCK_BYTES = tarfile.BLOCKSIZE
_END_OF_ARCHIVE = b"\0" * 2 * _BLOCK_BYTES
_MAX_LINKS = 40
"""Linux's limit."""
_FOLDER_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE_FLAGS = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def opener_of(folder: Path) -> Opener:
    """Return an opener for the files below `OUTPUT`, which is mounted at ``folder`` here."""

    @contextmanager
    def opened(path: str) -> Iterator[Archive]:
        parts = _parts_inside(path)
        if parts is None:
            raise RefusedError(f"artifact '{path}' is not below {OUTPUT}: other folders are not accessible")
        with ExitStack() as folders:
            try:
                above = folders.enter_context(_open_descriptor(os.open(folder, _FOLDER_FLAGS)))
                *way, name = _without_links(folder, path, parts) or (".",)
                for part in way:
                    above = folders.enter_context(_open_descriptor(os.open(part, _FOLDER_FLAGS, dir_fd=above)))
                os.stat(name, dir_fd=above, follow_symlinks=False)
            except (FileNotFoundError, NotADirectoryError):
                raise NothingThereError from None
            except OSError as error:
                raise InfrastructureError(f"artifact '{path}' cannot be read: {error.strerror}") from error
            yield Archive(_stream_archive(above, name, parts[-1] if parts else "output"), "")

    return opened


def _parts_inside(path: str) -> tuple[str, ...] | None:
    """Return the parts of a path below `OUTPUT`, without ``.`` and ``..``; None if it is outside."""
    normal = posixpath.normpath(path)
    if not f"{normal}/".startswith(f"{OUTPUT}/"):
        return None
    return tuple(part for part in normal.removeprefix(OUTPUT).split("/") if part)


def _without_links(folder: Path, path: str, parts: Sequence[str]) -> tuple[str, ...]:
    """Resolve the links in a path below `OUTPUT`.

    Raises:
        OSError: the path does not exist.
        RefusedError: a link points outside, or links form a cycle.
    """
    done: tuple[str, ...] = ()
    left = list(parts)
    links = 0
    while left:
        part = left.pop(0)
        here = folder.joinpath(*done, part)
        if not stat.S_ISLNK(here.lstat().st_mode):
            done = (*done, part)
            continue
        to = str(here.readlink())
        links += 1
        inside = _parts_inside(posixpath.join(OUTPUT, *done, to))
        if inside is None or links > _MAX_LINKS:
            shown = shorten(one_line(to), 200)
            raise RefusedError(f"artifact '{path}' is behind a link to '{shown}', which leaves the folder")
        done, left = (), [*inside, *left]
    return done


def _stream_archive(above: int, name: str, shown: str) -> Iterator[bytes]:
    """Yield the tar of a file or folder.

    Raises:
        InfrastructureError: it cannot be read.
    """
    try:
        yield from _stream_entries(above, name, shown)
    except OSError as error:
        raise InfrastructureError(
            f"artifact '{shorten(one_line(shown), 200)}' cannot be read: {error.strerror}"
        ) from error
    yield _END_OF_ARCHIVE


def _stream_entries(above: int, name: str, path: str) -> Iterator[bytes]:
    status = os.stat(name, dir_fd=above, follow_symlinks=False)
    entry = tarfile.TarInfo(path)
    if stat.S_ISDIR(status.st_mode):
        entry.type = tarfile.DIRTYPE
        yield _tar_header(entry)
        with _open_descriptor(os.open(name, _FOLDER_FLAGS, dir_fd=above)) as folder:
            for child in sorted(os.listdir(folder)):  # noqa: PTH208 (a descriptor)
                yield from _stream_entries(folder, child, f"{path}/{child}")
    elif stat.S_ISREG(status.st_mode):
        with _open_descriptor(os.open(name, _FILE_FLAGS, dir_fd=above)) as file:
            entry.size = os.fstat(file).st_size
            yield _tar_header(entry)
            yield from _stream_content(file, entry)
    else:
        entry.type = tarfile.SYMTYPE if stat.S_ISLNK(status.st_mode) else tarfile.FIFOTYPE
        if entry.type == tarfile.SYMTYPE:
            entry.linkname = os.readlink(name, dir_fd=above)
        yield _tar_header(entry)


def _tar_header(entry: tarfile.TarInfo) -> bytes:
    return entry.tobuf(tarfile.PAX_FORMAT, "utf-8", "surrogateescape")


def _stream_content(file: int, entry: tarfile.TarInfo) -> Iterator[bytes]:
    left = entry.size
    while left:
        chunk = os.read(file, min(left, _CHUNK_BYTES))
        if not chunk:
            raise InfrastructureError(
                f"artifact '{shorten(one_line(entry.name), 200)}' became shorter while it was read"
            )
        left -= len(chunk)
        yield chunk
    yield b"\0" * (-entry.size % _BLOCK_BYTES)


@contextmanager
def _open_descriptor(descriptor: int) -> Iterator[int]:
    try:
        yield descriptor
    finally:
        os.close(descriptor)
